"""The compiled part of `judging.view`: what of a cloud lies before each of many poses, without a table of all pairs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.compiled import compiled

Indices = npt.NDArray[np.intp]
Single = npt.NDArray[np.float32]


@compiled
def before(
    left: Single, right: Single, half: float, palm: tuple[float, float, float, float], ahead: float
) -> tuple[Single, Indices, Indices, Single]:
    """Return how far each pose's palm can be pushed on, and the points near its closing plane before it.

    All lengths are compared in single precision, and a place is a sum in the order of `left`'s columns, each product
    added with one rounding: what a matrix product with fused steps gives, to the bit.

    Args:
        left: (K, 3, 4) of `slab.factors`: the poses' axes and shifts.
        right: (4, N) of it: the points and ones.
        half: how far from the closing plane points count, along x [m].
        palm: halves of the palm's edges along x and y, what is kept before it, and its front's z [m].
        ahead: how far before what the palm can be pushed on points count, along z [m].

    Returns:
        (K,) how far [m]; of the points pose (M,), number (M,), and place (3, M) in the pose's frame [m].
    """
    poses, points = len(left), right.shape[1]
    least, wide, tall = np.float32(half), np.float32(palm[0]), np.float32(palm[1])
    reach, gap, front = max(least, wide), np.float32(palm[2]), np.float32(palm[3])
    farther = np.float32(ahead)
    stop = np.empty(poses, dtype=np.float32)
    x, near = np.empty(points, dtype=np.float32), np.empty(points, dtype=np.intp)
    yz = np.empty((2, points), dtype=np.float32)
    room = max(1024, 32 * poses)
    pose, point = np.empty(room, dtype=np.intp), np.empty(room, dtype=np.intp)
    place, count = np.empty((3, room), dtype=np.float32), 0
    for k in range(poses):
        _along(left[k, 0], right, x)
        some, nearest = 0, np.float32(np.inf)
        for n in range(points):
            if abs(x[n]) > reach:
                continue
            y, z = _at(left[k, 1], right, n), _at(left[k, 2], right, n)
            if abs(x[n]) <= wide and abs(y) <= tall and z < nearest:
                nearest = z
            if abs(x[n]) <= least:
                near[some], yz[0, some], yz[1, some] = n, y, z
                some += 1
        stop[k] = nearest - gap - front
        most = max(stop[k], np.float32(0.0)) + farther
        if count + some > room:
            room = 2 * (count + some)
            pose, point, place = _longer(pose, room), _longer(point, room), _wider(place, room)
        for m in range(some):
            if yz[1, m] <= most:
                n = near[m]
                pose[count], point[count] = k, n
                place[0, count], place[1, count], place[2, count] = x[n], yz[0, m], yz[1, m]
                count += 1
    return stop, pose[:count].copy(), point[:count].copy(), place[:, :count].copy()


@compiled
def _at(row: Single, right: Single, n: int) -> np.float32:
    """Return a row (4,) times the column n of `right` (4, N)."""
    total = np.float32(row[0] * right[0, n])
    for j in range(1, 4):
        # The product of two single numbers is a double one, exactly: their sum is rounded once.
        total = np.float32(np.float64(row[j]) * np.float64(right[j, n]) + np.float64(total))
    return total


@compiled
def _along(row: Single, right: Single, found: Single) -> None:
    """Write a row (4,) times all columns of `right` (4, N)."""
    for n in range(right.shape[1]):
        found[n] = np.float32(row[0] * right[0, n])
    for j in range(1, 4):
        factor = np.float64(row[j])
        for n in range(right.shape[1]):
            found[n] = np.float32(factor * np.float64(right[j, n]) + np.float64(found[n]))


@compiled
def _longer(array: Indices, room: int) -> Indices:
    """Return an array (M,) with room for more."""
    more = np.empty(room, dtype=array.dtype)
    more[: len(array)] = array
    return more


@compiled
def _wider(array: Single, room: int) -> Single:
    """Return an array (3, M) with room for more columns."""
    more = np.empty((3, room), dtype=array.dtype)
    more[:, : array.shape[1]] = array
    return more
