"""The simulated station's further cameras: a picture is rendered where somebody asks for one, and at no other time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import DepthRange

from twin_diagram.errors import StationError
from twin_diagram.native import require_egl
from twin_diagram.scenario import Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.station.depth_units import Colour, Depth
from twin_diagram.station.sim.camera import check_camera
from twin_diagram.station.sim.camera_defects import check_defects
from twin_diagram.station.sim.camera_light import DimLight
from twin_diagram.station.sim.camera_profiles import faults
from twin_diagram.station.sim.camera_truth import TrueCamera, true_camera, with_camera
from twin_diagram.station.sim.depth_sensor import DepthSensor
from twin_diagram.station.sim.render_settings import clipping, render_params
from twin_diagram.station.sim.world_renderer import LensView, WorldRenderer


@dataclass(frozen=True)
class _Eye:
    """One camera: what it truly is, what it does to light and depth, and when it shows nothing: from, to [s]."""

    truth: TrueCamera
    views: tuple[LensView, LensView]
    light: DimLight
    depth: DepthSensor
    dark: tuple[tuple[float, float], ...]


class CamerasOnDemand:
    """Renders the world of a scenario through the cameras of ``twin.cameras``, with the defects that ``world`` says.

    What one delivers is a function of the scenario's seed, the frame's number, the time and the world's positions
    alone. Motion blur and the delay of depth are left out: pictures are of one instant. One that is covered or has
    stopped delivers black pictures without depth.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build one renderer for all of them.

        Raises:
            ScenarioError: a camera that cannot be; it names the field.
            NativeLibraryError: EGL is missing.
        """
        cameras = scenario.twin.cameras
        for name, camera in cameras.items():
            check_camera(replace(camera, name=name), f"twin.cameras.{name}")
            check_defects(camera, with_camera(scenario, name).world.camera_defects)
        require_egl()
        self._eyes = {name: _eye(scenario, name) for name in cameras}
        if not cameras:
            return
        widest = max(cameras.values(), key=lambda camera: camera.depth_range[1])
        near = min(camera.depth_range[0] for camera in cameras.values())
        depth_range = DepthRange(near, widest.depth_range[1])
        self._renderer = WorldRenderer(scenario, render_params(), clipping(widest), depth_range)

    def look(self, name: str, positions: Array, number: int, time: float = 0.0) -> tuple[Colour, Depth]:
        """Return colours (H, W, 4) and depth (H', W') of a camera; depth in its units of length, 0 where none is.

        Args:
            name: of the camera.
            positions: (nq,) of the world's plant.
            number: of the frame, from which its noise is drawn.
            time: when it is taken [s].

        Raises:
            StationError: no such camera.
        """
        if name not in self._eyes:
            raise StationError(f"no camera {name!r}; these are: {', '.join(self._eyes) or 'none'}")
        eye = self._eyes[name]
        q = np.asarray(positions)
        colour = eye.light.seen(self._renderer.colour(q, eye.views[0], eye.truth.X_WC).copy(), number)
        depth = eye.depth.measured(self._renderer.depth(q, eye.views[1], eye.truth.X_WD).copy(), number)
        if any(start <= time <= end for start, end in eye.dark):
            return np.zeros_like(colour), np.zeros_like(depth)
        return colour, depth


def _eye(scenario: Scenario, name: str) -> _Eye:
    """Return a camera; each one's errors are drawn from a seed of its own."""
    own = with_camera(scenario, name)
    camera, defects = own.twin.camera, own.world.camera_defects
    assert camera is not None
    truth, off = true_camera(own), faults(defects)
    dark = [(start, end) for start, end in defects.covered]
    if defects.stops is not None:
        dark.append((defects.stops, np.inf))
    return _Eye(
        truth,
        (LensView(truth.colour), LensView(truth.depth)),
        DimLight(camera.width * camera.height * 4, defects.colour_noise, off, own.seed),
        DepthSensor(truth.depth, camera, off, defects.depth_unit, truth.depth_scale, own.seed),
        tuple(dark),
    )
