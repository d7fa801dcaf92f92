"""What the planner remembers from tick to tick, and how that is a vector."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate, pairwise
from typing import Final

import numpy as np

from twin_diagram.planning.mpc.trajectory import Trajectory
from twin_diagram.planning.paths.guide import TUNING as GUIDE
from twin_diagram.planning.paths.guide import Question
from twin_diagram.planning.paths.situation import Aim, Route
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE


@dataclass(frozen=True)
class Tuning:
    """How much is remembered: the lengths of the system's state; chosen by hand."""

    way_points: int = 12
    """Way points that are remembered; of a longer route the first ones."""


TUNING = Tuning()

FRESH: Final = -1_000_000
"""Stands for the tick of a search that was never made."""


@dataclass(frozen=True)
class Memory:
    """All that the planner remembers from tick to tick.

    Attributes:
        trajectory: the plan, in commanded positions; its start is `NEVER` before the first tick.
        offset: (n,) how far the command leads the arm, beyond what it lags behind [rad].
        goal: (7,) the goal that `goals` are for, all zero for none.
        stay: (n,) where to stay without a goal [rad].
        goals: (G, n) joint goals, G <= `guide.Tuning.goals`.
        route: the way ahead.
        tick: number of ticks.
        asked: tick at which the last search was asked for.
        heard: a search has answered since the goal is the present one.
        braked: what searches has failed: the arm rests until it works again.
        checked: when a tick last made a plan, or looked for a better one than the plan before and found none [s].
        next_goal: (7,) the goal after this one that a way was looked for to; all zero for none.
        beyond: (W, n) the way points to it that were found.
        pending: what was asked and not yet answered; no part of the vector.
    """

    trajectory: Trajectory
    offset: Array
    goal: Array
    stay: Array
    goals: Array
    route: Route
    tick: int
    asked: int
    heard: bool = False
    braked: bool = False
    checked: float = NEVER
    next_goal: Array = field(default_factory=lambda: np.zeros(POSE_SIZE))
    beyond: Array = field(default_factory=lambda: np.zeros((0, 0)))
    pending: Question | None = None

    @property
    def stuck(self) -> bool:
        """Whether there is a goal, a search has answered, and no way to it is known; not where searching has failed."""
        return bool(np.any(self.goal)) and self.heard and not self.braked and not self.route.to_goal

    @staticmethod
    def size(n: int, knots: int) -> int:
        """Return the length of the packed vector."""
        return 1 + n * (2 + knots) + n + 2 * POSE_SIZE + n + 1 + GUIDE.goals * n + 3 + 2 * TUNING.way_points * n + 5

    @staticmethod
    def initial(q: Array, knots: int, step: float) -> Memory:
        """Return the memory before the first tick, at rest at `q` (n,)."""
        n = len(q)
        trajectory = Trajectory.at_rest(NEVER, step, knots, q)
        return Memory(
            trajectory,
            np.zeros(n),
            np.zeros(POSE_SIZE),
            np.array(q, dtype=float),
            np.zeros((0, n)),
            Route.none(n),
            0,
            FRESH,
        )

    def pack(self) -> Array:
        """Return the memory as a vector."""
        t, n = self.trajectory, len(self.offset)
        goals, points = np.zeros((GUIDE.goals, n)), np.zeros((TUNING.way_points, n))
        goals[: len(self.goals)] = self.goals
        count = min(len(self.route.points), TUNING.way_points)
        points[:count] = self.route.points[:count]
        beyond = np.zeros_like(points)
        if len(self.beyond):
            beyond[: len(self.beyond)] = self.beyond
        return np.concatenate(
            [
                [t.start], t.q0, t.v0, t.accelerations.ravel(), self.offset, self.goal, self.stay,
                [len(self.goals)], goals.ravel(), [int(self.route.aim), count], points.ravel(),
                self.next_goal, [len(self.beyond)], beyond.ravel(),
                [self.tick, self.asked, self.heard, self.braked, self.checked],
            ]
        )  # fmt: skip

    @staticmethod
    def trajectory_of(vector: Array, n: int, knots: int, step: float) -> Trajectory:
        """Return the trajectory alone of a packed vector; copies."""
        part = np.array(vector[: 1 + (2 + knots) * n])
        return Trajectory(
            float(part[0]), step, part[1 : 1 + n], part[1 + n : 1 + 2 * n], part[1 + 2 * n :].reshape(knots, n)
        )

    @staticmethod
    def braked_in(vector: Array) -> bool:
        """Return whether a packed vector's arm rests because what searches for ways has failed."""
        return bool(vector[-2])

    @staticmethod
    def way_on_in(vector: Array, n: int, knots: int) -> bool:
        """Return whether a packed vector holds a way on to the goal after its goal."""
        return bool(vector[_parts(n, knots)[_FOUND].start])

    @staticmethod
    def proved_at(vector: Array) -> float:
        """Return when the plan of a packed vector was made, or last found better than any other [s]."""
        return max(float(vector[0]), float(vector[-1]))

    @staticmethod
    def unpack(vector: Array, n: int, knots: int, step: float, pending: Question | None = None) -> Memory:
        """Return the inverse of `pack`, with what is `pending` beside it; copies."""
        copy = np.array(vector)
        parts = (copy[part] for part in _parts(n, knots))
        offset, goal, stay, count, goals, route, points, next_goal, found, beyond, last = parts
        return Memory(
            Memory.trajectory_of(copy, n, knots, step),
            offset,
            goal,
            stay,
            goals.reshape(GUIDE.goals, n)[: int(count[0])],
            Route(Aim(int(route[0])), points.reshape(TUNING.way_points, n)[: int(route[1])]),
            int(last[0]),
            int(last[1]),
            bool(last[2]),
            bool(last[3]),
            float(last[4]),
            next_goal,
            beyond.reshape(TUNING.way_points, n)[: int(found[0])],
            pending,
        )


_FOUND: Final = 8
"""Which of `_parts` tells how many way points to the next goal were found."""


@cache
def _parts(n: int, knots: int) -> tuple[slice, ...]:
    """Return where each part of a packed `Memory` after its trajectory stands."""
    ways = TUNING.way_points * n
    sizes = (n, POSE_SIZE, n, 1, GUIDE.goals * n, 2, ways, POSE_SIZE, 1, ways, 5)
    return tuple(slice(*ends) for ends in pairwise(accumulate(sizes, initial=1 + (2 + knots) * n)))
