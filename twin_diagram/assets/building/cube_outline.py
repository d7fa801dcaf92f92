"""A cube's edge from its outline: how large it looks in each view, against how large a cube there would.

Depth that is bent by a millimetre moves faces of a cube of 50 mm by 2 %, but changes how large it looks by a fraction
of that: an outline's width is its angle times the distance, and the distance is half a metre. Where in a view the
outline lies does not matter, so poses hardly do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.assets.building.cube_scale import Cube, is_green
from twin_diagram.assets.building.depth_view import DepthView, Mask
from twin_diagram.assets.building.view_poses import TUNING as POSES
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the comparison."""

    least_pixels: float = 100.0
    """Smaller outlines are blurred by their pixels [pixel²]."""

    margin: int = 6
    """Pixels about the outline that are looked at; nearer to a picture's border it may be cut off."""

    unlike: float = 0.12
    """Share of the outline that may be missing or too much after its size is fitted: hidden ones lack more."""

    blurred: int = 2
    """How far inside of an outline its colour is mixed with what is beside it [pixel]; one more outside."""

    pixels: float = 0.35
    """Standard deviation of where an outline's opposite sides lie together [pixel]: blur, shade, grid."""

    green_behind: float = 0.4
    """Of what is green, by more than this share of the cube's, behind an outline each pixel counts whole."""


TUNING = Tuning()


def outlined_edges(views: Sequence[DepthView], cube: Cube) -> tuple[Array, Array]:
    """Return the edge that each view's outline tells, and its variance; only of views that show the cube whole.

    Args:
        views: with colours, at refined poses.
        cube: as far as it is known: to within a tenth of its edge.

    Returns:
        Edges (m,) and variances (m,), in the unit of the cube's edge.
    """
    edges, variances = [], []
    for view in views:
        found = _looks(view, cube)
        if found is None:
            continue
        ratio, width = found
        distance = float(np.linalg.norm(view.camera.p_WC - cube.centre))
        share = np.hypot(TUNING.pixels / width, POSES.prior_translation / distance)
        edges.append(cube.edge * ratio)
        variances.append((cube.edge * share) ** 2)
    return np.array(edges), np.array(variances)


def _corners(cube: Cube) -> Array:
    sign = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return cube.centre + cube.edge / 2 * sign @ cube.axes


def _looks(view: DepthView, cube: Cube) -> tuple[float, float] | None:
    """Return how large the cube looks, as a share of what is expected, and its width [pixel]; None where hidden."""
    u, v, z = view.camera.project(_corners(cube))
    if (z <= 0).any() or view.rgb is None:
        return None
    hull = cv2.convexHull(np.stack([u, v], axis=1).astype(np.float32))[:, 0].astype(float)
    expected = float(cv2.contourArea(hull.astype(np.float32)))
    margin = TUNING.margin + int(0.3 * np.sqrt(max(expected, 0.0)))
    low, high = np.floor(hull.min(axis=0)).astype(int) - margin, np.ceil(hull.max(axis=0)).astype(int) + margin
    height, width = view.rgb.shape[:2]
    low, high = np.maximum(low, 0), np.minimum(high, [width - 1, height - 1])
    if expected < TUNING.least_pixels or (high - low < 8).any():
        return None
    shown = view.rgb[low[1] : high[1] + 1, low[0] : high[0] + 1] / 255.0
    inside = _raster(hull - low, shown.shape[:2])
    green = _at(is_green(shown), inside)
    if green is None or _at_border(green, low, (width, height)):
        return None
    if green[[0, -1]].any() or green[:, [0, -1]].any():  # what is behind it, such as the table, is green too
        return None
    share = _covered(shown, green)
    ratio = float(np.sqrt(share.sum() / expected))
    middle = np.array([(share * grid).sum() for grid in np.indices(share.shape)][::-1]) / share.sum()
    centre = _centroid(hull - low)
    like = _raster((hull - low - centre) * ratio + middle, shown.shape[:2])
    different = float(np.abs(like - share).sum() / share.sum())
    return (ratio, float(np.sqrt(expected))) if different < TUNING.unlike else None


def _at(green: Mask, inside: npt.NDArray[np.float64]) -> Mask | None:
    """Return the connected green thing that covers most of the place where it is expected."""
    label, count = ndimage.label(green)
    if not count:
        return None
    sizes = np.bincount(label[inside > 0.5], minlength=count + 1)
    sizes[0] = 0
    return ndimage.binary_fill_holes(label == int(np.argmax(sizes))) if sizes.any() else None


def _at_border(green: Mask, low: Array, size: tuple[int, int]) -> bool:
    rows, columns = np.nonzero(green)
    left, top = columns.min() + low[0], rows.min() + low[1]
    right, bottom = columns.max() + low[0], rows.max() + low[1]
    return bool(min(left, top) < 2 or right > size[0] - 3 or bottom > size[1] - 3)


def _covered(shown: Array, green: Mask) -> npt.NDArray[np.float64]:
    """Return (h, w), what share of each pixel the green thing covers: 0 or 1, but for pixels at its outline.

    Those are mixed of how green it is nearest inside and outside.
    """
    box = np.ones((3, 3), np.uint8)
    core = cv2.erode(green.astype(np.uint8), box, iterations=TUNING.blurred) > 0
    beyond = cv2.dilate(green.astype(np.uint8), box, iterations=TUNING.blurred + 1) == 0
    if not core.any() or not beyond.any():
        return green.astype(float)
    _, own = ndimage.distance_transform_edt(~core, return_indices=True)
    _, other = ndimage.distance_transform_edt(~beyond, return_indices=True)
    hue = shown[..., 1] - (shown[..., 0] + shown[..., 2]) / 2  # light and dark of what is grey have the same: none
    near, far = hue[tuple(own)], hue[tuple(other)]
    mixed = np.clip((hue - far) / np.maximum(near - far, 0.05), 0.0, 1.0)
    # Before what is nearly as green, such as a cyan table, hue tells no shares.
    mixed = np.where(far < TUNING.green_behind * near, mixed, green)
    return np.where(core, 1.0, np.where(beyond, 0.0, mixed))


def _raster(hull: Array, size: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Return (h, w), what share of each pixel a convex polygon covers, to a sixteenth."""
    fine = 4
    big = np.zeros((size[0] * fine, size[1] * fine), np.uint8)
    # Pixel i spans i − ½ to i + ½: its fine ones have their centres at (i − ½) + (j + ½)/fine.
    at = (hull + 0.5) * fine - 0.5
    cv2.fillConvexPoly(big, np.rint(at * 256).astype(np.int32), 1, shift=8)
    return np.asarray(big.reshape(size[0], fine, size[1], fine).mean(axis=(1, 3)), dtype=float)


def _centroid(hull: Array) -> Array:
    m = cv2.moments(hull.astype(np.float32).reshape(-1, 1, 2))
    return np.array([m["m10"], m["m01"]]) / m["m00"]
