"""Colours of surface points, from the pictures that see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.depth_view import DepthView
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the choice of pictures."""

    near: float = 0.004
    """How far a point may be off a view's depth and still be what its pixel shows [m]."""

    sharpness: float = 4.0
    """Power of the cosine of incidence by which pictures are weighted: those that face the surface count."""

    least: float = 0.15
    """Least cosine of incidence of a picture that shows a place."""

    at_edges: float = 0.01
    """What a picture counts near edges, where another thing's colour may be in its pixels."""

    grey: float = 0.5
    """Colour of what no picture shows and nothing seen is near."""


TUNING = Tuning()


def views_that_see(views: Sequence[DepthView], points: Array, normals: Array) -> npt.NDArray[np.int64]:
    """Return how many views see each of the points (N, 3) with normals (N, 3), in W."""
    return np.asarray(sum((worth(view, points, normals) > 0).astype(np.int64) for view in views), dtype=np.int64)


def worth(view: DepthView, points: Array, normals: Array) -> Array:
    """Return how well a view shows each place (N, 3), 0 where it does not: a power of the cosine, little near edges."""
    u, v, z = view.camera.project(points)
    row, column, there = nearest_pixels(u, v, view.depth.shape)
    ray = points - view.camera.p_WC
    facing = -np.einsum("ni,ni->n", ray, normals) / np.maximum(np.linalg.norm(ray, axis=1), 1e-9)
    depth = view.depth[row, column]
    sees = there & (facing > TUNING.least) & (depth > 0) & (np.abs(depth - z) < TUNING.near / np.maximum(facing, 0.2))
    good = np.clip(facing, 0, 1) ** TUNING.sharpness
    return np.where(sees, good * np.where(view.near_edge[row, column], TUNING.at_edges, 1.0), 0.0)


def filled_in(points: Array, colours: Array, shown: npt.NDArray[np.bool_]) -> Array:
    """Return colours in which those not shown are those of the nearest shown point."""
    from scipy.spatial import cKDTree

    if shown.all() or not shown.any():
        return colours
    _, nearest = cKDTree(points[shown]).query(points[~shown], workers=1)
    out = colours.copy()
    out[~shown] = colours[shown][nearest]
    return out


def nearest_pixels(
    u: Array, v: Array, size: tuple[int, ...]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Return rows and columns (N,) of the nearest pixels in an image of `size`, 0 outside, and which lie inside."""
    there = (u > -0.5) & (v > -0.5) & (u < size[1] - 0.5) & (v < size[0] - 0.5)
    row, column = (np.where(there, np.rint(x), 0).astype(np.int64) for x in (v, u))
    return row, column, there


def bilinear_rgb(rgb: npt.NDArray[np.uint8], u: Array, v: Array) -> Array:
    """Return RGB in [0, 1] (N, 3) at fractional pixels."""
    height, width = rgb.shape[:2]
    x, y = np.clip(u, 0, width - 1.001), np.clip(v, 0, height - 1.001)
    x0, y0 = x.astype(np.int64), y.astype(np.int64)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    top = rgb[y0, x0] * (1 - fx) + rgb[y0, x0 + 1] * fx
    bottom = rgb[y0 + 1, x0] * (1 - fx) + rgb[y0 + 1, x0 + 1] * fx
    return np.asarray((top * (1 - fy) + bottom * fy) / 255.0)
