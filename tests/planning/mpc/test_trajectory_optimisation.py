"""What the optimiser does with its solver's answers, on one joint whose distance to a wall is a formula."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin_diagram.planning.collision.clearance import Contacts
from twin_diagram.planning.mpc.motion_program import Rows
from twin_diagram.planning.mpc.quadratic_program import QpSolver
from twin_diagram.planning.mpc.trajectory import Trajectory
from twin_diagram.planning.mpc.trajectory_optimisation import Limits, Optimiser, PlanProblem
from twin_diagram.signals.arrays import Array

KNOTS, STEP = 8, 0.15
LIMITS = Limits(np.array([-9.0]), np.array([9.0]), np.array([50.0]), np.array([40.0]))
Q0 = V0 = A0 = np.zeros(1)


class Wall:
    """At `where`: the joint's distance is what is left to it; to itself it has 1 m."""

    def __init__(self, where: float = 9.0) -> None:
        self.chain: Any = type("Chain", (), {"size": 1})
        self.where = where
        self.reaches: list[tuple[float, float]] = []

    def distances(self, q: Array, around: Any, reach: float, own_reach: float) -> Array:
        distance = np.stack([self.where - q[:, 0], np.ones(len(q))], axis=1)
        return np.where(distance < reach, distance, 1e3)

    def contacts(self, q: Array, around: Any, reach: float, own: float, margins: Array, most: int) -> Contacts:
        self.reaches.append((reach, own))
        distance = self.where - q[:, 0]
        row = np.flatnonzero(distance < reach)
        return Contacts(row, 0 * row, distance[row], -np.ones((len(row), 1)))


class Told:
    """Answers with accelerations that it is told, one after the other."""

    def __init__(self, *inner: Array, solved: bool = True) -> None:
        self.inner, self.solved, self.asked = list(inner), solved, 0

    def solve(self, gradient: Array, end: Array, rows: Rows, solver: QpSolver) -> Array | None:
        inner = self.inner[min(self.asked, len(self.inner) - 1)]
        self.asked += 1
        return inner[:, None] if self.solved else None


def to_rest(size: float) -> Array:
    """Accelerations of a motion over `size` that ends at rest."""
    inner = np.array([1.0, 1.0, 0.5, -0.5, -1.0, -1.0])
    motion = Trajectory(0.0, STEP, Q0, V0, np.concatenate([[0.0], inner, [0.0]])[:, None])
    return inner * size / float(motion.knots[-1, 0])


def path(optimiser: Optimiser, inner: Array) -> Array:
    motion = Trajectory(0.0, STEP, Q0, V0, np.concatenate([[0.0], inner, [0.0]])[:, None])
    return motion.at(optimiser.samples)[0]


def solved(solver: Told, wall: Wall, guess: Array | float = 0.0) -> tuple[Any, Optimiser]:
    optimiser = Optimiser(wall, LIMITS, KNOTS, STEP)  # type: ignore[arg-type]
    optimiser._program = solver  # type: ignore[assignment]
    m = len(optimiser.samples)
    guess = np.full((m, 1), guess) if isinstance(guess, float) else guess
    margins = np.tile([0.1, 0.01], (m, 1))
    fallback = Trajectory(5.0, STEP, Q0, V0, np.zeros((KNOTS, 1)))
    problem = PlanProblem(5.0, Q0, V0, A0, guess, None, margins, fallback)  # type: ignore[arg-type]
    found = optimiser.solve(problem, guess)
    return found, optimiser


def test_a_small_step_is_the_last() -> None:
    for size, count in ((0.019, 1), (0.021, 2)):
        solver = Told(to_rest(size))
        found, optimiser = solved(solver, Wall())
        assert solver.asked == count and found.solved and found.violation == 0.0
        np.testing.assert_allclose(found.trajectory.knots[-1], size)
        np.testing.assert_allclose(found.trajectory.at(5.0 + optimiser.samples)[0], path(optimiser, to_rest(size)))
    solver = Told(to_rest(0.3), to_rest(0.6), to_rest(0.9))
    found, _ = solved(solver, Wall())
    assert solver.asked == 2  # no more than two linearisations
    np.testing.assert_allclose(found.trajectory.knots[-1], 0.6)


def test_nothing_solved_leaves_the_plan_before() -> None:
    found, optimiser = solved(Told(to_rest(0.3), solved=False), Wall(0.05))
    assert not found.solved
    np.testing.assert_array_equal(found.trajectory.accelerations, np.zeros((KNOTS, 1)))
    assert found.violation == pytest.approx(0.05 * optimiser.fading.sum())  # 5 cm of the margin are not kept


def test_what_a_plan_lacks_is_weighted_by_samples_and_fades() -> None:
    _, optimiser = solved(Told(to_rest(0.0)), Wall())
    samples = np.arange(1, 15) * STEP / 2
    np.testing.assert_allclose(optimiser.samples, samples)
    np.testing.assert_allclose(optimiser.fading, STEP / 2 * np.exp(-samples / (0.7 * samples[-1])))
    wall = Wall(0.5)
    optimiser = Optimiser(wall, LIMITS, KNOTS, STEP)  # type: ignore[arg-type]
    q = np.linspace(0.0, 0.6, 14)[:, None]
    margins = np.tile([0.1, 1.02], (14, 1))
    expected = optimiser.fading @ np.maximum(np.maximum(0.1 - (0.5 - q[:, 0]), 0.02), 0.0)
    assert optimiser.assess(q, None, margins) == pytest.approx(expected)  # type: ignore[arg-type]
    contacts = optimiser._contacts(q, None, margins)  # type: ignore[arg-type]
    lacking = optimiser._lacking(contacts, margins)
    assert lacking == pytest.approx(optimiser.fading @ np.maximum(0.1 - (0.5 - q[:, 0]), 0.0))
    assert wall.reaches == [(0.2, 0.05)]


def test_a_misled_step_is_halved_or_left() -> None:
    """A margin of 0.1 m before a wall: the plan before lacks some, the whole step more, its half less."""
    _, plain = solved(Told(to_rest(0.0)), Wall())
    guess, wall = path(plain, to_rest(0.4)), Wall(0.45)
    misled = to_rest(-0.4) * -1.25  # to 0.5: farther in
    found, optimiser = solved(Told(misled), wall, guess)
    kept = optimiser.assess(guess, None, np.tile([0.1, 0.01], (14, 1)))  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.trajectory.accelerations, np.zeros((KNOTS, 1)))
    assert found.violation == pytest.approx(kept)

    class Bent(Wall):
        """Nothing is near half-way: walls on both sides of a gap at 0.2."""

        def distances(self, q: Array, around: Any, reach: float, own_reach: float) -> Array:
            distance = np.stack([0.12 - np.abs(q[:, 0] - 0.2), np.ones(len(q))], axis=1)
            return np.where(distance < reach, distance, 1e3)

        def contacts(self, q: Array, around: Any, reach: float, own: float, margins: Array, most: int) -> Contacts:
            row = np.arange(len(q))
            return Contacts(row, 0 * row, 0.12 - np.abs(q[:, 0] - 0.2), np.ones((len(q), 1)))

    guess = path(plain, to_rest(0.0))
    found, optimiser = solved(Told(to_rest(0.75)), Bent(), guess)
    half = path(plain, to_rest(0.375))
    np.testing.assert_allclose(found.trajectory.at(5.0 + optimiser.samples)[0], half, atol=1e-3)
    assert found.violation == pytest.approx(optimiser.assess(half, None, np.tile([0.1, 0.01], (14, 1))))  # type: ignore[arg-type]
    # A tenth of a millimetre's second more is the solver's noise.
    m = optimiser.samples
    for more, taken in ((0.9e-4, True), (1.1e-4, False)):
        wall = Wall(0.1 + 0.0)
        inner = to_rest(1.0)
        share = more / float(optimiser.fading @ path(plain, inner)[:, 0])
        found, _ = solved(Told(share * inner), wall, np.zeros((len(m), 1)))
        assert bool(np.abs(found.trajectory.accelerations).max() > 0) == taken


def test_fitted_accelerations_give_the_nearest_motion_that_ends_at_rest() -> None:
    _, optimiser = solved(Told(to_rest(0.0)), Wall())
    rng = np.random.default_rng(0)
    v0, a0 = np.array([0.3]), np.array([-0.7])
    base = optimiser.samples[:, None] * v0 + optimiser._P0[:, None] * a0
    inner = rng.standard_normal(KNOTS - 2)
    motion = Trajectory(0.0, STEP, Q0, v0, np.concatenate([a0, inner, [0.0]])[:, None])
    target = motion.at(optimiser.samples)[0]
    found = optimiser._fitted(v0, a0, base, target)
    assert found is not None
    fitted = Trajectory(0.0, STEP, Q0, v0, np.vstack([a0, found, 0 * a0[None]]))
    assert np.abs(fitted.at(np.array([fitted.end - 1e-9]))[1]).max() < 1e-6
    # Against the normal equations on motions that end at rest, solved another way.
    rest = optimiser._V[-1]
    null = np.linalg.svd(rest[None])[2][1:].T
    particular = rest * -(v0 + optimiser._V0[-1] * a0) / (rest @ rest)
    A = np.vstack([optimiser._P @ null, 1e-3 * null])
    b = np.concatenate([target[:, 0] - base[:, 0] - optimiser._P @ particular, -1e-3 * particular])
    np.testing.assert_allclose(found[:, 0], particular + null @ np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-8)
    assert optimiser._fitted(v0, a0, base, target + 30.0 * optimiser.samples[:, None] ** 2) is None


@pytest.mark.parametrize(("knots", "step", "period"), [(16, 0.12, 1 / 15), (20, 0.08, 0.02)])
def test_what_is_planned_over_and_over_keeps_the_limit_of_speed(knots: int, step: float, period: float) -> None:
    """A plan is fastest between its knots; one that may be as fast as the one before drifts off: by 36 and 31 %."""
    limits = Limits(np.array([-9.0]), np.array([9.0]), np.array([1.0]), np.array([10.0]))
    optimiser = Optimiser(Wall(), limits, knots, step)  # type: ignore[arg-type]
    plan = Trajectory.at_rest(0.0, step, knots, Q0)
    margins = np.tile([0.1, 0.01], (len(optimiser.samples), 1))
    for tick in range(60):
        now = tick * period
        (q,), (v,), (a,) = plan.at(np.array([now]))
        guess, far = plan.at(now + optimiser.samples)[0], np.full((len(optimiser.samples), 1), 3.0)
        found = optimiser.solve(PlanProblem(now, q, v, a, far, None, margins, plan), guess)  # type: ignore[arg-type]
        assert found.solved
        plan = found.trajectory
        assert np.abs(plan.at(now + np.linspace(0.0, period, 20))[1]).max() < 1.01
