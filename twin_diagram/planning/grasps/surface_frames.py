"""Frames on a surface: normals from neighbours, and Darboux frames, in which a gripper looks into the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from twin_diagram.signals.arrays import Array

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    neighbours: int = 24
    """Points that tell a normal's change: a ring or two around one, so that noise averages out and edges stay local."""


TUNING = Tuning()

EDGE: Final = 0.5
"""Cosine of the angle at which a surface has an edge: neighbours whose normals differ by more lie beyond it."""


def estimated_normals(points: Array, viewpoint: Array) -> Array:
    """Return unit normals (N, 3) of a cloud seen from one side: the least principal direction, facing the viewer.

    Args:
        points: (N, 3) [m], N >= 3.
        viewpoint: (3,) where the camera was [m].
    """
    around = points[_nearest(cKDTree(points), points, TUNING.neighbours)]
    spread = around - around.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0]
    away = np.einsum("ni,ni->n", normals, viewpoint - points) < 0
    return np.where(away[:, None], -normals, normals)


def darboux_frames(points: Array, normals: Array, chosen: Indices) -> Array:
    """Return the axes (K, 3, 3) of the gripper at chosen points of a surface, as columns x, y, z in the cloud's frame.

    z, the approach, runs against the outward normal; y, the closing axis, along the direction in which the normal
    changes most; x along the one in which it changes least. After ten Pas et al.: of M = Σ n nᵀ over neighbours the
    eigenvector of the least eigenvalue is the axis about which the surface does not curve. On a plane, where there is
    none, x is any direction in it: the search turns about z anyway.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit, outward.
        chosen: (K,) indices.
    """
    near = normals[_nearest(cKDTree(points), points[chosen], TUNING.neighbours)]
    own = normals[chosen]
    # A neighbour on the far side of a thin wall says nothing of how this side curves.
    near = near * (np.einsum("kmi,ki->km", near, own) > 0)[:, :, None]
    z = -own
    # Within the tangent plane: the eigenvectors of M need not be square to the point's own normal.
    a = _square_to(z)
    b = np.cross(z, a)
    u, v = np.einsum("kmi,ki->km", near, a), np.einsum("kmi,ki->km", near, b)
    # Angle of the direction of greatest spread of (u, v) about zero.
    angle = 0.5 * np.arctan2(2 * (u * v).sum(axis=1), (u * u - v * v).sum(axis=1))[:, None]
    y = np.cos(angle) * a + np.sin(angle) * b
    return np.stack([np.cross(y, z), y, z], axis=2)


def edge_frames(points: Array, normals: Array, chosen: Indices) -> tuple[Array, Array]:
    """Return the axes (K, 3, 3) of a gripper that comes over the nearest edge of a surface, and how near that is (K,).

    z, the approach, leads along the surface towards where the neighbours are, away from the rim or edge beyond which
    there are none; y, the closing axis, along the normal. How near: the way to the neighbours' middle as a share of
    their distance, 0 far from all edges, 0.4 on a straight one.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit, outward.
        chosen: (K,) indices.
    """
    near = _nearest(cKDTree(points), points[chosen], TUNING.neighbours)
    own = normals[chosen]
    same = np.einsum("kmi,ki->km", normals[near], own) > EDGE
    to = (points[near] - points[chosen][:, None]) * same[:, :, None]
    middle = to.mean(axis=1)
    middle -= np.einsum("ki,ki->k", middle, own)[:, None] * own
    length = np.linalg.norm(middle, axis=1)
    share = length / np.maximum(np.linalg.norm(to, axis=2).mean(axis=1), 1e-12)
    z = np.where(length[:, None] > 1e-9, middle / np.maximum(length, 1e-12)[:, None], _square_to(own))
    return np.stack([np.cross(own, z), own, z], axis=2), share


def _square_to(z: Array) -> Array:
    """Return unit vectors (K, 3) square to unit vectors (K, 3)."""
    rows = np.arange(len(z))
    other = np.zeros_like(z)
    other[rows, np.abs(z).argmin(axis=1)] = 1.0
    a = np.cross(z, other)
    return np.asarray(a / np.linalg.norm(a, axis=1, keepdims=True))


def _nearest(tree: cKDTree, points: Array, count: int) -> Indices:
    """Return the indices (K, count) of the points nearest to each; fewer where the cloud has fewer."""
    near = tree.query(points, k=np.arange(1, min(count, tree.n) + 1))[1]
    return np.asarray(near, dtype=np.intp)
