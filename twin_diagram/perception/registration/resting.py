"""In which ways an object rests on a level table: on the facets of its convex hull."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.assets import Asset
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.signals.arrays import Array

TIPPED: Final = 0.03
"""Deviation of how far a start is tipped [rad]: facets of one face of a scanned mesh differ by less."""


def resting(asset: Asset) -> list[tuple[Array, float]]:
    """Find orientations (3, 3) R_WO at rest on a level table and heights of O above it [m]; upright first.

    Facets of the convex hull below which the centroid of the surface lies, one of those that are `TIPPED` by less from
    one another. About a symmetric axis one of each kind is kept. Upright comes first if it is one of them.
    """
    corners = np.concatenate(asset.convex_pieces)
    try:
        hull = ConvexHull(corners)
    except QhullError:
        return [(np.eye(3), float(-asset.points_O[:, 2].min()))]
    centroid = asset.points_O.mean(axis=0)
    normals = np.unique(np.round(hull.equations[:, :3], 5), axis=0)
    normals = normals[np.lexsort((normals[:, 1], normals[:, 0], normals[:, 2]))]
    result: list[tuple[Array, float]] = []
    kinds: list[float] = []
    kept = np.zeros((0, 3))
    for normal in normals:
        if (kept @ normal > np.cos(TIPPED)).any():
            continue
        along = corners @ normal
        rim = corners[along > along.max() - 1e-4]
        turn = _down(normal)
        flat = (rim @ turn.T)[:, :2]
        try:
            sides = ConvexHull(flat).equations
        except QhullError:
            continue
        if (sides[:, :2] @ (turn @ centroid)[:2] + sides[:, 2]).max() > -1e-3:
            continue
        if asset.symmetric_axis == "z":
            if any(abs(normal[2] - kind) < 1e-3 for kind in kinds):
                continue
            kinds.append(float(normal[2]))
        kept = np.vstack([kept, normal])
        result.append((turn, float(along.max())))
    return result or [(np.eye(3), float(-corners[:, 2].min()))]


def _down(normal: Array) -> Array:
    """Return the smallest rotation that turns a unit vector to -z."""
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, -normal[2])
    if sine < 1e-9:
        return np.eye(3) if normal[2] < 0 else exp(np.array([np.pi, 0.0, 0.0]))
    return exp(axis / sine * angle)
