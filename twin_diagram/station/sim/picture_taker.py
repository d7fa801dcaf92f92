"""Takes the pictures of a camera as bad as real ones: functions of the scenario, the frame's number and a state alone.

So they may be taken anywhere: here when they are asked for, or in a process of their own, with the same result to the
bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.geometry import DepthRange

from twin_diagram.scenario import Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.station.depth_units import Colour, Depth
from twin_diagram.station.sim.camera_light import DimLight, mean_of
from twin_diagram.station.sim.camera_profiles import faults
from twin_diagram.station.sim.camera_truth import true_camera
from twin_diagram.station.sim.depth_sensor import DepthSensor
from twin_diagram.station.sim.render_settings import clipping, render_params
from twin_diagram.station.sim.world_renderer import LensView, WorldRenderer


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    still: float = 1e-4
    """What moves less while the shutter is open is not blurred [m; rad]: a tenth of a pixel at 1 m."""


TUNING = Tuning()


@dataclass(frozen=True)
class Exposure:
    """What a frame is taken of.

    Attributes:
        number: of the frame.
        colour_state: (nq + nv) of the world's plant when colours were taken, as bytes.
        depth_state: likewise, of depth.
    """

    number: int
    colour_state: bytes
    depth_state: bytes


class PictureTaker:
    """Renders what a scenario's camera saw and turns it into what it delivers."""

    def __init__(self, scenario: Scenario) -> None:
        """Draw what is fixed for the run; the world's appearance is built for the first picture.

        Args:
            scenario: its ``twin.camera`` is not None, and its defects were checked.
        """
        camera, defects = scenario.twin.camera, scenario.world.camera_defects
        assert camera is not None
        self._scenario, self._camera = scenario, camera
        self._off, self._truth = faults(defects), true_camera(scenario)
        truth = self._truth
        self._views = (LensView(truth.colour), LensView(truth.depth))
        size = camera.width * camera.height * 4
        self._light = DimLight(size, defects.colour_noise, self._off, scenario.seed)
        self._sensor = DepthSensor(truth.depth, camera, self._off, defects.depth_unit, truth.depth_scale, scenario.seed)

    def __reduce__(self) -> tuple[type[PictureTaker], tuple[Scenario]]:
        """Copy what it is made of: renderers cannot be."""
        return PictureTaker, (self._scenario,)

    def answer(self, exposure: Exposure) -> tuple[Colour, Depth]:
        """Return colours (H, W, 4) and depth (H', W') of a frame; see `colour` and `depth`."""
        return self.colour(exposure), self.depth(exposure)

    def warm_up(self) -> None:
        """Take a picture for nothing: the world's appearance is built then, and compiled loops are loaded."""
        state = self._renderer.any_state()
        self.answer(Exposure(0, state.tobytes(), state.tobytes()))

    def colour(self, exposure: Exposure) -> Colour:
        """Return the colours (H, W, 4) of a frame.

        The blur of what moves is the mean of two pictures, of the shutter's opening and of its closing.
        """
        state = np.frombuffer(exposure.colour_state)
        return self._light.seen(self._exposed(state), exposure.number)

    def depth(self, exposure: Exposure) -> Depth:
        """Return the depth (H, W) of a frame in the camera's units of length, 0 where nothing was measured."""
        q = np.frombuffer(exposure.depth_state)[: self._renderer.position_count]
        view, X_WD = self._views[1], self._truth.X_WD
        depth = self._renderer.depth(q, view, X_WD)
        shining = self._renderer.shows(q, view, X_WD, self._labels) if self._labels else None
        return self._sensor.measured(depth, exposure.number, shining)

    @cached_property
    def _renderer(self) -> WorldRenderer:
        near, far = self._camera.depth_range
        return WorldRenderer(self._scenario, render_params(), clipping(self._camera), DepthRange(near, far))

    @cached_property
    def _labels(self) -> list[int]:
        """Labels of the bodies that reflect."""
        objects = self._scenario.world.objects.items()
        return [int(self._renderer.objects[name]) for name, item in objects if item.reflective]

    def _exposed(self, state: Array) -> Colour:
        """Return the picture (H, W, 4) of a shutter that is open about the moment of a state."""
        nq = self._renderer.position_count
        q, v = state[:nq], state[nq:]
        view, X_WC = self._views[0], self._truth.X_WC
        if float(np.abs(v).max(initial=0.0)) * self._off.exposure < TUNING.still:
            return self._renderer.colour(q, view, X_WC)
        half = 0.5 * self._off.exposure * self._renderer.rates(state)
        return mean_of(*self._renderer.colours(q - half, q + half, view, X_WC))
