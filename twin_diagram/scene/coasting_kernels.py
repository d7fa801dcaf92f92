"""The compiled part of `object_filter`: where what moves has got to, and how sure that is."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def coast(poses: Array, covariances: Array, velocities: Array, times: Array, density: Array) -> None:
    """Move poses (K, 7) and covariances (K, 12, 12) on in place, at velocities (K, 6) for times (K,).

    The mean is exact, the covariance to first order; a row of time 0 stays to the bit.
    """
    for k in range(len(poses)):
        t = times[k]
        if t == 0.0:
            continue
        turn = _turn(velocities[k, 0] * t, velocities[k, 1] * t, velocities[k, 2] * t)
        w, x, y, z = turn
        a, b, c, d = poses[k, 0], poses[k, 1], poses[k, 2], poses[k, 3]
        poses[k, 0] = w * a - x * b - y * c - z * d
        poses[k, 1] = w * b + x * a + y * d - z * c
        poses[k, 2] = w * c - x * d + y * a + z * b
        poses[k, 3] = w * d + x * c - y * b + z * a
        for i in range(3):
            poses[k, 4 + i] += velocities[k, 3 + i] * t
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        P = covariances[k]
        _carry(P, R, t)
        _carry(P.T, R, t)
        for i in range(6):
            P[i, i] += t**3 / 3 * density[i]
            P[i, 6 + i] += t**2 / 2 * density[i]
            P[6 + i, i] += t**2 / 2 * density[i]
            P[6 + i, 6 + i] += t * density[i]


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
