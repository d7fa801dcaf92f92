"""Where the simulated camera and its lenses really are: near what the twin is told, and not quite there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import copy_scenario
from twin_diagram.scenario.lenses import colour_lens, depth_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import Lens
from twin_diagram.station.sim.camera_noise import TUNING as NOISE
from twin_diagram.station.sim.camera_profiles import faults
from twin_diagram.station.sim.noise import Stream, generator


@dataclass(frozen=True)
class TrueCamera:
    """A camera as it is.

    Attributes:
        colour: lens of the colours.
        X_WC: pose of the colours' optical frame C.
        depth: lens of depth.
        X_WD: pose of depth's optical frame D.
        depth_scale: what true depth [m] is multiplied by in the images.
    """

    colour: Lens
    X_WC: RigidTransform
    depth: Lens
    X_WD: RigidTransform
    depth_scale: float = 1.0


def with_camera(scenario: Scenario, name: str) -> Scenario:
    """Return a scenario whose one camera is that of a name, as it really is; the scenario itself for ``twin.camera``.

    Each camera's errors and noise are drawn from a seed of its own.

    Args:
        scenario: of several cameras.
        name: of ``twin.camera``, or one of ``twin.cameras``.

    Raises:
        ScenarioError: ``world.cameras`` tells of a camera that the twin does not have.
    """
    twin, world = scenario.twin, scenario.world
    for other in world.cameras:
        if other not in twin.cameras:
            told = ", ".join(twin.cameras) or "none"
            raise ScenarioError(f"world.cameras.{other}", f"none of twin.cameras is called so; these are: {told}")
    if twin.camera is not None and name == twin.camera.name:
        return scenario
    number = 1 + list(twin.cameras).index(name)
    own = copy_scenario(scenario)
    own.twin.camera = replace(twin.cameras[name], name=name)
    told_of = world.cameras.get(name)
    own.world.X_WC = None if told_of is None else told_of.X_WC
    if told_of is not None and told_of.defects is not None:
        own.world.camera_defects = told_of.defects
    own.seed = scenario.seed * 101 + number
    return own


def true_camera(scenario: Scenario) -> TrueCamera:
    """Return the true camera of a scenario, drawn from its seed: each figure is off by as much as `world` says.

    Lengths are as told and directions are drawn: 5 mm is 5 mm somewhere, 0.3 % is more or less.

    Args:
        scenario: its ``twin.camera`` is not None.

    Raises:
        ScenarioError: defects or intrinsics that make no sense.
    """
    camera, world = scenario.twin.camera, scenario.world
    assert camera is not None
    off = faults(world.camera_defects)
    rng = generator(scenario.seed, Stream.CAMERA_TRUTH, 0)
    shift, turn = off.X_WC_error[0] * _direction(rng, 3), off.X_WC_error[1] * _direction(rng, 3)
    signs = np.sign(rng.uniform(-1.0, 1.0, 2))
    pixel = camera.width / NOISE.width
    centre = off.centre_error * pixel * _direction(rng, 2)
    aside = off.colour_offset * pixel * float(rng.uniform()) * _direction(rng, 2)
    zoom, scale = 1.0 + off.focal_error * signs[0], 1.0 + off.depth_scale_error * signs[1]
    if world.X_WC is not None:
        X_WC = pose(world.X_WC)
    elif off.X_WC_error == (0.0, 0.0):
        X_WC = pose(camera.X_WC)
    else:
        told = pose(camera.X_WC)
        X_WC = RigidTransform(_rotation(turn) @ told.rotation(), told.translation() + shift)
    colour = _off(colour_lens(camera), zoom, centre + aside)
    if camera.depth is None:
        return TrueCamera(colour, X_WC, _off(colour_lens(camera), zoom, centre), X_WC, scale)
    depth = _off(depth_lens(camera), zoom, centre * (camera.depth.width / camera.width))
    return TrueCamera(colour, X_WC, depth, X_WC @ pose(camera.depth.X_DC).inverse(), scale / camera.depth.scale)


def _direction(rng: np.random.Generator, size: int) -> Array:
    vector = rng.standard_normal(size)
    return np.asarray(vector / np.linalg.norm(vector))


def _rotation(turn: Array) -> RotationMatrix:
    angle = float(np.linalg.norm(turn))
    return RotationMatrix(AngleAxis(angle, turn / angle)) if angle > 0 else RotationMatrix()


def _off(lens: Lens, zoom: float, centre: Array) -> Lens:
    return replace(lens, fx=lens.fx * zoom, fy=lens.fy * zoom, cx=lens.cx + centre[0], cy=lens.cy + centre[1])
