"""One receding-horizon problem: the knots' accelerations that follow a reference and keep clear of everything.

Sequential quadratic programming. Position and velocity are linear in the accelerations; distances and torques are
linearised about the present guess, and a slack at each sample, punished by more than the reference can gain, keeps
every program solvable. The last knot is at rest, so that any plan can be carried out to its end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from twin_diagram.planning.collision.clearance import Clearance, Contacts, Surroundings
from twin_diagram.planning.mpc.active_set import ActiveSet
from twin_diagram.planning.mpc.arm_torque import TorqueBounds
from twin_diagram.planning.mpc.motion_program import MotionProgram, Rows
from twin_diagram.planning.mpc.quadratic_program import QpSolver
from twin_diagram.planning.mpc.trajectory import Trajectory, response
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Limits:
    """What the joints may do; (n,) each. Without torque none is looked at."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    torque: Array | None = None


@dataclass(frozen=True)
class OptimiserTuning:
    """Weights of the problem."""

    tracking: float = 1.0
    """Cost per rad² and second away from the reference."""
    speed: float = 0.02
    """Per (rad/s)² and second of difference from the reference's speed: twice the root of tracking and acceleration,
    by which a step is followed without overshoot."""
    acceleration: float = 1e-4
    """Per (rad/s²)² and second: what is off is made up for in some 0.1 s."""
    change: float = 1e-4
    """Per (rad/s²)² that the acceleration changes from knot to knot, and second."""
    proximity: float = 0.05
    """Per rad² and second away from the guess that distances were linearised about."""
    slack: float = 1e3
    """Per metre and second that a margin is not kept."""
    slack_square: float = 2e4
    """Per metre² and second."""
    fade: float = 0.7
    """Far ahead, where forecasts are vague, slack costs less, with this time constant as a share of the horizon."""
    braking: float = 0.5
    """A speed above its limit is braked with this share of the acceleration at least: torque may not allow all."""
    reach: float = 0.20
    """Distances above this are left out [m]."""
    own_reach: float = 0.05
    """The same for the arm's distance to itself [m]."""
    rows: int = 64
    """Most distances in one program, the smallest first."""
    iterations: int = 2
    """Linearisations of distances and torques in one tick, at most: the next tick starts from this one's plan."""
    settled: float = 0.02
    """A step smaller than this needs no further iteration [rad]."""
    better: float = 0.5
    """Distances are linearised about the reference where it lacks less than this share of what the last plan lacks."""
    worse: float = 1e-4
    """A plan may lack this much more of the margins than the one before and be taken [m·s]: the solver's noise."""


class PlanProblem(NamedTuple):
    """What one plan is asked for; M samples, B bodies.

    Attributes:
        start: the plan's first time [s].
        q0: (n,) position there, kept [rad].
        v0: (n,) velocity there, kept.
        a0: (n,) acceleration there, kept.
        reference: (M, n) where to be at the samples [rad].
        around: the bodies at the samples.
        margins: (M, B + 1) distance to keep from each body, and of the arm from itself, at each sample [m].
        fallback: what to keep to where no program is solved; it starts in the same state.
        torque: bounds at the knots but the first and last; None: none.
    """

    start: float
    q0: Array
    v0: Array
    a0: Array
    reference: Array
    around: Surroundings
    margins: Array
    fallback: Trajectory
    torque: TorqueBounds | None = None


@dataclass(frozen=True)
class Optimum:
    """What the optimiser found.

    Attributes:
        trajectory: the plan.
        violation: what it lacks of the margins, weighted and summed over the samples [m·s]; 0 where all are kept.
        solved: whether every program was solved.
    """

    trajectory: Trajectory
    violation: float
    solved: bool


class Optimiser:
    """Holds the constant matrices of a horizon.

    Args:
        clearance: distances.
        limits: the joints'.
        knots: N.
        step: between knots [s].
        tuning: None for the defaults.
        solver: None for `ActiveSet`.
    """

    def __init__(
        self,
        clearance: Clearance,
        limits: Limits,
        knots: int,
        step: float,
        tuning: OptimiserTuning | None = None,
        solver: QpSolver | None = None,
    ) -> None:
        self.tuning = tuning or OptimiserTuning()
        self.limits = limits
        self.knots, self.step = knots, step
        self._clearance = clearance
        self._solver = solver or ActiveSet()
        n = clearance.chain.size
        self._n = n
        # Samples: the knots after the first, and half-way between.
        self.samples = np.arange(1, 2 * (knots - 1) + 1) * step / 2
        P, V = response(self.samples, step, knots)
        # The first acceleration is given, the last is zero; those between are free.
        self._P, self._V = P[:, 1:-1], V[:, 1:-1]
        self._P0, self._V0 = P[:, 0], V[:, 0]
        self._free = knots - 2
        self._at_knots = np.arange(1, 2 * (knots - 1), 2)
        weight = np.full(len(self.samples), step / 2)
        t = self.tuning
        horizon = self.samples[-1]
        self.fading = np.exp(-self.samples / (t.fade * horizon)) * weight
        tracking = self._P.T @ (self._P * weight[:, None])
        difference = np.diff(np.eye(knots), axis=0)
        change = (difference.T @ difference)[1:-1, 1:-1] * t.change * step
        self._change0 = (difference.T @ difference)[1:-1, 0] * t.change * step
        damping = self._V.T @ (self._V * weight[:, None])
        price = (
            (t.tracking + t.proximity) * tracking
            + t.speed * damping
            + t.acceleration * step * np.eye(self._free)
            + change
        )
        self._tracking_gain = (self._P * weight[:, None]).T
        self._speed_gain = (self._V * weight[:, None]).T
        self.price = price
        limited = np.concatenate([np.eye(self._free), self._V[:-1], self._P[self._at_knots]])
        self._limited = Rows.of_joints(limited, np.zeros((len(limited), n)), np.zeros((len(limited), n)))
        self._program = MotionProgram(price, self._V[-1], t.slack * self.fading, t.slack_square * self.fading)

    def solve(self, problem: PlanProblem, guess: Array) -> Optimum:
        """Optimise one plan.

        Args:
            problem: what is asked.
            guess: (M, n) positions at the samples, to linearise about unless the reference keeps clear of more.

        Returns:
            The better, by violation, of what was found and the fallback.
        """
        a0, reference, around, margins = problem.a0, problem.reference, problem.around, problem.margins
        base, base_velocity = self._coasting(problem.q0, problem.v0, a0)
        about, contacts, kept = self._begin(guess, reference, around, margins)
        inner, present, solved, change, torque = None, about, True, np.inf, problem.torque
        for iteration in range(self.tuning.iterations):
            contacts = self._contacts(present, around, margins) if iteration else contacts
            torque = self._torque_about(torque, present, base_velocity, inner)
            rows = self._rows(base, base_velocity, present, contacts, margins)
            slope = self._gradient(base, base_velocity, a0, present, reference)
            found = self._program.solve(slope, -base_velocity[-1], self._torque_bounded(rows, torque), self._solver)
            if found is None:
                solved = False
                break
            before, inner, present = present, found, base + self._P @ found
            change = np.abs(present - before).max()
            if change < self.tuning.settled:
                break
        if inner is None:
            return Optimum(problem.fallback, kept, solved)
        if change < self.tuning.settled and iteration == 0:
            violation = self._lacking(self._ahead(contacts, present - about), margins)  # distances are as linearised
        else:
            violation = self.assess(present, around, margins)
        if violation > kept + self.tuning.worse:
            inner, violation = self._halved(problem.v0, a0, base, (present + guess) / 2, around, margins, kept)
        if inner is None:
            return Optimum(problem.fallback, kept, solved)
        knots = np.vstack([a0, inner, 0.0 * a0])
        plan = Trajectory(problem.start, self.step, problem.q0, problem.v0, knots)
        return Optimum(plan, violation, solved)

    def solve_moving_on(self, problem: PlanProblem, guess: Array) -> Optimum:
        """Optimise as `solve` does, with a guess that stands though the reference leads on.

        About where it stands, what is before the arm bars the way around it, too. Where the plan is clear of all and
        one about the reference is, it is that one.
        """
        standing = self.solve(problem, guess)
        if not self._is_clear(standing):
            return standing
        going = self.solve(problem, problem.reference)
        return going if self._is_clear(going) else standing

    def _is_clear(self, found: Optimum) -> bool:
        return found.solved and found.violation <= self.tuning.worse

    def _begin(
        self, guess: Array, reference: Array, around: Surroundings, margins: Array
    ) -> tuple[Array, Contacts, float]:
        """Return the positions to linearise about, what they come near to, and what the guess lacks of the margins.

        Where the plan before would stay among things, their slopes may mislead; the reference leads away from them.
        """
        contacts = self._contacts(guess, around, margins)
        kept = self._lacking(contacts, margins)
        if kept > self.tuning.worse:
            there = self._contacts(reference, around, margins)
            if self._lacking(there, margins) < self.tuning.better * kept:
                return reference, there, kept
        return guess, contacts, kept

    def _coasting(self, q0: Array, v0: Array, a0: Array) -> tuple[Array, Array]:
        """Return positions and velocities (M, n) at the samples where the free accelerations are zero."""
        return q0 + self.samples[:, None] * v0 + self._P0[:, None] * a0, v0 + self._V0[:, None] * a0

    def _halved(
        self, v0: Array, a0: Array, base: Array, half: Array, around: Surroundings, margins: Array, kept: float
    ) -> tuple[Array | None, float]:
        """Return half of a step that the linearisation misled, as accelerations, where it lacks less than `kept`."""
        violation = self.assess(half, around, margins)
        return (self._fitted(v0, a0, base, half) if violation < kept else None), violation

    def _torque_bounded(self, rows: Rows, torque: TorqueBounds | None) -> Rows:
        """Return rows with those that bound torque, where there are some."""
        return rows if torque is None else Rows.joined([rows, _torque_rows(torque)])

    def _torque_about(
        self, torque: TorqueBounds | None, present: Array, base_velocity: Array, inner: Array | None
    ) -> TorqueBounds | None:
        """Return bounds on torque, linearised about accelerations where some were found: a new way has other bounds.

        Args:
            torque: bounds as they are; None: none.
            present: (M, n) positions at the samples.
            base_velocity: (M, n) velocities there where the free accelerations are zero.
            inner: (k, n) the free accelerations; None: none were found yet.
        """
        if torque is None or inner is None:
            return torque
        free = self._at_knots[:-1]
        return torque.about(present[free], (base_velocity + self._V @ inner)[free])

    def _contacts(self, q: Array, around: Surroundings, margins: Array) -> Contacts:
        """Return what positions (M, n) at the samples come near to, beside what is wanted."""
        t = self.tuning
        return self._clearance.contacts(q, around, t.reach, t.own_reach, margins, t.rows)

    def assess(self, q: Array, around: Surroundings, margins: Array) -> float:
        """Return what positions (M, n) at the samples lack of the margins; see `Optimum.violation`."""
        reach, own = float(margins.max()) + 1e-6, float(margins[:, -1].max()) + 1e-6
        distance = self._clearance.distances(q, around, reach, own_reach=own)
        return float(self.fading @ np.maximum(margins - distance, 0.0).max(axis=1))

    def _ahead(self, contacts: Contacts, moved: Array) -> Contacts:
        """Return contacts as their slopes foresee them after positions at the samples moved by (M, n)."""
        change = np.einsum("mn,mn->m", contacts.gradient, moved[contacts.row])
        return replace(contacts, distance=contacts.distance + change)

    def _lacking(self, contacts: Contacts, margins: Array) -> float:
        """Return what contacts lack of the margins; see `Optimum.violation`."""
        lacking = np.zeros(len(self.samples))
        np.maximum.at(lacking, contacts.row, margins[contacts.row, contacts.body] - contacts.distance)
        return float(self.fading @ lacking)

    def _fitted(self, v0: Array, a0: Array, base: Array, q: Array) -> Array | None:
        """Return the free accelerations whose motion is nearest to positions (M, n) and ends at rest.

        None where they do not keep the limits.
        """
        rest = self._V[-1]
        k = self._free
        system = np.zeros((k + 1, k + 1))
        system[:k, :k] = self._P.T @ self._P + 1e-6 * np.eye(k)
        system[:k, k] = system[k, :k] = rest
        end = -(v0 + self._V0[-1] * a0)
        inner = np.linalg.solve(system, np.vstack([self._P.T @ (q - base), end]))[:k]
        if (np.abs(inner) > self.limits.acceleration + 1e-6).any():
            return None
        return np.asarray(inner)

    def _gradient(self, base: Array, base_velocity: Array, a0: Array, present: Array, reference: Array) -> Array:
        """Return the price's slope by the free accelerations (k, n) where they are zero; arguments as in `solve`."""
        t = self.tuning
        pull = t.tracking * (base - reference) + t.proximity * (base - present)
        faster = t.speed * (base_velocity - np.gradient(reference, self.samples, axis=0))
        result: Array = self._tracking_gain @ pull + self._speed_gain @ faster + self._change0[:, None] * a0
        return result

    def _rows(
        self,
        base: Array,
        base_velocity: Array,
        present: Array,
        contacts: Contacts,
        margins: Array,
    ) -> Rows:
        """Return all bounds on the free accelerations.

        Args:
            base: (M, n) positions at the samples where the free accelerations are zero.
            base_velocity: (M, n) likewise.
            present: (M, n) positions about which distances are linearised.
            contacts: at `present`.
            margins: see `solve`.
        """
        order = np.argsort(contacts.distance - margins[contacts.row, contacts.body], kind="stable")
        order = order[: self.tuning.rows]
        sample, slope = contacts.row[order], contacts.gradient[order]
        needed = margins[sample, contacts.body[order]] - contacts.distance[order]
        needed += np.einsum("mn,mn->m", slope, present[sample] - base[sample])
        clear = Rows(self._P[sample], slope, needed, np.full(len(order), np.inf), sample)

        knots, most = self._at_knots, self.limits.acceleration
        # Half-way between knots, too, where a plan is at its fastest. What is too fast already is braked: allowed as
        # much as the plan before has, each plan would allow the next one some more.
        still = base_velocity[:-1]
        braked = np.abs(still) - self.tuning.braking * most * self._V[:-1].sum(axis=1)[:, None]
        speed = np.maximum(self.limits.velocity, braked + 1e-6)
        lower = np.minimum(self.limits.lower, present[knots])
        upper = np.maximum(self.limits.upper, present[knots])
        bounded = np.tile(most, (self._free, 1))
        low = np.concatenate([-bounded, -speed - still, lower - base[knots]])
        high = np.concatenate([bounded, speed - still, upper - base[knots]])
        return Rows.joined([clear, replace(self._limited, low=low.ravel(), high=high.ravel())])


def _torque_rows(torque: TorqueBounds) -> Rows:
    """Return rows that bound the torque at the free knots (K, n)."""
    count, n = torque.load.shape
    low, high = -torque.allowed - torque.load, torque.allowed - torque.load
    mass = torque.mass.reshape(count * n, n)
    return Rows(np.repeat(np.eye(count), n, axis=0), mass, low.ravel(), high.ravel(), np.full(count * n, -1))
