"""The planner as a system: commands for the arm's own controller, at any time between ticks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, InputPort, State

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.model.model import Model
from twin_diagram.model.model_user import ModelUser
from twin_diagram.planning.collision.collision_scene import holders, load_scene, packed
from twin_diagram.planning.collision.held_shape import at_rest, obstacles_beside
from twin_diagram.planning.given import check_kinds, check_planner
from twin_diagram.planning.mpc.arm_torque import PAYLOAD, ArmTorque, LearnedPayload
from twin_diagram.planning.mpc.asking_ahead import NOWHERE, Onward, going_on
from twin_diagram.planning.mpc.limits import limits_of
from twin_diagram.planning.mpc.payload_gravity import gravity_regressor
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.mpc.quadratic_program import QpSolver
from twin_diagram.planning.mpc.warm_up import warm_up
from twin_diagram.planning.paths.no_way import Hindrance, HindranceKind
from twin_diagram.planning.paths.search_process import SearchProcess
from twin_diagram.planning.preview import AHEAD
from twin_diagram.runtime.timing import timed
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import HAND_SIZE, NOTHING, Hand
from twin_diagram.signals.layouts import NEVER, POSE_SIZE, TRACK_SIZE
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, THING_SIZE


@dataclass(frozen=True)
class Tuning:
    """When a tick comes and what is kept, chosen by hand: any time that is short beside an image's period."""

    margin: float = 1e-3
    """A tick comes this long after the tracks that it uses [s]."""


TUNING = Tuning()


class Mpc(ModelUser[Model]):
    """Moves the tool to a goal around the twin's objects, and out of their way.

    .. pydrake_system::

        name: Mpc
        input_ports:
        - arm_state
        - tracks
        - parameters
        - goal
        - measurement_time (optional)
        - further_tracks (optional)
        - things (optional)
        - hand (optional)
        - brake (optional)
        - next_goal (optional)
        - next_hand (optional)
        - next_pause (optional)
        output_ports:
        - position_commanded
        - torque_commanded
        - plan
        - plan_time
        - position_planned
        - reach

    Ports:
        arm_state: (2n) estimated joint angles [rad] and speeds [rad/s].
        tracks: (K · TRACK_SIZE) a `layouts.Track` per library object, in the library's order.
        parameters: (p) what the filter learned; those named `PAYLOAD` are used.
        goal: (7) X_WG of the tool frame as (qw, qx, qy, qz, px, py, pz); an all-zero quaternion: stay.
        further_tracks: (F · FURTHER_TRACK_SIZE) of further instances of the objects; see `signals.things`.
        things: (T · THING_SIZE) unknown things, to be kept clear of as the objects are.
        hand: (HAND_SIZE) what is held is part of the arm's shape, from the first plan on, and no obstacle; what may be
            touched is no obstacle either, nor, while the fingers are around it, what moves. See `signals.hand`.
        brake: (1 + n) whether something else stopped the arm, and where it is held [rad]: plans start there, from rest.
        next_goal: (7) X_WG that it goes to after `goal`, zeros: none: a way there is sought beforehand, …
        next_hand: (HAND_SIZE) … with what is held then; see `signals.hand`. Not connected: nothing.
        next_pause: (1) how long it rests before that, once it is at `goal` [s]. Not connected: not at all.
        measurement_time: (1) time of the arm's newest message [s]; until it is >= 0 nothing is planned. Not connected:
            `arm_state` is trusted from the start.
        position_commanded: (n) [rad]; the plan now, twice continuously differentiable in time. Before the first plan:
            where the arm is, `home` before the first message.
        torque_commanded: (n) [N·m] to add to the arm's own controller: the weight of the payload as learned, and what
            a corrected model needs beyond the given one to hold still.
        plan: (knots · n) the plan's knots from now on, row by row [rad].
        plan_time: (1) when the plan was made, or last found better than any other [s]; `NEVER` before the first.
        position_planned: (n) where the plan is `preview.AHEAD` from now [rad]; where it will have been at `goal` by
            then and a way on to `next_goal` is known, where that is.
        reach: (1) how many joint positions are known that put the tool at the goal; `NEVER` where there is none.

    Rate: plans at `planner.rate`, a periodic update. It comes right after the scene-graph updater's tick that
    first holds a new image's poses. Latency: commands follow the plan at any time that they are asked for; a plan
    reacts to an image as old as the camera's latency and one tick of the updater.

    State: one discrete vector, see `planner_state.Memory`, and what was asked of a search and not answered yet: an
    answer counts `planner.route_after` later. The goal counts from `task.start` on. Which of its models a
    Context uses is a numeric parameter of that Context: see `ModelUser`; of a corrected one its torques alone count.
    """

    def __init__(
        self,
        model: Model,
        twin: scenario.Twin,
        library: Mapping[str, Asset],
        packages: Mapping[str, str | Path] | None = None,
        parameter_names: Sequence[str] = PAYLOAD,
        solver: QpSolver | None = None,
    ) -> None:
        """Read the shapes of the arm, fixtures and library.

        Args:
            model: the arm.
            twin: what the twin is told; `arm`, `home`, `fixtures`, `planner`, `task.start`, `camera` and `scene.rate`
                count.
            library: the known objects by name, in the order of the tracks.
            packages: local folders for `package://` names.
            parameter_names: of the `parameters` port, in order; a unit in brackets after a name does not count.
            solver: for quadratic programs; None for `ActiveSet`.

        Raises:
            ArgumentError: an argument of another kind.
            ScenarioError: a tuning value that makes no sense.
            ModelError: a shape that cannot be read.
        """
        check_kinds(model, twin, library)
        super().__init__()
        self.set_name("mpc")
        check_planner(twin.planner)
        scene = load_scene(model.spec, twin.fixtures, library, packages)
        pieces = [tuple(asset.convex_pieces) for asset in library.values()]
        limits = limits_of(model, scene, model.velocity_limit, twin.planner)
        self.planner: Final = MotionPlanner(scene, model.velocity_limit, twin.planner, solver, pieces, limits=limits)
        warm_up(self.planner)
        self._sizes = np.array([asset.size for asset in library.values()]).reshape(-1, 3)

        self._n, self._knots, self._step = len(model.joints), twin.planner.knots, twin.planner.step
        self._begin_with(model)
        self._start = twin.task.start
        self._carried: Final = LearnedPayload.among(parameter_names)
        self._declare(twin, len(library), len(parameter_names))

    def _declare(self, twin: scenario.Twin, objects: int, parameters: int) -> None:
        """Declare state, inputs, events and outputs, for so many library objects and learned parameters."""
        n = self._n
        self._arm_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._tracks_in = self.DeclareVectorInputPort("tracks", TRACK_SIZE * objects)
        self._parameters_in = self.DeclareVectorInputPort("parameters", parameters)
        self._goal_in = self.DeclareVectorInputPort("goal", POSE_SIZE)
        self._time_in = self.DeclareVectorInputPort("measurement_time", 1)
        further = twin.slots.further(objects)
        self._further_in = self.DeclareVectorInputPort("further_tracks", FURTHER_TRACK_SIZE * further)
        self._things_in = self.DeclareVectorInputPort("things", THING_SIZE * twin.slots.unknown)

        self._hand_in = self.DeclareVectorInputPort("hand", HAND_SIZE)
        self._brake_in = self.DeclareVectorInputPort("brake", 1 + n)
        self._next_in = self.DeclareVectorInputPort("next_goal", POSE_SIZE)
        self._then_in = self.DeclareVectorInputPort("next_hand", HAND_SIZE)
        self._pause_in = self.DeclareVectorInputPort("next_pause", 1)

        home = np.array(twin.home, dtype=float) if twin.home else np.zeros(n)
        self._state = self.DeclareDiscreteState(self.planner.initial(home).pack())
        self._pending = self.DeclareAbstractState(Value(()))  # what is asked, or nothing: Drake 1.58 takes no None
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / twin.planner.rate, _offset(twin), self._tick)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / twin.filter.rate, 0.0, self._latch)
        state, arm = self.discrete_state_ticket(self._state), self._arm_in.ticket()
        moving = {self.time_ticket(), state, arm, self._time_in.ticket()}
        self.DeclareVectorOutputPort("position_commanded", n, self._calc_position, prerequisites_of_calc=moving)
        self.DeclareVectorOutputPort(
            "torque_commanded",
            n,
            self._calc_torque,
            prerequisites_of_calc={arm, self._parameters_in.ticket(), self.all_parameters_ticket()},
        )
        self.DeclareVectorOutputPort("plan", self._knots * n, self._calc_plan, prerequisites_of_calc={state})
        self.DeclareVectorOutputPort("plan_time", 1, self._calc_plan_time, prerequisites_of_calc={state})
        pending = self.abstract_state_ticket(self._pending)
        moving |= {port.ticket() for port in (self._next_in, self._then_in, self._pause_in)}
        self.DeclareVectorOutputPort("position_planned", n, self._calc_planned, prerequisites_of_calc=moving)
        self.DeclareVectorOutputPort("reach", 1, self._calc_reach, prerequisites_of_calc={state, pending})

    def add_asset(self, asset: Asset) -> None:
        """Take in the shape of an asset that came later; `further_tracks` tell of it by its number."""
        self.planner.scene.added.append(packed(asset))
        self._sizes = np.vstack([self._sizes, asset.size])

    def memory(self, context: Context) -> Memory:
        """Return a copy of what the planner remembers."""
        pending = next(iter(context.get_abstract_state(int(self._pending)).get_value()), None)
        return Memory.unpack(self._vector(context), self._n, self._knots, self._step, pending)

    def recount(self, context: Context, change: Array) -> None:
        """Count angles anew: the arm is where it was, but its angles are others by `change` (n,) [rad].

        The plan goes on from there; joint goals are where they were: at them the tool is at its goal.

        Args:
            context: of this system.
            change: (n,) [rad].
        """
        memory = self.memory(context)
        trajectory = replace(memory.trajectory, q0=memory.trajectory.q0 + change)
        memory = replace(memory, trajectory=trajectory, stay=memory.stay + change)
        if not np.any(memory.goal):  # what it stays at
            route = replace(memory.route, points=memory.route.points + change)
            memory = replace(memory, goals=memory.goals + change, route=route)
        context.SetDiscreteState(int(self._state), memory.pack())

    def braked(self, context: Context) -> bool:
        """Return whether the arm rests because what searches for ways has failed and does not work again yet."""
        return Memory.braked_in(self._vector(context))

    def why_no_way(self, context: Context, name: Callable[[int, int, int], str]) -> Hindrance | None:
        """Return why no way to the goal is known; None where one is, where there is no goal, or nobody knows yet.

        It takes a tenth of a search, for whoever looks between steps: no tick does.

        Args:
            context: of this system.
            name: what objects and things are called, as `Names.of`.
        """
        memory = self.memory(context)
        planner, arm, tracks, further, things = self._surroundings(context)
        if not (memory.stuck and np.isfinite(arm).all()):
            return None
        scene = planner.scene
        found = planner.guide.why_no_way(arm[: self._n], scene.forecast(tracks, further, things), memory.goals)
        found = replace(found, holding=planner is not self.planner)
        if found.reason is not HindranceKind.BLOCKED or found.body is None:
            return found
        fixtures = [body.name for body in scene.clearance.bodies[: scene.fixture_count]]
        names = fixtures + [name(*each) for each in holders(scene.object_count, further, things)]
        return replace(found, name=names[found.body])

    @contextmanager
    def searching_beside(self, *, waits: bool = True) -> Iterator[None]:
        """Have ways be searched for in a process of their own, which starts and ends with the `with` statement.

        Without it they are searched for within the tick in which they count, with the same result to the bit.

        Args:
            waits: a simulation waits for an answer that is late; a real arm does not: it counts when it comes.
        """
        before = self.planner.searcher
        with SearchProcess(self.planner.guide, waits=waits) as searcher:
            self.planner.searcher = searcher
            try:
                yield
            finally:
                self.planner.searcher = before

    def _make(self, model: Model) -> Model:
        return model

    def _vector(self, context: Context) -> Array:
        return cast(Array, context.get_discrete_state(int(self._state)).value())

    def _known(self, context: Context) -> bool:
        """Return whether the arm's state means anything yet."""
        if not self._time_in.HasValue(context):
            return True
        return float(cast(Array, self._time_in.Eval(context))[0]) >= 0.0

    @timed("Mpc")
    def _tick(self, context: Context, state: State) -> EventStatus:
        if not self._known(context):
            return EventStatus.DidNothing()
        now = context.get_time()
        goal = np.array(self._goal_in.Eval(context)) if now >= self._start - 1e-9 else np.zeros(POSE_SIZE)
        planner, arm, tracks, further, things = self._surroundings(context)
        memory = self.memory(context)
        brake = _given(self._brake_in, context)
        if brake is not None and brake[0]:
            memory = replace(planner.hold(memory, now, brake[1:]), stay=memory.stay)
        dynamics = ArmTorque(self._in_use(context), planner.scene.chain, self._payload(context))
        after = self._onward(context)
        memory, _ = planner.tick(memory, now, arm, tracks, goal, further, things, arm=dynamics, after=after)
        state.get_mutable_discrete_state().set_value(int(self._state), memory.pack())
        pending = () if memory.pending is None else (memory.pending,)
        state.get_mutable_abstract_state(int(self._pending)).set_value(pending)
        return EventStatus.Succeeded()

    def _onward(self, context: Context) -> Onward:
        """Return where the arm goes after its goal."""
        goal, then, pause = (_given(port, context) for port in (self._next_in, self._then_in, self._pause_in))
        hand = Hand() if then is None else Hand.unpack(then)
        # What is held is one thing to the planner, whenever the fingers came to it.
        held = b"" if hand.held == NOTHING else replace(hand, since=0.0).pack().tobytes()
        rests = 0.0 if pause is None else float(pause[0])
        return Onward(NOWHERE.goal if goal is None else goal, held, rests)

    def _surroundings(self, context: Context) -> tuple[MotionPlanner, Array, Array, Array | None, Array | None]:
        """Return who plans now, with what is held in its hand, the arm's state, and what is to be kept clear of."""
        arm, tracks = np.array(self._arm_in.Eval(context)), np.array(self._tracks_in.Eval(context))
        beside = self._further_in, self._things_in
        further, things = (_given(port, context) for port in beside)
        planner = self.planner
        if self._hand_in.HasValue(context):
            hand = Hand.unpack(np.array(self._hand_in.Eval(context)))
            if np.isfinite(arm).all():
                chain = planner.scene.chain
                X_WT = chain.tool(chain.place(arm[None, : self._n]))[0]
                tracks, further, things = obstacles_beside(hand, X_WT, self._sizes, tracks, further, things)
                if hand.around:
                    tracks, further, things = at_rest(X_WT[:3, 3], tracks, further, things)
            if hand.held != NOTHING:
                planner = planner.holding(replace(hand, touched=NOTHING, since=0.0).pack().tobytes())
        return planner, arm, tracks, further, things

    def _latch(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        """Hold the arm where it is from the first message on, before there is a plan."""
        if self._vector(context)[0] != NEVER or not self._known(context):
            return EventStatus.DidNothing()
        q = np.array(self._arm_in.Eval(context))[: self._n]
        if not np.isfinite(q).all():
            return EventStatus.DidNothing()
        memory = self.planner.hold(self.memory(context), context.get_time(), q)
        discrete.set_value(int(self._state), memory.pack())
        return EventStatus.Succeeded()

    def _payload(self, context: Context) -> Array:
        """Return the payload as learned (4,), see `PAYLOAD`; zeros where it is not."""
        return self._carried.of(cast(Array, self._parameters_in.Eval(context)) if self._carried.index else None)

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._planned(context, 0.0))

    def _calc_planned(self, context: Context, output: BasicVector) -> None:
        found, vector = None, self._vector(context)
        if Memory.way_on_in(vector, self._n, self._knots):
            pause = self._onward(context).pause
            found = going_on(self.planner.guide, self.memory(context), context.get_time(), AHEAD, pause)
        output.SetFromVector(self._planned(context, AHEAD) if found is None else found)

    def _planned(self, context: Context, ahead: float) -> Array:
        """Return where the plan is (n,) so much [s] from now: before the first, where the arm is."""
        vector = self._vector(context)
        if vector[0] == NEVER and self._known(context):
            q = np.array(self._arm_in.Eval(context))[: self._n]
            if np.isfinite(q).all():
                return q
        trajectory = Memory.trajectory_of(vector, self._n, self._knots, self._step)
        return trajectory.position(context.get_time() + ahead)

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        q = np.array(self._arm_in.Eval(context))[: self._n]
        torque: Array = np.zeros(self._n)
        payload = self._payload(context)
        if payload.any() and np.isfinite(q).all():
            torque = gravity_regressor(self.planner.scene.chain, q) @ payload
        number, still = self.model_number(context), np.zeros(self._n)
        if number and np.isfinite(q).all():
            torque = torque + self._made[number].bias(q, still) - self._made[0].bias(q, still)
        output.SetFromVector(torque)

    def _calc_plan(self, context: Context, output: BasicVector) -> None:
        trajectory = Memory.trajectory_of(self._vector(context), self._n, self._knots, self._step)
        output.SetFromVector(trajectory.knots.ravel())

    def _calc_plan_time(self, context: Context, output: BasicVector) -> None:
        output[0] = Memory.proved_at(self._vector(context))

    def _calc_reach(self, context: Context, output: BasicVector) -> None:
        memory = self.memory(context)
        known, found = np.linalg.norm(memory.goal[:4]) > 0.5, len(memory.goals)
        # As long as the first search goes on nobody knows.
        output[0] = found if known and (found or memory.pending is None or memory.heard) else NEVER


def _given(port: InputPort, context: Context) -> Array | None:
    return np.array(port.Eval(context)) if port.HasValue(context) else None


def _offset(twin: scenario.Twin) -> float:
    """Return when within a period to plan: right after the updater's tick that follows a new image's delivery [s]."""
    camera = next(iter(twin.perceiving.values()), None)
    if camera is None:
        return 0.0
    delivered = camera.latency + TUNING.margin
    updated = np.ceil(delivered * twin.scene.rate - 1e-9) / twin.scene.rate
    return float((updated + TUNING.margin) % (1.0 / twin.planner.rate))
