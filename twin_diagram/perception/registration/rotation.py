"""Rotation matrices and vectors of many poses at once; quaternions are those of `signals.rotations`.

Registration calls these hundreds of times a frame on a few hundred vectors, where a call costs more than its sums:
results (..., 3) are views of arrays that hold each component in one piece, which is what the next call reads.
"""

from __future__ import annotations

import numpy as np

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


def exp(vectors: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3) (Rodrigues)."""
    half = np.maximum(0.5 * np.sqrt(dot(vectors, vectors)), 1e-12)[..., None, None]
    K = skew(vectors)
    sine = np.sin(half) / half
    return np.asarray(np.eye(3) + sine * np.cos(half) * K + 0.5 * sine * sine * (K @ K))


def log(R: Array) -> Array:
    """Return the rotation vectors (..., 3) of rotation matrices, for angles below 180°."""
    half = 0.5 * (R[..., (2, 0, 1), (1, 2, 0)] - R[..., (1, 2, 0), (2, 0, 1)])
    sine = np.sqrt(dot(half, half))[..., None]
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)[..., None]
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
    return screw(a, b)[..., :3]


def dot(a: Array, b: Array) -> Array:
    """Return the inner products (...) of (..., 3) and (..., 3)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def screw(r: Array, way: Array) -> Array:
    """Return (..., 6): r x way and way, by which a turn and a shift move points r (..., 3) along ways (..., 3)."""
    x, y, z = r[..., 0], r[..., 1], r[..., 2]
    a, b, c = way[..., 0], way[..., 1], way[..., 2]
    rows = np.empty((6, *(x.shape if x.shape == a.shape else np.broadcast_shapes(x.shape, a.shape))))
    rows[0], rows[1], rows[2] = y * c - z * b, z * a - x * c, x * b - y * a
    rows[3], rows[4], rows[5] = a, b, c
    return components_last(rows)


def components_last(rows: Array) -> Array:
    """Return a view (..., k) of (k, ...)."""
    return rows.transpose(*range(1, rows.ndim), 0)


to_quaternion = rotations.from_matrix


def from_quaternion(q: Array) -> Array:
    """Return the rotation matrix (3, 3) of (w, x, y, z), of any length but 0."""
    return rotations.matrix(np.asarray(q) / np.linalg.norm(q))
