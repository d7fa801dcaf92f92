"""Rotations of one pose at a time, as quaternions (w, x, y, z): what a pose's innovation needs.

Perturbations are left ones: R(φ) = Exp(φ) R with φ [rad] in W.
"""

from __future__ import annotations

import numpy as np

from twin_diagram.signals import Array


def normalized(q: Array) -> Array:
    """Unit length, w ≥ 0."""
    q = q / np.linalg.norm(q)
    return -q if q[0] < 0.0 else q


def multiply(a: Array, b: Array) -> Array:
    """The product a b."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return np.array(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def exp(phi: Array) -> Array:
    """The quaternion of a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(phi))
    return np.concatenate([[np.cos(angle / 2.0)], 0.5 * np.sinc(angle / (2.0 * np.pi)) * phi])


def difference(b: Array, a: Array) -> Array:
    """The rotation vector (3,) [rad], of length up to π, that turns a into b."""
    turn = multiply(b, a * np.array([1.0, -1.0, -1.0, -1.0]))
    if turn[0] < 0.0:
        turn = -turn
    sine = float(np.linalg.norm(turn[1:]))
    # At zero the ratio's limit is 2/w.
    ratio = 2.0 * float(np.arctan2(sine, turn[0])) / sine if sine > 1e-12 else 2.0
    return ratio * turn[1:]
