"""What the twin acts on: one goal that stays, or the steps of a task, the gripper's commands, what comes of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import scenario_error
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.between_fingers import refuse_elsewhere, refuse_turning
from twin_diagram.planning.collision.geometry_to_solids import given_solids
from twin_diagram.planning.collision.hand_shape import hand_shape
from twin_diagram.planning.grasps.gripper import SHIPPED
from twin_diagram.planning.grasps.own_gripper import gripper_of_shape
from twin_diagram.planning.preview import Preview
from twin_diagram.planning.tasks.place_goals import check_places
from twin_diagram.planning.tasks.task_system import Fingers, TaskRunner
from twin_diagram.scenario import poses
from twin_diagram.scene.twin_scene import TwinScene
from twin_diagram.scene.updater_system import SceneGraphUpdater
from twin_diagram.signals.layouts import POSE_SIZE
from twin_diagram.station import ports
from twin_diagram.twin.own_systems import connect_ports, inputs_of


def goal_vector(task: scenario.Task) -> np.ndarray:
    """Return X_WG as (qw, qx, qy, qz, px, py, pz); zeros where there is no goal."""
    if task.X_WG is None:
        return np.zeros(POSE_SIZE)
    X_WG = poses.pose(task.X_WG)
    return np.concatenate([X_WG.rotation().ToQuaternion().wxyz(), X_WG.translation()])


def add_task(
    builder: DiagramBuilder,
    twin: scenario.Twin,
    packages: Mapping[str, str | Path] | None,
    model: Model,
    library: Mapping[str, Asset],
    scene: TwinScene,
) -> tuple[OutputPort, TaskRunner | None]:
    """Add what says where to go: return the port of the goal, and what runs the steps, where there are some.

    Raises:
        ScenarioError: a step that this arm cannot do, or a place where nothing can stand; it names the field.
    """
    if not twin.task.steps:
        source = builder.AddNamedSystem("goal", ConstantVectorSource(goal_vector(twin.task)))
        return source.get_output_port(), None
    if any(step.kind == "pick" for step in twin.task.steps):
        try:
            refuse_turning(scene.plant, scene.arm)
            refuse_elsewhere(scene.plant, scene.scene_graph, scene.arm)
        except ModelError as error:
            raise scenario_error("twin.arm", error) from error
    check_places(twin.task, library, given_solids(twin.arm, twin.fixtures, packages))
    described = scene.default_positions[scene.gripper_position_index]
    hand = hand_shape(scene.plant, scene.scene_graph, scene.arm)
    fingers = Fingers.of(scene.plant, scene.arm, described, scene.followers.widening, hand.palm)
    known = next((one for one in SHIPPED.values() if one.frame == twin.arm.tool_frame), None)
    gripper = known or gripper_of_shape(hand, f"{Path(twin.arm.model).stem}_hand", twin.arm.tool_frame or "tool")
    runner = builder.AddNamedSystem("task_runner", TaskRunner(model, twin, library, fingers, gripper))
    return runner.GetOutputPort("goal"), runner


def connect_task(
    builder: DiagramBuilder, runner: TaskRunner | None, ekf: System, updater: SceneGraphUpdater, controller: System
) -> None:
    """Let the steps, where there are some, see what the twin believes, and tell scene and controller of the hand."""
    if runner is None:
        return
    builder.Connect(ekf.GetOutputPort("arm_state"), runner.GetInputPort("arm_state"))
    for name in ("tracks", "further_tracks"):
        builder.Connect(updater.GetOutputPort(name), runner.GetInputPort(name))
    builder.Connect(runner.GetOutputPort("hand"), updater.GetInputPort("hand"))
    for name in inputs_of(controller, ("hand", "next_goal", "next_hand", "next_pause")):
        builder.Connect(runner.GetOutputPort(name), controller.GetInputPort(name))
    if controller.HasOutputPort("reach"):
        builder.Connect(controller.GetOutputPort("reach"), runner.GetInputPort("reach"))
    for name in ("step", "outcome", "hand", "notes"):
        builder.ExportOutput(runner.GetOutputPort(name), f"task.{name}")


def add_preview(builder: DiagramBuilder, twin: scenario.Twin, model: Model, ekf: System, controller: System) -> Preview:
    """Add what foresees the arm, by the controller's plan where it has one, and show what it says."""
    told = twin.planner.velocity_share * np.where(np.isfinite(model.velocity_limit), model.velocity_limit, np.pi)
    made = Preview(model, ekf.GetOutputPort("covariance").size(), told)
    preview = builder.AddNamedSystem("preview", made)
    connect_ports(builder, ekf, preview, "arm_state", "covariance")
    if controller.HasOutputPort("position_planned"):
        connect_ports(builder, controller, preview, "position_planned")
    for name in ("position_previewed", "preview_covariance"):
        builder.ExportOutput(preview.GetOutputPort(name), name)
    return preview


def export_acting(
    builder: DiagramBuilder,
    goal: OutputPort,
    scene: TwinScene,
    updater: SceneGraphUpdater,
    runner: TaskRunner | None,
) -> None:
    """Show the goal, tell all that ask where the fingers are, and command them as the steps say, else as described."""
    builder.ExportOutput(goal, "goal")
    if not scene.gripper_position_index.size:
        return
    state = builder.ExportInput(updater.GetInputPort("gripper_state"), ports.GRIPPER_MEASURED)
    for system in builder.GetSystems():
        if system is not updater and system.HasInputPort("gripper_state"):
            builder.ConnectInput(state, system.GetInputPort("gripper_state"))
    if runner is not None:
        builder.ExportOutput(runner.GetOutputPort("gripper_position_commanded"), ports.GRIPPER_COMMANDED)
        builder.ExportOutput(runner.GetOutputPort("gripper_force_limit"), ports.GRIPPER_FORCE_LIMIT)
        return
    fingers = scene.default_positions[scene.gripper_position_index]
    grip = builder.AddNamedSystem("gripper_command", ConstantVectorSource(fingers))
    builder.ExportOutput(grip.get_output_port(), ports.GRIPPER_COMMANDED)
