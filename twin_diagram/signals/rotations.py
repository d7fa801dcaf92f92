"""Unit quaternions (w, x, y, z), batched over leading axes: what poses' filters need.

A rotation's perturbation is a left one: R(φ) = Exp(φ) R̂ with φ [rad] expressed in W.
"""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array


def multiply(a: Array, b: Array) -> Array:
    """Return the product a b of quaternions (…, 4)."""
    # Parts by their places: this is called thousands of times a second, with few quaternions.
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    w = aw * bw - ax * bx - ay * by - az * bz
    result = np.empty((*np.shape(w), 4))
    result[..., 0] = w
    result[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    result[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    result[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return result


def conjugate(q: Array) -> Array:
    """Return the inverse rotation, (…, 4)."""
    return q * _CONJUGATE


def normalized(q: Array) -> Array:
    """Return the unit length, and w >= 0 so that equal rotations have equal numbers; (…, 4)."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def exp(phi: Array) -> Array:
    """Return the quaternion of a rotation vector (…, 3) [rad]."""
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    # sin(x/2)/x from np.sinc, which is exact at zero.
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * phi], axis=-1)


def log(q: Array) -> Array:
    """Return the rotation vector (…, 3) [rad] of a unit quaternion, of length up to π."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    # At zero the ratio's limit is 2/w.
    ratio = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
    return ratio * q[..., 1:]


def matrix(q: Array) -> Array:
    """Return the rotation matrix (…, 3, 3) of a unit quaternion."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    result = np.empty((*q.shape[:-1], 3, 3))
    result[..., 0, 0], result[..., 0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z)
    result[..., 0, 2], result[..., 1, 0] = 2 * (x * z + w * y), 2 * (x * y + w * z)
    result[..., 1, 1], result[..., 1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    result[..., 2, 0], result[..., 2, 1] = 2 * (x * z - w * y), 2 * (y * z + w * x)
    result[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return result


def from_matrix(R: Array) -> Array:
    """Return the unit quaternion, w >= 0, of one rotation matrix (3, 3): the dominant eigenvector of Bar-Itzhack's."""
    K = np.array(
        [
            [R[0, 0] + R[1, 1] + R[2, 2], 0.0, 0.0, 0.0],
            [R[2, 1] - R[1, 2], R[0, 0] - R[1, 1] - R[2, 2], 0.0, 0.0],
            [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], 0.0],
            [R[1, 0] - R[0, 1], R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    _, vectors = np.linalg.eigh(K)
    q = vectors[:, -1]
    return np.asarray(q if q[0] >= 0 else -q)


def difference(q_b: Array, q_a: Array) -> Array:
    """Return φ with R_b = Exp(φ) R_a, (…, 3) [rad]."""
    return log(multiply(q_b, conjugate(q_a)))


def fold_about_z(q_measured: Array, q_near: Array) -> Array:
    """Turn a measured rotation about its own z axis until it is as near to another as can be.

    A body symmetric about its z axis looks the same after any such turn, so the turn says nothing: what stays is the
    tilt (swing) of the axis. With the axes opposed no turn is better than another and the measurement is returned.
    """
    w, _, _, z = multiply(conjugate(q_near), q_measured)
    if np.hypot(w, z) < 1e-9:
        return q_measured
    half = np.arctan2(-z, w)
    return multiply(q_measured, np.array([np.cos(half), 0.0, 0.0, np.sin(half)]))


_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
"""Signs of the inverse rotation."""
