"""The simulated RGB-D camera: rendering, its rate and latency."""

from __future__ import annotations

import re

import numpy as np
from pydrake.geometry import (
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, LeafSystem
from pydrake.systems.primitives import Demultiplexer
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from twin_diagram.errors import ScenarioError
from twin_diagram.native import require_egl
from twin_diagram.scenario import Camera, Scenario
from twin_diagram.scenario.lenses import colour_lens, depth_lens
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.add_models import transform
from twin_diagram.station.sim.camera_defects import CameraDefectsSystem, check_defects
from twin_diagram.station.sim.camera_profiles import faults
from twin_diagram.station.sim.camera_truth import with_camera
from twin_diagram.station.sim.exposure_shutter import ExposureShutter
from twin_diagram.station.sim.real_camera import RealCamera
from twin_diagram.station.sim.render_settings import clipping, render_params
from twin_diagram.station.sim.world_plant import WorldPlant, build_appearance
from twin_diagram.station.sim.world_renderer import drakes_intrinsics

_RENDERER = "camera"
"""The name under which SceneGraph knows the render engine."""


def camera_info(camera: Camera) -> CameraInfo:
    """Return Drake's intrinsics of a camera as the twin is told of it, but for its distortion."""
    return drakes_intrinsics(colour_lens(camera))


def check_camera(camera: Camera, field: str = "twin.camera") -> None:
    """Refuse a camera that cannot be.

    Raises:
        ScenarioError: names the field.
    """
    if not re.fullmatch(r"\w[\w-]*", camera.name):
        raise ScenarioError(f"{field}.name", f"{camera.name!r} is not a name of letters, digits, _ and -")
    for name in ("width", "height", "focal", "rate"):
        if not getattr(camera, name) > 0:
            raise ScenarioError(f"{field}.{name}", f"{getattr(camera, name)} is not positive")
    if not 0 < camera.latency < 1.0 / camera.rate:
        period = f"{1 / camera.rate:.4g} s"
        raise ScenarioError(
            f"{field}.latency", f"{camera.latency} s is not between 0 and the time between frames, {period}"
        )
    if len(camera.depth_range) != 2 or not 0 < camera.depth_range[0] < camera.depth_range[1]:
        raise ScenarioError(f"{field}.depth_range", f"{camera.depth_range} is not [nearest, farthest]")
    colour_lens(camera, field)
    depth_lens(camera, field)


class Shutter(LeafSystem):
    """Remembers where everything was when the camera last took a picture.

    .. pydrake_system::

        name: Shutter
        input_ports:
        - positions
        output_ports:
        - positions_shown
        - capture_time

    Positions are captured at k / rate and stand on `positions_shown` (nq) from k / rate + latency on, with their
    `capture_time` (1) [s], `NEVER` before the first. State holds positions, not images: an image is rendered only where
    it is asked for, and is a function of the state.
    """

    def __init__(self, positions: Array, rate: float, latency: float, stops: float | None = None) -> None:
        """Build a shutter.

        Args:
            positions: (nq,) shown before the first capture.
            rate: captures per second [1/s].
            latency: less than the time between captures [s].
            stops: nothing is captured from then on [s]; None: it goes on.
        """
        super().__init__()
        self._stops = np.inf if stops is None else stops
        nq = len(positions)
        self._nq = nq
        self._positions = self.DeclareVectorInputPort("positions", nq)
        newest = np.concatenate([positions, [NEVER]])
        state = self.DeclareDiscreteState(np.concatenate([newest, newest]))
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, self._capture)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, latency, self._deliver)
        ticket = {self.discrete_state_ticket(state)}
        self.DeclareVectorOutputPort("positions_shown", nq, self._calc_positions, prerequisites_of_calc=ticket)
        self.DeclareVectorOutputPort("capture_time", 1, self._calc_time, prerequisites_of_calc=ticket)

    def _capture(self, context: Context, discrete: DiscreteValues) -> None:
        if context.get_time() >= self._stops:
            return
        shown = context.get_discrete_state_vector().value()[self._nq + 1 :]
        discrete.set_value(np.concatenate([self._positions.Eval(context), [context.get_time()], shown]))

    def _deliver(self, context: Context, discrete: DiscreteValues) -> None:
        captured = context.get_discrete_state_vector().value()[: self._nq + 1]
        discrete.set_value(np.concatenate([captured, captured]))

    def _calc_positions(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[self._nq + 1 : -1])

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output[0] = context.get_discrete_state_vector().value()[-1]


def add_cameras(
    builder: DiagramBuilder, scenario: Scenario, world: WorldPlant
) -> dict[str, CameraDefectsSystem | RealCamera]:
    """Add the cameras that the twin looks through, by name: see `add_camera`. The others take pictures on demand."""
    return {name: add_camera(builder, with_camera(scenario, name), world) for name in scenario.twin.perceiving}


def add_camera(builder: DiagramBuilder, scenario: Scenario, world: WorldPlant) -> CameraDefectsSystem | RealCamera:
    """Add the scenario's camera, which looks at the world.

    It captures at k / rate and delivers `latency` later.

    Args:
        builder: of the station.
        scenario: its ``twin.camera`` is not None.
        world: whose plant is in `builder`.

    Returns:
        The system whose output ports are the camera's.

    Raises:
        NativeLibraryError: EGL is missing.
        ScenarioError: a camera that cannot be.
    """
    camera = scenario.twin.camera
    assert camera is not None
    check_camera(camera)
    check_defects(camera, scenario.world.camera_defects)
    require_egl()
    if faults(scenario.world.camera_defects).plain and camera.depth is None and not any(camera.distortion):
        return _add_ideal_camera(builder, scenario, camera, world.plant)
    return _add_real_camera(builder, scenario, camera, world.plant)


def _add_real_camera(builder: DiagramBuilder, scenario: Scenario, camera: Camera, plant: MultibodyPlant) -> RealCamera:
    """Add a camera that takes colours and depth at two times, from two places, each through its own lens."""
    delay = faults(scenario.world.camera_defects).depth_delay / camera.rate
    start = plant.GetPositionsAndVelocities(plant.CreateDefaultContext())
    real = builder.AddNamedSystem(f"{camera.name}_real", RealCamera(scenario, len(start)))
    stops = scenario.world.camera_defects.stops
    shutter = builder.AddNamedSystem(
        f"{camera.name}_shutter",
        ExposureShutter(start, camera.rate, camera.latency, delay, stops, captured=real.expect),
    )
    builder.Connect(plant.get_state_output_port(), shutter.get_input_port())
    for name in ("colour_state", "depth_state", "capture_time"):
        builder.Connect(shutter.GetOutputPort(name), real.GetInputPort(name))
    return real


def _add_ideal_camera(
    builder: DiagramBuilder, scenario: Scenario, camera: Camera, plant: MultibodyPlant
) -> CameraDefectsSystem:
    """Add a camera whose depth is that of its colours, in time and place."""
    X_WC = transform(scenario.world.X_WC or camera.X_WC, "world.X_WC")
    beside = builder.HasSubsystemNamed("appearance")
    shown = build_appearance(builder, scenario, f"{camera.name}_appearance" if beside else "appearance")
    scene_graph = shown.scene_graph
    scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(render_params()))
    start = plant.GetPositions(plant.CreateDefaultContext())
    stops = scenario.world.camera_defects.stops
    shutter = builder.AddNamedSystem(f"{camera.name}_shutter", Shutter(start, camera.rate, camera.latency, stops))
    sizes = [plant.num_positions(), plant.num_velocities()]
    state = builder.AddNamedSystem(f"{camera.name}_positions", Demultiplexer(sizes))
    builder.Connect(plant.get_state_output_port(), state.get_input_port())
    builder.Connect(state.get_output_port(0), shutter.get_input_port())
    builder.Connect(shutter.GetOutputPort("positions_shown"), shown.poses.get_input_port())
    near, far = camera.depth_range
    core = RenderCameraCore(_RENDERER, camera_info(camera), clipping(camera), RigidTransform())
    sensor = builder.AddNamedSystem(
        f"{camera.name}_renderer",
        RgbdSensor(
            scene_graph.world_frame_id(),
            X_WC,
            ColorRenderCamera(core, False),
            DepthRenderCamera(core, DepthRange(near, far)),
        ),
    )
    builder.Connect(scene_graph.get_query_output_port(), sensor.query_object_input_port())
    spoilt = builder.AddNamedSystem(
        f"{camera.name}_defects", CameraDefectsSystem(camera, scenario.world.camera_defects, scenario.seed)
    )
    builder.Connect(sensor.color_image_output_port(), spoilt.GetInputPort("rgb_rendered"))
    builder.Connect(sensor.depth_image_32F_output_port(), spoilt.GetInputPort("depth_rendered"))
    builder.Connect(shutter.GetOutputPort("capture_time"), spoilt.GetInputPort("time_rendered"))
    return spoilt
