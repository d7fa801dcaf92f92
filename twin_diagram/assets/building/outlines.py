"""Where an object ends in a depth image, before something farther: its outline tells where it is across the picture.

What faces a camera tells how far away it is and little else: views from above see a mug's walls from the side alone,
and slide over its floor. At its outline a thing's surface runs along the ray, so a place there has a normal that points
outwards in the picture, and other views, who see that side from in front, have the same surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.depth_view import TUNING as EDGES
from twin_diagram.assets.building.depth_view import DepthView
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    jump: float = 0.01
    """How much farther what lies behind must be [m], or an edge of `near_edges`, if that is more: a foot on a table,
    from which the table goes on, is no outline."""

    beyond: int = 4
    """How far beside the outline what lies behind may begin [pixel]: a round side has no depth where it turns away."""

    around: float = 2.5
    """Standard deviation of the window that tells which way is out [pixel]: as wide as depth noise is correlated."""

    one_sided: float = 0.4
    """How far the middle of what is as near must lie beside the pixel, in `around`: at a straight outline it is 0.8, of
    a thread 0."""

    most: int = 400
    """About how many points of a view are used: all of a mug at arm's length."""

    near: float = 0.005
    """How far from the box about the object they may lie [m]: it was found by what faces the cameras."""

    nothing: float = 1e3
    """Depth that stands for none [m]."""


TUNING = Tuning()


def outline_near(view: DepthView, low: Array, high: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return some of the points of `outline` that lie in a box in W, or near to it, and their normals."""
    points, normals = outline(view)
    place = points @ view.camera.R_WC.T + view.camera.p_WC
    near = ((place > low - TUNING.near) & (place < high + TUNING.near)).all(axis=1)
    some = rng.permutation(np.flatnonzero(near))[: TUNING.most]
    return points[some], normals[some]


def outline(view: DepthView) -> tuple[Array, Array]:
    """Return places and unit normals (N, 3) in C along the outlines in a view's depth, half a pixel outside of it.

    Only pixels with trust count, in the view's mask where there is one: what is beside it is none of the object's.
    """
    depth, c = view.depth, view.camera
    limit = np.maximum(TUNING.jump, EDGES.edge_jump * depth / c.fx)
    open_depth = np.where(depth > 0, depth, np.float32(TUNING.nothing))
    side = 2 * TUNING.beyond + 1
    behind = cv2.dilate(depth, np.ones((side, side), np.uint8)) - depth > limit
    last = cv2.dilate(open_depth, np.ones((3, 3), np.uint8)) - depth > limit
    own = view.trust > 0 if view.mask is None or view.colour is not view.camera else (view.trust > 0) & view.mask
    rows, columns = np.nonzero(behind & last & own)
    if not len(rows):
        return np.zeros((0, 3)), np.zeros((0, 3))
    out, sure = _outwards(open_depth, rows, columns, limit[rows, columns])
    rows, columns, out = rows[sure], columns[sure], out[sure]
    z = depth[rows, columns].astype(float)
    ray = np.stack([(columns - c.cx) / c.fx, (rows - c.cy) / c.fy, np.ones_like(z)], axis=1)
    step = np.stack([out[:, 0] / c.fx, out[:, 1] / c.fy, np.zeros_like(z)], axis=1)
    along = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    normal = step - np.einsum("ni,ni->n", step, along)[:, None] * along
    return z[:, None] * (ray + 0.5 * step), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _outwards(
    depth: npt.NDArray[np.float32], rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64], limit: Array
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the unit way (N, 2; u, v) out of what is as near as each pixel, to a `limit` (N,), and where it is sure.

    It leads away from the middle of those pixels.
    """
    reach = round(3 * TUNING.around)
    padded = np.pad(depth, reach, constant_values=TUNING.nothing)
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    windows = np.lib.stride_tricks.sliding_window_view(padded, u.shape)[rows, columns]
    near = np.abs(windows - depth[rows, columns][:, None, None]) < limit[:, None, None]
    weight = near * np.exp(-(u**2 + v**2) / (2 * TUNING.around**2))
    out = -np.stack([(weight * u).sum(axis=(1, 2)), (weight * v).sum(axis=(1, 2))], axis=1)
    length = np.linalg.norm(out, axis=1)
    sure = length > TUNING.one_sided * TUNING.around * weight.sum(axis=(1, 2))
    return out / np.maximum(length, 1e-12)[:, None], sure
