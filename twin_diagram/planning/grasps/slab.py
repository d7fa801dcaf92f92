"""What of a cloud lies before a gripper, for many poses at once: lists of (pose, point), not a table of all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Slab:
    """Points near the plane in which the fingers close, ordered by pose.

    Attributes:
        poses: how many there are, K.
        pose: (M,) whose each entry is.
        point: (M,) which point of the cloud.
        q: (3, M) its place in the pose's frame G [m].
    """

    poses: int
    pose: Indices
    point: Indices
    q: Array

    def where(self, kept: Flags) -> Slab:
        """Return the entries kept (M,)."""
        return Slab(self.poses, self.pose[kept], self.point[kept], self.q[:, kept])

    def least(self, values: Array) -> Array:
        """Return each pose's least of values (M,), infinite where it has none."""
        found = np.full(self.poses, np.inf)
        if len(values):
            starts = np.flatnonzero(np.diff(self.pose, prepend=-1))
            found[self.pose[starts]] = np.minimum.reduceat(values, starts)
        return found

    def most(self, values: Array) -> Array:
        """Return each pose's largest of values (M,), minus infinity where it has none."""
        return -self.least(-values)

    def total(self, values: Array) -> Array:
        """Return each pose's sum of values (M,)."""
        return np.bincount(self.pose, weights=values, minlength=self.poses)


def slab_of(points: Array, R: Array, p: Array, half: float, ahead: float = np.inf) -> Slab:
    """Return the points whose x in the gripper's frame is within ±half [m].

    Args:
        points: (N, 3) in O [m].
        R: (K, 3, 3) the poses' axes in O, as columns.
        p: (K, 3) their origins in O [m].
        half: half of the slab's thickness [m].
        ahead: points whose z is larger are left out [m].
    """
    x = R[:, :, 0] @ points.T
    x -= np.einsum("ki,ki->k", R[:, :, 0], p)[:, None]
    pose, point = np.nonzero(np.abs(x, out=x) <= half)
    rows = np.ascontiguousarray(R.transpose(0, 2, 1))
    shifts = np.einsum("kij,kj->ki", rows, p)
    own = points[point]
    q = np.empty((3, len(pose)))
    for axis in range(3):
        np.einsum("mi,mi->m", own, rows[pose, axis], out=q[axis])
        q[axis] -= shifts[pose, axis]
    slab = Slab(len(R), pose, point, q)
    return slab if np.isinf(ahead) else slab.where(q[2] <= ahead)
