"""What the arm is commanded: the controller's commands, through the stop monitor where there is one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.model.model import Model
from twin_diagram.planning.braking.stop_monitor import StopMonitor
from twin_diagram.planning.tasks.task_system import TaskRunner
from twin_diagram.scene.updater_system import SceneGraphUpdater
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports
from twin_diagram.twin.own_systems import inputs_of
from twin_diagram.twin.true_angles import PUT, shifted


def add_stop_monitor(
    builder: DiagramBuilder,
    twin: scenario.Twin,
    model: Model,
    library: Mapping[str, Asset],
    packages: Mapping[str, str | Path] | None,
    parameter_names: Sequence[str],
) -> StopMonitor | None:
    """Add what stops the arm in time, unless the twin is told to have nothing of the kind.

    Raises:
        ModelError: a shape that cannot be read.
    """
    if twin.stop_monitor is None:
        return None
    return builder.AddNamedSystem("stop_monitor", StopMonitor(model, twin, library, packages, parameter_names))


def connect_commands(
    builder: DiagramBuilder,
    controller: System,
    monitor: StopMonitor | None,
    ekf: System,
    updater: SceneGraphUpdater,
    runner: TaskRunner | None,
    offset: Array | None,
) -> None:
    """Let the controller command the arm, through the monitor where there is one; show commands.

    Commands leave as encoders of this offset (n,) [rad] read them; None: there is no door.

    Further instances and unknown things come with the camera, messages' times with the arm's messages.
    """
    torque = controller.GetOutputPort("torque_commanded") if controller.HasOutputPort("torque_commanded") else None
    if monitor is None:
        size = controller.GetOutputPort("position_commanded").size()
        _export_position(builder, controller, offset)
        if torque is None:
            torque = builder.AddNamedSystem("no_torque", ConstantVectorSource(np.zeros(size))).get_output_port()
        builder.ExportOutput(torque, ports.TORQUE_COMMANDED)
        return
    for name in ("position_commanded", "torque_commanded", "plan_time"):
        if controller.HasOutputPort(name):
            builder.Connect(controller.GetOutputPort(name), monitor.GetInputPort(name))
    for source, names in ((ekf, ("arm_state", "parameters", "message_time")), (updater, ("tracks", "further_tracks"))):
        for name in names:
            builder.Connect(source.GetOutputPort(name), monitor.GetInputPort(name))
    if runner is not None:
        builder.Connect(runner.GetOutputPort("hand"), monitor.GetInputPort("hand"))
    for name in inputs_of(controller, ("brake",)):
        builder.Connect(monitor.GetOutputPort("brake"), controller.GetInputPort(name))
    _export_position(builder, monitor, offset)
    builder.ExportOutput(monitor.GetOutputPort("torque_commanded"), ports.TORQUE_COMMANDED)
    builder.ExportOutput(monitor.GetOutputPort("brake"), "brake")


def _export_position(builder: DiagramBuilder, system: System, offset: Array | None) -> None:
    port = shifted(builder, PUT, system.GetOutputPort("position_commanded"), offset)
    builder.ExportOutput(port, ports.POSITION_COMMANDED)
