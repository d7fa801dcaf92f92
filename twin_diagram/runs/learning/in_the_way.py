"""What is in the fingers' way in a bin: its walls, and what lies beside the thing that is to be taken, as points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    rooms: tuple[float, ...] = (0.004, 0.0)
    """By which all of it counts as nearer than it is [m]: the arm sags by two millimetres, pictures are off by one, and
    of what lies beside no picture from above shows the sides. Where that leaves no grasp, it counts as where it is."""

    walls: float = 0.008
    """Distance between points that stand for the bin's walls, and how thick these are at the least [m]."""

    beside: int = 500
    """Points of each thing beside that are kept."""


TUNING = Tuning()


def in_the_way(low: Array, high: Array, others: Sequence[Array]) -> list[Array]:
    """Return points (N, 3) that fingers keep clear of [m]: with room about all of it, then without, see `Tuning.rooms`.

    Args:
        low: (3,) lowest corner of the bin's inside.
        high: (3,) its highest.
        others: points (M, 3) of each thing that lies beside, in random order.
    """
    few = [points[: TUNING.beside] for points in others]
    found = []
    for room in TUNING.rooms:
        shifts = room * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        shifts = np.column_stack([np.unique(shifts, axis=0), np.zeros(len(np.unique(shifts, axis=0)))])
        found.append(np.concatenate([wall_points(low, high, room), *(one + shift for one in few for shift in shifts)]))
    return found


def wall_points(low: Array, high: Array, room: float = 0.0) -> Array:
    """Return points (N, 3) on the inner faces of a bin's walls and on their rims, moved nearer by some room [m].

    Args:
        low: (3,) lowest corner of its inside [m].
        high: (3,) its highest.
        room: by which the faces are moved inwards, and the rims up [m].
    """
    z = np.arange(low[2], high[2] + 1e-9, TUNING.walls)
    found = []
    for axis in (0, 1):
        along = np.arange(low[1 - axis], high[1 - axis], TUNING.walls)
        face = np.array([[-room, height] for height in z] + [[out, high[2] + room] for out in (0.0, TUNING.walls)])
        k, a = (grid.ravel() for grid in np.meshgrid(np.arange(len(face)), along))
        for inner, outwards in ((low[axis], -1.0), (high[axis], 1.0)):
            wall = np.zeros((a.size, 3))
            wall[:, axis], wall[:, 1 - axis], wall[:, 2] = inner + outwards * face[k, 0], a, face[k, 1]
            found.append(wall)
    return np.concatenate(found)
