"""How much of what a closed surface holds is inside of two bodies at once: a handle that goes on within its mug.

Along a ray each triangle that faces it leads into a body, and each that faces away out of one. So the number of bodies
about every place of the ray is known: 1 inside, 2 and more where bodies overlap, 0 outside and in a cavity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from twin_diagram.assets.building.surface import Surface, edge_pairs
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    rays: int = 256
    """That are drawn through the box about a surface: a share of a tenth is told to a fifth."""


TUNING = Tuning()


def overlap(surface: Surface, seed: int = 0) -> float:
    """Return the share of what a closed surface holds that lies in two bodies or more; 0 of a single body.

    Args:
        surface: closed.
        seed: of the rays.
    """
    one, two = edge_pairs(surface.faces)
    graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(surface.faces), len(surface.faces)))
    if connected_components(graph, directed=False)[0] == 1:
        return 0.0
    corners = surface.vertices[surface.faces]
    axis = int(np.argmax(np.ptp(surface.vertices, axis=0)))  # across the longest edge, where rays are the closest
    others = [k for k in range(3) if k != axis]
    low, high = surface.vertices.min(axis=0)[others], surface.vertices.max(axis=0)[others]
    places = low + (high - low) * np.random.default_rng(seed).random((TUNING.rays, 2))
    flat, along = corners[..., others], corners[..., axis]
    first, last = flat.min(axis=1), flat.max(axis=1)
    held = np.zeros(2)
    for place in places:
        near = np.flatnonzero(((first <= place) & (place <= last)).all(axis=1))
        held += _held(flat[near], along[near], place)
    return float(held[1] / held[0]) if held[0] > 0.0 else 0.0


def _held(flat: Array, along: Array, place: Array) -> tuple[float, float]:
    """Return for how long a ray is inside of any body, and of two or more.

    Args:
        flat: (F, 3, 2) corners of triangles across the ray.
        along: (F, 3) along it.
        place: (2,) where the ray is.
    """
    edge, to = np.roll(flat, -1, axis=1) - flat, place - flat
    side = edge[..., 0] * to[..., 1] - edge[..., 1] * to[..., 0]
    hit = (side > 0.0).all(axis=1) | (side < 0.0).all(axis=1)
    side, along = side[hit], along[hit]
    # The share of each corner is the area across from it.
    at = (side[:, [1, 2, 0]] * along).sum(axis=1) / side.sum(axis=1)
    order = np.argsort(at)
    bodies = np.abs(np.cumsum(np.sign(side[order, 0])))[:-1]
    lengths = np.diff(at[order])
    return float(lengths[bodies > 0.5].sum()), float(lengths[bodies > 1.5].sum())
