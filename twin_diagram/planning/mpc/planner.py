"""The planner whole: from memory and inputs to memory; where to go, by which way, and how to move there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import Forecast, Scene
from twin_diagram.planning.mpc import asking_ahead
from twin_diagram.planning.mpc.arm_torque import ArmTorque, TorqueBounds, torque_bounds
from twin_diagram.planning.mpc.asking_ahead import NOWHERE, Onward, kept_ahead
from twin_diagram.planning.mpc.backing_out import proved_wrong, way_out, without
from twin_diagram.planning.mpc.limits import limits_of
from twin_diagram.planning.mpc.margins import as_near_as, at_samples
from twin_diagram.planning.mpc.planner_state import FRESH, Memory
from twin_diagram.planning.mpc.planner_state import TUNING as PLANNER_STATE
from twin_diagram.planning.mpc.quadratic_program import QpSolver
from twin_diagram.planning.mpc.trajectory import Trajectory
from twin_diagram.planning.mpc.trajectory_optimisation import Limits, Optimiser, OptimiserTuning, PlanProblem
from twin_diagram.planning.paths.guide import TUNING as GUIDE
from twin_diagram.planning.paths.guide import Guide, GuideSettings, Question, together
from twin_diagram.planning.paths.inverse_kinematics import IkTuning
from twin_diagram.planning.paths.searching import Here, Searcher
from twin_diagram.planning.paths.situation import FOLLOWED, Aim, Route
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE


@dataclass(frozen=True)
class Tuning:
    """How near, how fast and how soon; chosen by hand.

    `tests/planning_bench.py` shows their effect on an arm among things that move (touched, arrived),
    `sims/closed_loop.py --seeds 20` in the loop with perception.
    """

    retry: float = 2.0
    """Joint goals for a goal that seems out of reach are looked for again after this [s]."""

    patience: float = 0.2
    """A search that found no way is made again so long after its answer [s]."""

    decisions: float = 15.0
    """Routes are decided upon this often, or at each tick where ticks come less often [Hz]: as often as images come."""

    first_goals: IkTuning = field(default_factory=lambda: IkTuning(starts=12, iterations=24))
    """What a tick itself looks for when a goal is new: joint goals near by, in few ms; a search finds the others."""

    stopping_time: float = 0.5
    """Without anywhere to go the arm comes to rest in about this time [s]."""

    ahead: float = 0.1
    """What is followed is so far ahead on its way [s]: by so much a plan lags, whose first acceleration is that of the
    one before. Descents of 6 cm then run past their end by 0.4 mm, where they did by 2."""

    standing: float = 0.02
    """A plan that moves no joint by more than this [rad] stands: it may have found no way between margins …"""

    going: float = 0.1
    """… where the way leads on by more than this [rad]; then it may come as near to what rests as the way does."""

    travel: float = 0.95
    """Routes are travelled at this share of the limits of speed and acceleration, so that the motion can catch up."""

    reanchor: float = 0.25
    """The command starts anew from the measured position where it is farther from it than this [rad]."""

    lag: float = 0.1
    """What an arm follows its command behind along its own way [s] is no reason to plan otherwise: it comes along …"""

    play: float = 0.02
    """… nor is this [rad]; by anything more, plans start where the arm is measured to be, …"""

    found_time: float = 0.1
    """… low-passed with this time constant: a few of its messages [s]."""

    offset_time: float = 0.7
    """The lasting difference of command and position is learnt with this time constant while the arm is slow [s]."""

    offset_speed: float = 0.1
    """Slow means below this [rad/s]."""

    offset_cap: float = 0.2
    """Commands lead the arm by no more than this for good [rad]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Report:
    """What a tick found, for tests and drawings; nothing of it is needed for the next tick."""

    aim: Aim
    violation: float
    solved: bool
    reanchored: bool


class MotionPlanner:
    """Plans an arm's motion in a scene. Holds constants alone: what changes is in `Memory`.

    Attributes:
        guide: what is searched with.
        empty: the same with an empty hand.
        searcher: where that runs; here, unless somebody sets another.
    """

    def __init__(
        self,
        scene: Scene,
        velocity_limit: Array,
        params: scenario.Planner,
        solver: QpSolver | None = None,
        pieces_O: Sequence[Sequence[Array]] = (),
        hand: bytes = b"",
        limits: Limits | None = None,
    ) -> None:
        """Prepare what is constant.

        Args:
            scene: shapes and kinematics.
            velocity_limit: (n,) the joints' [rad/s].
            params: tuning.
            solver: for quadratic programs; None for `ActiveSet`.
            pieces_O: corners of the convex pieces of each object that may be held [m].
            hand: what the arm of `scene` holds, a packed `Hand`; empty: nothing. See `holding`.
            limits: of `limits_of`; None: as speed and `params` allow, and no torque.
        """
        self.scene, self.params = scene, params
        self.limits = limits or limits_of(None, scene, velocity_limit, params)
        speed, acceleration = TUNING.travel * self.limits.velocity, TUNING.travel * self.limits.acceleration
        self.guide = self.empty = Guide(scene, GuideSettings(speed, params.clearance, pieces_O, acceleration))
        self.router = self.guide.router
        self.searcher: Searcher = Here(self.guide)
        self.optimiser = Optimiser(
            scene.clearance, self.limits, params.knots, params.step, OptimiserTuning(reach=params.influence), solver
        )
        self._velocity_limit, self._solver, self._hand = velocity_limit, solver, hand
        self._holding = lru_cache(maxsize=GUIDE.grips)(self._made)
        rate = params.rate
        self._latency, self._patience = (max(1, round(t * rate)) for t in (params.route_after, TUNING.patience))
        self._retry, self._every = round(TUNING.retry * rate), max(1, round(rate / TUNING.decisions))

    def _made(self, hand: bytes) -> MotionPlanner:
        guide = self.guide.holding(hand)
        made = MotionPlanner(guide.scene, self._velocity_limit, self.params, self._solver, (), hand, self.limits)
        made.guide, made.router, made.empty = guide, guide.router, self.empty
        return made

    def holding(self, hand: bytes) -> MotionPlanner:
        """Return the planner of the same arm with something in its hand, a packed `Hand`."""
        result = self._holding(hand)
        result.searcher = self.searcher
        return result

    def initial(self, q: Array) -> Memory:
        """Return the memory before the first tick, at rest at `q` (n,)."""
        return Memory.initial(q, self.params.knots, self.params.step)

    def hold(self, memory: Memory, now: float, q: Array) -> Memory:
        """Return the memory with the arm held at `q` (n,) from `now` on."""
        trajectory = Trajectory.at_rest(now, self.params.step, self.params.knots, q)
        return replace(memory, trajectory=trajectory, stay=trajectory.q0.copy())

    def tick(
        self,
        memory: Memory,
        now: float,
        arm_state: Array,
        tracks: Array,
        goal: Array,
        *beside: Array | None,
        arm: ArmTorque | None = None,
        after: Onward = NOWHERE,
    ) -> tuple[Memory, Report]:
        """Plan anew.

        Args:
            memory: from the last tick.
            now: time [s].
            arm_state: (2n,) estimated positions [rad] and velocities [rad/s].
            tracks: (K · TRACK_SIZE,) of the library's objects.
            goal: (7,) X_WG of the tool frame; an all-zero quaternion: stay.
            beside: further instances and unknown things, as `Scene.forecast` takes them.
            arm: dynamics as known now, for bounds on torque; None: there are none.
            after: the goal after this one: a way there is searched for before.
        """
        rng = np.random.default_rng([self.params.seed, memory.tick])
        if memory.braked and self.searcher.works():
            memory = replace(memory, braked=False, pending=None, asked=FRESH)
        memory, q0, v0, a0, reanchored = self._anchor(memory, now, arm_state)
        stop = q0 + TUNING.stopping_time / 2 * v0
        further, things = (*beside, None, None)[:2]
        forecast, seed = self.scene.forecast(tracks, further, things), (self.params.seed, memory.tick, 1)
        question = Question(seed, q0, goal, memory.goals, False, tracks, further, things, added=tuple(self.scene.added))
        before, memory = memory, kept_ahead(memory, self._aim(memory, q0, stop, goal, forecast, rng), after.goal)
        memory = self._heard(memory, q0, forecast)
        if memory.tick % self._every == 0 or memory is not before:
            memory = self._decided(memory, q0, forecast, question, rng)
        memory = self._looked_ahead(memory, question, forecast, after)

        route, samples, stays = memory.route, self.optimiser.samples, not np.any(memory.goal)
        end = route.points[-1:] if route.to_goal else memory.goals[:0]
        situation = self.guide.margins_at(q0, forecast, end, at_rest=stays)
        way = self.router.travel(q0, route, v0)
        margins = at_samples(situation, samples, way.duration, stays=stays)
        around = self.scene.around(forecast, samples)
        guess = memory.trajectory.at(now + samples)[0] - memory.offset
        line, waits = route.aim is Aim.LINE, route.aim is Aim.NOTHING
        reference = np.repeat(stop[None], len(samples), axis=0) if waits else way.at(samples + TUNING.ahead)
        fallback = replace(memory.trajectory, q0=memory.trajectory.q0 - memory.offset)
        if (stands := route.to_goal and _stands(guess, reference)) or line:
            near = self.scene.clearance.distances(reference, around, float(margins.max()) + FOLLOWED, own=False)
            margins = as_near_as(near, margins, situation, lagging=line)
        out = way_out(self.scene, self.router.lifted, situation, self.limits.velocity)
        if out is not None:
            reference, margins = out.at(samples), without(margins, proved_wrong(situation))
        problem = PlanProblem(now, q0, v0, a0, reference, around, margins, fallback, self._torque(memory, now, arm))
        tries = stands and out is None and memory.tick % self._every == 0
        solve = self.optimiser.solve_moving_on if tries else self.optimiser.solve
        outcome = solve(problem, guess)
        plan = replace(outcome.trajectory, q0=outcome.trajectory.q0 + memory.offset)
        memory = replace(memory, tick=memory.tick + 1, checked=now if outcome.solved else memory.checked)
        return replace(memory, trajectory=plan), Report(route.aim, outcome.violation, outcome.solved, reanchored)

    def _torque(self, memory: Memory, now: float, arm: ArmTorque | None) -> TorqueBounds | None:
        """Return bounds on torque at the knots of a plan that starts now, about the plan before."""
        if arm is None or self.limits.torque is None:
            return None
        knots: Array = now + self.params.step * np.arange(1.0, self.params.knots - 1)
        q, v, a = memory.trajectory.at(knots)
        return torque_bounds(arm, q - memory.offset, v, a, self.limits.torque)

    def _heard(self, memory: Memory, q0: Array, forecast: Forecast) -> Memory:
        """Take the answer to what was asked, when it is due."""
        question = memory.pending
        if question is None or memory.tick - memory.asked < self._latency or not self.searcher.ready(question):
            return memory
        answer = self.searcher.answer(question)
        if answer is None:
            return replace(memory, pending=None, braked=True, route=Route.none(len(q0)))
        if not np.array_equal(question.goal, memory.goal):
            return asking_ahead.answered(memory, answer.points)
        memory = replace(memory, pending=None, heard=True, goals=answer.goals)
        points = answer.points[: PLANNER_STATE.way_points]
        now = self.guide.situation(q0, forecast, answer.goals)
        good = memory.route.to_goal and self.router.follows(memory.route.points, now)
        if len(points) and not good and self.router.follows(points, now):
            memory = replace(memory, route=Route(Aim.GOAL, points))
        return memory

    def _decided(
        self, memory: Memory, q0: Array, forecast: Forecast, question: Question, rng: np.random.Generator
    ) -> Memory:
        """Choose the route, and ask for a search where that may find a better one."""
        if memory.braked:
            return replace(memory, route=Route.none(len(q0)))
        if not memory.route.to_goal and np.any(memory.goal):
            line, free, _ = self.guide.line(q0, memory.goal, forecast, waited=True)
            memory = replace(memory, route=Route(Aim.LINE, line)) if free else memory
        now = self.guide.situation(q0, forecast, memory.goals, at_rest=not np.any(memory.goal))
        route, wants = self.router.decide(memory.route, now, rng, fresh=memory.asked == FRESH)
        memory = replace(memory, route=Route(route.aim, route.points[: PLANNER_STATE.way_points]))
        wanted, known = bool(np.any(memory.goal)), len(memory.goals) > 0
        since = memory.tick - memory.asked - self._latency
        due = since >= (self._patience if known else self._retry) or memory.asked == FRESH
        if memory.pending is not None or not due or not (wants or (wanted and not route.to_goal)):
            return memory
        question = replace(question, goal=memory.goal, goals=memory.goals, more_goals=wanted, hand=self._hand)
        self.searcher.ask(question)
        return replace(memory, pending=question, asked=memory.tick)

    def _looked_ahead(self, memory: Memory, question: Question, forecast: Forecast, after: Onward) -> Memory:
        """Ask for a way on to the goal after this one, where nothing else is asked for: once, unless it is blocked."""
        if not after.goal.any() or memory.pending is not None or memory.braked or not memory.route.to_goal:
            return memory
        known = asking_ahead.foretold(memory, after.goal)
        if known and not (len(memory.beyond) and memory.tick % self._every == 0):
            return memory
        later = after.pause + self.router.travel(question.q, memory.route).duration  # by then it sets off
        if known:
            return asking_ahead.revised(self.empty, memory, replace(forecast, later=later), after.hand)
        asked = asking_ahead.question_ahead(
            self.guide, memory, replace(question, hand=after.hand, later=later), after.goal
        )
        if asked is None or memory.next_goal.any():  # what was known led elsewhere
            memory = replace(memory, beyond=memory.goals[:0])
        memory = replace(memory, next_goal=after.goal.copy())
        if asked is None:
            return memory
        self.searcher.ask(asked)
        return replace(memory, pending=asked, asked=memory.tick)

    def _anchor(self, memory: Memory, now: float, arm_state: Array) -> tuple[Memory, Array, Array, Array, bool]:
        """Return where the new plan starts: where the arm is, but for what it lags behind along its own way.

        Speed and acceleration are those of the command, so that commands go on smoothly. Where the arm is somewhere
        else altogether they start anew.
        """
        n = self.scene.chain.size
        q_measured, v_measured = arm_state[:n], arm_state[n:]
        known = bool(np.isfinite(arm_state).all())
        q, v, a = (part[0] for part in memory.trajectory.at(np.array([now])))
        first = memory.trajectory.start == NEVER
        lost = known and (first or np.abs(q - memory.offset - q_measured).max() > TUNING.reanchor)
        if lost:
            v = np.zeros(n) if first else np.clip(v_measured, -self.limits.velocity, self.limits.velocity)
            trajectory = self._stop(now, q_measured, v)
            memory = replace(memory, trajectory=trajectory, offset=np.zeros(n), route=Route.none(n))
            if first:
                memory = replace(memory, stay=q_measured.copy())
            return memory, q_measured.copy(), v, trajectory.accelerations[0], True
        if first:
            memory = replace(memory, trajectory=replace(memory.trajectory, start=now))
        if known:
            slow = max(float(np.abs(v).max()), float(np.abs(v_measured).max())) < TUNING.offset_speed
            memory = replace(memory, offset=self._lead(memory.offset, q - q_measured, v, slow=slow))
        return memory, q - memory.offset, v, a, False

    def _lead(self, offset: Array, ahead: Array, v: Array, *, slow: bool) -> Array:
        """Return how far commands lead the arm, (n,), beyond what it lags behind.

        Args:
            offset: what was known of it [rad].
            ahead: (n,) the command less the measured position now [rad].
            v: (n,) of the command [rad/s].
            slow: whether what is left is lasting.
        """
        lead, lag = ahead - offset, TUNING.lag * np.abs(v) + TUNING.play
        beyond = lead - np.clip(lead, -lag, lag)
        quick, slowly = (min(1.0, 1.0 / (self.params.rate * time)) for time in (TUNING.found_time, TUNING.offset_time))
        learnt = offset + quick * beyond + (slowly * (lead - beyond) if slow else 0.0)
        return np.clip(learnt, -TUNING.offset_cap, TUNING.offset_cap)

    def _stop(self, now: float, q: Array, v: Array) -> Trajectory:
        """Come to rest from a velocity, evenly within the horizon."""
        knots, h = self.params.knots, self.params.step
        accelerations = np.zeros((knots, len(q)))
        count = max(2, int(np.ceil(np.abs(v / self.limits.acceleration).max() / h)) + 1)
        count = min(count, knots - 1)
        # Trapezoid: the area under the accelerations must take the velocity away.
        accelerations[:count] = -v / (h * (count - 0.5))
        return Trajectory(now, h, q.copy(), v.copy(), accelerations)

    def _aim(
        self, memory: Memory, q0: Array, stop: Array, goal: Array, forecast: Forecast, rng: np.random.Generator
    ) -> Memory:
        """Find joint goals near by for a goal that is new.

        Args:
            memory: from the last tick.
            q0: (n,) where the arm is.
            stop: (n,) where it can soon be at rest.
            goal: (7,)
            forecast: of the objects.
            rng: of this tick.
        """
        goal = np.where(np.isfinite(goal).all(), goal, 0.0)
        wanted = float(np.linalg.norm(goal[:4])) > 0.5
        had = float(np.linalg.norm(memory.goal[:4])) > 0.5
        n = len(q0)
        if not wanted:
            if had:
                # The goal was taken away: stay where the arm soon comes to rest.
                route = Route(Aim.GOAL, stop[None])
                still = np.zeros(POSE_SIZE)
                memory = replace(memory, goal=still, stay=stop, goals=stop[None], route=route)
                return replace(memory, pending=None, heard=False, asked=FRESH)
            if len(memory.goals) == 0:
                return replace(memory, goals=memory.stay[None], route=Route(Aim.GOAL, memory.stay[None]))
            return memory
        if had and np.array_equal(goal, memory.goal):
            return memory
        found = self.guide.joint_goals(q0, goal, forecast, rng, TUNING.first_goals)
        line, free, passes = self.guide.line(q0, goal, forecast)
        route = Route(Aim.LINE, line) if free else Route.none(n)
        # What bars a short way for a moment is waited for: no other way to stand is looked for at first.
        asked = memory.tick if passes else FRESH
        if len(line):
            found = line[-1:] if passes else together(line[-1:], found)
        elif len(known := asking_ahead.way_known(self.guide, memory, goal, rng, TUNING.first_goals)):
            found = together(known[-1:], found)
            if self.router.follows(known, self.guide.situation(q0, forecast, found)):
                route = Route(Aim.GOAL, known)
        memory = replace(memory, goal=goal.copy(), goals=found, route=route)
        return replace(memory, pending=None, heard=False, asked=asked)


def _stands(guess: Array, reference: Array) -> bool:
    """Tell whether the plan before (M, n) stays where it is though the way (M, n) leads elsewhere."""
    return bool(np.ptp(guess, axis=0).max() < TUNING.standing and np.ptp(reference, axis=0).max() > TUNING.going)
