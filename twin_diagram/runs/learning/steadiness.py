"""Tells how surely something stands on a side, and on which one near to that in which it leant on others."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.signals.arrays import Array

STEADY: Final = 0.1
"""What may be tilted by so much stands [rad]. What leant in a heap may not: a bottle, upside down and 14° askew, was
let go so, fell over and rolled off the table."""
NEAR: Final = 0.6
"""As far from how it leant a side on which it stands is looked for [rad]: heaps lean things by 25° and more."""
FINE: Final = 0.003
"""Edge of the cells that stand for a surface where it matters how it stands [m]: a cap of 26 mm."""
LOWEST: Final = 0.999
"""Share of the points above the lowest one that counts: a few in the air are of no surface."""
TOUCHING: Final = 0.003
"""Points so near to the lowest are stood upon [m]: what their places are off."""


def levelled(points: Array, down: Array) -> Array | None:
    """Return the direction (3,) near to one that points down in which points (N, 3) stand most surely; None: none."""
    try:
        normals = np.unique(ConvexHull(points).equations[:, :3].round(2), axis=0)
    except (QhullError, ValueError):
        return None
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = normals[normals @ down > np.cos(NEAR)]
    sure = [steadiness(points, normal) for normal in near]
    if not sure or max(sure) <= max(steadiness(points, down), 0.0):
        return None
    return np.asarray(near[int(np.argmax(sure))])


def steadiness(points: Array, down: Array) -> float:
    """Return by how much points (N, 3) may be tilted before they fall over, standing with a direction (3,) down [rad].

    Their weight is taken to be in the middle of the box about them. Negative: it falls over at once.
    """
    across = np.linalg.svd(down[None])[2][1:]
    depth, middle = points @ down, 0.5 * (points.min(axis=0) + points.max(axis=0))
    lowest = float(np.quantile(depth, LOWEST))
    foot = points[depth > lowest - TOUCHING] @ across.T
    try:
        edges = ConvexHull(foot).equations
    except (QhullError, ValueError):  # an edge or a corner
        return -np.inf
    inside = -float((edges[:, :2] @ (across @ middle) + edges[:, 2]).max())
    return float(np.arctan2(inside, lowest - middle @ down))
