"""Compiled sums over the points that a frame shows of a known surface: some tens each, of hundreds of surfaces."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def seen_at(pixels: Array, z: Array, lens: Array, R_WC: Array, p_WC: Array) -> tuple[Array, Array]:
    """Return what pixels (N, 2) at depths z (N,) [m] show, (N, 3) each: in the camera's frame and in W.

    Args:
        pixels: columns and rows [px].
        z: depth [m].
        lens: fx, fy, cx, cy.
        R_WC: (3, 3)
        p_WC: (3,)
    """
    points_C, points_W = np.empty((len(z), 3)), np.empty((len(z), 3))
    for k in range(len(z)):
        x, y = (pixels[k, 0] - lens[2]) / lens[0] * z[k], (pixels[k, 1] - lens[3]) / lens[1] * z[k]
        points_C[k, 0], points_C[k, 1], points_C[k, 2] = x, y, z[k]
        for i in range(3):
            points_W[k, i] = R_WC[i, 0] * x + R_WC[i, 1] * y + R_WC[i, 2] * z[k] + p_WC[i]
    return points_C, points_W


@compiled
def distances(
    points_W: Array,
    places: Array,
    normals: Array,
    p_WC: Array,
    z: Array,
    noise: tuple[float, float, float],
    least: float,
) -> tuple[Array, Array]:
    """Return how far points (N, 3) are before a surface (N,) [m], and the noise of that (N,) [m].

    Noise is along the line of sight; what of it shows is what of that is across the surface.

    Args:
        points_W: seen.
        places: the nearest ones of the surface.
        normals: there, in W.
        p_WC: the camera's place.
        z: depth [m].
        noise: floor, growth and start, see `DepthSigma`.
        least: of the noise [m].
    """
    distance, sigma = np.empty(len(z)), np.empty(len(z))
    for k in range(len(z)):
        off, across = 0.0, 0.0
        for i in range(3):
            off += normals[k, i] * (points_W[k, i] - places[k, i])
            across += normals[k, i] * (points_W[k, i] - p_WC[i])
        distance[k] = off
        deep = noise[0] + noise[1] * (z[k] - noise[2]) ** 2
        sigma[k] = max(deep * abs(across) / max(z[k], 1e-6), least)
    return distance, sigma


@compiled
def normal_equations(
    points_C: Array, normals: Array, distance: Array, weight: Array, R_WC: Array, fx: float, fy: float
) -> tuple[Array, Array, Array, float, float]:
    """Return Σ w J Jᵀ (10, 10), Σ w J d (10,), Σ w J (10,), Σ w and Σ w d; rows J (10,) are n · `point_shifts`.

    Args:
        points_C: (N, 3) seen [m].
        normals: (N, 3) of the surface, in W.
        distance: (N,) d [m].
        weight: (N,) w [1/m²].
        R_WC: (3, 3)
        fx: focal length [px].
        fy: focal length [px].
    """
    H, b, along, total, pull = np.zeros((10, 10)), np.zeros(10), np.zeros(10), 0.0, 0.0
    J, n, f, m = np.empty(10), np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(distance)):
        w, d = weight[k], distance[k]
        if w == 0.0:
            continue
        p = points_C[k]
        for i in range(3):
            n[i] = normals[k, i]
            f[i] = R_WC[i, 0] * p[0] + R_WC[i, 1] * p[1] + R_WC[i, 2] * p[2]
        for i in range(3):
            m[i] = R_WC[0, i] * n[0] + R_WC[1, i] * n[1] + R_WC[2, i] * n[2]
        J[0], J[1], J[2] = n[1] * f[2] - n[2] * f[1], n[2] * f[0] - n[0] * f[2], n[0] * f[1] - n[1] * f[0]
        J[3], J[4], J[5] = -n[0], -n[1], -n[2]
        J[6], J[7] = n[0] * f[0] + n[1] * f[1] + n[2] * f[2], m[0] * p[0] + m[1] * p[1]
        J[8], J[9] = p[2] / fx * m[0], p[2] / fy * m[1]
        total += w
        pull += w * d
        for i in range(10):
            along[i] += w * J[i]
            b[i] += w * J[i] * d
            for j in range(i + 1):
                H[i, j] += w * J[i] * J[j]
    for i in range(10):
        for j in range(i):
            H[j, i] = H[i, j]
    return H, b, along, total, pull


@compiled
def scatter(distance: Array, sigma: Array) -> float:
    """Return the median of how far distances (N,) are from their median, in units of their noise (N,)."""
    middle = np.median(distance)
    off = np.empty(len(distance))
    for k in range(len(distance)):
        off[k] = abs(distance[k] - middle) / sigma[k]
    return float(np.median(off))
