"""Colours of surface points, from the pictures that see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.view import View
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the choice of pictures."""

    near: float = 0.004
    """How far a point may be off a view's depth and still be what its pixel shows [m]."""

    sharpness: float = 4.0
    """Power of the cosine of incidence by which pictures are weighted: those that face the surface count."""

    grey: float = 0.5
    """Colour of what no picture shows and nothing seen is near."""


TUNING = Tuning()


def colours_from_views(views: Sequence[View], points: Array, normals: Array) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return colours (N, 3) in [0, 1] of points (N, 3) with normals (N, 3), in W, and how many views see each (N,).

    A point that no picture shows is left grey; `filled_in` gives it its nearest neighbour's colour.
    """
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    count = np.zeros(len(points), np.int64)
    for view in views:
        u, v, z = view.camera.project(points)
        row, column, there = _nearest(u, v, view.depth.shape)
        ray = points - view.camera.p_WC
        facing = -np.einsum("ni,ni->n", ray, normals) / np.maximum(np.linalg.norm(ray, axis=1), 1e-9)
        depth = view.depth[row, column]
        sees = there & (facing > 0.1) & (depth > 0) & (np.abs(depth - z) < TUNING.near / np.maximum(facing, 0.2))
        count += sees & (facing > 0.2)
        if view.rgb is None:
            continue
        u, v, _ = view.colour.project(points)
        row, column, inside = _nearest(u, v, view.rgb.shape)
        sure = ~view.near_edge[np.where(there, row, 0) % view.depth.shape[0], column % view.depth.shape[1]]
        w = np.where(sees & inside, facing**TUNING.sharpness * np.where(sure, 1.0, 0.01), 0.0)
        total += w[:, None] * _bilinear(view.rgb, np.where(inside, u, 0), np.where(inside, v, 0))
        weight += w
    shown = weight > 0
    colours = np.where(shown[:, None], total / np.maximum(weight, 1e-12)[:, None], TUNING.grey)
    return filled_in(points, colours, shown), count


def filled_in(points: Array, colours: Array, shown: npt.NDArray[np.bool_]) -> Array:
    """Return colours in which those not shown are those of the nearest shown point."""
    from scipy.spatial import cKDTree

    if shown.all() or not shown.any():
        return colours
    _, nearest = cKDTree(points[shown]).query(points[~shown], workers=1)
    out = colours.copy()
    out[~shown] = colours[shown][nearest]
    return out


def _nearest(u: Array, v: Array, size: tuple[int, ...]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    there = (u > -0.5) & (v > -0.5) & (u < size[1] - 0.5) & (v < size[0] - 0.5)
    return (*(np.where(there, np.rint(x), 0).astype(np.int64) for x in (v, u)), there)  # type: ignore[return-value]


def _bilinear(rgb: npt.NDArray[np.uint8], u: Array, v: Array) -> Array:
    """Return RGB in [0, 1] (N, 3) at fractional pixels."""
    height, width = rgb.shape[:2]
    x, y = np.clip(u, 0, width - 1.001), np.clip(v, 0, height - 1.001)
    x0, y0 = x.astype(np.int64), y.astype(np.int64)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    top = rgb[y0, x0] * (1 - fx) + rgb[y0, x0 + 1] * fx
    bottom = rgb[y0 + 1, x0] * (1 - fx) + rgb[y0 + 1, x0 + 1] * fx
    return np.asarray((top * (1 - fy) + bottom * fy) / 255.0)
