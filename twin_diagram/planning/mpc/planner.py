"""The planner whole: from memory and inputs to memory; where to go, by which way, and how to move there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import Forecast, Scene
from twin_diagram.planning.mpc.planner_state import TUNING as PLANNER_STATE
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.mpc.quadratic_program import QpSolver
from twin_diagram.planning.mpc.trajectory import Trajectory
from twin_diagram.planning.mpc.trajectory_optimisation import Limits, Optimiser, OptimiserTuning
from twin_diagram.planning.paths import inverse_kinematics
from twin_diagram.planning.paths.route import Aim, Route, Router, RouteTuning, Situation
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE


@dataclass(frozen=True)
class Tuning:
    """How near, how fast and how soon; chosen by hand.

    `tests/planning_bench.py` shows their effect on an arm among things that move (touched, arrived),
    `sims/closed_loop.py --seeds 20` in the loop with perception.
    """

    retry: int = 30
    """Ticks after which joint goals are drawn anew while no way to one is known."""

    least: float = 0.25
    """Share of the clearance that is always wanted, however near to a thing the goal is."""

    least_at_rest: float = 0.6
    """The same where there is no goal: nobody asked to be so near."""

    approach: float = 0.1
    """How fast the margin grows to its full size away from a goal next to a thing [m/s of travel]."""

    own_clearance: float = 0.01
    """The arm keeps from itself [m]."""

    stopping_time: float = 0.5
    """Without anywhere to go the arm comes to rest in about this time [s]."""

    surprise: float = 0.02
    """How much more than the clearance plans keep from what lies ahead [m] …"""

    surprise_time: float = 1.0
    """… by this many seconds or more, and less up to there."""

    travel: float = 0.9
    """Routes are travelled at this share of the speed limit, so that the motion can catch up."""

    reanchor: float = 0.25
    """The command starts anew from the measured position where it is farther from it than this [rad]."""

    offset_time: float = 0.7
    """The lasting difference of command and position is learnt with this time constant while the arm is slow [s]."""

    offset_speed: float = 0.1
    """Slow means below this [rad/s]."""

    offset_cap: float = 0.05
    """No more than this is made up for [rad]."""


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

    Args:
        scene: shapes and kinematics.
        limits: velocity (n,) and acceleration limits come from here and from `params`.
        params: tuning.
        solver: for quadratic programs; None for ProxQP.
    """

    def __init__(
        self, scene: Scene, velocity_limit: Array, params: scenario.Planner, solver: QpSolver | None = None
    ) -> None:
        n = scene.chain.size
        self.scene, self.params = scene, params
        velocity = params.velocity_share * np.where(np.isfinite(velocity_limit), velocity_limit, np.pi)
        self.limits = Limits(scene.lower, scene.upper, velocity, np.full(n, params.acceleration))
        self.router = Router(scene, TUNING.travel * velocity, RouteTuning())
        self.optimiser = Optimiser(
            scene.clearance,
            self.limits,
            params.knots,
            params.step,
            OptimiserTuning(reach=params.influence),
            solver,
        )

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
    ) -> tuple[Memory, Report]:
        """Plan anew.

        Args:
            memory: from the last tick.
            now: time [s].
            arm_state: (2n,) estimated positions [rad] and velocities [rad/s].
            tracks: (K · TRACK_SIZE,) of the library's objects.
            goal: (7,) X_WG of the tool frame; an all-zero quaternion: stay.
            beside: further instances and unknown things, as `Scene.forecast` takes them.
        """
        rng = np.random.default_rng([self.params.seed, memory.tick])
        memory, q0, v0, a0, reanchored = self._anchor(memory, now, arm_state)
        forecast = self.scene.forecast(tracks, *beside)
        memory = self._aim(memory, q0, q0 + TUNING.stopping_time / 2 * v0, goal, forecast, rng)

        situation = self._situation(
            q0, forecast, memory.goals, TUNING.least if np.any(memory.goal) else TUNING.least_at_rest
        )
        may_search = memory.tick - memory.searched >= self.router.tuning.patience
        route, failed = self.router.decide(memory.route, situation, rng, may_search=may_search)

        samples = self.optimiser.samples
        goal_index = situation.goal_of(route) if route.aim is Aim.GOAL else None
        # Plans keep more the farther ahead, so that there is room left when something does what was not foreseen.
        extra = TUNING.surprise * np.minimum(samples / TUNING.surprise_time, 1.0)
        left = np.maximum(self.router.duration(q0, route) - samples, 0.0)
        margins = np.stack(
            [
                situation.margins(goal_index, float(e), TUNING.approach * float(t))
                for e, t in zip(extra, left, strict=True)
            ]
        )
        around = self.scene.around(forecast, samples)
        old_q, old_v, _ = memory.trajectory.at(now + samples)
        guess = old_q - memory.offset
        if route.aim is Aim.NOTHING:
            reference = np.repeat((q0 + TUNING.stopping_time / 2 * v0)[None], len(samples), axis=0)
        else:
            reference = self.router.reference(q0, route, samples)
        fallback = replace(memory.trajectory, q0=memory.trajectory.q0 - memory.offset)
        outcome = self.optimiser.solve(now, q0, v0, a0, guess, old_v, reference, around, margins, fallback)
        plan = replace(outcome.trajectory, q0=outcome.trajectory.q0 + memory.offset)
        memory = replace(
            memory,
            trajectory=plan,
            route=Route(route.aim, route.points[: PLANNER_STATE.way_points]),
            tick=memory.tick + 1,
            searched=memory.tick if failed else memory.searched,
        )
        return memory, Report(route.aim, outcome.violation, outcome.solved, reanchored)

    def _situation(self, q: Array, forecast: Forecast, goals: Array, least: float) -> Situation:
        """Return what is near, here and at the goals; `least` share of the clearance is wanted there."""
        scene, clearance = self.scene, self.params.clearance
        q_all = np.vstack([q[None], goals])
        around = scene.around(forecast, np.zeros(len(q_all)))
        distance = scene.clearance.distances(
            q_all, around, clearance + max(self.router.tuning.spare, TUNING.surprise) + 0.01
        )
        still = np.ones(scene.fixture_count + len(forecast.present), dtype=bool)
        still[scene.fixture_count :] = ~forecast.moving
        return Situation(
            q, forecast, goals, distance[0], distance[1:], still, clearance, least * clearance, TUNING.own_clearance
        )

    def _anchor(self, memory: Memory, now: float, arm_state: Array) -> tuple[Memory, Array, Array, Array, bool]:
        """Return where the new plan starts: where the old one is now, unless the arm is somewhere else altogether."""
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
        if known and np.abs(v).max() < TUNING.offset_speed and np.abs(v_measured).max() < TUNING.offset_speed:
            gain = min(1.0, 1.0 / (self.params.rate * TUNING.offset_time))
            offset = memory.offset + gain * (q - q_measured - memory.offset)
            memory = replace(memory, offset=np.clip(offset, -TUNING.offset_cap, TUNING.offset_cap))
        return memory, q - memory.offset, v, a, False

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
        """Find the joint goals for the goal, anew when it changes and now and then while no way is known to any.

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
                return replace(
                    memory, goal=np.zeros(POSE_SIZE), stay=stop, goals=stop[None], route=Route(Aim.GOAL, stop[None])
                )
            if len(memory.goals) == 0:
                return replace(memory, goals=memory.stay[None], route=Route(Aim.GOAL, memory.stay[None]))
            return memory
        same = had and np.array_equal(goal, memory.goal)
        stuck = memory.route.aim is not Aim.GOAL and memory.tick % TUNING.retry == 0
        if same and not stuck:
            return memory
        X_WG = np.eye(4)
        X_WG[:3, :3] = Rotation.from_quat(goal[[1, 2, 3, 0]]).as_matrix()
        X_WG[:3, 3] = goal[4:]
        found = inverse_kinematics.solve(self.scene.chain, X_WG, q0, self.scene.lower, self.scene.upper, rng)
        # Those that are clear of everything come first, the nearest first among them.
        situation = self._situation(q0, forecast, found, TUNING.least)
        clear = (situation.at_goals >= np.append(np.full(len(situation.still), situation.least), situation.own)).all(
            axis=1
        )
        found = found[np.argsort(~clear, kind="stable")]
        return replace(memory, goal=goal.copy(), goals=found[: PLANNER_STATE.goals], route=Route.none(n))
