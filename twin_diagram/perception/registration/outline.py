"""How far the outline of what the image shows lies outside of the outline that a model has at a pose."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.rotation import cross
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import unit_rays

Mask = npt.NDArray[np.bool_]
Cells = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Tuning:
    """Constants, chosen by hand on rendered sequences of grey and repainted things before a D435."""

    low: tuple[float, float] = (0.015, 0.5)
    """What is lower above the table is left out [m], or than this share of the thing's height: there, segmentation
    takes things for table."""

    rim: tuple[float, float] = (0.03, 0.6)
    """Outlines begin this high, or at this share: the lower rim is where the table begins."""

    sunk: float = 6.0
    """Outlines begin no lower than so many deviations of a height above the table: what stands out of it by four is
    a thing's (`segmentation`), and of what stands out by no more than that half is taken for the table."""

    closed: float = 1.2
    """Gaps between projected points are closed up to so many of the model's spacings."""

    placed: float = 4.0
    """Image points within so many deviations of the surface, and `near`, are the object's, whatever their segment."""

    near: float = 0.003
    """See `placed` [m]."""

    own: float = 0.5
    """A segment is the object's of which this share is."""

    touched: float = 0.5
    """An edge is another thing's that lies by so much farther out with it [cells]: by one of them, but for rounding."""

    farthest: float = 0.04
    """An edge farther off is as far off as this [m]."""

    nearest: float = 0.05
    """Nothing is looked at that is nearer to the camera [m]."""

    lit: float = 0.3
    """Where less than this share of an outline is clear of pixels without depth, such pixels hide none of it."""

    fewest: int = 12
    """Fewer cells are no outline."""

    smooth: float = 1.5
    """Deviation of the blur of distances, whose slope is an outline's normal [cells]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Outline:
    """The image's outline beside the model's.

    Attributes:
        J: (E, 10) by how much each cell of the model's outline goes outward [cells] with turn, shift and stretch (see
            `moves`), and with all of it growing by one cell.
        apart: (E,) how far outside of it the image's outline lies [cells].
        outside: share of the thing's image that lies outside of the model's outline.
        missed: share of the model's outline that shows something else, where nothing hides it.
        touched: (E,) which cells lie so far out by points alone that are near the model, but of another's segment: what
            bears it, or stands against it, is near it there.
    """

    J: Array
    apart: Array
    outside: float
    missed: float
    touched: Mask

    def in_place(self, within: float) -> float:
        """Return the share of the model's outline that the image's is within so many cells of."""
        return float(np.mean(np.abs(self.apart) <= within))


def height_above(table: Array, points_W: Array) -> Array:
    """Return how high points (N, 3) are above a table z = a x + b y + c [m]."""
    return np.asarray(points_W[:, 2] - points_W[:, :2] @ table[:2] - table[2])


def moves(way: Array, r: Array, R: Array) -> Array:
    """Return (N, 9) how far points go along `way` (N, 3): by turns, shifts, and stretches along O's axes.

    Args:
        way: unit vectors in W, or any linear measure of a shift.
        r: (N, 3) the points from O, axes of W [m].
        R: (3, 3) R_WO.
    """
    return np.hstack([cross(r, way), way, (way @ R) * (r @ R)])


def own_points(model: ModelCloud, segments: Segments, one: RegisteredPose) -> tuple[Mask, Mask]:
    """Return (N,) which of the segments' points are near an object's surface, and which are its own.

    Its own are those near it, and those of segments that mostly are.

    Args:
        model: the object.
        segments: the image taken apart.
        one: where it is.
    """
    local = (segments.points_W - one.p) @ one.R
    reach = _reach(model, segments, one)
    near = np.zeros(len(local), dtype=bool)
    around = np.flatnonzero(np.einsum("ni,ni->n", local, local) < (model.radius + reach) ** 2)
    near[around] = np.isfinite(model.nearest.query(local[around], reach)[0])
    count = max(segments.count, 1)
    mine = np.bincount(segments.labels[near], minlength=count)
    whole = np.maximum(np.bincount(segments.labels, minlength=count), 1)
    return near, np.asarray(near | (mine >= TUNING.own * whole)[segments.labels])


def _mostly(segments: Segments, own: Mask) -> Mask:
    """Return (N,) which of the segments' points are of segments that mostly are an object's `own` (N,)."""
    count = max(segments.count, 1)
    whole = np.maximum(np.bincount(segments.labels, minlength=count), 1)
    return np.asarray((np.bincount(segments.labels[own], minlength=count) >= TUNING.own * whole)[segments.labels])


def _reach(model: ModelCloud, segments: Segments, one: RegisteredPose) -> float:
    """Return how far from a cloud's points depth may show the surface [m]."""
    z = max(float((one.p - segments.camera.p_WC) @ segments.camera.R_WC[:, 2]), 0.0)
    return TUNING.near + TUNING.placed * float(segments.camera.depth_noise(np.array(z))) + 0.5 * model.spacing


def outline(model: ModelCloud, frame: Frame, segments: Segments, one: RegisteredPose, own: Mask) -> Outline | None:
    """Return the outline of what the image shows beside the model's; None where hardly any of it is in view.

    Args:
        model: the object.
        frame: the image.
        segments: the same, taken apart.
        one: the pose.
        own: (N,) which of the segments' points are the object's.
    """
    points = model.points @ one.R.T + one.p
    height = height_above(frame.table, points)
    top = float(height.max())
    least = TUNING.sunk * _height_noise(frame, one.p)
    low, rim = (max(least, min(most, share * top)) for most, share in (TUNING.low, TUNING.rim))
    points, height = points[height > low], height[height > low]
    if not len(points):
        return None
    u, v, z = frame.camera.project(points)
    cell = float(np.median(z)) * frame.stride / frame.camera.fx
    if z.min() < TUNING.nearest:
        return None
    spot = np.stack([u, v], axis=1) / frame.stride
    closed = int(np.ceil(TUNING.closed * model.spacing / cell))
    margin = closed + int(np.ceil(TUNING.farthest / cell)) + 2
    # The picture's part of a window about the model: what it covers beyond the picture belongs to its outline.
    first = np.floor(spot.min(axis=0)).astype(int) - margin
    size = np.ceil(spot.max(axis=0)).astype(int) + margin + 1 - first
    c0, r0 = np.maximum(first, 0)
    c1, r1 = np.minimum(first + size, segments.label_image.shape[::-1])
    if c1 - c0 < 3 or r1 - r0 < 3:
        return None
    whole = _covered(spot - first, (size[1], size[0]), closed)
    ours = np.ascontiguousarray(whole[r0 - first[1] : r1 - first[1], c0 - first[0] : c1 - first[0]])
    spot = spot - [c0, r0]
    part = (slice(r0, r1), slice(c0, c1))
    specks = _specks(model, segments, one, ours, low, part)
    seen, tall, before, hidden = _shown(segments, own, low, float(np.median(z)), part, specks)
    outside = _share(~ours, tall)
    missed = _share(~seen, ours & ~hidden)
    at, index = _edge(ours, before, hidden, spot, height > rim)
    if len(at) < TUNING.fewest:
        return None
    inward = _signed(ours)
    cut = TUNING.farthest / cell
    r, c = at.T
    apart, touched = np.clip(inward[r, c] - _signed(tall | (seen & ours))[r, c], -cut, cut), np.zeros(len(at), bool)
    mostly = _mostly(segments, own)
    if (own & ~mostly).any():
        sure = _shown(segments, mostly, low, float(np.median(z)), part, specks)[1]
        less = np.clip(inward[r, c] - _signed(sure | (seen & ours))[r, c], -cut, cut)
        touched = apart - less > TUNING.touched
    way = _outward(frame, points[index], _slopes(inward, at))
    J = np.hstack([moves(way, points[index] - one.p, one.R), np.ones((len(at), 1))])
    return Outline(J, apart, outside, missed, touched)


def _height_noise(frame: Frame, p: Array) -> float:
    """Return the standard deviation of heights above the table that depth shows at a place (3,) in W [m]."""
    camera, up = frame.camera, np.array([-frame.table[0], -frame.table[1], 1.0])
    ray = p - camera.p_WC
    z = max(float(ray @ camera.R_WC[:, 2]), TUNING.nearest)
    return float(camera.depth_noise(np.array(z))) * abs(float(ray @ up)) / (z * float(np.linalg.norm(up)))


def _share(part: Mask, whole: Mask) -> float:
    """Return how much of a mask is in another, 0 of none."""
    return float(np.count_nonzero(part & whole)) / max(float(np.count_nonzero(whole)), 1.0)


def _covered(spot: Array, shape: tuple[int, int], closed: int) -> Mask:
    """Return the cells (h, w) that projected points (P, 2) cover, gaps between them closed."""
    mask = np.zeros(shape, dtype=np.uint8)
    c, r = np.round(spot).astype(int).T
    inside = (c >= 0) & (r >= 0) & (c < shape[1]) & (r < shape[0])
    mask[r[inside], c[inside]] = 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * closed + 1, 2 * closed + 1))
    wide = cv2.copyMakeBorder(mask, closed, closed, closed, closed, cv2.BORDER_CONSTANT, value=0)
    return np.asarray(cv2.morphologyEx(wide, cv2.MORPH_CLOSE, disc)[closed:-closed, closed:-closed] > 0)


def _specks(
    model: ModelCloud, segments: Segments, one: RegisteredPose, ours: Mask, low: float, part: tuple[slice, slice]
) -> Mask:
    """Return which cells of a part of the image are in no segment, and show the object's surface.

    A handle that a strip without depth parts from its mug is too small for a segment: it is there nonetheless.

    Args:
        model: the object.
        segments: the image taken apart.
        one: the pose.
        ours: (h, w) the cells that the model covers.
        low: height above the table [m].
        part: rows and columns.
    """
    camera = segments.camera
    specks = np.zeros(ours.shape, dtype=bool)
    depth = segments.depth[:: segments.stride, :: segments.stride][part]
    at = np.nonzero(ours & (segments.label_image[part] == SEGMENTS.background) & (depth > 0.0))
    rays = unit_rays(camera.optics)[:: segments.stride, :: segments.stride][part][at]
    points_W = camera.p_WC + depth[at][:, None] * (rays @ camera.R_WC.T)
    near = np.isfinite(model.nearest.query((points_W - one.p) @ one.R, _reach(model, segments, one))[0])
    specks[at] = near & (height_above(segments.table, points_W) > low)
    return specks


def _shown(
    segments: Segments, own: Mask, low: float, middle: float, part: tuple[slice, slice], specks: Mask
) -> tuple[Mask, Mask, Mask, Mask]:
    """Return which cells of a part of the image show a thing, and which do above `low`, and what hides it.

    What hides it stands without and with single pixels without depth.

    Args:
        segments: the image taken apart.
        own: (N,) which of its points are the thing's.
        low: height above the table [m].
        middle: the thing's depth [m]: what is nearer stands before it.
        part: rows and columns.
        specks: cells of that part that show it besides.
    """
    seen, tall = (np.zeros(segments.label_image.shape, dtype=bool) for _ in range(2))
    rows, columns = np.nonzero(segments.label_image >= 0)
    seen[rows, columns] = own
    tall[rows, columns] = own & (height_above(segments.table, segments.points_W) > low)
    labels, depth = segments.label_image[part], segments.depth[:: segments.stride, :: segments.stride][part]
    # Single pixels without depth, as edges have them, hide no edge: they are what lies around them.
    void = labels == SEGMENTS.no_depth
    wide = _opened(void)
    seen, tall = (mask[part] | specks for mask in (seen, tall))
    seen, tall = (mask | (void & ~wide & ~_opened(~mask)) for mask in (seen, tall))
    nearer = (labels != SEGMENTS.background) & (depth < middle) & ~void
    before = ~seen & (nearer | (labels == SEGMENTS.robot) | wide)
    return seen, tall, before, ~seen & (before | void)


def _opened(mask: Mask) -> Mask:
    """Return a mask without what is narrower than three cells."""
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)


def _edge(
    ours: Mask, before: Mask, hidden: Mask, spot: Array, high: Mask
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the cells (E, 2) of the model's outline, row and column, that nothing hides, and its points nearest them.

    Those by points that are `high`: where a thing meets the table depth has no holes, and tells nothing of other edges.

    Args:
        ours: (h, w) the cells that the model covers.
        before: (h, w) those where something stands before it.
        hidden: (h, w) the same with single pixels without depth: a shadow's, or an edge's if all of it has them.
        spot: (P, 2) column and row of its points.
        high: (P,) those above the lower rim.
    """
    # Where the picture ends, the outline does not.
    inner = cv2.erode(ours.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1)
    whole = ours & (inner == 0)
    at = np.argwhere(whole)
    if not len(at):
        return at, np.zeros(0, dtype=np.int64)
    index = np.asarray(((spot[None] - at[:, None, ::-1]) ** 2).sum(axis=2).argmin(axis=1))
    near = [cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0 for mask in (hidden, before)]
    lit, every = (high[index] & ~mask[tuple(at.T)] for mask in near)
    chosen = lit if np.count_nonzero(lit) >= TUNING.lit * np.count_nonzero(every) else every
    return at[chosen], index[chosen]


def _signed(mask: Mask) -> Array:
    """Return (h, w) the distance to a mask's edge [cells], negative within."""
    cells: Cells = mask.astype(np.uint8)
    away = cv2.distanceTransform(1 - cells, cv2.DIST_L2, 5)
    within = cv2.distanceTransform(cells, cv2.DIST_L2, 5)
    return np.asarray(np.where(mask, 0.5 - within, away - 0.5), dtype=float)


def _slopes(inward: Array, at: npt.NDArray[np.int64]) -> Array:
    """Return (E, 2) the unit normals of an outline, column and row, outward, by its signed distances."""
    smooth = cv2.GaussianBlur(inward, (0, 0), TUNING.smooth)
    r, c = at.T
    slope = np.stack([np.gradient(smooth, axis=1)[r, c], np.gradient(smooth, axis=0)[r, c]], axis=1)
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9))


def _outward(frame: Frame, points_W: Array, normal: Array) -> Array:
    """Return (E, 3) by how many cells points go outward for a shift in W, along normals (E, 2) of the outline."""
    camera = frame.camera
    p_C = (points_W - camera.p_WC) @ camera.R_WC
    way = np.zeros((len(points_W), 3))
    way[:, :2] = normal * [camera.fx, camera.fy] / p_C[:, 2:]
    way[:, 2] = -(way[:, :2] * p_C[:, :2]).sum(axis=1) / p_C[:, 2]
    return np.asarray(way @ camera.R_WC.T / frame.stride)
