"""The system that runs a task's steps: goals for the planner, commands for the gripper, and how it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final, cast

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.finger_travel import FingerTravel, limits, travel_of
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.hand_shape import Palm
from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.kept_grasps import grasps_of
from twin_diagram.planning.grasps.known_object import read_known
from twin_diagram.planning.tasks import step_state
from twin_diagram.planning.tasks.goal_after import before_task, goal_after
from twin_diagram.planning.tasks.grasp_choice import ShapeGrasps
from twin_diagram.planning.tasks.grasp_from_above import NO_PALM
from twin_diagram.planning.tasks.in_hand import Eye
from twin_diagram.planning.tasks.slips import told_of
from twin_diagram.planning.tasks.standing_beside import StandingBeside
from twin_diagram.planning.tasks.step_state import Phase, TaskOutcome, TaskState
from twin_diagram.planning.tasks.step_view import PackedRows, StepView, Takeable
from twin_diagram.planning.tasks.transitions import advance
from twin_diagram.runtime.timing import timed
from twin_diagram.scenario.lenses import calibration_error, colour_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CALIBRATION_SIZE, SIZE
from twin_diagram.signals.hand import HAND_SIZE
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, POSE_SIZE, TRACK_SIZE, PoseMeasurement, Track
from twin_diagram.signals.pose_vectors import from_matrix
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, THING_SIZE


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    grasps: int = 30
    """Grasps of an object's shape that are kept: some come from below, or from where others stand."""

    ticks: float = 2.0
    """Of the task for one of the planner: a goal that changes waits for half a plan's period at most."""

    foreseen: float = 1.5
    """So long before a task begins its first goal is told [s]: what is previewed, and a search before that."""


TUNING = Tuning()


@dataclass(frozen=True)
class Fingers:
    """The travel of a gripper's fingers.

    Attributes:
        described: (g,) where the description has them, which is where they stay while no step is about them [m or rad].
        closed: (g,) the end of their travel at which they meet [m or rad].
        opened: (g,) the other end [m or rad].
        widening: (g,) by how much the opening grows with each, that of what follows it included.
        palm: of the hand.
        travel: of a hand whose joints turn; None: they slide.
    """

    described: Array
    closed: Array
    opened: Array
    widening: Array | float = 1.0
    palm: Palm = NO_PALM
    travel: FingerTravel | None = None

    @staticmethod
    def of(
        plant: MultibodyPlant, arm: Arm, described: Array, widening: Array | float = 1.0, palm: Palm = NO_PALM
    ) -> Fingers:
        """Return the fingers of an arm's gripper: where they slide they meet at the end that is nearer to zero."""
        travel = travel_of(plant, arm)
        closed, opened = (travel.closed, travel.opened) if travel else limits(plant, arm)
        return Fingers(np.array(described, dtype=float), closed, opened, widening, palm, travel)

    @property
    def widest(self) -> float:
        """Greatest opening between the fingers [m]."""
        return self.opening(self.opened)

    def opening(self, positions: Array) -> float:
        """Return the opening at positions (g,) [m]."""
        if self.travel is not None:
            return self.travel.opening(positions)
        return float((self.widening * np.abs(positions - self.closed)).sum())

    def fastest(self, positions: Array, rates: Array) -> float:
        """Return the speed of the fastest finger [m/s] at positions (g,) that change at rates (g,)."""
        levers = 1.0 if self.travel is None else 0.5 * len(rates) * self.travel.lever(positions)
        return float(np.abs(levers * rates).max(initial=0.0))

    def at(self, share: float) -> Array:
        """Return positions (g,) [m or rad] opened by a share of the widest; where it is negative, as described."""
        if share < 0.0:
            return self.described
        if self.travel is not None:
            share = self.travel.share_of(share * self.widest)
        return self.closed + share * (self.opened - self.closed)


def shape_grasps(asset: Asset, gripper: Gripper | None) -> ShapeGrasps:
    """Return the grasps of an asset's shape for a gripper; none where nobody knows what it is like."""
    if gripper is None:
        return ShapeGrasps()
    grasps = grasps_of(read_known(asset.folder), gripper, count=TUNING.grasps)
    low, high = gripper.boxes(retreat=0.0)
    ends = np.stack([low, high])
    corners = np.concatenate([ends[list(pick), :, [0, 1, 2]].T for pick in product((0, 1), repeat=3)])
    return ShapeGrasps(grasps.poses, grasps.score, grasps.contacts, corners)


def takeable(asset: Asset, gripper: Gripper | None) -> Takeable:
    """Return what a pick must know of an asset; with the grasps of its shape for a gripper, where one is given."""
    shape = shape_grasps(asset, gripper)
    return Takeable(tuple(asset.convex_pieces), asset.symmetric_axis is not None, shape)


def told_eye(camera: scenario.Camera) -> Eye | None:
    """Return a camera as the twin is told of it; None where it is told to be where it is said to be."""
    variances = calibration_error(camera).variances
    if not variances.any():
        return None
    lens, X_WC = colour_lens(camera), pose(camera.X_WC)
    where = X_WC.translation().copy(), X_WC.rotation().matrix().copy()
    return Eye(*where, (lens.fx, lens.fy), np.zeros(SIZE), np.diag(variances))


class TaskRunner(LeafSystem):
    """Runs the steps of a task, one after the other.

    .. pydrake_system::

        name: TaskRunner
        input_ports:
        - arm_state
        - tracks
        - measurement_time (optional)
        - object_poses (optional)
        - gripper_state (optional)
        - reach (optional)
        - calibration (optional)
        - further_tracks (optional)
        - things (optional)
        output_ports:
        - goal
        - gripper_position_commanded
        - gripper_force_limit
        - step
        - outcome
        - hand
        - notes
        - next_goal
        - next_hand
        - next_pause

    Ports:
        arm_state: (2n) estimated joint angles [rad] and speeds [rad/s].
        tracks: (K · TRACK_SIZE) a `layouts.Track` per library object, in the library's order.
        measurement_time: (1) of the arm's newest message [s]; until it is >= 0 nothing begins.
        object_poses: (K · MEASUREMENT_SIZE) what the newest image showed: whether what is held is seen elsewhere.
        gripper_state: (2g) positions of the fingers [m], then speeds [m/s]. Not connected: they stand as described.
        reach: (1) how many joint positions reach the goal; `NEVER` where the planner has none.
        calibration: (10 + 100) errors of the camera's calibration that are taken out of what it shows, and their
            covariance; see `signals.calibration_error`. Not connected: none are, and what is told of them counts.
        further_tracks: (F · FURTHER_TRACK_SIZE) further instances of the library's objects; see `signals.things`.
        things: (T · THING_SIZE) unknown things; see there. Like other objects they count where a grasp is chosen.
        goal: (7) X_WG of the tool frame; an all-zero quaternion: stay.
        gripper_position_commanded: (g) [m].
        gripper_force_limit: (1) [N]; not a number before the first `pick`: as the description has it.
        step: (1) number of the present step, from 0; the number of steps once all are done.
        outcome: (3) `step_state.TaskOutcome`, `step_state.Why`, `step_state.Phase`.
        hand: (HAND_SIZE) what is held or may be touched; see `signals.hand`.
        notes: (RING · NOTE_FIELDS) what happened to steps, newest last; see `step_state.told`.
        next_goal: (7) where the arm goes after `goal`, also before the task begins; zeros: it is not known.
        next_hand: (HAND_SIZE) what is held on the way there; see `signals.hand`.
        next_pause: (1) how long the arm stays before it goes there, once it is where it is to be now [s].

    Rate: twice the planner's, a periodic discrete update. Latency: one period; the planner plans for the goal of the
    tick before. State: one discrete vector, see `step_state.TaskState`.
    """

    def __init__(
        self,
        model: Model,
        twin: scenario.Twin,
        library: Mapping[str, Asset],
        fingers: Fingers,
        gripper: Gripper | None = None,
    ) -> None:
        """Take in the steps.

        Args:
            model: the arm.
            twin: what the twin is told, checked; `task`, `planner.rate` and `library` count.
            library: the known objects by name, in the order of the tracks.
            fingers: of its gripper.
            gripper: what grasps of objects' shapes are sought for; None: things are taken from above alone.

        Raises:
            ScenarioError: a step needs a gripper that closes, and there is none.
        """
        super().__init__()
        self.set_name("task_runner")
        self.told_steps: Final = tuple(twin.task.steps)
        self._steps: Final = step_state.steps_of(twin.task, list(library))
        picked = {step.object for step in self.told_steps if step.kind == "pick" and step.goal is None}
        self._library: Final = [takeable(asset, gripper if name in picked else None) for name, asset in library.items()]
        if not (np.isfinite(fingers.widest) and fingers.widest > 0.0):
            for index, step in enumerate(self.told_steps):
                if step.kind == "pick":
                    raise ScenarioError(f"twin.task.steps.{index}.kind", "pick needs a gripper; twin.arm has none")
        self._kinds: Final = [known.pieces for known in self._library]
        self._model: Final = model
        self._fingers: Final = fingers
        self._start: Final = twin.task.start
        n, g, objects = len(model.joints), len(fingers.closed), len(library)
        self._declare_inputs(n, g, objects, twin.slots)
        cameras = list(twin.perceiving.values())
        self._eye: Final = told_eye(cameras[0]) if len(cameras) == 1 else None
        self._state = self.DeclareDiscreteState(cast(Any, TaskState().pack()))
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / (TUNING.ticks * twin.planner.rate), 0.0, self._tick)
        # Read off the vector: they are asked for at each change, of which there are a hundred a second.
        outputs: dict[str, tuple[int, Callable[[Array], Any]]] = {
            "goal": (POSE_SIZE, lambda vector: vector[step_state.TOLD["goal"]]),
            "gripper_position_commanded": (g, lambda vector: self._fingers.at(float(vector[step_state.OPENED]))),
            "gripper_force_limit": (1, lambda vector: vector[step_state.TOLD["gripper_force_limit"]]),
            "step": (1, lambda vector: vector[step_state.TOLD["step"]]),
            "outcome": (3, lambda vector: vector[list(step_state.OUTCOME)]),
            "hand": (HAND_SIZE, lambda vector: vector[step_state.TOLD["hand"]]),
            "notes": (step_state.RING * step_state.NOTE_FIELDS, lambda vector: vector[step_state.TOLD["notes"]]),
            "next_goal": (POSE_SIZE, lambda vector: vector[step_state.TOLD["next_goal"]]),
            "next_hand": (HAND_SIZE, lambda vector: vector[step_state.TOLD["next_hand"]]),
            "next_pause": (1, lambda vector: vector[step_state.TOLD["next_pause"]]),
        }
        for name, (size, value) in outputs.items():
            self._declare_output(name, size, value)

    def _declare_inputs(self, n: int, g: int, objects: int, slots: scenario.Slots) -> None:
        """Declare what is told, of so many joints, fingers and objects of the library."""
        self._arm_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._tracks_in = self.DeclareVectorInputPort("tracks", TRACK_SIZE * objects)
        self._time_in = self.DeclareVectorInputPort("measurement_time", 1)
        self._measured_in = self.DeclareVectorInputPort("object_poses", MEASUREMENT_SIZE * objects)
        self._gripper_in = self.DeclareVectorInputPort("gripper_state", 2 * g)
        self._reach_in = self.DeclareVectorInputPort("reach", 1)
        self._calibration_in = self.DeclareVectorInputPort("calibration", CALIBRATION_SIZE)
        self._further_in = self.DeclareVectorInputPort("further_tracks", FURTHER_TRACK_SIZE * slots.further(objects))
        self._things_in = self.DeclareVectorInputPort("things", THING_SIZE * slots.unknown)

    def _declare_output(self, name: str, size: int, value: Callable[[Array], Any]) -> None:
        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(value(self._vector(context)))

        ticket = self.discrete_state_ticket(self._state)
        self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={ticket})

    def add_asset(self, asset: Asset) -> None:
        """Take in the shape of an asset that came later; `further_tracks` tell of it by its number."""
        self._kinds.append(tuple(asset.convex_pieces))

    def remembered(self, context: Context) -> TaskState:
        """Return a copy of what is remembered; `context` is this system's."""
        return TaskState.unpack(self._vector(context))

    def _vector(self, context: Context) -> Array:
        """Return the packed `TaskState`, not to be written to."""
        return np.asarray(context.get_discrete_state(int(self._state)).value())

    def told(self, context: Context) -> list[dict[str, Any]]:
        """Return what was told of steps, oldest first, see `step_state.told`; `context` is this system's."""
        return step_state.told(self.remembered(context).notes, self.told_steps)

    def standing(self, context: Context) -> dict[str, Any]:
        """Return how the task stands, for ``summary.json``.

        Outcome, number of steps done, where it failed, why, and how far what is held, or was held last, has moved in
        the hand.
        """
        state = self.remembered(context)
        result: dict[str, Any] = {"outcome": state.outcome.name.lower(), "steps": len(self._steps), "done": state.step}
        if state.outcome is TaskOutcome.FAILED:
            result["why"] = step_state.SENTENCES[state.why]
        elif state.outcome is TaskOutcome.RUNNING:
            result["phase"] = state.phase.name.lower()
        if state.lies.image >= 0.0:
            result["in_hand"] = told_of(state.lies)
        return result

    @timed("TaskRunner")
    def _tick(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        state = self.remembered(context)
        begins = self._start - context.get_time()
        if state.phase is Phase.REST or begins > TUNING.foreseen:
            return EventStatus.DidNothing()
        seen = self._seen(context)
        if seen is None:
            return EventStatus.DidNothing()
        if begins > 1e-9:
            state = before_task(state, seen, self._steps, self._library, begins)
        else:
            state = advance(state, seen, self._steps, self._library)
            state = replace(state, after=goal_after(state, seen, self._steps, self._library))
        discrete.set_value(int(self._state), cast(Any, state.pack()))
        return EventStatus.Succeeded()

    def _seen(self, context: Context) -> StepView | None:
        """Return what is known now; None before the arm's first message."""
        if self._time_in.HasValue(context) and float(cast(Array, self._time_in.Eval(context))[0]) < 0.0:
            return None
        arm = np.array(self._arm_in.Eval(context))
        if not np.isfinite(arm).all():
            return None
        n, g = len(arm) // 2, len(self._fingers.closed)
        q = arm[:n]
        speed = float(np.linalg.norm(self._model.tool_jacobian(q)[3:] @ arm[n:]))
        fingers = np.concatenate([self._fingers.described, np.zeros(g)])
        if self._gripper_in.HasValue(context):
            told = np.array(self._gripper_in.Eval(context))
            fingers = told if np.isfinite(told).all() else fingers
        tracks = cast(Array, self._tracks_in.Eval(context)).reshape(-1, TRACK_SIZE)
        measured = np.zeros((len(tracks), MEASUREMENT_SIZE))
        if self._measured_in.HasValue(context):
            shown = cast(Array, self._measured_in.Eval(context)).reshape(-1, MEASUREMENT_SIZE)
            # A user's own perception may say anything: what is no number shows nothing.
            measured = np.where(np.isfinite(shown).all(axis=1, keepdims=True), shown, 0.0)
        reach = float(cast(Array, self._reach_in.Eval(context))[0]) if self._reach_in.HasValue(context) else NEVER
        return StepView(
            now=context.get_time(),
            X_WT=from_matrix(self._model.tool_pose(q).GetAsMatrix4()),
            speed=speed,
            tracks=PackedRows(tracks, Track.unpack),
            measured=PackedRows(measured, PoseMeasurement.unpack),
            opening=self._fingers.opening(fingers[:g]),
            finger_speed=self._fingers.fastest(fingers[:g], fingers[g:]),
            widest=self._fingers.widest,
            palm=self._fingers.palm,
            reach=reach,
            eye=self._eye_now(context),
            beside=self._beside(context),
        )

    def _beside(self, context: Context) -> StandingBeside:
        """Return what stands beside the library's objects, not to be written to."""
        ports = self._further_in, self._things_in
        further, things = (cast(Array, p.Eval(context)) if p.HasValue(context) else np.zeros(0) for p in ports)
        return StandingBeside(further, things, self._kinds)

    def _eye_now(self, context: Context) -> Eye | None:
        """Return the camera with what is known of its calibration by now; None where nothing is told of its errors."""
        if self._eye is None or not self._calibration_in.HasValue(context):
            return self._eye
        known = np.array(self._calibration_in.Eval(context))
        return replace(self._eye, errors=known[:SIZE], covariance=known[SIZE:].reshape(SIZE, SIZE))
