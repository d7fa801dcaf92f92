"""Compiled loops over an arm's links: where they are, and how what moves with them moves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.signals.compiled import compiled


@compiled
def place(
    q: Array, constant: Array, sine: Array, cosine: Array, linear: Array, axes_P: Array, origins_P: Array
) -> tuple[Array, Array, Array]:
    """Return poses (N, n + 1, 4, 4) of links, axes (N, n, 3) and origins (N, n, 3) of joints; see `Chain`."""
    count, n = q.shape
    X, axes, origins = np.zeros((count, n + 1, 4, 4)), np.empty((count, n, 3)), np.empty((count, n, 3))
    for row in range(count):
        for i in range(4):
            X[row, 0, i, i] = 1.0
        for k in range(n):
            s, c, a = np.sin(q[row, k]), np.cos(q[row, k]), q[row, k]
            P, L = X[row, k], X[row, k + 1]
            L[3, 3] = 1.0
            for i in range(3):
                axes[row, k, i] = P[i, 0] * axes_P[k, 0] + P[i, 1] * axes_P[k, 1] + P[i, 2] * axes_P[k, 2]
                o = P[i, 0] * origins_P[k, 0] + P[i, 1] * origins_P[k, 1] + P[i, 2] * origins_P[k, 2]
                origins[row, k, i] = o + P[i, 3]
            for j in range(4):
                x = constant[k, 0, j] + s * sine[k, 0, j] + c * cosine[k, 0, j] + a * linear[k, 0, j]
                y = constant[k, 1, j] + s * sine[k, 1, j] + c * cosine[k, 1, j] + a * linear[k, 1, j]
                z = constant[k, 2, j] + s * sine[k, 2, j] + c * cosine[k, 2, j] + a * linear[k, 2, j]
                for i in range(3):
                    L[i, j] = P[i, 0] * x + P[i, 1] * y + P[i, 2] * z
            for i in range(3):
                L[i, 3] += P[i, 3]
    return X, axes, origins


@compiled
def carried(X_WL: Array, points_L: Array, links: Ints) -> Array:
    """Return points (S, 3) of links (S,) in W, (N, S, 3)."""
    result = np.empty((len(X_WL), len(points_L), 3))
    for row in range(len(X_WL)):
        for s in range(len(points_L)):
            X = X_WL[row, links[s]]
            x, y, z = points_L[s, 0], points_L[s, 1], points_L[s, 2]
            for i in range(3):
                result[row, s, i] = X[i, 0] * x + X[i, 1] * y + X[i, 2] * z + X[i, 3]
    return result


@compiled
def turned(X_WO: Array, body: Ints, row: Ints, vectors_O: Array) -> Array:
    """Return vectors (M, 3) of bodies' frames in W, (M, 3)."""
    result = np.empty_like(vectors_O)
    for m in range(len(body)):
        X, v = X_WO[body[m], row[m]], vectors_O[m]
        for i in range(3):
            result[m, i] = X[i, 0] * v[0] + X[i, 1] * v[1] + X[i, 2] * v[2]
    return result


@compiled
def slopes(
    p_W: Array, link: Ints, row: Ints, normal: Array, axes: Array, origins: Array, prismatic: npt.NDArray[np.bool_]
) -> Array:
    """Return (M, n) how fast points (M, 3) that move with links (M,) go along normals (M, 3) with each joint."""
    n = axes.shape[1]
    result = np.zeros((len(p_W), n))
    for m in range(len(p_W)):
        nx, ny, nz = normal[m, 0], normal[m, 1], normal[m, 2]
        for k in range(min(link[m], n)):
            ax, ay, az = axes[row[m], k, 0], axes[row[m], k, 1], axes[row[m], k, 2]
            if prismatic[k]:
                result[m, k] = ax * nx + ay * ny + az * nz
                continue
            x = p_W[m, 0] - origins[row[m], k, 0]
            y = p_W[m, 1] - origins[row[m], k, 1]
            z = p_W[m, 2] - origins[row[m], k, 2]
            result[m, k] = (ay * z - az * y) * nx + (az * x - ax * z) * ny + (ax * y - ay * x) * nz
    return result
