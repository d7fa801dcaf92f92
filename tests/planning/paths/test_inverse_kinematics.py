"""Searches for joint goals, step by step, and which of what they find counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.planning.collision.ball_cover import arm_plant
from twin_diagram.planning.collision.chain import Chain
from twin_diagram.planning.paths.inverse_kinematics import IkTuning, nearby, pose_error, solve
from twin_diagram.signals.arrays import Array

EVERY = IkTuning(position_tolerance=np.inf, rotation_tolerance=np.inf, distinct=0.0)
NEAR = np.array([0.3, -0.9, 1.1, -1.3, 0.6, 0.4])
WIDE = np.full(6, 2.5)


@pytest.fixture(scope="module")
def chain() -> Chain:
    plant, _, arm, _ = arm_plant(scenario.ArmModel(model="arms/ur5e.urdf", tool_frame=""))
    return Chain.from_plant(plant, arm.joint_indices, arm.tool_frame)


def found(chain: Chain, goal: Array, tuning: IkTuning | None, near: Array = NEAR, limit: Array = WIDE) -> Array:
    X_WG = chain.tool(chain.place(goal[None]))[0]
    return solve(chain, X_WG, near, -limit, limit, np.random.default_rng(7), tuning)


def rows(q: Array) -> Array:
    return np.asarray(q[np.lexsort(q.T)])


def starts(low: Array, high: Array, near: Array = NEAR) -> Array:
    rng = np.random.default_rng(7)
    first = near + np.linspace(0.0, 1.5, 48)[:, None] * rng.standard_normal((48, 6))
    return np.clip(np.vstack([first, rng.uniform(low, high, (48, 6))]), low, high)


def test_half_of_the_searches_start_near_the_other_anywhere(chain: Chain) -> None:
    q = found(chain, NEAR, replace(EVERY, iterations=0))
    np.testing.assert_allclose(rows(q), rows(starts(-WIDE + 0.05, WIDE - 0.05)))
    np.testing.assert_array_equal(q[0], NEAR)  # the nearest first
    assert (np.diff(np.linalg.norm(q - NEAR, axis=1)) >= 0.0).all()
    q = found(chain, NEAR, replace(EVERY, iterations=0), limit=np.array([9.0, 2, 2, 0.1, 2, np.inf]), near=0.0 * NEAR)
    assert np.abs(q[:, 3]).max() == pytest.approx(0.08)  # a narrow joint keeps a tenth of its range
    assert 3.0 < np.abs(q[:, 5]).max() < 6.0


def test_a_step_is_damped_least_squares_no_longer_than_told(chain: Chain) -> None:
    goal = NEAR + 0.5
    low, high = -WIDE + 0.05, WIDE - 0.05
    q0 = starts(low, high)
    X_WG = chain.tool(chain.place(goal[None]))[0]
    expected = q0.copy()
    placement = chain.place(q0)
    error, J = pose_error(chain.tool(placement), X_WG), chain.tool_jacobian(placement)
    limited = 0
    for k in range(len(q0)):
        columns = np.ones(6, dtype=bool)
        for _ in range(2):
            system = np.vstack([J[k] * columns, np.sqrt(1e-3) * np.eye(6)])
            step = np.linalg.lstsq(system, np.append(error[k], np.zeros(6)), rcond=None)[0]
            columns = columns & ~((q0[k] <= low) & (step < 0)) & ~((q0[k] >= high) & (step > 0))
        limited += not columns.all()
        expected[k] = np.clip(q0[k] + step * min(1.0, 0.4 / np.abs(step).max()), low, high)
    assert limited > 3
    np.testing.assert_allclose(rows(found(chain, goal, replace(EVERY, iterations=1))), rows(expected), atol=1e-9)


@pytest.mark.parametrize("iterations", [5, 7, 9])
def test_what_counts_is_exact_to_ten_micrometres_and_distinct(chain: Chain, iterations: int) -> None:
    goal = NEAR + 0.3
    X_WG = chain.tool(chain.place(goal[None]))[0]
    every = found(chain, goal, replace(EVERY, iterations=iterations))
    error = pose_error(chain.tool(chain.place(every)), X_WG)
    good = (np.linalg.norm(error[:, :3], axis=1) < 1e-4) & (np.linalg.norm(error[:, 3:], axis=1) < 1e-5)
    expected: list[Array] = []
    for q in every[good]:
        if all(np.abs(q - other).max() >= 0.3 for other in expected):
            expected.append(q)
    assert 0 < good.sum() < len(every)
    np.testing.assert_allclose(found(chain, goal, IkTuning(iterations=iterations)), expected)


def test_solutions_keep_away_from_the_limits(chain: Chain) -> None:
    for above, there in ((0.055, True), (0.045, False)):
        limit = np.abs(NEAR) + np.array([1.0, 1.0, above, 1.0, 1.0, 1.0])
        q = found(chain, NEAR, None, limit=limit)
        assert bool(len(q) and np.abs(q[0] - NEAR).max() < 1e-3) == there


def test_a_goal_close_by_is_reached_in_the_shortest_way(chain: Chain) -> None:
    goal = NEAR + 0.02 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    X_WG = chain.tool(chain.place(goal[None]))[0]
    q, error = nearby(chain, X_WG, NEAR, -WIDE, WIDE, 12)
    assert np.abs(error).max() < 1e-9 and np.abs(q - goal).max() < 1e-6
    np.testing.assert_allclose(error, pose_error(chain.tool(chain.place(q[None])), X_WG)[0], atol=1e-9)
    placement = chain.place(NEAR[None])
    J, first = chain.tool_jacobian(placement)[0], pose_error(chain.tool(placement), X_WG)[0]
    step = J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(6), first)
    np.testing.assert_allclose(nearby(chain, X_WG, NEAR, -WIDE, WIDE, 1)[0], NEAR + step, atol=1e-9)
    q, error = nearby(chain, X_WG, NEAR, -WIDE, np.append(WIDE[:5], NEAR[5]), 12)
    assert q[5] <= NEAR[5] and np.abs(error).max() > 1e-3, "six joints have no other way past a limit"


def test_the_errors_turn_and_move_the_tool_into_the_goal(chain: Chain) -> None:
    rng = np.random.default_rng(0)
    q = NEAR + 0.2 * rng.standard_normal((5, 6))
    v = rng.standard_normal(6)
    h = 1e-6
    for each in q:
        X_WG = chain.tool(chain.place((each + h * v)[None]))[0]
        placement = chain.place(each[None])
        np.testing.assert_allclose(
            pose_error(chain.tool(placement), X_WG)[0] / h, chain.tool_jacobian(placement)[0] @ v, atol=1e-4
        )


def test_what_turns_the_tool_is_told_for_half_turns_too() -> None:
    from scipy.spatial.transform import Rotation

    from twin_diagram.planning.paths.inverse_kernels import _error

    rng, error = np.random.default_rng(8), np.empty(6)
    for angle in (0.0, 1e-9, 0.3, 2.0, np.pi - 1e-4, np.pi):
        X_WT, X_WG = np.eye(4), np.eye(4)
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        X_WT[:3, :3] = Rotation.random(random_state=3).as_matrix()
        X_WG[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix() @ X_WT[:3, :3]
        X_WT[:3, 3], X_WG[:3, 3] = rng.standard_normal(3), rng.standard_normal(3)
        p = _error(X_WT, np.eye(4), X_WG, error)
        np.testing.assert_allclose(p, X_WT[:3, 3])
        np.testing.assert_allclose(error[3:], X_WG[:3, 3] - X_WT[:3, 3])
        turned = Rotation.from_rotvec(error[:3]).as_matrix() @ X_WT[:3, :3]
        np.testing.assert_allclose(turned, X_WG[:3, :3], atol=1e-6)
        assert np.linalg.norm(error[:3]) == pytest.approx(angle, abs=1e-6)


def test_limits_may_lie_beyond_half_a_turn(chain: Chain) -> None:
    """A joint that is mounted the other way round may have its limits from 3.5 to 6 rad."""
    goal = NEAR + [0.0, 0.0, 0.0, 0.0, 4.4, 0.0]
    X_WG = chain.tool(chain.place(goal[None]))[0]
    low, high = np.where(np.arange(6) == 4, 3.5, -WIDE), np.where(np.arange(6) == 4, 6.0, WIDE)
    q = solve(chain, X_WG, goal + 0.1, low, high, np.random.default_rng(7), IkTuning())
    np.testing.assert_allclose(q[0], goal, atol=1e-3)
    assert (q >= low).all() and (q <= high).all()
