"""Rotation matrices and vectors of many poses at once; quaternions are those of `signals.rotations`."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


def exp(vectors: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3) (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    K = skew(vectors)
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + a * K + b * (K @ K))


def log(R: Array) -> Array:
    """Return the rotation vectors (..., 3) of rotation matrices, for angles below 180°."""
    half = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    sine = np.linalg.norm(half, axis=-1, keepdims=True)
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)[..., None]
    angle = np.arctan2(sine, cosine)
    return np.asarray(half * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0))


def skew(v: Array) -> Array:
    """Return the cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    result = np.zeros((*v.shape[:-1], 3, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return result


def cross(a: Array, b: Array) -> Array:
    """Return the cross products of (..., 3) and (..., 3); `numpy.cross` takes several times longer on small arrays."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


to_quaternion = rotations.from_matrix


def from_quaternion(q: Array) -> Array:
    """Return the rotation matrix (3, 3) of (w, x, y, z), of any length but 0."""
    return rotations.matrix(np.asarray(q) / np.linalg.norm(q))
