"""A global planner in joint space: RRT-Connect with shortcuts, bounded by how many configurations it may check.

(Kuffner and LaValle, RRT-Connect: an efficient approach to single-query path planning, ICRA 2000.) Bounded by checks
and not by time, so that the same question always has the same answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

IsFree = Callable[[Array], npt.NDArray[np.bool_]]
"""Says of configurations (M, n) which are free, (M,)."""


@dataclass(frozen=True)
class GuideTuning:
    """How the global planner searches."""

    resolution: float = 0.08
    """Distance between checked configurations, largest joint [rad]."""
    extension: float = 0.8
    """Longest branch [rad]."""
    shortcuts: int = 16
    """Straight lines that are tried between random points of a path found."""
    trials: int = 2
    """Searches, of which the shortest path is taken."""
    window: float = 1.2
    """Samples lie within this of start and goals, joint by joint, in every second search step [rad]."""


class _Budget:
    """Counts checks."""

    def __init__(self, is_free: IsFree, checks: int) -> None:
        self._is_free = is_free
        self.left = checks

    def free(self, q: Array) -> npt.NDArray[np.bool_]:
        self.left -= len(q)
        return self._is_free(q)


def interpolate(start: Array, end: Array, resolution: float) -> Array:
    """Return evenly spaced configurations (M, n) after `start` through `end`, at most `resolution` apart per joint."""
    count = max(1, int(np.ceil(np.abs(end - start).max() / resolution - 1e-9)))
    return start + (np.arange(1, count + 1) / count)[:, None] * (end - start)


def length(path: Array, weights: Array) -> float:
    """Return the length of a path (W, n): its segments' largest weighted joint motion, summed."""
    return float(np.abs(np.diff(path, axis=0) * weights).max(axis=1).sum())


def plan(
    start: Array,
    goals: Array,
    is_free: IsFree,
    lower: Array,
    upper: Array,
    rng: np.random.Generator,
    checks: int,
    weights: Array | None = None,
    tuning: GuideTuning | None = None,
) -> Array | None:
    """Return a free path from `start` to one of several goals.

    Args:
        start: (n,), taken to be free.
        goals: (G, n), taken to be free.
        is_free: checks configurations.
        lower: (n,) finite limits [rad] of what is drawn, widened to those of start and goals.
        upper: (n,) likewise.
        rng: draws samples.
        checks: most configurations that may be checked.
        weights: (n,) cost of a joint's motion per radian; None: one.
        tuning: None for the defaults.

    Returns:
        (W, n) way points from `start` to a goal with free straight lines between, or None where none was found.
    """
    tuning = tuning or GuideTuning()
    weights = np.ones(len(start)) if weights is None else weights
    ends = np.vstack([start, goals])
    lower, upper = np.minimum(lower, ends.min(axis=0)), np.maximum(upper, ends.max(axis=0))
    budget = _Budget(is_free, checks)
    best: Array | None = None
    for _ in range(tuning.trials):
        # A first path may cost all; what is left of the checks goes into finding a better one.
        path = _connect(start, goals, budget, lower, upper, rng, weights, tuning)
        if path is None:
            break
        path = shorten(path, budget.free, rng, tuning, weights)
        if best is None or length(path, weights) < length(best, weights):
            best = path
    return best


class _Tree:
    def __init__(self, roots: Array) -> None:
        self.nodes = [*np.atleast_2d(roots)]
        self.parents = [-1] * len(self.nodes)

    def nearest(self, q: Array, weights: Array) -> int:
        return int(np.abs((np.array(self.nodes) - q) * weights).max(axis=1).argmin())

    def add(self, q: Array, parent: int) -> int:
        self.nodes.append(q)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def branch(self, index: int) -> list[Array]:
        result = []
        while index >= 0:
            result.append(self.nodes[index])
            index = self.parents[index]
        return result


def _connect(
    start: Array,
    goals: Array,
    budget: _Budget,
    lower: Array,
    upper: Array,
    rng: np.random.Generator,
    weights: Array,
    tuning: GuideTuning,
) -> Array | None:
    trees = [_Tree(start), _Tree(goals)]
    low = np.maximum(lower, np.vstack([start, goals]).min(axis=0) - tuning.window)
    high = np.minimum(upper, np.vstack([start, goals]).max(axis=0) + tuning.window)
    turn = 0
    while budget.left > 0:
        near = turn // 2 % 2 == 0
        sample = rng.uniform(low, high) if near else rng.uniform(lower, upper)
        growing, other = trees[turn % 2], trees[1 - turn % 2]
        new = _grow(growing, sample, budget, weights, tuning, once=True)
        if new is not None:
            target = growing.nodes[new]
            met = _grow(other, target, budget, weights, tuning, once=False)
            if met is not None and np.array_equal(other.nodes[met], target):
                ours, theirs = growing.branch(new), other.branch(met)
                forward = ours[::-1] + theirs[1:]
                return np.array(forward if turn % 2 == 0 else forward[::-1])
        turn += 1
    return None


def _grow(
    tree: _Tree, target: Array, budget: _Budget, weights: Array, tuning: GuideTuning, *, once: bool
) -> int | None:
    """Grow a tree straight towards a target as far as is free; answers the new end, None where nothing grew."""
    index = tree.nearest(target, weights)
    node = tree.nodes[index]
    way = target - node
    far = np.abs(way).max()
    if far < 1e-9:
        return index
    if once and far > tuning.extension:
        target = node + way * (tuning.extension / far)
    line = interpolate(node, target, tuning.resolution)
    line[-1] = target
    free = budget.free(line)
    count = len(line) if free.all() else int(np.argmin(free))
    if count == 0:
        return None
    return tree.add(line[count - 1], index)


def shorten(path: Array, is_free: IsFree, rng: np.random.Generator, tuning: GuideTuning, weights: Array) -> Array:
    """Replace stretches of a path (W, n) by straight lines where they are free; start and end stay."""
    path = prune(path, is_free, tuning.resolution)
    for _ in range(tuning.shortcuts):
        if len(path) < 3:
            break
        steps = np.abs(np.diff(path, axis=0) * weights).max(axis=1)
        ends = np.concatenate([[0.0], np.cumsum(steps)])
        first, second = np.sort(rng.uniform(0.0, ends[-1], 2))
        i, j = (min(int(np.searchsorted(ends, s, side="right")) - 1, len(steps) - 1) for s in (first, second))
        if i == j:
            continue
        a = path[i] + (first - ends[i]) / max(steps[i], 1e-12) * (path[i + 1] - path[i])
        b = path[j] + (second - ends[j]) / max(steps[j], 1e-12) * (path[j + 1] - path[j])
        shorter = np.vstack([path[: i + 1], a, b, path[j + 1 :]])
        if (
            length(shorter, weights) < length(path, weights) - 1e-6
            and is_free(interpolate(a, b, tuning.resolution)).all()
        ):
            path = shorter
    return path


def prune(path: Array, is_free: IsFree, resolution: float) -> Array:
    """Leave out way points that a free straight line makes needless, the farthest first."""
    kept, here = [path[0]], 0
    while here < len(path) - 1:
        for there in range(len(path) - 1, here, -1):
            if there == here + 1 or is_free(interpolate(path[here], path[there], resolution)).all():
                break
        kept.append(path[there])
        here = there
    return np.array(kept)
