"""What of a cloud lies before a gripper, for many poses at once: lists of (pose, point), not a table of all of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]
Single = npt.NDArray[np.float32]


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
        at = np.flatnonzero(kept)
        return Slab(self.poses, self.pose[at], self.point[at], self.q.take(at, axis=1))

    @cached_property
    def _starts(self) -> Indices:
        """Where each pose's entries begin, of poses that have some."""
        return np.flatnonzero(np.diff(self.pose, prepend=-1))

    def least(self, values: Array) -> Array:
        """Return each pose's least of values (M,), infinite where it has none."""
        found = np.full(self.poses, np.inf)
        if len(values):
            found[self.pose[self._starts]] = np.minimum.reduceat(values, self._starts)
        return found

    def most(self, values: Array) -> Array:
        """Return each pose's largest of values (M,), minus infinity where it has none."""
        return -self.least(-values)


def slab_of(q: Array, kept: Flags) -> Slab:
    """Return chosen ones of all points (K, 3, N) in the frames of K poses, kept (K, N)."""
    flat = np.flatnonzero(kept)
    poses, count = kept.shape
    pose = flat // count
    point = flat - pose * count
    at = flat + 2 * count * pose  # of x in q laid out flat
    return Slab(poses, pose, point, np.stack([q.reshape(-1).take(at + axis * count) for axis in range(3)]))


def factors(points: Array, R: Array, p: Array) -> tuple[Single, Single]:
    """Return (K, 3, 4) and (4, N) in single precision, whose product is points in the frames of K poses [m].

    Args:
        points: (N, 3) in O [m].
        R: (K, 3, 3) the poses' axes in O, as columns.
        p: (K, 3) their origins in O [m].
    """
    # Of points about their middle, which single precision serves best.
    middle = points.mean(axis=0)
    shifts = np.einsum("kij,ki->kj", R, middle - p)
    left = np.concatenate([R.transpose(0, 2, 1), shifts[:, :, None]], axis=2)
    right = np.concatenate([points - middle, np.ones((len(points), 1))], axis=1).T
    return left.astype(np.float32), right.astype(np.float32)


def in_frames(points: Array, R: Array, p: Array) -> Array:
    """Return points (N, 3) in the frames of K poses, (K, 3, N) [m], in single precision: 0.1 µm at a metre.

    Args:
        points: in O [m].
        R: (K, 3, 3) the poses' axes in O, as columns.
        p: (K, 3) their origins in O [m].
    """
    left, right = factors(points, R, p)
    return np.asarray((left.reshape(-1, 4) @ right).reshape(len(R), 3, len(points)), dtype=np.float32)
