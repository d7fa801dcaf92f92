"""Who is where and when: things on a table that are carried, taken out of view and brought back, as a hand does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pose_truth.things import OWN, YCB, Thing, thing

from twin_diagram.perception.registration.resting import resting
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]

CELLS = np.array([[0.17 * (k % 4) - 0.255, 0.19 * (k // 4) - 0.19] for k in range(12)])
"""Where things may stand, in W [m]: nothing of the library is wider than these are apart."""
LIFT = 0.22
"""Carried things go over the others [m]."""
AWAY = np.array([0.2, 0.75])
"""Beyond the picture, where things are taken [m]."""
PERIOD = 1 / 15
"""Between frames [s]."""


@dataclass(frozen=True)
class Carry:
    """One thing's way from a place to another: up, across with a turn, down.

    Attributes:
        begin, end: when [s].
        p0, p1: where its origin starts and ends [m].
        R0, R1: how it is turned there.
        tilt: rotation vector by which it leans half way [rad].
    """

    begin: float
    end: float
    p0: Array
    p1: Array
    R0: Array
    R1: Array
    tilt: Array

    def pose(self, time: float) -> tuple[Array, Array]:
        """Return R and p at a time between begin and end."""
        s = float(np.clip((time - self.begin) / (self.end - self.begin), 0.0, 1.0))
        across = _smooth(np.clip((s - 0.25) / 0.5, 0.0, 1.0))
        up = _smooth(np.clip(s / 0.3, 0.0, 1.0)) - _smooth(np.clip((s - 0.7) / 0.3, 0.0, 1.0))
        turn = rotations.log(rotations.from_matrix(self.R1 @ self.R0.T))
        R = rotations.matrix(rotations.exp(across * turn)) @ self.R0
        R = rotations.matrix(rotations.exp(4.0 * across * (1.0 - across) * self.tilt)) @ R
        return R, self.p0 + across * (self.p1 - self.p0) + [0.0, 0.0, LIFT * up]


def _smooth(s: float) -> float:
    return float(s * s * (3.0 - 2.0 * s))


@dataclass(frozen=True)
class Actor:
    """A thing and its ways, in order of time; between them it stands where the last one ended.

    Attributes:
        kind: the thing.
        known: whether the library has it.
        R, p: where it begins.
        ways: what happens to it.
    """

    kind: Thing
    known: bool
    R: Array
    p: Array
    ways: tuple[Carry, ...]

    def pose(self, time: float) -> tuple[Array, Array, bool]:
        """Return R, p and whether it is being carried."""
        R, p = self.R, self.p
        for way in self.ways:
            if time < way.begin:
                break
            R, p = way.pose(time)
            if time < way.end:
                return R, p, True
        return R, p, False


@dataclass(frozen=True)
class Script:
    """A scene: actors, and a plate that crosses the view: its first and last place (camera's x, y) [m], and when."""

    actors: tuple[Actor, ...]
    plate: tuple[Array, Array, float, float]


def drawn(data: object, rng: np.random.Generator, seconds: float) -> Script:
    """Draw a scene of eight things, two alike, one in no library; four are carried, one of them away for a while."""
    kinds = [str(one) for one in rng.permutation([*YCB, "mug", "can"])[:7]]
    kinds.append(kinds[int(rng.integers(7))])
    stranger = next(k for k, one in enumerate(kinds) if kinds.count(one) == 1)
    if rng.random() < 0.5:
        kinds[stranger] = OWN[2]
    cells = [int(one) for one in rng.permutation(len(CELLS))]
    actors, free = [], cells[8:]
    moved = [int(one) for one in rng.permutation(8)[:4]]
    for k, name in enumerate(kinds):
        one = thing(name, data)  # type: ignore[arg-type]
        R, p = _stood(one, CELLS[cells[k]], rng)
        ways: tuple[Carry, ...] = ()
        if k in moved:
            ways = _ways(one, R, p, CELLS[free[moved.index(k)]], moved.index(k), seconds, rng)
        actors.append(Actor(one, k != stranger, R, p, ways))
    start, end = np.array([-0.75, rng.uniform(-0.15, 0.15)]), np.array([0.75, rng.uniform(-0.15, 0.15)])
    begin = float(rng.uniform(0.3, 0.6)) * seconds
    return Script(tuple(actors), (start, end, begin, begin + float(rng.uniform(1.0, 2.0))))


def _stood(one: Thing, cell: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return how a thing stands in a cell, as it does most often, turned at random."""
    rests = resting(one.asset)
    R, height = rests[0] if rng.random() < 0.7 else rests[int(rng.integers(len(rests)))]
    turn = rotations.matrix(rotations.exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])))
    return turn @ R, np.array([*(cell + rng.uniform(-0.01, 0.01, 2)), height])


def _ways(
    one: Thing, R: Array, p: Array, cell: Array, number: int, seconds: float, rng: np.random.Generator
) -> tuple[Carry, ...]:
    """Return the ways of the thing that is moved as the number-th: the first is taken away and brought back."""
    R1, p1 = _stood(one, cell, rng)
    if number != 0:
        # Set down as it stood, but for a turn about the vertical.
        yaw = rotations.matrix(rotations.exp(np.array([0.0, 0.0, rng.uniform(-1.5, 1.5)])))
        R1, p1 = yaw @ R, np.array([*p1[:2], p[2]])
    tilt = rng.uniform(-0.6, 0.6, 3)
    begin = float(rng.uniform(0.15, 0.55)) * seconds
    if number:
        return (Carry(begin, begin + float(rng.uniform(1.2, 2.4)), p, p1, R, R1, tilt),)
    out = np.array([*AWAY, p[2]])
    back = begin + float(rng.uniform(2.0, 3.0))
    # Some cameras see what stands there: it turns on its way back, not at once.
    return (Carry(begin, begin + 1.2, p, out, R, R, tilt), Carry(back, back + 1.2, out, p1, R, R1, -tilt))
