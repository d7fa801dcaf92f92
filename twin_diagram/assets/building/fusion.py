"""Depth images fused into a signed distance on a grid, that keeps thin walls and cavities.

A truncated signed distance (Curless and Levoy, 1996) with three differences:

- Distances are measured across the surface, not along the ray: times the cosine of incidence.
- Behind the surface a view speaks only as deep as its noise makes necessary; so the far side of a thin wall is left to
  the views that see it. Inside is what no view has looked through.
- Rays that pass far in front are votes for free space and never averaged with distances: averaged, they move surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.assets.building.cube_scale import Cube
from twin_diagram.assets.building.depth_view import DepthView, Map
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the fusion; what they do shows in `sims/benchmarks/reconstruction.py`."""

    front: float = 3.5
    """Truncation in front of the surface, in voxels or standard deviations of depth, whichever is more."""

    behind: float = 2.0
    """Truncation behind it, likewise."""

    behind_at_most: float = 0.003
    """Largest truncation behind the surface [m]: walls are kept down to about this thickness at worst."""

    in_front: float = 0.3
    """What a view's distance counts farther in front of the surface than it speaks behind it."""

    free_votes: float = 2.0
    """How many views must look through a place for each unit of weight that says it lies just below a surface."""

    foot: float = 2.0
    """Height up to which what does not rise above it is the support's noise [standard deviations of depth], …"""

    thinnest: float = 0.002
    """… at least [m], as of a fine grid: a pan's floor of 3 mm must stay, also on a coarse grid, …"""

    foot_voxels: float = 2.0
    """… and at most [voxels]."""

    same_surface: float = 0.003
    """Depth that differs less from its neighbours' is interpolated between them [m]."""

    slab: int = 32_768
    """Points that are worked on at a time."""

    edge_votes: float = 0.8
    """What a ray beside an edge counts of such a vote: two of them do."""

    least_free: float = 1.5
    """How many views must look through a place that nothing else is known of before it is outside, …"""

    least_weight: float = 0.03
    """Weight up to which a place counts as unknown, though it should lie inside: that of one pixel beside an edge."""

    share_free: float = 0.075
    """… or, of few views, this share of them: with eight, a place in a mug is looked through by one, beside an edge."""

    gainsaid: float = 0.10
    """Rays beside edges alone must be more than this share of the views that show a surface in front of the place. Of a
    box in a hand before a D415 up to 8 of 70 views had such rays, and none a sure one, pass through what 60 and more
    showed to lie within: layers of nothing lay under its sides. Where fingers were, seldom looked at, 27 views showed
    something in front, and 0.12 filled it (`sims/benchmarks/real2sim_tables.py`, seed 10, one object)."""


TUNING = Tuning()


@dataclass(frozen=True)
class FusionGrid:
    """A regular grid: point (i, j, k) lies at `origin + voxel · (i, j, k)`, axes of W.

    Attributes:
        origin: (3,) [m].
        voxel: distance of neighbours [m].
        shape: points along each axis.
    """

    origin: Array
    voxel: float
    shape: tuple[int, int, int]

    @staticmethod
    def around(low: Array, high: Array, voxel: float, margin: float) -> FusionGrid:
        """Return the grid that covers a box [m] and a margin around it [m]."""
        count = np.ceil((high - low + 2 * margin) / voxel).astype(int) + 1
        return FusionGrid(low - margin, voxel, (int(count[0]), int(count[1]), int(count[2])))

    def axes(self) -> list[Array]:
        """Return the coordinates along each axis [m]."""
        return [self.origin[k] + self.voxel * np.arange(self.shape[k]) for k in range(3)]

    def points(self) -> Array:
        """Return (nx, ny, nz, 3) [m]."""
        return np.stack(np.meshgrid(*self.axes(), indexing="ij"), axis=-1)


@dataclass(frozen=True)
class DistanceField:
    """A field over a grid.

    Attributes:
        grid: where.
        distance: (nx, ny, nz) signed distance, positive outside, within the truncation [m].
        weight: (nx, ny, nz) how much near-surface evidence there is; 0 where only rays passed, or none.
        known: (nx, ny, nz) whether any view told anything of the place.
    """

    grid: FusionGrid
    distance: Map
    weight: Map
    known: npt.NDArray[np.bool_]


def fuse(views: Sequence[DepthView], grid: FusionGrid, noise: float, plane: Array | None = None) -> DistanceField:
    """Return the signed distance to what views saw.

    Args:
        views: at their best known poses.
        grid: where it is wanted.
        noise: standard deviation of a depth pixel at the object [m]; sets the truncation.
        plane: (4,) unit normal n, up, and offset d of the support: n·p = d in W; what lies below it is outside.

    Returns:
        Where no view has looked, the inside: what was never seen is not carved.
    """
    front = TUNING.front * max(grid.voxel, noise)
    behind = min(TUNING.behind * max(grid.voxel, noise), max(TUNING.behind_at_most, 1.5 * grid.voxel))
    total = np.zeros(grid.shape, np.float32)
    weight = np.zeros(grid.shape, np.float32)
    free = np.zeros(grid.shape, np.float32)
    votes = np.zeros(grid.shape, np.float32)
    clearly, within = np.zeros(grid.shape, np.float32), np.zeros(grid.shape, np.float32)
    for view in views:
        _add(view, grid, front, behind, total, weight, free, votes, clearly, within)
    near = (weight > TUNING.least_weight) | (total > 0)
    distance = np.where(near, total / np.maximum(weight, 1e-6), -front).astype(np.float32)
    # Looked through by far more than saw something just in front of it: free, as far in as such votes go.
    least = min(TUNING.least_free, TUNING.share_free * len(views))
    empty = (clearly > least) | ((free > least) & (free > TUNING.gainsaid * within))
    through = np.where(weight > TUNING.least_weight, votes > TUNING.free_votes * weight, empty)
    distance = np.where(through & ((distance < 0) | (weight <= TUNING.least_weight)), front, distance)
    if plane is not None:
        distance = _cut_off(distance, grid, plane, front, noise)
    return DistanceField(grid, distance.astype(np.float32), weight, near | empty)


def without(field: DistanceField, cube: Cube) -> DistanceField:
    """Return a field in which a cube is outside: where it stands nothing else is, though no view looks in there."""
    return _less(field, (field.grid.points() - cube.centre) @ cube.axes.T, np.full(3, cube.edge / 2))


def without_hand(field: DistanceField, hand: Boxes, within: float) -> DistanceField:
    """Return a field in which a hand's boxes are outside, but for their outermost layer of a thickness `within` [m]."""
    points = (field.grid.points() - hand.X_ST[:3, 3]) @ hand.X_ST[:3, :3]
    for low, high in zip(hand.low, hand.high, strict=True):
        field = _less(field, points - 0.5 * (low + high), 0.5 * (high - low) - within)
    return field


def without_remains(field: DistanceField) -> DistanceField:
    """Return a field less what no view told anything of and is thinner than an inside that none can tell of.

    Views tell of the first voxels below what they see: where they tell nothing, those around are inside, too. What is
    not so is a corner beside a hand's boxes into which nobody could look in any grasp.
    """
    radius = round(TUNING.behind)
    ball = np.linalg.norm(np.indices((2 * radius + 1,) * 3) - radius, axis=0) < radius
    solid = field.distance < 0.0
    gone = solid & ~field.known & ~ndimage.binary_opening(solid, ball)
    return replace(field, distance=np.where(gone, np.float32(0.5 * field.grid.voxel), field.distance))


def _less(field: DistanceField, points: Array, half: Array) -> DistanceField:
    """Return a field less a box: `points` (nx, ny, nz, 3) of the grid in its frame, `half` (3,) of its edges [m]."""
    reach = float(np.abs(field.distance).max())
    inside = np.clip((half - np.abs(points)).min(axis=-1), -reach, reach)
    return replace(field, distance=np.maximum(field.distance, inside).astype(np.float32))


def _cut_off(distance: Map, grid: FusionGrid, plane: Array, front: float, noise: float) -> Map:
    """Return the distance without what lies below the support, and without sheets that the support's own noise leaves.

    Just above the support only that is inside which rises above its noise: a place's distance there is at least that of
    the place above it where that ends, which changes nothing at upright sides, nor below floors, however thin.
    """
    height = sum(np.moveaxis(plane[k] * axis[None, None, :], 2, k) for k, axis in enumerate(grid.axes())) - plane[3]
    foot = min(max(TUNING.foot * noise, TUNING.thinnest), TUNING.foot_voxels * grid.voxel)
    at = np.argwhere(height < foot)
    above = at + (foot - height[tuple(at.T)])[:, None] * plane[:3] / grid.voxel
    higher = ndimage.map_coordinates(distance, above.T, order=1, mode="nearest")
    distance = distance.copy()
    distance[tuple(at.T)] = np.maximum(distance[tuple(at.T)], higher)
    return np.asarray(np.maximum(distance, np.clip(-height, -front, front)), dtype=np.float32)


def _add(
    view: DepthView,
    grid: FusionGrid,
    front: float,
    behind: float,
    total: Map,
    weight: Map,
    free: Map,
    votes: Map,
    clearly: Map,
    within: Map,
) -> None:
    """Add what one view says of each point of the grid, slab by slab: what is at work at a time stays in the cache."""
    camera = view.camera
    clear = (~view.near_edge & (view.depth > 0)).astype(np.float32)
    told = np.dstack([view.depth, view.trust, view.across, clear])
    size = grid.shape[1] * grid.shape[2]
    slab = max(1, TUNING.slab // size)
    R_CW = camera.R_WC.T
    start = R_CW @ (grid.origin - camera.p_WC)
    step = R_CW * grid.voxel
    index = [np.arange(n, dtype=np.float32) for n in grid.shape]
    flat = [
        (np.float32(step[k, 1]) * index[1][:, None] + np.float32(step[k, 2]) * index[2] + np.float32(start[k])).ravel()
        for k in range(3)
    ]
    for first in range(0, grid.shape[0], slab):
        x, y, z = (np.float32(step[k, 0]) * index[0][first : first + slab, None] + flat[k] for k in range(3))
        # OpenCV looks no more than 32,766 places up in a row, and a thing that stands on edge has more in a slab.
        x, y, z = (part.reshape(-1, grid.shape[2]) for part in (x, y, z))
        np.maximum(z, np.float32(1e-3), out=z)
        u = x / z * np.float32(camera.fx) + np.float32(camera.cx)
        v = y / z * np.float32(camera.fy) + np.float32(camera.cy)
        nearest = cv2.remap(told, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        mixed = cv2.remap(view.depth, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        depth, trust, across, sure = (nearest[..., k] for k in range(4))
        smooth = (trust > 0) & (np.abs(mixed - depth) < TUNING.same_surface)
        ahead = np.where(smooth, mixed, depth) - z
        d = ahead * across
        band = (trust > 0) & (d > -behind) & (d < front)
        # Half as deep as it speaks, a view begins to fall silent, and as far in front to speak low: were it louder
        # there, noise would move surfaces inwards.
        low = np.where(d > 0, np.float32(TUNING.in_front), np.float32(0.0))
        w = np.where(band, trust * np.clip(2.0 * (1.0 - np.abs(d) / behind), low, 1.0), 0)
        at = slice(first, first + slab)
        weight[at] += w.reshape(-1, *grid.shape[1:])
        total[at] += (w * d).reshape(-1, *grid.shape[1:])
        within[at] += ((trust > 0) & (d < -behind)).reshape(-1, *grid.shape[1:])
        through = (ahead > front) & ~band
        # Beside edges a ray may be off to either side: enough where nothing else is known, not against what was seen.
        free[at] += np.where(through & (depth > 0), np.maximum(sure, TUNING.edge_votes), 0).reshape(-1, *grid.shape[1:])
        clearly[at] += np.where(through & (depth > 0), sure, 0).reshape(-1, *grid.shape[1:])
        votes[at] += np.where(through, np.float32(view.vote) * sure, 0).reshape(-1, *grid.shape[1:])
