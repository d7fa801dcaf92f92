"""What is in the fingers' way in a bin: its walls, and what lies beside the thing that is to be taken, as points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    rooms: tuple[float, ...] = (0.004, 0.0)
    """By which all of it counts as nearer than it is [m]: the arm sags by two millimetres, pictures are off by one, and
    of what lies beside no picture from above shows the sides. It counts as higher by as much: the hand's palm reaches
    over it. Where that leaves no grasp, it counts as where it is."""

    walls: float = 0.008
    """Distance between points that stand for the bin's walls, and how thick these are at the least [m]."""

    beside: float = 0.006
    """Edge of the cells of each thing beside of which a point is kept [m], less than half of a finger's thickness: of a
    cracker box's face places are up to 17 mm from the nearest of 500 drawn points."""

    yielding: float = 0.025
    """What lies beside a thing and this near to it, as seen from above, gives way to a finger [m]: it is 15 mm thick,
    and there is some room already. With 15 mm a bottle that a cracker box and a ring lean on leaves no more grasps."""

    border: int = 3
    """Pixels between two things whose outlines are one: edges of depth have no depth of their own."""

    above: float = 0.01
    """By which something at such a border is higher where it may lie over the other [m]."""

    covered: float = 0.1
    """Share of a thing's outline at such borders from which what is below another one is told of it."""


TUNING = Tuning()


def in_the_way(low: Array, high: Array, others: Sequence[Array]) -> list[Array]:
    """Return points (N, 3) that fingers keep clear of [m]: with room about all of it, then without, see `Tuning.rooms`.

    Args:
        low: (3,) lowest corner of the bin's inside.
        high: (3,) its highest.
        others: points (M, 3) of each thing that lies beside.
    """
    few = [points[np.unique(np.floor(points / TUNING.beside), axis=0, return_index=True)[1]] for points in others]
    found = []
    for room in TUNING.rooms:
        found.append(np.concatenate([wall_points(low, high, room), *(with_room(one, room) for one in few)]))
    return found


def with_room(points: Array, room: float) -> Array:
    """Return points (M, 3) that stand for others (N, 3), nearer and higher by some room [m]."""
    shifts = room * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    shifts = np.insert(np.unique(shifts, axis=0), 2, room, axis=1)
    return np.concatenate([points + shift for shift in shifts])


def yielding_away(thing: SeenThing, others: Sequence[Array]) -> list[Array]:
    """Return of points (M, 3) of each thing beside one those that stay where a finger beside it pushes others away.

    What is higher than the thing stays: the hand's palm would come down on it.
    """
    tree = cKDTree(thing.points[:, :2])
    return [points[(tree.query(points[:, :2])[0] > TUNING.yielding) | (points[:, 2] > thing.top)] for points in others]


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


def covered_share(thing: SeenThing, others: Sequence[SeenThing]) -> float:
    """Return the share of a thing's outline in the picture beside which something higher begins: it may go on below.

    Args:
        thing: as the picture shows it.
        others: what else it shows.
    """
    corner = thing.pixels.min(axis=0) - TUNING.border - 1
    shape = tuple(thing.pixels.max(axis=0) - corner + TUNING.border + 2)
    around, height = np.full(shape, -np.inf), np.full(shape, -np.inf)
    around[tuple((thing.pixels - corner).T)] = thing.points[:, 2]
    own = np.isfinite(around)
    for other in others:
        at = other.pixels - corner
        inside = ((at >= 0) & (at < shape)).all(axis=1)
        height[tuple(at[inside].T)] = other.points[inside, 2]
    size = 2 * TUNING.border + 1
    outline = own & ~ndimage.binary_erosion(own)
    beside = (
        ndimage.maximum_filter(height, size)[outline] > ndimage.maximum_filter(around, size)[outline] + TUNING.above
    )
    return float(beside.mean())


def why_barred(why: str, thing: SeenThing, others: Sequence[SeenThing]) -> str:
    """Return why a thing cannot be taken, with what lies on it or leans over it; see `covered_share`."""
    share = covered_share(thing, others)
    return why if share < TUNING.covered else f"something lies over it, along {100 * share:.0f} % of its outline; {why}"
