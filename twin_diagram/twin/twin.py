"""Wires the systems of the twin: with `closed_loop`, the only place where systems meet.

The twin is one Diagram whose inputs are a station's outputs and whose outputs are a station's inputs, by the same
names. It is built from the scenario's ``twin:`` alone, so it cannot know what a simulated world hides.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, OutputPort, System

from twin_diagram import scenario
from twin_diagram.assets.asset import Asset
from twin_diagram.estimation.drift_system import DriftMonitor
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.model.model import Model
from twin_diagram.perception.segmentation.learned import Segmenter
from twin_diagram.planning.braking.stop_monitor import StopMonitor
from twin_diagram.planning.mpc_system import Mpc
from twin_diagram.planning.preview import Preview
from twin_diagram.planning.tasks.task_system import TaskRunner
from twin_diagram.scenario.validation import check_twin
from twin_diagram.scene import object_events
from twin_diagram.scene.object_events import Names
from twin_diagram.scene.twin_scene import TwinScene, add_twin_scene
from twin_diagram.scene.updater_system import SceneGraphUpdater
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import HAND_SIZE
from twin_diagram.signals.layouts import POSE_SIZE, TRACK_SIZE
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, THING_SIZE
from twin_diagram.station import ports
from twin_diagram.twin.acting import add_preview, add_task, connect_task, export_acting
from twin_diagram.twin.added_assets import AddedAssets
from twin_diagram.twin.estimating import add_estimation
from twin_diagram.twin.fused_sensors import Fused, export, fused_sensors
from twin_diagram.twin.given_files import Packages, check_fixtures, library_of, model_of, named
from twin_diagram.twin.health import HealthMonitor
from twin_diagram.twin.kept_scene import keep_scene, scene_monitor
from twin_diagram.twin.own_systems import check, check_segmenter, inputs_of
from twin_diagram.twin.own_systems import connect_ports as _connect
from twin_diagram.twin.sight import add_sight
from twin_diagram.twin.stopping_in_time import add_stop_monitor, connect_commands
from twin_diagram.twin.true_angles import TAKEN, Door, add_shift, behind_door, offset_of

MASS = "payload.mass"
"""Name of the learned mass among the filter's parameters."""


@dataclass(frozen=True, repr=False)
class TwinDiagram:
    """The twin, built.

    Attributes:
        diagram: in and out as a station's, the other way round; besides, what it believes: `arm_state`, `parameters`,
            `covariance`, `nis`, `object_poses`, `tracks`, `alarm`, `alarm_log`, `alarm_evidence`, `positions`, `plan`,
            `goal`, `query_object`, and what it lacks: `health`, a row of three for each of `health.lacks` (see
            `health.HealthMonitor`). Of what is beside the first instance of each object: `further_poses`,
            `further_tracks`, `things`, and `object_events`. Where the arm will be: `position_previewed`,
            `preview_covariance`.
        model: the arm's physics in true joint angles, as all within the twin takes it.
        measured_model: the same as logs show it: with the offsets that encoders are known to have; see `true_angles`.
        library: the known objects, in order.
        scene: the twin's own plant and SceneGraph.
        parameter_names: of `parameters`, in order.
        mass_index: of the payload's mass in `parameters`; None where none is learned.
        fused: sensors that the filter fuses besides the arm's own.
        preview: foresees the arm.
        ekf, drift, mpc, monitor: the systems that use the model; a corrected one reaches them as `ModelUser` says.
            `mpc` is None where a controller of the user's own stands in its place; `monitor`, which stops the arm in
            time, where it is told to have none.
        health: the system that says what the twin lacks.
        runner: the system that runs the steps of its task; None where it has none.
        added: assets that came later; see `add_asset`.
        door: takes encoders' offsets off; None where none was known and the twin does not mend its model.
    """

    diagram: Diagram
    model: Model
    measured_model: Model
    library: dict[str, Asset]
    scene: TwinScene
    parameter_names: tuple[str, ...]
    mass_index: int | None
    fused: tuple[Fused, ...]
    ekf: AdaptiveEkf
    drift: DriftMonitor
    mpc: Mpc | None
    health: HealthMonitor
    runner: TaskRunner | None
    monitor: StopMonitor | None
    preview: Preview
    added: AddedAssets
    door: Door | None = None

    def __repr__(self) -> str:
        """Say in one line what it knows and learns: a notebook shows it."""
        known = f"joints={list(self.model.joints)}, library={list(self.library)}"
        return f"TwinDiagram({known}, parameters={list(self.parameter_names)})"

    @property
    def _model_users(self) -> list[AdaptiveEkf | DriftMonitor | Mpc | StopMonitor]:
        """The systems that a corrected model reaches; a user's own controller is not one of them."""
        return [self.ekf, self.drift, *(user for user in (self.mpc, self.monitor) if user is not None)]

    def add_model(self, model: Model) -> int:
        """Take in a corrected model of the same arm; answer its number. No Context uses it yet.

        Args:
            model: as logs show it, as `measured_model`.

        Raises:
            TwinError: the twin cannot use it.
        """
        offset = offset_of(self.measured_model)
        if model.joints == self.measured_model.joints:  # another arm's is refused by whoever would use it
            offset = offset if self.door is None else offset_of(model)
            model = behind_door(model, offset)
        numbers = {system.add_model(model) for system in self._model_users}
        assert len(numbers) == 1
        if self.door is not None:
            self.door.offsets.append(offset)
        return numbers.pop()

    def use_model(self, context: Context, number: int) -> None:
        """Have filter, monitors and planner go on with another model; 0 is the one that the twin was built with.

        Where its encoders' offsets are others, all that is remembered as angles counts anew: the arm stays where it is.
        Systems that remember angles have a method `recount`, one's own may have one, too.

        Args:
            context: of `diagram`, between two steps of a simulator; other Contexts stay as they are.
            number: as `add_model` gave it.
        """
        for system in self._model_users:
            system.use_model(self.diagram.GetMutableSubsystemContext(system, context), number)
        change = np.zeros(0) if self.door is None else self.door.move(context, number)
        for system in self.diagram.GetSystems() if change.any() else ():
            if hasattr(system, "recount"):
                system.recount(self.diagram.GetMutableSubsystemContext(system, context), change)

    def add_asset(self, asset: Asset | str | Path, name: str | None = None) -> int:
        """Take in an asset that the library does not hold; answer its number. No Context uses it yet.

        Args:
            asset: it, or its folder.
            name: what it is called here; None: as in its `asset.yaml`.

        Raises:
            AssetError: it cannot be read.
            TwinError: the name is taken or empty, or the twin has no eyes or no slots for it.
        """
        return self.added.add(asset, name)

    def use_asset(self, context: Context, number: int, X_WO: RigidTransform | None = None) -> None:
        """Search for an added asset from the next image on, follow it and keep clear of it, under its own name.

        Its first instance holds a slot from now on. Once more it changes nothing.

        Args:
            context: of `diagram`, between two steps of a simulator; other Contexts stay as they are.
            number: as `add_asset` gave it.
            X_WO: where it is now; None: nobody knows.

        Raises:
            IndexError: no asset of that number was added.
            TwinError: no slot is free, or X_WO is not finite.
        """
        self.added.use(self.diagram, context, number, X_WO)

    def looking_beside(self) -> AbstractContextManager[Callable[[], None]]:
        """Have a process of its own look at images where that has a latency; see `IcpPoseEstimator`."""
        return self.added.looking_beside()

    def names(self, context: Context) -> Names:
        """Return what objects and things are called."""
        return self.added.names(self.diagram, context)

    def keep_scene(self, context: Context) -> bool:
        """Give the twin's SceneGraph the geometry of all that holds a slot now; see `kept_scene`.

        Args:
            context: of `diagram`, between two steps of a simulator; other Contexts stay as they are.
        """
        return keep_scene(self.diagram, self.scene, context)

    def scene_monitor(self) -> Callable[[Context], EventStatus]:
        """Return what calls `keep_scene` after each step: `simulator.set_monitor(twin.scene_monitor())`."""
        return scene_monitor(self.diagram, self.scene)

    def events(self, context: Context) -> list[dict[str, Any]]:
        """Return what happened to objects and things, oldest first: time [s], event, object."""
        ring = np.asarray(self.diagram.GetOutputPort("object_events").Eval(context))
        return object_events.told(ring, self.names(context))

    def step_events(self, context: Context) -> list[dict[str, Any]]:
        """Return what happened to the task's steps, oldest first: see `planning.tasks.step_state.told`."""
        if self.runner is None:
            return []
        return self.runner.told(self.diagram.GetSubsystemContext(self.runner, context))

    def brakes(self, context: Context) -> list[dict[str, Any]]:
        """Return when and why the arm was stopped and went on, oldest first: see `StopMonitor.told`."""
        return (
            [] if self.monitor is None else self.monitor.told(self.diagram.GetSubsystemContext(self.monitor, context))
        )

    def alarms(self, context: Context) -> list[dict[str, Any]]:
        """Return what the drift monitor raised, oldest first, with evidence: see `estimation.drift.alarm_events`."""
        return self.drift.events(self.diagram.GetSubsystemContext(self.drift, context), self.model.joints)

    def lacking(self, context: Context) -> list[dict[str, Any]]:
        """Return what the twin lacked so far: reason, what, first and last time [s]; see `health.HealthMonitor`."""
        return self.health.told(self.diagram.GetSubsystemContext(self.health, context))

    def parameters(self, context: Context) -> dict[str, float]:
        """Return what the filter has learnt, by name."""
        values = self.diagram.GetOutputPort("parameters").Eval(context)
        return {name: round(float(value), 6) for name, value in zip(self.parameter_names, values, strict=True)}


def make_twin(
    twin: scenario.Twin,
    packages: Packages | None = None,
    *,
    controller: System | None = None,
    perception: System | None = None,
    segmenter: Segmenter | None = None,
) -> TwinDiagram:
    """Build the twin.

    Args:
        twin: what it is told.
        packages: local folders for `package://` names.
        controller: in the place of `Mpc`; its ports: see `own_systems`.
        perception: in the place of `PerceptionSystem` and `IcpPoseEstimator`; its ports: see `own_systems`.
        segmenter: says which thing each pixel of an image shows, called in the loop: see `learned.Segmenter`.

    Raises:
        ScenarioError: something it is told does not exist or does not fit; the message names the field.
        TwinError: a controller, perception or segmenter that does not fit; the message names the port.
    """
    check_twin(twin)
    check_segmenter(segmenter, perception, twin)
    builder = DiagramBuilder()
    measured_model = model_of(twin, packages)
    model, offset = _through_door(measured_model, mends=twin.healing is not None)
    library = library_of(twin, packages)
    scene = _add_scene(builder, twin, packages)
    fused = fused_sensors(twin, model.last_link)
    ekf, drift = add_estimation(builder, twin, model, fused)
    parameter_names = tuple(label.split(" ")[0] for label in ekf.ekf.parameters.labels(model.joints))
    updater = _add_updater(builder, scene, twin)
    mpc = None if controller else named("twin", lambda: Mpc(model, twin, library, packages, parameter_names))
    moves: System = mpc or controller  # type: ignore[assignment]  # one of them is there
    _check_controller(moves, len(model.joints), len(library), len(parameter_names), twin.slots)
    builder.AddNamedSystem("mpc" if mpc else "controller", moves)
    goal, runner = add_task(builder, twin, packages, model, library, scene)
    health = builder.AddNamedSystem("health_monitor", HealthMonitor(twin))
    monitor = named("twin", lambda: add_stop_monitor(builder, twin, model, library, packages, parameter_names))
    preview = add_preview(builder, twin, model, ekf, moves)
    _take_measurements(builder, offset, ekf, *filter(None, (drift, moves, health, runner, monitor, preview)))
    connect_task(builder, runner, ekf, updater, moves)
    _connect(builder, ekf, updater, "arm_state")
    _connect_controller(builder, ekf, updater, goal, moves, health)
    _connect(builder, updater, health, "tracks")
    sight = add_sight(
        builder, twin, library, packages, ekf, updater, health, moves, perception, runner, monitor, segmenter
    )
    named("twin.filter.sensors", lambda: export(builder, ekf, fused, twin, model, packages))

    connect_commands(builder, moves, monitor, ekf, updater, runner, offset)
    export_acting(builder, goal, scene, updater, runner)
    _export_beliefs(builder, ekf, drift, updater, moves, health)
    builder.ExportOutput(scene.query_output, "query_object")
    mass_index = parameter_names.index(MASS) if MASS in parameter_names else None
    known = model, measured_model, library, scene, parameter_names, mass_index, tuple(fused)
    added = AddedAssets(scene, sight, (mpc, monitor, runner))
    diagram = _built(builder)
    door = None if offset is None else Door(diagram, offset)
    return TwinDiagram(diagram, *known, ekf, drift, mpc, health, runner, monitor, preview, added, door)


def _through_door(measured_model: Model, *, mends: bool) -> tuple[Model, Array | None]:
    """Return the model in true joint angles, and the offset (n,) that is taken off; None where no door is needed.

    Args:
        measured_model: as logs show it.
        mends: whether the twin may find an offset while it runs.
    """
    offset = offset_of(measured_model)
    return behind_door(measured_model, offset), offset if offset.any() or mends else None


def _add_scene(builder: DiagramBuilder, twin: scenario.Twin, packages: Packages | None) -> TwinScene:
    """Add the twin's own plant and SceneGraph."""
    check_fixtures(twin, packages)
    return named("twin.fixtures", lambda: add_twin_scene(builder, twin, packages))


def _built(builder: DiagramBuilder) -> Diagram:
    diagram = builder.Build()
    diagram.set_name("twin")
    return diagram


def _add_updater(builder: DiagramBuilder, scene: TwinScene, twin: scenario.Twin) -> SceneGraphUpdater:
    """Add what keeps the scene in step with what is seen."""
    only = next(iter(twin.perceiving.values()), None) if len(twin.perceiving) < 2 else None
    made = SceneGraphUpdater(scene, twin.scene, only, twin.slots.forget_after)
    updater = builder.AddNamedSystem("scene_graph_updater", made)
    builder.Connect(updater.GetOutputPort("positions"), scene.positions_input)
    builder.Connect(updater.GetOutputPort("further_tracks"), scene.further_input)
    return updater


def _check_controller(system: System, n: int, objects: int, parameters: int, slots: scenario.Slots) -> None:
    """Refuse a controller of n joints that does not fit; raises TwinError."""
    beside = {"further_tracks": FURTHER_TRACK_SIZE * slots.further(objects), "things": THING_SIZE * slots.unknown}
    beside |= {"hand": HAND_SIZE, "brake": 1 + n, "next_goal": POSE_SIZE, "next_hand": HAND_SIZE, "next_pause": 1}
    arm = dict.fromkeys(("position_measured", "velocity_estimated", "torque_measured"), n)
    inputs = {"arm_state": 2 * n, "tracks": TRACK_SIZE * objects, "parameters": parameters, "goal": POSE_SIZE}
    inputs |= beside
    further = {"torque_commanded": n, "reach": 1, "plan_time": 1, "position_planned": n}
    check("controller", system, {**inputs, **arm, "measurement_time": 1}, {"position_commanded": n}, further)


def _connect_controller(
    builder: DiagramBuilder,
    ekf: AdaptiveEkf,
    updater: SceneGraphUpdater,
    goal: OutputPort,
    controller: System,
    health: HealthMonitor,
) -> None:
    """Connect what the twin believes and what it is to reach to those inputs that the controller has; tell health."""
    _connect(builder, ekf, health, "message_time")
    _connect(builder, ekf, controller, *inputs_of(controller, ("arm_state", "parameters")))
    _connect(builder, updater, controller, *inputs_of(controller, ("tracks", "further_tracks")))
    if controller.HasInputPort("goal"):
        builder.Connect(goal, controller.GetInputPort("goal"))
    if controller.HasOutputPort("reach"):
        _connect(builder, controller, health, "reach")


def _take_measurements(builder: DiagramBuilder, offset: Array | None, *systems: System) -> None:
    """Let the arm's messages into those systems that want them, under the station's names.

    Args:
        builder: of the twin.
        offset: (n,) of encoders [rad]; None: there is no door.
        systems: those that may want them.
    """
    measured = {
        ports.POSITION_MEASURED: "position_measured",
        ports.VELOCITY_ESTIMATED: "velocity_estimated",
        ports.TORQUE_MEASURED: "torque_measured",
        ports.MEASUREMENT_TIME: "measurement_time",
    }
    for name, port in measured.items():
        inputs = [system.GetInputPort(port) for system in systems if system.HasInputPort(port)]
        if name == ports.POSITION_MEASURED and offset is not None:
            door = add_shift(builder, TAKEN, -offset)
            for each in inputs:
                builder.Connect(door.get_output_port(), each)
            inputs = [door.get_input_port(0)]
        builder.ExportInput(inputs[0], name)
        for each in inputs[1:]:
            builder.ConnectInput(name, each)


def _export_beliefs(
    builder: DiagramBuilder,
    ekf: AdaptiveEkf,
    drift: DriftMonitor,
    updater: SceneGraphUpdater,
    controller: System,
    health: HealthMonitor,
) -> None:
    """Show what the systems believe, under their own ports' names; a controller's command is a plan of one knot."""
    for system, names in (
        (ekf, ("arm_state", "parameters", "covariance", "innovation", "nis")),
        (drift, ("alarm", "alarm_log", "alarm_evidence")),
        (updater, ("tracks", "positions", "further_tracks", "object_events")),
        (controller, ("plan" if controller.HasOutputPort("plan") else "position_commanded",)),
        (health, ("health",)),
    ):
        for name in names:
            builder.ExportOutput(system.GetOutputPort(name), "plan" if system is controller else name)
