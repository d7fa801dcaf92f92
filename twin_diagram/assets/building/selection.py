"""Which points belong to the object: those that masks agree on, or the one thing that stands out of its support.

Masks are grown before they are projected (SyncTwin, section III-B, mask projection expansion), because poses are off;
what the growth lets in, background behind edges and rims of the table, goes again: other views' masks outvote the one,
and the support plane is cut away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.assets.building.colouring import nearest_pixels
from twin_diagram.assets.building.depth_view import DepthView, Mask
from twin_diagram.errors import FramesError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the choice, chosen by hand."""

    growth: int = 4
    """How far masks are grown [pixel]: poses 2 mm and 0.2° off move things at 0.6 m by three pixels."""

    agreement: float = 0.5
    """Least share of the views that see a point whose masks must hold it."""

    visible: float = 0.012
    """How far a point may be off a view's depth and still be what that view sees [m]."""

    cell: float = 0.01
    """Edge of the cells by which things are told apart [m]: a gap of one to two cells makes two things."""

    stands_out: float = 0.006
    """Least height above the support from which a point is the thing's [m], …"""

    spreads: float = 4.0
    """… and in standard deviations of what is flat there: a network's table is bent by millimetres."""

    bent: float = 0.02
    """Distance from the support within which what is flat is the support's [m]."""

    flat: float = 0.94
    """Least cosine between its normals and the support's."""

    sparse: float = 0.08
    """Points in a cell, as a share of the median cell's, below which it counts as empty."""

    second: float = 0.06
    """Least size of a second thing, as a share of the first one's cells."""

    reach: float = 0.6
    """Radius about what the cameras look at within which a thing is looked for, as a share of their distance."""

    most_cells: float = 1e8
    """Of cells: more is no scene about one thing, but one in a wrong unit; five metres each way have as many."""

    least_points: int = 60
    """Least number of points an object must have."""


TUNING = Tuning()


def grown(mask: Mask, pixels: int = TUNING.growth) -> Mask:
    """Return a mask grown by a disc of that radius [pixel]."""
    size = 2 * pixels + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc) > 0)


def looked_at(views: Sequence[DepthView]) -> tuple[Array, float]:
    """Return the point (3,) nearest to all optical axes, and the cameras' median distance to it [m].

    Nearest in the sense of least squares: Σ (I − z zᵀ)(x − p) = 0. Where all look the same way, it lies at the median
    depth.
    """
    A, b = np.zeros((3, 3)), np.zeros(3)
    for view in views:
        axis = view.camera.R_WC[:, 2]
        across = np.eye(3) - np.outer(axis, axis)
        depth = float(np.median(view.depth[view.depth > 0])) if (view.depth > 0).any() else 1.0
        guess = view.camera.p_WC + depth * axis
        A += across + 0.02 * np.eye(3)
        b += across @ view.camera.p_WC + 0.02 * guess
    point: Array = np.asarray(np.linalg.solve(A, b), dtype=float)
    return point, float(np.median([np.linalg.norm(view.camera.p_WC - point) for view in views]))


def masked_by_most(views: Sequence[DepthView], points: Array, masks: Sequence[Mask]) -> npt.NDArray[np.bool_]:
    """Return (N,), whether most views that see a point (N, 3) have it within their mask."""
    seen, held = np.zeros(len(points)), np.zeros(len(points))
    for view, mask in zip(views, masks, strict=True):
        u, v, z = view.camera.project(points)
        row, column, there = nearest_pixels(u, v, view.depth.shape)
        depth = view.depth[row, column]
        sees = there & (depth > 0) & (np.abs(depth - z) < TUNING.visible)
        uc, vc, _ = view.colour.project(points)
        row, column, inside = nearest_pixels(uc, vc, mask.shape)
        seen += sees & inside
        held += sees & inside & mask[row, column]
    return np.asarray((seen > 0) & (held >= TUNING.agreement * seen))


def things(points: Array) -> list[npt.NDArray[np.int64]]:
    """Return the indices of points (N, 3) thing by thing, the largest first; things are apart by more than a cell."""
    cell = np.floor((points - points.min(axis=0)) / TUNING.cell).astype(int)
    often = np.zeros(cell.max(axis=0) + 1, np.int64)
    np.add.at(often, tuple(cell.T), 1)
    # Pixels that fly between two surfaces are few in any one place.
    full = often > TUNING.sparse * np.median(often[often > 0])
    label, _ = ndimage.label(full, np.ones((3, 3, 3)))
    of_point = label[tuple(cell.T)]
    cells = np.bincount(label[full], minlength=1)
    order = np.argsort(-cells, kind="stable")
    return [np.flatnonzero(of_point == k) for k in order if k and cells[k]]


def the_one_thing(points: Array, where: str) -> npt.NDArray[np.int64]:
    """Return the indices of the points (N, 3) of the one thing among them.

    Raises:
        FramesError: there is none, or a second one of some size; `where` begins the message.
    """
    if len(points) < TUNING.least_points:
        raise FramesError(
            f"{where}: nothing is there: {len(points)} points of an object, {TUNING.least_points} are needed"
        )
    extent = np.ptp(points, axis=0)
    if float((extent / TUNING.cell + 1.0).prod()) > TUNING.most_cells:
        said = " × ".join(f"{x:.3g}" for x in extent)
        raise FramesError(
            f"{where}: what is there would be {said} m large; is a unit wrong (depth_scale: mm per step)?"
        )
    found = things(points)
    if len(found) > 1 and len(found[1]) >= max(TUNING.second * len(found[0]), TUNING.least_points / 2):
        apart = float(np.linalg.norm(points[found[0]].mean(axis=0) - points[found[1]].mean(axis=0)))
        raise FramesError(f"{where}: two things, {apart * 1000:.0f} mm apart: mask one of them")
    return found[0]
