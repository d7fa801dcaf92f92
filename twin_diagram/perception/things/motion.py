"""How fast an unknown thing moves, from where its middle and its edges were in some images: pure functions.

Along each of three axes an image shows a middle and two edges. A thing that moves takes all of them along; one that
turns, or that an arm hides more and more of, moves some of them, and not all one way. So the smallest shift counts, and
only where all go one way; an edge that the image's border or something nearer cuts off is none. What may be noise is
zero, as the data's own jitter tells.

Of what comes into view little by little, one place stays where it is while the thing goes, and of what has just set off
five images tell late. Where the thing's surface contradicts (see `flow`), that counts: it is less exact, and never
blind.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import DepthImage
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things import flow_kernels
from twin_diagram.perception.things.flow import FLOW_SIZE, VIEWS, Flow, no_views, with_view
from twin_diagram.perception.things.seen_through import TUNING as SEEN_THROUGH
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout
from twin_diagram.signals.layouts import NEVER


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    window: float = 0.28
    """Images of so long count [s]: five at 15 Hz. Longer ones tell of a motion later, shorter ones noise as motion."""

    fewest: int = 3
    """Images in it that must show an edge: two have no jitter."""

    share: float = 0.1
    """The outermost points, this share of them when most of the thing was seen, are an edge, and their median its
    place: where depth jumps one point in ten or so flies, which along the line of sight makes a third of these."""

    fewest_points: int = 5
    """But so many at least: a median of fewer goes with one that strays."""

    looked_at: int = 40
    """Points of an edge that are looked at for what cuts it off: more of them tell nothing new."""

    around: int = 4
    """What cuts an edge off is no farther from it, in pixels of the grid: the rims that segmentation leaves out."""

    cut: float = 0.15
    """An edge of which this share is cut off is none."""

    sure: float = 16.3
    """Squared velocity over its variance, from which on it is none of noise: 1 in 1000 by chance, of three axes."""

    images: tuple[float, float] = (4.0, 30.0)
    """Jitter is averaged over so many images at the most [2 s]; the camera's data sheet counts as so many."""

    outlier: float = 9.0
    """A squared step of the jitter counts as no more than this times what is usual: another part may have shown."""

    alike: float = 2.0
    """Shifts within so many standard deviations of each other are one: the smallest alone would be too small."""

    contradicted: float = 25.9
    """Squared difference from what the surface tells, over its variance, from which on the edges are wrong: 1 in
    100,000 by chance, of three axes."""

    unknown: float = 0.5
    """Where neither tells, a velocity is taken to be what it was, to this [m/s]: few things on tables are faster."""

    fade: float = 0.3
    """Where no edge shows, a velocity is forgotten with this time constant [s]."""


TUNING = Tuning()

ROWS: Final = 8
"""Images that are kept at the most."""
_ROW: Final = 1 + 9 + 9
"""Time, then (3, 3) low edges, middles and high edges, then whether each counts."""
MOTION_SIZE: Final = ROWS * _ROW + 9 + 1 + 1 + FLOW_SIZE
"""A packed `ShownMotion`."""


@dataclass(frozen=True)
class ShownMotion:
    """Where a thing's middle and edges were, oldest first.

    Attributes:
        rows: (N, 19) of images: time [s]; low edges, middles and high edges along three axes [m]; whether each counts.
        jitter: (3, 3) variance of each of those [m²]; zero before the first image.
        count: how many images that is worth.
        most: points that the thing has shown at the most.
        views: its surface in images before; see `flow`.
    """

    rows: Array = field(default_factory=lambda: np.zeros((0, _ROW)))
    jitter: Array = field(default_factory=lambda: np.zeros((3, 3)))
    count: float = 0.0
    most: int = 0
    views: Array = field(default_factory=no_views)

    def pack(self) -> Array:
        """Return it as a vector of `MOTION_SIZE`."""
        rows = np.full((ROWS, _ROW), NEVER)
        rows[: len(self.rows)] = self.rows
        return np.concatenate([rows.ravel(), self.jitter.ravel(), [self.count, float(self.most)], self.views.ravel()])

    @staticmethod
    def unpack(vector: Array) -> ShownMotion:
        """Return the inverse of `pack`; copies."""
        rows = vector[: ROWS * _ROW].reshape(ROWS, _ROW)
        jitter = vector[ROWS * _ROW : ROWS * _ROW + 9].reshape(3, 3).copy()
        count, most = vector[ROWS * _ROW + 9 : ROWS * _ROW + 11]
        views = vector[-FLOW_SIZE:].reshape(VIEWS, -1).copy()
        return ShownMotion(rows[rows[:, 0] >= 0.0].copy(), jitter, float(count), int(most), views)


def axes_of(segments: Segments) -> Array:
    """Return (3, 3) in W, one a row: level along the image's rows, level away from the camera, up."""
    right = segments.camera.R_WC[:, 0].copy()
    right[2] = 0.0
    length = float(np.linalg.norm(right))
    right = right / length if length > 0.1 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([right, np.cross(up, right), up])


def shown_again(motion: ShownMotion, own: npt.NDArray[np.int64], segments: Segments) -> ShownMotion:
    """Return a motion after an image that showed its thing.

    Args:
        motion: before.
        own: the thing's points among the segments'.
        segments: the image taken apart.
    """
    points = segments.points_W[own]
    along = points @ axes_of(segments).T
    most = max(motion.most, len(own))
    k = min(max(round(TUNING.share * most), TUNING.fewest_points), len(own))
    places, counts = np.zeros((3, 3)), np.ones((3, 3))
    cells = segments.cells[own]
    mine = np.zeros(segments.label_image.size, dtype=bool)
    mine[cells] = True
    depth = one_layout(segments.depth[:: segments.stride, :: segments.stride])
    order = np.argpartition(along, (k - 1, len(own) - k), axis=0)
    for axis in range(3):
        for side, chosen in ((0, order[:k, axis]), (2, order[len(own) - k :, axis])):
            places[side, axis] = np.median(along[chosen, axis])
            some = chosen[:: max(1, len(chosen) // TUNING.looked_at)]
            counts[side, axis] = _cut(cells[some], mine, depth, segments) < TUNING.cut
    places[1] = along.mean(axis=0)
    row = np.concatenate([[segments.time], places.ravel(), counts.ravel()])
    before = motion.rows[motion.rows[:, 0] > segments.time - TUNING.window]
    rows = np.concatenate([before, row[None]])[-ROWS:]
    jitter, count = _jitter(motion, rows, points, segments)
    return ShownMotion(rows, jitter, count, most, with_view(motion.views, own, segments))


def velocity_of(
    motion: ShownMotion, before: Array, segments: Segments, surface: Flow | None = None, doubted: float = 0.0
) -> tuple[Array, float]:
    """Return (3,) how fast a thing moves in W [m/s], and the variance of a coordinate of that [m²/s²].

    Args:
        motion: the newest image taken in.
        before: (3,) what it was taken to be.
        segments: of the newest image.
        surface: what that tells; None: nothing.
        doubted: variance of a coordinate of `before` [m²/s²].
    """
    told, variance, doubt = _of_edges(motion, before, segments, doubted)
    if surface is None:
        return told, variance
    off = surface.velocity - told
    # What the edges tell is doubted by their own variance, too, where that is told.
    own = np.linalg.inv(np.eye(3) + variance * surface.information)
    if float(off @ surface.information @ own @ off) <= TUNING.contradicted:
        return told, variance
    axes = axes_of(segments)
    edges = (axes.T / (doubt + (axes @ off) ** 2)) @ axes
    covariance = np.linalg.inv(surface.information + edges)
    both = covariance @ (surface.information @ surface.velocity + edges @ told)
    if float(both @ surface.information @ both) <= TUNING.sure:
        both = np.zeros(3)
    return both, float(np.linalg.eigvalsh(covariance)[-1])


def _of_edges(motion: ShownMotion, before: Array, segments: Segments, doubted: float) -> tuple[Array, float, Array]:
    """Return what a thing's middle and edges tell: velocity (3,), the variance of a coordinate, and variances (3,).

    Those, along `axes_of`, are what is left of it where they may not tell the truth: they are as wrong as they differ.
    Where no edge shows, the velocity is as doubtful as before, and more so by what is forgotten of it.
    """
    axes, rows = axes_of(segments), motion.rows
    slopes, variances, counts = _slopes(motion)
    told, least, spread = np.zeros((3, 3))
    known, doubt = np.zeros(3, dtype=bool), np.full(3, TUNING.unknown**2)
    for axis in range(3):
        open_ = counts[:, axis]
        if not (open_[0] or open_[2]) or not open_[1]:
            continue
        known[axis], spread[axis] = True, variances[open_, axis].max()
        found, variance = slopes[open_, axis], variances[open_, axis]
        doubt[axis] = spread[axis] + np.ptp(found) ** 2
        if (found > 0).all() or (found < 0).all():
            k = int(np.argmin(np.abs(found)))
            least[axis] = found[k]
            same = (found - found[k]) ** 2 <= TUNING.alike**2 * (variance + variance[k])
            told[axis] = np.average(found[same], weights=1.0 / variance[same])
    if known.any() and float((least[known] ** 2 / spread[known]).sum()) <= TUNING.sure:
        told[:] = 0.0
    passed = float(rows[-1, 0] - rows[-2, 0]) if len(rows) > 1 else TUNING.window
    was = (axes @ before)[~known]
    told[~known] = was * np.exp(-passed / TUNING.fade)
    spread[~known] = doubted + (was - told[~known]) ** 2
    return axes.T @ told, float(spread.max()), doubt


def _slopes(motion: ShownMotion) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return (3, 3) slopes [m/s], their variances [m²/s²] and which of them images show."""
    rows = motion.rows
    time = rows[:, 0, None, None]
    place, weight = rows[:, 1:10].reshape(-1, 3, 3), rows[:, 10:19].reshape(-1, 3, 3)
    total = np.maximum(weight.sum(axis=0), 1.0)
    off = time - (weight * time).sum(axis=0) / total
    sxx = (weight * off**2).sum(axis=0)
    shown = (weight.sum(axis=0) >= TUNING.fewest) & (weight[-1] > 0)
    safe = np.where(shown, sxx, 1.0)
    slopes = (weight * off * place).sum(axis=0) / safe
    return slopes, motion.jitter / safe, shown


def _jitter(motion: ShownMotion, rows: Array, points: Array, segments: Segments) -> tuple[Array, float]:
    """Return the variances of a thing's edges and middle with the newest image in, and how many images they are of.

    How far the place in the middle of three images is off the line through its neighbours tells them, whatever the
    thing's velocity. The camera's data sheet and pixels are where they begin.
    """
    camera = segments.camera
    z = float(np.median((points - camera.p_WC) @ camera.R_WC[:, 2]))
    pixel = z * segments.stride / camera.focal
    told = float(camera.depth_noise(np.array(z))) ** 2 + pixel**2 / 12.0
    jitter = motion.jitter if motion.count > 0 else np.full((3, 3), told)
    count = max(motion.count, TUNING.images[0])
    if len(rows) < 3:
        return jitter, count
    t0, t1, t2 = rows[-3:, 0]
    a = (t2 - t1) / max(t2 - t0, 1e-9)
    place, shown = rows[-3:, 1:10].reshape(3, 3, 3), rows[-3:, 10:19].all(axis=0).reshape(3, 3)
    off = place[1] - a * place[0] - (1.0 - a) * place[2]
    new = np.minimum(off**2 / (1.0 + a**2 + (1.0 - a) ** 2), TUNING.outlier * jitter)
    after = np.where(shown, (count * jitter + new) / (count + 1.0), jitter)
    return after, min(count + 1.0, TUNING.images[1])


def _cut(cells: npt.NDArray[np.int64], mine: npt.NDArray[np.bool_], depth: DepthImage, segments: Segments) -> float:
    """Return which share of an edge, its points at cells (K,) of the grid, is cut off by the border or what is nearer.

    Args:
        cells: of the points, as indices into the flat label image.
        mine: (cells,) which of them are the thing's own.
        depth: (h, w) of the grid [m].
        segments: the image taken apart.
    """
    here = depth.ravel()[cells].astype(float)
    slack = SEEN_THROUGH.slack + SEEN_THROUGH.sigmas * segments.camera.depth_noise(here)
    labels = one_layout(segments.label_image)
    return flow_kernels.cut_off(cells, mine, labels, SEGMENTS.robot, depth, slack, TUNING.around) / len(cells)
