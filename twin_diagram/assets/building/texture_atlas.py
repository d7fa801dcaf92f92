"""A picture for a mesh without texture coordinates: each triangle has half of a square cell of it, a gutter around.

No charts are cut, so nothing is stretched, folded or left out, whatever the mesh; the price is a seam at each edge,
which the gutter hides: a cell's texels go on past its triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.colouring import TUNING as COLOURS
from twin_diagram.assets.building.colouring import bilinear_rgb, filled_in, nearest_pixels, worth
from twin_diagram.assets.building.depth_view import DepthView
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the atlas."""

    cell: int = 10
    """Edge of a cell [pixel]: two triangles of 4 mm get texels of half a millimetre."""

    well: float = 0.05
    """Least worth of the picture that shows a triangle whose colour others take: not one beside an edge."""

    pictures: int = 3
    """Pictures that are mixed for a triangle, those that face it best: more blur it where poses are off."""


TUNING = Tuning()


@dataclass(frozen=True)
class Atlas:
    """Where triangles lie in the picture.

    Attributes:
        edge: of the square picture [pixel].
        uv: (F, 3, 2), v upwards.
        face: (T,) the triangle of each texel that has one.
        share: (T, 3) its barycentric coordinates there; gutters lie a little outside.
        row, column: (T,) of the texels.
    """

    edge: int
    uv: Array
    face: npt.NDArray[np.int64]
    share: Array
    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]


def lay_out(count: int) -> Atlas:
    """Return an atlas for `count` triangles."""
    n = TUNING.cell
    cells = (count + 1) // 2
    across = int(np.ceil(np.sqrt(cells)))
    edge = across * n
    reach = n - 4.0
    corner = np.array([[1.0, 1.0], [1.0 + reach, 1.0], [1.0, 1.0 + reach]])  # x, y in the cell [pixel]
    corners = np.stack([corner, n - corner])
    face = np.arange(count)
    origin = n * np.stack([(face // 2) % across, (face // 2) // across], axis=1)
    xy = origin[:, None, :] + corners[face % 2]
    uv = np.stack([xy[..., 0] / edge, 1.0 - xy[..., 1] / edge], axis=-1)
    y, x = np.indices((n, n)).reshape(2, -1)
    upper = (x + y + 1.0 > n).astype(int)
    own = np.where(upper[:, None], n - 0.5 - np.stack([x, y], axis=1), np.stack([x, y], axis=1) + 0.5)
    b = (own - 1.0) / reach
    share = np.stack([1.0 - b.sum(axis=1), b[:, 0], b[:, 1]], axis=1)
    texel_face = (2 * np.arange(cells)[:, None] + upper).reshape(-1)
    row = (n * (np.arange(cells) // across)[:, None] + y).reshape(-1)
    column = (n * (np.arange(cells) % across)[:, None] + x).reshape(-1)
    there = texel_face < count
    return Atlas(edge, uv, texel_face[there], np.tile(share, (cells, 1))[there], row[there], column[there])


def textured(
    views: Sequence[DepthView], vertices: Array, faces: npt.NDArray[np.int64], atlas: Atlas
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Return the picture (edge, edge, 3): each triangle from the pictures that see it and face it best.

    Beside it one as large, white where a triangle's colour is made up: no picture shows it, or none but at its edges.
    Where there are no colours at all, nothing is.

    Args:
        views: at their best known poses.
        vertices: (V, 3) in W [m].
        faces: (F, 3).
        atlas: of as many triangles.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    middle, normal = (a + b + c) / 3, np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
    value = np.stack([worth(view, middle, normal) for view in views])
    best = np.argsort(-value, axis=0, kind="stable")[: TUNING.pictures]
    points = np.einsum("tk,tki->ti", atlas.share, vertices[faces[atlas.face]])
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for k, view in enumerate(views):
        if view.rgb is None:
            continue
        chosen = (best == k).any(axis=0) & (value[k] > 0)
        here = np.flatnonzero(chosen[atlas.face])
        u, v, _ = view.colour.project(points[here])
        _, _, inside = nearest_pixels(u, v, view.rgb.shape)
        here, u, v = here[inside], u[inside], v[inside]
        w = value[k, atlas.face[here]]
        total[here] += w[:, None] * bilinear_rgb(view.rgb, u, v)
        weight[here] += w
    shown = weight > 0
    colours = np.where(shown[:, None], total / np.maximum(weight, 1e-12)[:, None], COLOURS.grey)
    # Triangles that no picture shows take the colour of the nearest that one does: by triangle, they are fewer.
    blank = np.bincount(atlas.face, shown, minlength=len(faces)) == 0
    mean: Array = np.stack(
        [np.bincount(atlas.face, colours[:, i] * shown, minlength=len(faces)) for i in range(3)], axis=1
    ).astype(float)
    mean /= np.maximum(np.bincount(atlas.face, shown, minlength=len(faces)), 1)[:, None]
    well = ~blank & (value.max(axis=0) > TUNING.well)
    mean = filled_in(middle, mean, well if well.any() else ~blank)
    mean = mean if not blank.all() else np.full_like(mean, COLOURS.grey)
    colours = np.where(shown[:, None], colours, mean[atlas.face])
    picture = np.full((atlas.edge, atlas.edge, 3), 128, np.uint8)
    picture[atlas.row, atlas.column] = np.round(255 * colours)
    made_up = np.zeros_like(picture)
    if not blank.all():
        poor = blank | (value.max(axis=0) <= COLOURS.at_edges)
        made_up[atlas.row, atlas.column] = 255 * poor[atlas.face, None]
    return picture, made_up
