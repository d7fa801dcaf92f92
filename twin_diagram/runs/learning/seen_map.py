"""How well each part of an object's surface was seen, and which parts were not: a map of patches and voxels.

A patch of the surface is *seen* in a picture where it is within 0.8 m, less than 70° from its normal and not behind
anything; it counts as seen where two pictures show it. What no picture ever measured is found by carving: voxels that
some picture looks through are free, as are those within the hand; the border of what is left is the object's surface
or hides it (Kutulakos and Seitz 2000, "A theory of shape by space carving").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import cKDTree

from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.signals.arrays import Array

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    edge: float = 0.003
    """Of the voxels [m]: seven across a finger's pad."""

    room: float = 0.012
    """About the cloud in which what was not seen is looked for [m]."""

    behind: float = 0.004
    """What a picture measured so far behind a voxel's middle was looked at through it [m]: depth noise and an edge."""

    patch: float = 0.004
    """Edge of the cells in which the cloud's points are one patch, those of each facing apart [m]."""

    neighbours: int = 12
    """Of a point, by whose distance its share of the surface is told."""

    near: float = 0.007
    """Within this of the cloud, across it, the border of what was carved is the measured surface itself [m]."""

    aside: float = 0.003
    """The same along the surface [m]: the cloud has a point each 2 mm. With 7 mm that way, too, a strip as wide about
    what a finger hid, 20 mm wide, passed for measured, and cans and flasks for seen by 0.1 to 5 points more."""

    off: float = 0.006
    """By which the depth of a pixel may differ from that of the patch that it shows [m]."""

    farthest: float = 0.8
    """From the camera, beyond which a patch is not seen [m]."""

    slant: float = 70.0
    """Of the line of sight from the normal, from which on a patch is not seen [deg]."""

    frames: int = 2
    """Pictures that must show a patch."""

    smooth: float = 1.5
    """σ with which voxels are smoothed for the normals of their border [voxels]."""

    off_border: float = 0.0075
    """Along its normal, at which lines of sight from a patch begin [m]: clear of the voxels that it lies in."""

    directions: int = 128
    """Lines of sight from a patch, all about: 10° apart."""


TUNING = Tuning()


@dataclass(frozen=True)
class Voxels:
    """A grid of voxels: its lowest corner (3,) [m], edge [m], and which are not known to be free (X, Y, Z)."""

    low: Array
    edge: float
    full: Flags

    def middles(self, index: npt.NDArray[np.intp]) -> Array:
        """Return the middles (N, 3) of voxels by their numbers (N, 3) [m]."""
        return np.asarray(self.low + self.edge * (index + 0.5))

    def holds(self, points: Array) -> Flags:
        """Return which points (…, 3) lie in voxels that are not known to be free."""
        index = np.floor((points - self.low) / self.edge).astype(np.int64)
        inside: Flags = np.asarray(((index >= 0) & (index < self.full.shape)).all(axis=-1))
        index = np.where(inside[..., None], index, 0)
        return np.asarray(inside & self.full[index[..., 0], index[..., 1], index[..., 2]])


@dataclass(frozen=True)
class SeenMap:
    """Patches of an object's surface, and how well each was seen.

    Attributes:
        points: (N, 3) [m], with outward normals (N, 3).
        normals: of them.
        area: (N,) of each [m²].
        frames: (N,) pictures in which each was seen.
        distance: (N,) least from the camera in these [m]; inf: none.
        angle: (N,) least between normal and line of sight in these [rad]; inf: none.
        reachable: (N,) whether a camera somewhere about it would see it.
        voxels: what was carved.
    """

    points: Array
    normals: Array
    area: Array
    frames: npt.NDArray[np.int64]
    distance: Array
    angle: Array
    reachable: Flags
    voxels: Voxels

    @property
    def seen(self) -> Flags:
        """(N,) which of them count as seen."""
        return np.asarray(self.frames >= TUNING.frames)

    @property
    def missing(self) -> Flags:
        """(N,) which of them some pose would show and none did."""
        return np.asarray(self.reachable & ~self.seen)

    @property
    def seen_share(self) -> float:
        """Share of the surface seen, of what some pose would show."""
        whole = float(self.area[self.reachable | self.seen].sum())
        return float(self.area[self.seen].sum()) / whole if whole > 0.0 else 0.0


def seen_map(points: Array, normals: Array, frames: Sequence[RgbdFrame], hands: Sequence[Boxes] = ()) -> SeenMap:
    """Return how well an object's surface was seen.

    Args:
        points: (N, 3) of its cloud in S [m], with outward normals (N, 3).
        normals: of them.
        frames: pictures with their cameras' poses in S, and masks of the object.
        hands: where the hand was, a grasp each.
    """
    voxels = carved(points, frames, hands)
    measured = _patches(points, normals)
    gaps = _gaps(voxels, points)
    where, outward = (np.concatenate(rows) for rows in zip(measured[:2], gaps[:2], strict=True))
    count, distance, angle = looked_at(where, outward, frames)
    # What was never measured is there only if something is seen of it.
    reachable = np.concatenate([np.ones(len(measured[0]), dtype=bool), sights(voxels, *gaps[:2]).any(axis=1)])
    return SeenMap(
        where, outward, np.concatenate([measured[2], gaps[2]]), count, distance, angle, reachable, voxels
    )  # fmt: skip


def carved(points: Array, frames: Sequence[RgbdFrame], hands: Sequence[Boxes]) -> Voxels:
    """Return the voxels about a cloud (N, 3) that no picture looks through, and no hand fills."""
    low, high = points.min(axis=0) - TUNING.room, points.max(axis=0) + TUNING.room
    shape = np.ceil((high - low) / TUNING.edge).astype(int)
    full = Voxels(low, TUNING.edge, np.ones(tuple(shape), dtype=bool))
    left = np.argwhere(full.full)
    for frame in frames:
        z, depth = _depths(full.middles(left), frame)[:2]
        left = left[~(depth > z + TUNING.behind)]
    for hand in hands:
        left = left[~hand.hold(full.middles(left))]
    kept = np.zeros(tuple(shape), dtype=bool)
    kept[tuple(left.T)] = True
    return Voxels(low, TUNING.edge, kept)


def sights(voxels: Voxels, points: Array, normals: Array, slant: float = TUNING.slant) -> Flags:
    """Return (N, D) which directions of `all_about` are open from patches, less slanted than that to their normals."""
    directions = all_about(TUNING.directions)
    begin = points + TUNING.off_border * normals
    steps = np.arange(1, int(np.linalg.norm(voxels.full.shape)) + 1) * voxels.edge
    patch, way = np.nonzero(normals @ directions.T > np.cos(np.deg2rad(slant)))
    going = np.ones(len(patch), dtype=bool)
    high = voxels.low + voxels.edge * np.array(voxels.full.shape)
    active = np.arange(len(patch))
    for step in steps:
        at = begin[patch[active]] + step * directions[way[active]]
        met = voxels.holds(at)
        going[active[met]] = False
        active = active[~met & ((at > voxels.low) & (at < high)).all(axis=1)]
        if not len(active):
            break
    found = np.zeros((len(points), len(directions)), dtype=bool)
    found[patch, way] = going
    return found


def all_about(count: int) -> Array:
    """Return unit vectors (count, 3) evenly all about, on a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _patches(points: Array, normals: Array) -> tuple[Array, Array, Array]:
    """Return middles, normals (P, 3) and areas (P,) of a cloud's patches: points of one cell that face alike."""
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (normals[np.arange(len(axis)), axis] > 0.0)
    key = np.column_stack([np.floor(points / TUNING.patch).astype(np.int64), facing])
    _, of, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    of = of.reshape(-1)
    # A point's share of the surface, by how far off its neighbours are: the cloud is not equally dense everywhere.
    k = min(TUNING.neighbours, len(points) - 1)
    around = cKDTree(points).query(points, k=k + 1)[0][:, -1]
    sums = np.zeros((len(count), 7))
    np.add.at(sums, of, np.column_stack([points, normals, np.pi * around**2 / max(k, 1)]))
    outward = sums[:, 3:6] / np.linalg.norm(sums[:, 3:6], axis=1, keepdims=True)
    return sums[:, :3] / count[:, None], outward, sums[:, 6]


def _gaps(voxels: Voxels, points: Array) -> tuple[Array, Array, Array]:
    """Return middles, normals (G, 3) and areas (G,) of the carved border where nothing was measured."""
    padded = np.pad(voxels.full, 1)
    border = padded & ~ndimage.binary_erosion(padded)
    smooth = ndimage.gaussian_filter(padded.astype(np.float32), TUNING.smooth)
    index = np.argwhere(border)
    slope = -np.stack([part[tuple(index.T)] for part in np.gradient(smooth)], axis=1)
    middle, length = voxels.middles(index - 1), np.linalg.norm(slope, axis=1)
    middle, outward = middle[length > 1e-6], slope[length > 1e-6] / length[length > 1e-6, None]
    kept = ~_measured(middle, outward, points)
    middle, outward = middle[kept], outward[kept]
    return middle, outward, voxels.edge**2 / np.maximum(np.abs(outward).max(axis=1), 1e-9)


def _measured(border: Array, outward: Array, points: Array) -> Flags:
    """Return which places (B, 3) of a border, with normals (B, 3), have points (N, 3) of the cloud below or above."""
    pairs = cKDTree(border).sparse_distance_matrix(cKDTree(points), TUNING.near, output_type="ndarray")
    off = points[pairs["j"]] - border[pairs["i"]]
    across = np.einsum("ni,ni->n", off, outward[pairs["i"]])
    found = np.zeros(len(border), dtype=bool)
    found[pairs["i"][np.einsum("ni,ni->n", off, off) - across**2 < TUNING.aside**2]] = True
    return found


def looked_at(points: Array, normals: Array, frames: Sequence[RgbdFrame]) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Return in how many pictures patches are seen, and their least distance and angle in these (N,)."""
    count = np.zeros(len(points), dtype=np.int64)
    nearest, straightest = np.full(len(points), np.inf), np.full(len(points), np.inf)
    for frame in frames:
        z, depth, shown = _depths(points, frame)
        line = frame.camera.p_WC - points
        distance = np.linalg.norm(line, axis=1)
        angle = np.arccos(np.clip(np.einsum("ni,ni->n", line, normals) / distance, -1.0, 1.0))
        good = shown & (np.abs(depth - z) < TUNING.off) & (distance < TUNING.farthest)
        good &= angle < np.deg2rad(TUNING.slant)
        count += good
        nearest = np.where(good, np.minimum(nearest, distance), nearest)
        straightest = np.where(good, np.minimum(straightest, angle), straightest)
    return count, nearest, straightest


def _depths(points: Array, frame: RgbdFrame) -> tuple[Array, Array, Flags]:
    """Return points' depth (N,), that of their pixels [m], 0 where none is, and whether these show the object."""
    u, v, z = frame.camera.project(points)
    column, row = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
    height, width = frame.depth.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (z > 0.0)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    depth = np.where(inside, frame.depth[row, column], 0.0)
    shown = inside if frame.mask is None else inside & frame.mask[row, column]
    return z, depth, np.asarray(shown)
