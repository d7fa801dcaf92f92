"""The compiled part of `closing`: what fingers and pads meet among a slab's entries."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled

Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]


@compiled
def nearest_before(
    pose: Indices, q: Array, offset: Array, other: Flags, least: float, most: float, half: float
) -> Array:
    """Return (K,) the least z of what would meet a finger, or part of one, that is pushed on; infinite: nothing [m].

    Args:
        pose: (M,) whose each entry is.
        q: (3, M) its place [m].
        offset: (K,) of the gripper along y [m].
        other: (M,) entries that must not come between the fingers either.
        least: from so far off the middle along y on [m].
        most: to so far [m].
        half: to so far to either side along x [m].
    """
    found = np.full(len(offset), np.inf)
    for m in range(len(pose)):
        k = pose[m]
        aside = abs(q[1, m] - offset[k])
        if (other[m] or aside >= least) and aside <= most and abs(q[0, m]) <= half and q[2, m] < found[k]:
            found[k] = q[2, m]
    return found


@compiled
def ends_between(pose: Indices, q: Array, offset: Array, other: Flags, wide: float, half: float) -> Array:
    """Return (K, 2) the least and largest z of what of the object is between the fingers [m]; ±infinite: nothing.

    Args:
        pose: (M,) whose each entry is.
        q: (3, M) its place [m].
        offset: (K,) of the gripper along y [m].
        other: (M,) entries that are not of the object.
        wide: to so far off the middle along y [m].
        half: to so far to either side along x [m].
    """
    ends = np.empty((len(offset), 2))
    ends[:, 0], ends[:, 1] = np.inf, -np.inf
    for m in range(len(pose)):
        k = pose[m]
        if not other[m] and abs(q[0, m]) <= half and abs(q[1, m] - offset[k]) <= wide:
            ends[k, 0], ends[k, 1] = min(ends[k, 0], q[2, m]), max(ends[k, 1], q[2, m])
    return ends


@compiled
def _along(axis: npt.NDArray[np.float32], normal: npt.NDArray[np.float32]) -> np.float32:
    """Return a normal's part along an axis (3,) each: each product is added with one rounding, as in `slab_kernels`."""
    total = np.float32(axis[0] * normal[0])
    for j in range(1, 3):
        total = np.float32(np.float64(axis[j]) * np.float64(normal[j]) + np.float64(total))
    return total


@compiled
def reached(
    pose: Indices,
    point: Indices,
    q: Array,
    other: Flags,
    axes: npt.NDArray[np.float32],
    normals: npt.NDArray[np.float32],
    offset: Array,
    depth: Array,
    half: float,
    wide: float,
    along: tuple[float, float, float, float],
    places: Array,
) -> tuple[Array, Array, Array]:
    """Write what is on the pads, and return how far out it and what is beside them reaches.

    Args:
        pose: (M,) whose each entry is.
        point: (M,) which point of the cloud.
        q: (3, M) its place [m].
        other: (M,) entries that are not of the object.
        axes: (K, 3) y of the poses, in the cloud's frame.
        normals: (N, 3) of the cloud's points there.
        offset: (K,) along y [m].
        depth: (K,) along z [m].
        half: of the pads' width [m].
        wide: half of what the fingers open [m].
        along: z of the palm's front, the fingers', the pads' back and the pads' front [m].
        places: (M, 3) y and z [m] of what is on the pads and how much its normal is along y, written; NaN: it is not.

    Returns:
        (K, 2) how far out along y and -y entries on the pads reach, the same of those beside them, minus infinity where
        there are none [m], and (K, 2) how many are on the pads and the sum of (exp(n_y²) - 1) / (e - 1).
    """
    palm, front, pad_back, pad_front = along
    furthest, beside = np.full((len(offset), 2), -np.inf), np.full((len(offset), 2), -np.inf)
    sums, whole = np.zeros((len(offset), 2)), np.expm1(1.0)
    for m in range(len(pose)):
        places[m, 0] = np.nan
        if other[m] or abs(q[0, m]) > half:
            continue
        k = pose[m]
        y, z = q[1, m] - offset[k], q[2, m] - depth[k]
        if not (abs(y) <= wide and palm <= z <= front):
            continue
        if not pad_back <= z <= pad_front:
            beside[k, 0], beside[k, 1] = max(beside[k, 0], y), max(beside[k, 1], -y)
            continue
        n = np.float64(_along(axes[k], normals[point[m]]))
        places[m, 0], places[m, 1], places[m, 2] = y, z, n
        furthest[k, 0], furthest[k, 1] = max(furthest[k, 0], y), max(furthest[k, 1], -y)
        sums[k, 0] += 1.0
        sums[k, 1] += np.expm1(n * n) / whole
    return furthest, beside, sums


@compiled
def touched(
    pose: Indices,
    point: Indices,
    q: Array,
    normals: Array,
    places: Array,
    furthest: Array,
    against: Array,
    patch: Array,
) -> tuple[Array, Array]:
    """Return (K, 2, 3) where each pad touches, in the poses' frames [m], and the mean normal there, in the cloud's.

    Entries count by what the pad sees of them: a side that it does not see is not pressed.

    Args:
        pose: (M,) whose each entry is.
        point: (M,) which point of the cloud.
        q: (3, M) its place [m].
        normals: (N, 3) of the cloud's points.
        places: (M, 3) of `reached`.
        furthest: (K, 2) of `reached` [m].
        against: (K,) a pad touches what is no more than this behind the furthest [m].
        patch: (K,) the same for normals [m].
    """
    count = len(furthest)
    contact, normal, size = np.zeros((count, 2, 3)), np.zeros((count, 2, 3)), np.zeros((count, 2, 2))
    for m in range(len(pose)):
        if np.isnan(places[m, 0]):
            continue
        k, y, z, n = pose[m], places[m, 0], places[m, 1], places[m, 2]
        for side in range(2):
            sign = 1.0 - 2.0 * side
            seen = max(sign * n, 1e-6)
            if sign * y >= furthest[k, side] - against[k]:
                size[k, side, 0] += seen
                contact[k, side, 0] += seen * q[0, m]
                contact[k, side, 1] += seen * y
                contact[k, side, 2] += seen * z
            if sign * y >= furthest[k, side] - patch[k]:
                size[k, side, 1] += seen
                for i in range(3):
                    normal[k, side, i] += seen * normals[point[m], i]
    for k in range(count):
        for side in range(2):
            for i in range(3):
                contact[k, side, i] /= max(size[k, side, 0], 1e-12)
                normal[k, side, i] /= max(size[k, side, 1], 1e-12)
    return contact, normal
