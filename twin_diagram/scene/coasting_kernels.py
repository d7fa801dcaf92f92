"""The compiled part of `object_filter`: where things have got to, and how sure that is."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def carry(
    poses: Array,
    covariances: Array,
    velocities: Array,
    modes: Array,
    ages: Array,
    coast: float,
    stale_after: float,
    density: Array,
    walks: Array,
) -> None:
    """Carry poses (K, 7), covariances (K, 12, 12) and velocities (K, 6) on in place.

    The mean is exact, the covariance to first order; what rests stays to the bit.

    Args:
        poses: as they were when they were seen last.
        covariances: the same.
        velocities: the same; zeros once they are not trusted any more.
        modes: (K,) 0: never seen, 1: at rest, 2: moving.
        ages: (K,) how long ago they were seen, not negative; zeros where never [s].
        coast: how long a velocity is trusted [s].
        stale_after: how long what rests is taken to rest [s].
        density: (6,) of accelerations.
        walks: (3, 6) by how much a variance grows each second where it is stale, where it rests, and in all at most.
    """
    for k in range(len(poses)):
        moving, age = modes[k] == 2.0, ages[k]
        if moving and age > 0.0:
            _coast(poses[k], covariances[k], velocities[k], min(age, coast), density)
        # What nobody has looked at may have been moved, all the more where it was moving.
        unseen = max(age - (coast if moving else stale_after), 0.0)
        for i in range(6):
            walk = walks[0, i] + (velocities[k, i] * velocities[k, i] if moving else 0.0)
            grown = unseen * walk + age * (0.0 if moving else walks[1, i])
            covariances[k, i, i] += min(grown, walks[2, i])
            if age > coast:
                velocities[k, i] = 0.0


@compiled
def _coast(pose: Array, P: Array, velocity: Array, t: float, density: Array) -> None:
    """Move a pose (7,) and its covariance (12, 12) on in place, at a velocity (6,) for t > 0 [s]."""
    w, x, y, z = _turn(velocity[0] * t, velocity[1] * t, velocity[2] * t)
    a, b, c, d = pose[0], pose[1], pose[2], pose[3]
    pose[0] = w * a - x * b - y * c - z * d
    pose[1] = w * b + x * a + y * d - z * c
    pose[2] = w * c - x * d + y * a + z * b
    pose[3] = w * d + x * c - y * b + z * a
    for i in range(3):
        pose[4 + i] += velocity[3 + i] * t
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    _carry(P, R, t)
    _carry(P.T, R, t)
    for i in range(6):
        P[i, i] += t**3 / 3 * density[i]
        P[i, 6 + i] += t**2 / 2 * density[i]
        P[6 + i, i] += t**2 / 2 * density[i]
        P[6 + i, 6 + i] += t * density[i]


@compiled
def pose_covariances(P: Array, poses: Array, axes: Array, floor: Array, about_axis: float, shared: Array) -> Array:
    """Return (K, 6, 6) of poses (K, 7), out of P (K, 12, 12), with what no averaging removes.

    Args:
        P: of the error states.
        poses: in W.
        axes: (K, 3) of symmetry in O.
        floor: (6,) variances that all share.
        about_axis: variance of the turn about such an axis.
        shared: (K, 6, 6) what is added; (0, 6, 6): nothing.
    """
    found = P[:, :6, :6].copy()
    axis_W = np.empty(3)
    for k in range(len(P)):
        if len(shared):
            for i in range(6):
                for j in range(6):
                    found[k, i, j] += shared[k, i, j]
        for i in range(6):
            found[k, i, i] += floor[i]
        w, x, y, z = poses[k, 0], poses[k, 1], poses[k, 2], poses[k, 3]
        a, b, c = axes[k, 0], axes[k, 1], axes[k, 2]
        axis_W[0] = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
        axis_W[1] = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
        axis_W[2] = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
        for i in range(3):
            for j in range(3):
                found[k, i, j] += about_axis * axis_W[i] * axis_W[j]
    return found


@compiled
def statuses(modes: Array, ages: Array, stale_after: float, lost_after: float, words: Array) -> Array:
    """Return (K,) what to call objects.

    Args:
        modes: (K,) as in `carry`.
        ages: (K,) how long ago they were seen [s].
        stale_after: above this they are stale [s].
        lost_after: above this they are lost [s].
        words: (5,) for what was never seen, rests, moves, is stale, is lost.
    """
    found = np.empty(len(modes))
    for k in range(len(modes)):
        if modes[k] == 0.0:
            found[k] = words[0]
        elif ages[k] > lost_after:
            found[k] = words[4]
        elif ages[k] > stale_after:
            found[k] = words[3]
        else:
            found[k] = words[2] if modes[k] == 2.0 else words[1]
    return found


@compiled
def _carry(P: Array, R: Array, t: float) -> None:
    """Multiply P (12, 12) from the left, in place, by the transition: turned by R (3, 3), moved on by t [s]."""
    for j in range(12):
        x, y, z = P[0, j], P[1, j], P[2, j]
        for i in range(3):
            P[i, j] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z + t * P[6 + i, j]
            P[3 + i, j] += t * P[9 + i, j]


@compiled
def _turn(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion, w >= 0, of a rotation vector [rad]."""
    angle = np.sqrt(x * x + y * y + z * z)
    # At zero the ratio's limit is 1/2.
    w, ratio = np.cos(angle / 2), np.sin(angle / 2) / angle if angle > 0.0 else 0.5
    # Of very many rounds rounding leaves no unit quaternion.
    length = np.sqrt(w * w + ratio * ratio * (x * x + y * y + z * z))
    sign = -1.0 if w < 0.0 else 1.0
    return sign * w / length, sign * ratio * x / length, sign * ratio * y / length, sign * ratio * z / length
