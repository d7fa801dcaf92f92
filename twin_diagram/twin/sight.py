"""Wires what leads from the cameras' images to the objects' poses, and those to whoever wants to know of them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram import scenario
from twin_diagram.assets.asset import Asset
from twin_diagram.errors import TwinError
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.perception.registration.pose_system import IcpPoseEstimator
from twin_diagram.perception.segmentation.learned import Segmenter
from twin_diagram.perception.segmentation.segmentation_system import PerceptionSystem
from twin_diagram.planning.braking.stop_monitor import StopMonitor
from twin_diagram.planning.tasks.task_system import TaskRunner
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.scene.updater_system import SceneGraphUpdater
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER
from twin_diagram.station import ports
from twin_diagram.twin.added_assets import Sight
from twin_diagram.twin.arm_sensing.camera_calibrator import add_calibrator
from twin_diagram.twin.given_files import Packages
from twin_diagram.twin.health import HealthMonitor
from twin_diagram.twin.own_systems import VALUE, check, connect_ports, inputs_of
from twin_diagram.twin.several_cameras import add_several_cameras

SightT = TypeVar("SightT", bound=System)


def add_sight(
    builder: DiagramBuilder,
    twin: scenario.Twin,
    library: dict[str, Asset],
    packages: Packages | None,
    ekf: AdaptiveEkf,
    updater: SceneGraphUpdater,
    health: HealthMonitor,
    moves: System,
    own: System | None,
    runner: TaskRunner | None,
    monitor: StopMonitor | None,
    segmenter: Segmenter | None,
) -> Sight | None:
    """Add what leads from the cameras to the scene; without a camera, what says that nothing was seen."""
    cameras = list(twin.perceiving.values())
    if not cameras and own is None:
        _add_nothing_seen(builder, updater, len(library))
        return None
    if not cameras and own is not None:
        _add_poses_from_elsewhere(builder, own, ekf, updater, len(library))
        _tell_of_sight(builder, own, updater, health, moves, runner, monitor)
        return None
    if len(cameras) > 1:
        if own is not None:
            raise TwinError(f"perception: it sees through one camera, not through {', '.join(twin.perceiving)}")
        timed = [system for system in (updater, monitor) if system is not None]
        eyes = add_several_cameras(builder, twin, library, packages, ekf, timed, health, segmenter)
        connect_ports(builder, eyes, updater, "rests")
        return _tell_of_sight(builder, eyes, updater, health, moves, runner, monitor)
    camera = cameras[0]
    first: System
    last: System
    if own is None:
        first, last = _own_eyes(twin, library, camera, packages, segmenter)
        builder.AddNamedSystem("icp_pose_estimator", last)
    else:
        images = {"rgb_image": VALUE, "depth_image": VALUE, "image_time": 1}
        state = ekf.GetOutputPort("arm_state").size()
        check("perception", own, {**images, "arm_state": state}, {"object_poses": MEASUREMENT_SIZE * len(library)}, {})
        first = last = own
    builder.AddNamedSystem("perception", first)
    for port, name in (("rgb_image", ports.rgb_image(camera.name)), ("depth_image", ports.depth_image(camera.name))):
        if first.HasInputPort(port):
            builder.ExportInput(first.GetInputPort(port), name)
    users = (first, updater, health, *([] if monitor is None else [monitor]))
    timed = [system for system in users if system.HasInputPort("image_time")]
    image_time = builder.ExportInput(timed[0].GetInputPort("image_time"), ports.image_time(camera.name))
    for system in timed[1:]:
        builder.ConnectInput(image_time, system.GetInputPort("image_time"))
    connect_ports(builder, ekf, first, *inputs_of(first, ("arm_state",)))
    if own is None:
        connect_ports(builder, first, last, "segments", *inputs_of(last, ("picture",)))
    if own is None and calibration_error(camera).variances.any():
        calibrator = add_calibrator(builder, twin.arm, camera, twin.perception, packages)
        connect_ports(builder, ekf, calibrator, "arm_state")
        for user in (first, updater, *([] if runner is None else [runner])):
            connect_ports(builder, calibrator, user, "calibration")
    _tell_of_sight(builder, last, updater, health, moves, runner, monitor)
    return last if isinstance(last, IcpPoseEstimator) else None


def _add_nothing_seen(builder: DiagramBuilder, updater: SceneGraphUpdater, objects: int) -> None:
    blind = builder.AddNamedSystem("no_camera", ConstantVectorSource(np.array([NEVER])))
    nothing = builder.AddNamedSystem("no_poses", ConstantVectorSource(np.zeros(MEASUREMENT_SIZE * objects)))
    builder.Connect(blind.get_output_port(), updater.GetInputPort("image_time"))
    builder.Connect(nothing.get_output_port(), updater.GetInputPort("object_poses"))


def _add_poses_from_elsewhere(
    builder: DiagramBuilder, own: System, ekf: AdaptiveEkf, updater: SceneGraphUpdater, objects: int
) -> None:
    """Add a user's System that knows poses without a camera, by markers for example."""
    inputs = {"arm_state": ekf.GetOutputPort("arm_state").size()}
    check("perception", own, inputs, {"object_poses": MEASUREMENT_SIZE * objects, "image_time": 1}, {})
    builder.AddNamedSystem("perception", own)
    connect_ports(builder, ekf, own, *inputs_of(own, ("arm_state",)))
    connect_ports(builder, own, updater, "image_time")


def _own_eyes(
    twin: scenario.Twin,
    library: dict[str, Asset],
    camera: scenario.Camera,
    packages: Packages | None,
    segmenter: Segmenter | None,
) -> tuple[PerceptionSystem, IcpPoseEstimator]:
    """Return what takes a camera's images apart, and what finds objects in them."""
    first = PerceptionSystem(twin.arm, camera, twin.perception, packages, segmenter=segmenter)
    settings = (twin.registration, twin.perception, twin.slots, twin.scene)
    # A user's segmenter stays in the process that it was made in.
    return first, IcpPoseEstimator(library, camera, *settings, first.parting if segmenter is None else None)


def _tell_of_sight(
    builder: DiagramBuilder,
    last: SightT,
    updater: SceneGraphUpdater,
    health: HealthMonitor,
    moves: System,
    runner: TaskRunner | None,
    monitor: StopMonitor | None,
) -> SightT:
    """Connect what finds objects to whoever wants to know of them; return it."""
    for user in (updater, *([] if runner is None else [runner])):
        connect_ports(builder, last, user, "object_poses")
    for eye in builder.GetSystems() if runner is not None else ():
        if isinstance(eye, PerceptionSystem):
            connect_ports(builder, runner, eye, "hand")
    builder.ExportOutput(last.GetOutputPort("object_poses"), "object_poses")
    # What a user's own perception does not tell of, there is none of.
    for name, systems in (("further_poses", (updater,)), ("things", (updater,)), ("turned_away", (health,))):
        if last.HasOutputPort(name):
            for system in systems:
                connect_ports(builder, last, system, *inputs_of(system, (name,)))
            builder.ExportOutput(last.GetOutputPort(name), name)
    if last.HasOutputPort("things"):  # where they are by now
        for user in (moves, *filter(None, (monitor, runner))):
            connect_ports(builder, updater, user, *inputs_of(user, ("things",)))
    return last
