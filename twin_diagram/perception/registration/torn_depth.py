"""Takes depth for none where it lies behind an object whose colours are seen there: shiny surfaces tear it.

Depth cameras see patches of a reflective surface some millimetres to centimetres too deep, never too near. Where a
model stands right, such patches lie behind it within its outline, in front of what it stands on, and show its colours
all the same. They tell nothing of its place or its name, and pull a pose towards them as long as they seem to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.assessment import TUNING as ASSESSMENT
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.colour_kernels import cut_out
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.fit_kernels import PlaceCuts, placed_weights
from twin_diagram.perception.registration.frame import TUNING as FRAME
from twin_diagram.perception.registration.frame import Frame, blur_within
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.outline import TUNING as OUTLINE
from twin_diagram.perception.registration.outline import height_above
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.perception.registration.residuals import brightness
from twin_diagram.perception.registration.view import View
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants, set on six rendered scenes of a shiny can before a D435."""

    behind: tuple[float, float] = (0.005, 2.0)
    """What is seen deeper by this [m] and so many deviations of depth lies behind the surface, …"""

    deepest: float = 0.045
    """… and by no more than this [m]: makers' cameras err by up to 30 mm there, and a pose by half of that."""

    above: tuple[float, float] = (0.005, 2.0)
    """What is no higher above the table [m], and by no more deviations, may be the table seen past the object."""

    torn: tuple[float, float] = (0.1, 0.6)
    """Such a share of what has depth within the outline is torn; less is noise, more is another thing or place."""

    missing: float = 0.3
    """Where such a share of the outline has no depth at all, its surface tears what is left, too."""

    fits: tuple[float, float] = (0.9, 0.7)
    """Of what such a share is in place, and such a share of that fits in colour, depth is not torn: see `tracking`."""

    alike: float = 0.5
    """Colours of torn points fit as often as those of points in place, times this, or it is another thing."""

    fewest: int = 8
    """Of fewer model points nothing is told."""


TUNING = Tuning()


@dataclass(frozen=True)
class Behind:
    """What is seen behind a model's surface at a pose.

    Attributes:
        pixels: (H, W) those some way behind it.
        share: theirs of the pixels within its outline that have depth.
        missing: share of the pixels within its outline that have none.
        part: first and last row, first and last column of the cells around it.
        shown: (h, w) which cells of that part may show it, within its outline: those, in place, and without depth.
    """

    pixels: Mask
    share: float
    missing: float
    part: tuple[int, int, int, int]
    shown: Mask

    @property
    def may_be_torn(self) -> bool:
        """Whether so much of it is neither noise, nor another thing or place."""
        return self.share <= TUNING.torn[1] and (self.share >= TUNING.torn[0] or self.missing >= TUNING.missing)


def past_what_is_torn(model: ModelCloud, view: View, R: Array, p: Array) -> View:
    """Return an image, past an object's tears where it is in doubt without; see `past_tears`."""
    if not model.coloured or not view.frame.planes:
        return view
    if fits(model, view.frame, Poses(R[None], p[None]), view.params.model_points):
        return view
    return past_tears(model, view, R, p) or view


def fits(model: ModelCloud, frame: Frame, pose: Poses, points: int) -> bool:
    """Return whether an object at one pose is `in_place` in an image, by so many points."""
    fit = assess(model, frame, pose, points)
    return in_place(float(fit.shape[0]), float(fit.quality[0]))


def in_place(shape: float, quality: float) -> bool:
    """Return whether so much of an object is in place, and fits in colour, that it has torn no depth."""
    return shape >= TUNING.fits[0] and quality >= TUNING.fits[1] * shape


def past_tears(model: ModelCloud, view: View, R: Array, p: Array) -> View | None:
    """Return an image as if nothing had been measured where an object's surface tore depth; None where it did not.

    Args:
        model: the object; one without colours cannot tell.
        view: the image.
        R: (3, 3) R_WO.
        p: (3,) p_WO [m].
    """
    if not model.coloured or not view.frame.planes:
        return None
    seen = behind(model, view.frame, R, p)
    if not seen.may_be_torn:
        return None
    pose, sure = Poses(R[None], p[None]), behind(model, view.frame, R, p, low=False)
    for torn, parts in ((seen, [sure.pixels, seen.pixels & ~sure.pixels]), (sure, [sure.pixels])):
        if torn.may_be_torn:
            frame = frame_without(view, torn)
            if fits(model, frame, pose, view.params.model_points) and _show_it(model, frame, pose, parts):
                return without(view, torn, frame)
    return None


def without(view: View, torn: Behind, frame: Frame) -> View:
    """Return an image as if nothing had been measured at torn pixels; `frame` is that for registration."""
    segments = view.segments
    cells = torn.pixels[:: segments.stride, :: segments.stride]
    label = np.where(cells, np.int16(SEGMENTS.no_depth), segments.label_image)
    left = ~cells.ravel()[segments.cells]
    left_over = replace(
        segments,
        points_W=segments.points_W[left],
        normals_W=segments.normals_W[left],
        colours=segments.colours[left],
        labels=segments.labels[left],
        label_image=label,
        depth=frame.depth,
    )
    return replace(view, segments=left_over, frame=frame)


def frame_without(view: View, torn: Behind) -> Frame:
    """Return an image for registration as if nothing had been measured at torn pixels.

    Its colours are those around the object alone, also where depth is torn or missing within its outline.
    """
    frame, segments, stride = view.frame, view.segments, view.frame.stride
    cells = torn.pixels[::stride, ::stride]
    r0, r1, c0, c1 = torn.part
    label = segments.label_image.copy()
    own = label[r0:r1, c0:c1]
    own[torn.shown & ((own == SEGMENTS.no_depth) | (own == SEGMENTS.background))] = 0
    (height, width), margin = frame.depth.shape, FRAME.margin
    v0, v1 = max(r0 * stride - margin, 0), min(r1 * stride + margin, height)
    u0, u1 = max(c0 * stride - margin, 0), min(c1 * stride + margin, width)
    counted = cut_out(segments.rgb, label, stride, (v0, v1, u0, u1))
    return replace(
        frame,
        depth=np.where(torn.pixels, np.float32(0.0), frame.depth),
        past=frame.past & ~cells,
        colours=tuple(blur_within(counted, width) for width in FRAME.blur),
        corner=(u0, v0),
    )


def kept(frame: Frame, torn: Mask, points_W: Array) -> Array:
    """Return those of an image's points (N, 3) that are not on its torn pixels (H, W)."""
    u, v, _ = frame.camera.project(points_W)
    column, row = (np.clip(np.rint(at).astype(int), 0, n - 1) for at, n in zip((u, v), torn.shape[::-1], strict=True))
    return points_W[~torn[row, column]]


def behind(model: ModelCloud, frame: Frame, R: Array, p: Array, *, low: bool = True) -> Behind:
    """Return what is seen behind a model's surface at a pose R (3, 3), p (3,); but for what is as `low` as a table."""
    camera, stride = frame.camera, frame.stride
    deep = np.zeros(frame.depth.shape, dtype=bool)
    front, r0, c0 = _front(model, frame, R, p)
    cells = (r0, r0 + front.shape[0], c0, c0 + front.shape[1])
    if not front.size:
        return Behind(deep, 0.0, 0.0, cells, front > 0.0)
    v0, u0 = r0 * stride, c0 * stride
    part = frame.depth[v0 : cells[1] * stride, u0 : cells[3] * stride]
    rows, columns = (
        np.minimum((np.arange(n) + stride // 2) // stride, m - 1) for n, m in zip(part.shape, front.shape, strict=True)
    )
    surface = front[rows][:, columns]
    at = np.nonzero((surface > 0.0) & (part > 0.0))
    z = part[at].astype(float)
    off, sigma = z - surface[at], camera.depth_noise(surface[at])
    x, y = (at[1] + u0 - camera.centre[0]) / camera.fx * z, (at[0] + v0 - camera.centre[1]) / camera.fy * z
    points_W = camera.p_WC + np.stack([x, y, z], axis=1) @ camera.R_WC.T
    slack = TUNING.behind[0] + TUNING.behind[1] * sigma
    chosen = (off > slack) & (off < TUNING.deepest)
    if not low:
        chosen &= height_above(frame.table, points_W) > TUNING.above[0] + TUNING.above[1] * sigma
    own = chosen | (np.abs(off) <= slack)
    deep[at[0][chosen] + v0, at[1][chosen] + u0] = True
    shown = (surface > 0.0) & (part == 0.0)
    missing = int(np.count_nonzero(shown))
    shown[at[0][own], at[1][own]] = True
    shares = int(np.count_nonzero(chosen)) / max(len(z), 1), missing / max(missing + len(z), 1)
    return Behind(deep, *shares, cells, shown[::stride, ::stride])


def _front(model: ModelCloud, frame: Frame, R: Array, p: Array) -> tuple[npt.NDArray[np.float32], int, int]:
    """Return depth [m] of a model's surface in cells of a part of the grid, 0 beside it, and the first cell's place."""
    camera, stride, shape = frame.camera, frame.stride, frame.past.shape
    points = model.points @ R.T + p
    points = points[np.einsum("ni,ni->n", camera.p_WC - points, model.normals @ R.T) > 0.0]
    u, v, z = camera.project(points) if len(points) else (np.zeros(0),) * 3
    none = np.zeros((0, 0), dtype=np.float32), 0, 0
    if not len(points) or z.min() < OUTLINE.nearest:
        return none
    column, row = np.rint(u / stride).astype(int), np.rint(v / stride).astype(int)
    inside = (row >= 0) & (column >= 0) & (row < shape[0]) & (column < shape[1])
    if not inside.any():
        return none
    row, column, z = row[inside], column[inside], z[inside].astype(np.float32)
    wide = int(np.ceil(OUTLINE.closed * model.spacing * camera.fx / (stride * float(np.median(z)))))
    r0, c0 = max(int(row.min()) - wide, 0), max(int(column.min()) - wide, 0)
    r1, c1 = min(int(row.max()) + wide + 1, shape[0]), min(int(column.max()) + wide + 1, shape[1])
    nearest = np.full((r1 - r0, c1 - c0), np.inf, dtype=np.float32)
    np.minimum.at(nearest, (row - r0, column - c0), z)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * wide + 1, 2 * wide + 1))
    shown = np.isfinite(nearest)
    covered = cv2.morphologyEx(shown.astype(np.uint8), cv2.MORPH_CLOSE, disc) > 0
    filled = np.where(shown, nearest, cv2.erode(nearest, disc))
    return np.where(covered & np.isfinite(filled), filled, np.float32(0.0)), r0, c0


def _show_it(model: ModelCloud, frame: Frame, pose: Poses, parts: Sequence[Mask]) -> bool:
    """Return whether parts of what lies behind a model's surface show its colours, each as those in place do."""
    looked = look(model, frame, pose, model.views.shape[1], FINE)
    cuts = PlaceCuts(OUTLINE.near, ASSESSMENT.placed, ASSESSMENT.same_surface, RESIDUALS.model_noise)
    weight = placed_weights(looked.told, looked.flags, frame.noise, cuts) * looked.painted
    found = frame.plain_colour_at(looked.u, looked.v, FINE)
    gain = brightness(found, looked.colour, looked.n, weight)
    off = np.linalg.norm(found - np.minimum(looked.colour * gain[..., None], 1.0), axis=2)[0]
    fits = off / np.maximum(gain[0], 0.2) < RESIDUALS.colour_cut
    placed = weight[0] > 0.0
    if np.count_nonzero(placed) < TUNING.fewest or (usual := float(fits[placed].mean())) < TUNING.alike:
        return False
    height, width = parts[0].shape
    row = np.clip(np.rint(looked.v[0]).astype(int), 0, height - 1)
    column = np.clip(np.rint(looked.u[0]).astype(int), 0, width - 1)
    counted = (looked.counted & looked.painted)[0]
    shown = [fits[counted & part[row, column]] for part in parts]
    return all(np.count_nonzero(one) >= TUNING.alike * usual * len(one) for one in shown)
