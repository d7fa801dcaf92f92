"""Which views look through what the others see: their poses, or the unit of their depth, are wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.assets.building.colouring import nearest_pixels
from twin_diagram.assets.building.depth_view import DepthView, view_points
from twin_diagram.errors import FramesError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    points: int = 200
    """Of each view that are looked up in the others."""

    past: float = 0.5
    """Share of what others see through which a view must look to contradict them: honest ones have some hundredths, one
    whose depth is ten times too large has all."""

    most_unseen: float = 0.8
    """Share of the surface that no view shows: above it, what was built is none of what they show. A plate that lies
    has 0.47."""

    least: int = 100
    """Fewer points that a view can say anything about tell nothing."""


TUNING = Tuning()


def looking_past(views: Sequence[DepthView], low: Array, high: Array, through: float, seed: int = 0) -> Array:
    """Return the share (n,) of the others' points in a box through which each view looks, of those not hidden from it.

    Args:
        views: n of one thing.
        low: (3,) lowest corner of the box about it [m].
        high: (3,) its highest.
        through: how far behind a point one must see to look through it [m].
        seed: of the points that are drawn.
    """
    rng = np.random.default_rng(seed)
    some = []
    for view in views:
        points, _, _ = view_points(view, 1)
        points = points[((points > low) & (points < high)).all(axis=1)]
        some.append(points[rng.permutation(len(points))[: TUNING.points]])
    shares = np.zeros(len(views))
    for k, view in enumerate(views):
        points = np.concatenate([*some[:k], *some[k + 1 :]])
        u, v, z = view.camera.project(points)
        row, column, there = nearest_pixels(u, v, view.depth.shape)
        depth = view.depth[row, column]
        told = there & (depth > 0) & (depth > z - through) & ~view.near_edge[row, column]
        if np.count_nonzero(told) >= TUNING.least:
            shares[k] = float(np.mean(depth[told] > z[told] + through))
    return shares


def check_unseen(unseen: float, where: str) -> float:
    """Return the share of a surface that is `unseen`, or refuse it where that is too much; `where` begins the message.

    Raises:
        FramesError: it is none of what they show.
    """
    if unseen > TUNING.most_unseen:
        said = f"{100 * unseen:.0f} % of what was built is seen in no view"
        raise FramesError(f"{where}: {said}; is a unit wrong, or a pose?")
    return unseen
