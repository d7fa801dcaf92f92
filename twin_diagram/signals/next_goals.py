"""What goes over the wires about where the arm goes after the goal that it has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE

COUNT: Final = 2
"""Goals that are told: in the second that is looked ahead fingers close, lift and set off across."""
_ROW: Final = POSE_SIZE + 2
"""Numbers of a packed goal."""
NEXT_GOALS_SIZE: Final = COUNT * _ROW
"""Packed goals."""


@dataclass(frozen=True)
class NextGoal:
    """A goal after another.

    Attributes:
        X_WG: (7) of the tool frame.
        pause: so long after it has come to the goal before the arm sets out for this one [s]; negative: it passes the
            goal before, and is on its way so much sooner.
        earliest: when it sets out at the soonest [s]; `NEVER`: that is not known.
    """

    X_WG: Array
    pause: float = 0.0
    earliest: float = NEVER


def pack(goals: list[NextGoal]) -> Array:
    """Return the first `COUNT` goals as a vector of `NEXT_GOALS_SIZE`; zeros where there are none."""
    rows = np.zeros((COUNT, _ROW))
    for row, each in zip(rows, goals, strict=False):
        row[:] = [*each.X_WG, each.pause, each.earliest]
    return rows.ravel()


def unpack(vector: Array) -> list[NextGoal]:
    """Return the inverse of `pack`, up to the first that is no goal."""
    goals: list[NextGoal] = []
    for row in vector.reshape(COUNT, _ROW):
        if not (np.isfinite(row).all() and row[:4].any()):
            break
        goals.append(NextGoal(row[:POSE_SIZE].copy(), float(row[POSE_SIZE]), float(row[POSE_SIZE + 1])))
    return goals
