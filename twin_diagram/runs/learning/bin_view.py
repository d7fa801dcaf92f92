"""What lies in the bin, by one picture: points of things, the highest first."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.assets.building.depth_view import make_view
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.perception.segmentation.parting import part
from twin_diagram.planning.grasps import estimated_normals
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    above: float = 0.004
    """Height over the bin's bottom from which a point is a thing's [m]: thrice a good camera's noise there."""

    beside: float = 0.006
    """Distance from the bin's walls within which a point is theirs [m]."""

    least: int = 120
    """Pixels of the smallest thing: 1.5 cm square from 0.9 m."""

    noise: float = 0.001
    """Standard deviation of depth in the bin at the least [m]; it is that of the bottom in the picture."""

    certain: float = 4.0
    """Standard deviations over the bottom from which a point is a thing's, and from point to point a step."""

    bottom: float = 0.02
    """Within which of the bottom's height its points are looked for [m]."""

    few: int = 1000
    """Fewer points of the bottom do not tell its noise."""

    gap: float = 0.012
    """Step in depth at which one thing ends and another begins [m]."""

    directions: int = 24
    """In which a thing's width is looked at: every 7.5°."""

    border: int = 2
    """Pixels from the picture's border within which a thing is cut off by it: the outermost ones may have no depth."""

    longest: float = 0.2
    """How far what is cut off may go on beyond the picture's border [m]: the longest thing that a hand takes."""

    dense: float = 0.006
    """Between points that stand for what lies there [m], less than half of a finger's thickness."""

    some: int = 50
    """Points that tell which thing is meant: of 50 of which a third are a neighbour's, 1 % have them for most."""


TUNING = Tuning()


@dataclass(frozen=True)
class SeenThing:
    """Something that lies in a bin or stands on the platform, as one picture shows it.

    Attributes:
        points: (N, 3) in W, in random order [m].
        normals: (N, 3) towards the camera.
        pixels: (N, 2) row and column.
        viewpoint: (3,) where the camera was.
        beside: whether it lies on the table beside the bin.
        through: (M, 3) points of what it lies on that are seen through its holes.
        beyond: (K, 3) where it may go on beyond the picture's border, if that cuts it off; the nearest ones first.
    """

    points: Array
    normals: Array
    pixels: npt.NDArray[np.int64]
    viewpoint: Array
    beside: bool = False
    through: Array = field(default_factory=lambda: np.zeros((0, 3)))
    beyond: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def middle(self) -> Array:
        """(3,) of the box about it [m]."""
        return np.asarray((self.points.min(axis=0) + self.points.max(axis=0)) / 2)

    @property
    def some(self) -> Array:
        """(K, 3) few of its points, all over it [m]."""
        return self.points[: TUNING.some]

    @property
    def at(self) -> list[float]:
        """`middle` to millimetres, as lines tell it [m]."""
        return [round(float(value), 3) for value in self.middle]

    @property
    def top(self) -> float:
        """Height of its highest points [m]."""
        return float(np.quantile(self.points[:, 2], 0.98))


def things_within(
    picture: Picture, low: Array, high: Array, seed: int = 0, also: npt.NDArray[np.bool_] | None = None
) -> list[SeenThing]:
    """Return what a picture shows within a box, the highest first.

    Args:
        picture: of a camera that looks into it.
        low: (3,) lowest corner; its z is the bottom's upper side [m].
        high: (3,) highest corner; what stands out above it counts as well.
        seed: of the points' order.
        also: (H, W) which pixels count as well.
    """
    points = picture.points()
    inside = (points[..., :2] > low[:2] + TUNING.beside).all(-1) & (points[..., :2] < high[:2] - TUNING.beside).all(-1)
    inside = inside if also is None else inside | also
    return things_at(picture, inside & (picture.depth > 0), float(low[2]), seed)


def things_at(
    picture: Picture, there: npt.NDArray[np.bool_], support: float, seed: int = 0, *, beside: bool = False
) -> list[SeenThing]:
    """Return what stands out over a support among some pixels, the highest first.

    Args:
        picture: that shows it.
        there: (H, W) which pixels: with depth, of the support or of what lies on it.
        support: its height [m].
        seed: of the points' order.
        beside: whether that is the table beside the bin.
    """
    points = picture.points()
    noise = bottom_noise(points[there][:, 2] - support)
    above, gap = max(TUNING.above, TUNING.certain * noise), max(TUNING.gap, TUNING.certain * noise)
    depth = np.where(picture.depth > 0, picture.depth, 0).astype(np.float32)
    mask = there & (points[..., 2] > support + above)
    label, count = part(depth, mask, 1.0 / picture.camera.fx, noise, gap, TUNING.least)
    view = make_view(picture.camera, picture.depth, reach=1)
    normals = view.normals @ picture.camera.R_WC.T
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        own_mask = label == k
        rows = np.argwhere(own_mask)
        through = points[ndimage.binary_fill_holes(own_mask) & there & ~mask]
        rows = rows[rng.permutation(len(rows))]
        at = (rows[:, 0], rows[:, 1])
        # A rim is all edge, and has no normals of its own in the picture: its points' neighbours tell them.
        own, bare = normals[at], np.linalg.norm(normals[at], axis=1) < 0.5
        if bare.any():
            own = np.where(bare[:, None], estimated_normals(points[at], picture.camera.p_WC), own)
        beyond = beyond_border(picture.camera, rows, points[at], support)
        found.append(SeenThing(points[at], own, rows, picture.camera.p_WC, beside, through, beyond))
    return sorted(found, key=lambda thing: -thing.top)


def beyond_border(camera: ViewCamera, pixels: npt.NDArray[np.int64], points: Array, support: float) -> Array:
    """Return points (K, 3) where a thing may go on beyond the border of the picture, the nearest first; none: nowhere.

    Args:
        camera: of the picture.
        pixels: (N, 2) rows and columns of the thing.
        points: (N, 3) there in W [m].
        support: height of what it lies on [m].
    """
    found = []
    for axis, size in ((0, camera.height), (1, camera.width)):
        for cut, sign in ((pixels[:, axis] < TUNING.border, -1.0), (pixels[:, axis] >= size - TUNING.border, 1.0)):
            outwards = sign * camera.R_WC[:2, 1 - axis]
            if not cut.any() or np.linalg.norm(outwards) < 1e-6:
                continue
            outwards = outwards / np.linalg.norm(outwards)
            own = points[cut][np.argsort(-points[cut][:, 2], kind="stable")]
            own = own[np.unique(np.floor(own[:, :2] / TUNING.dense), axis=0, return_index=True)[1]]  # each the highest
            for x, y, top in own:
                far, z = np.meshgrid(
                    np.arange(TUNING.dense, TUNING.longest, TUNING.dense), np.arange(support, top, TUNING.dense)
                )
                place = np.array([x, y]) + far.reshape(-1, 1) * outwards
                found.append(np.column_stack([place, z.ravel(), far.ravel()]))
    if not found:
        return np.zeros((0, 3))
    every = np.concatenate(found)
    return np.asarray(every[np.argsort(every[:, 3], kind="stable"), :3])


def bottom_noise(heights: Array) -> float:
    """Return the standard deviation of depth [m], by heights (N,) over a bottom of what is seen there and upon it [m].

    It is told by what lies below the bottom: above it there are things.
    """
    below = -heights[(heights < 0.0) & (heights > -TUNING.bottom)]
    return max(TUNING.noise, 1.4826 * float(np.median(below))) if len(below) >= TUNING.few else TUNING.noise


def narrowest(thing: SeenThing) -> float:
    """Return the least width of a thing from above, over all directions [m]."""
    angles = np.arange(TUNING.directions) * (np.pi / TUNING.directions)
    along = thing.points[:, :2] @ np.stack([np.cos(angles), np.sin(angles)])
    return float((np.quantile(along, 0.99, axis=0) - np.quantile(along, 0.01, axis=0)).min())


def save_picture(path: Path, picture: Picture, thing: SeenThing | None, text: str) -> None:
    """Write a picture with a box about a thing and a line of text: what a report shows."""
    image = cv2.cvtColor(picture.rgb, cv2.COLOR_RGB2BGR)
    if thing is not None:
        (v0, u0), (v1, u1) = thing.pixels.min(axis=0) - 4, thing.pixels.max(axis=0) + 4
        cv2.rectangle(image, (int(u0), int(v0)), (int(u1), int(v1)), (40, 40, 230), 2)
    cv2.putText(
        image, text.encode("ascii", "replace").decode(), (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    good, data = cv2.imencode(".png", image)
    assert good
    path.write_bytes(data.tobytes())
