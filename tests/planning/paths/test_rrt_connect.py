"""The global planner: how it samples, grows, counts and shortens, in two joints."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from twin_diagram.planning.paths import rrt_connect
from twin_diagram.planning.paths.rrt_connect import GuideTuning, _Budget, _connect, _grow, _Tree
from twin_diagram.signals.arrays import Array

ONES = np.ones(2)


def free(q: Array) -> np.ndarray:
    return np.ones(len(q), dtype=bool)


def test_the_nearest_node_is_by_the_largest_weighted_motion() -> None:
    tree = _Tree(np.array([[0.0, 0.0], [1.0, 0.3], [0.2, 0.9]]))
    assert tree.nearest(np.array([0.6, 0.4]), ONES) == 1
    assert tree.nearest(np.array([0.6, 0.4]), np.array([1.0, 0.1])) in (1, 2)
    assert tree.nearest(np.array([0.55, 0.0]), np.array([0.1, 1.0])) == 0
    index = tree.add(np.array([2.0, 2.0]), 1)
    np.testing.assert_array_equal(tree.branch(index), [[2.0, 2.0], [1.0, 0.3]])


def test_a_tree_grows_no_farther_than_a_branch_and_as_far_as_is_free() -> None:
    tuning = GuideTuning()
    for target, end in (([3.0, 1.5], [0.8, 0.4]), ([0.5, 0.2], [0.5, 0.2])):
        tree = _Tree(np.zeros(2))
        new = _grow(tree, np.array(target), _Budget(free, 1000), ONES, tuning, once=True)
        assert new is not None
        np.testing.assert_allclose(tree.nodes[new], end)
    tree = _Tree(np.zeros(2))
    new = _grow(tree, np.array([3.0, 1.5]), _Budget(free, 1000), ONES, tuning, once=False)
    assert new is not None
    np.testing.assert_array_equal(tree.nodes[new], [3.0, 1.5])
    assert _grow(tree, np.array([3.0, 1.5]), _Budget(free, 1000), ONES, tuning, once=False) == new
    # Up to a wall at 0.5: the last checked configuration before it, checks 0.08 rad apart.
    budget = _Budget(lambda q: q[:, 0] < 0.5, 1000)
    tree = _Tree(np.zeros(2))
    new = _grow(tree, np.array([0.8, 0.0]), budget, ONES, tuning, once=True)
    assert new is not None and budget.left == 990
    np.testing.assert_allclose(tree.nodes[new], [0.48, 0.0])
    assert (
        _grow(_Tree(np.zeros(2)), np.array([0.8, 0.0]), _Budget(lambda q: q[:, 0] > 9, 99), ONES, tuning, once=True)
        is None
    )


def test_a_line_is_cut_no_finer_than_it_must_be() -> None:
    assert len(rrt_connect.interpolate(np.zeros(1), np.array([0.24]), 0.08)) == 3
    assert len(rrt_connect.interpolate(np.zeros(1), np.array([0.2401]), 0.08)) == 4
    np.testing.assert_allclose(rrt_connect.interpolate(np.zeros(1), np.zeros(1), 0.08), [[0.0]])


class Recorded:
    """A generator that remembers within which bounds it was asked."""

    def __init__(self) -> None:
        self.bounds: list[tuple[Array, Array]] = []
        self._rng = np.random.default_rng(1)

    def uniform(self, low: Array, high: Array) -> Array:
        self.bounds.append((np.array(low), np.array(high)))
        return np.asarray(self._rng.uniform(low, high))


def test_samples_come_from_a_window_and_from_everywhere_two_steps_each() -> None:
    rng = Recorded()
    start, goals = np.array([0.0, 0.5]), np.array([[1.0, 0.0]])

    def is_free(q: Array) -> np.ndarray:
        return q[:, 0] < 0.5

    _connect(start, goals, _Budget(is_free, 300), np.full(2, -2.0), np.full(2, 1.9), rng, ONES, GuideTuning())  # type: ignore[arg-type]
    near, far = ([-1.2, -1.2], [1.9, 1.7]), ([-2.0, -2.0], [1.9, 1.9])
    assert len(rng.bounds) > 8
    for turn, (low, high) in enumerate(rng.bounds):
        expected = near if turn % 4 < 2 else far
        np.testing.assert_allclose(low, expected[0])
        np.testing.assert_allclose(high, expected[1])


@pytest.mark.parametrize("seed", range(6))
def test_found_paths_are_free_lead_from_start_to_goal_and_are_the_better_of_two(seed: int) -> None:
    def is_free(q: Array) -> np.ndarray:
        return (np.abs(q[:, 0]) > 0.3) | (q[:, 1] > 1.0)

    start, goals = np.array([-1.0, 0.0]), np.array([[1.0, 0.0], [1.4, 0.2]])
    bound = np.full(2, 2.0)
    weights = np.array([1.0, 2.0])
    several = []
    for trials in (1, 2):
        rng = np.random.default_rng(seed)
        found = rrt_connect.plan(start, goals, is_free, -bound, bound, rng, 20000, weights, GuideTuning(trials=trials))
        assert found is not None
        np.testing.assert_array_equal(found[0], start)
        assert (found[-1] == goals).all(axis=1).any()
        for a, b in pairwise(found):
            assert is_free(rrt_connect.interpolate(a, b, 0.16)).all()
        several.append(rrt_connect.length(found, weights))
    assert several[1] <= several[0] + 1e-12
    told = rrt_connect.plan(start, goals, is_free, -bound, bound, np.random.default_rng(seed), 20000, weights)
    assert told is not None
    assert rrt_connect.length(told, weights) == several[1]  # two searches are what is done unless told


def test_start_and_goals_may_lie_beyond_what_is_drawn() -> None:
    """As those of a joint do that has turned by more than half a turn, or of a long rail."""

    def is_free(q: Array) -> np.ndarray:
        return (np.abs(q[:, 0] - 5.0) > 0.3) | (q[:, 1] > 1.0)

    bound = np.full(2, np.pi)
    start, goals = np.array([4.2, 0.0]), np.array([[5.8, 0.0]])
    found = rrt_connect.plan(start, goals, is_free, -bound, bound, np.random.default_rng(1), 20000)
    assert found is not None
    np.testing.assert_array_equal(found[[0, -1]], [start, goals[0]])


def test_without_weights_all_joints_weigh_one() -> None:
    start, goals, bound = np.zeros(2), np.array([[1.0, 1.0]]), np.full(2, 2.0)
    paths = [
        rrt_connect.plan(start, goals, lambda q: np.hypot(q[:, 0] - 0.5, q[:, 1] - 0.5) > 0.3, -bound, bound,
                         np.random.default_rng(2), 5000, weights)
        for weights in (None, ONES)
    ]  # fmt: skip
    np.testing.assert_array_equal(paths[0], paths[1])


def test_a_zigzag_is_drawn_straight_but_not_through_what_is_in_the_way() -> None:
    path = np.array([[0.0, 0.0], [0.5, 1.0], [1.0, 0.0], [1.5, 1.0], [2.0, 0.0]])

    def outside(q: Array) -> np.ndarray:
        return np.hypot(q[:, 0] - 1.0, q[:, 1] + 0.2) > 0.25

    short = rrt_connect.shorten(path, outside, np.random.default_rng(0), GuideTuning(), ONES)
    np.testing.assert_array_equal(short[[0, -1]], path[[0, -1]])
    assert rrt_connect.length(short, ONES) < rrt_connect.length(rrt_connect.prune(path, outside, 0.08), ONES) + 1e-12
    for a, b in pairwise(short):
        assert outside(rrt_connect.interpolate(a, b, 0.08)).all()
    np.testing.assert_array_equal(
        rrt_connect.shorten(path, free, np.random.default_rng(0), GuideTuning(), ONES), path[[0, -1]]
    )


def test_shortcuts_make_a_detour_shorter_within_their_number() -> None:
    """Around a corner that no straight line between way points cuts; each shortcut asks for one line at most."""

    def corner(q: Array) -> np.ndarray:
        return (q[:, 0] < 0.9) | (q[:, 1] > 0.6) | (np.hypot(q[:, 0] - 2, q[:, 1]) < 0.0)

    def is_free(q: Array) -> np.ndarray:
        return ~((q[:, 0] > -0.1) & (q[:, 0] < 2.1) & (q[:, 1] < 0.2))

    path = np.array([[-1.0, 0.0], [-1.0, 2.0], [3.0, 2.0], [3.0, 0.0]])
    asked: list[int] = []

    def counted(q: Array) -> np.ndarray:
        asked.append(len(q))
        return is_free(q)

    weights = np.array([1.0, 3.0])
    kept = rrt_connect.prune(path, is_free, 0.08)
    pruning = [0]

    def pruned(q: Array) -> np.ndarray:
        pruning[0] += 1
        return is_free(q)

    rrt_connect.prune(path, pruned, 0.08)
    short = rrt_connect.shorten(path, counted, np.random.default_rng(3), GuideTuning(), weights)
    assert rrt_connect.length(short, weights) < 0.9 * rrt_connect.length(kept, weights)
    assert 4 <= len(asked) - pruning[0] <= 16
    for a, b in pairwise(short):
        assert is_free(rrt_connect.interpolate(a, b, 0.08)).all()
