"""Depth images fused into a signed distance on a grid, that keeps thin walls and cavities.

A truncated signed distance (Curless and Levoy, 1996) with three differences:

- Distances are measured across the surface, not along the ray: times the cosine of incidence.
- Behind the surface a view speaks only as deep as its noise makes necessary; so the far side of a thin wall is left to
  the views that see it. Inside is what no view has looked through.
- Rays that pass far in front are votes for free space and never averaged with distances: averaged, they move surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.view import Map, View
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

    free_votes: float = 2.0
    """How many views must look through a place for each unit of weight that says it lies just below a surface."""

    least_free: float = 1.5
    """How many views must look through a place that nothing else is known of before it is outside."""


TUNING = Tuning()


@dataclass(frozen=True)
class Grid:
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
    def around(low: Array, high: Array, voxel: float, margin: float) -> Grid:
        """Return the grid that covers a box [m] and a margin around it [m]."""
        count = np.ceil((high - low + 2 * margin) / voxel).astype(int) + 1
        return Grid(low - margin, voxel, (int(count[0]), int(count[1]), int(count[2])))

    def axes(self) -> list[Array]:
        """Return the coordinates along each axis [m]."""
        return [self.origin[k] + self.voxel * np.arange(self.shape[k]) for k in range(3)]

    def points(self) -> Array:
        """Return (nx, ny, nz, 3) [m]."""
        return np.stack(np.meshgrid(*self.axes(), indexing="ij"), axis=-1)


@dataclass(frozen=True)
class Fused:
    """A field over a grid.

    Attributes:
        grid: where.
        distance: (nx, ny, nz) signed distance, positive outside, within the truncation [m].
        weight: (nx, ny, nz) how much near-surface evidence there is; 0 where only rays passed, or none.
        known: (nx, ny, nz) whether any view told anything of the place.
    """

    grid: Grid
    distance: Map
    weight: Map
    known: npt.NDArray[np.bool_]


def fuse(views: Sequence[View], grid: Grid, noise: float, plane: Array | None = None) -> Fused:
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
    for view in views:
        _add(view, grid, front, behind, total, weight, free)
    near = weight > 0
    distance = np.where(near, total / np.maximum(weight, 1e-6), -front).astype(np.float32)
    # Looked through by far more than saw something just in front of it: free, as far in as such votes go.
    through = np.where(near, free > TUNING.free_votes * weight, free > TUNING.least_free)
    distance = np.where(through & (distance < 0), front, distance)
    if plane is not None:
        height = sum(np.moveaxis(plane[k] * axis[None, None, :], 2, k) for k, axis in enumerate(grid.axes())) - plane[3]
        distance = np.maximum(distance, np.clip(-height, -front, front))
    return Fused(grid, distance.astype(np.float32), weight, near | (free > TUNING.least_free))


def _add(view: View, grid: Grid, front: float, behind: float, total: Map, weight: Map, free: Map) -> None:
    """Add what one view says of each point of the grid."""
    u, v, z = _projected(view, grid)
    camera = view.camera
    inside = (u > -0.5) & (v > -0.5) & (u < camera.width - 0.5) & (v < camera.height - 0.5) & (z > 1e-3)
    at = np.flatnonzero(inside)
    pixel = np.rint(v.reshape(-1)[at]).astype(np.int32) * camera.width + np.rint(u.reshape(-1)[at]).astype(np.int32)
    seen = _plane_depth(view, u.reshape(-1)[at], v.reshape(-1)[at], pixel)
    ahead = seen - z.reshape(-1)[at]
    trust = view.trust.reshape(-1)[pixel]
    slant = _across(view).reshape(-1)[pixel]
    d = ahead * slant
    band = (trust > 0) & (d > -behind) & (d < front)
    ramp = np.clip(2.0 * (1.0 + d / behind), 0.0, 1.0)  # half as deep as it speaks, a view begins to fall silent
    w = np.where(band, trust * ramp, 0).astype(np.float32)
    weight.reshape(-1)[at] += w
    total.reshape(-1)[at] += w * d
    clear = ~view.near_edge.reshape(-1)[pixel] & (view.depth.reshape(-1)[pixel] > 0)
    free.reshape(-1)[at] += (clear & (ahead > front) & ~band).astype(np.float32)


def _plane_depth(view: View, u: Map, v: Map, pixel: npt.NDArray[np.int32]) -> Map:
    """Return the depth at fractional pixels: bilinear between four neighbours of one surface, else that of the nearest."""
    width, height = view.camera.width, view.camera.height
    flat = view.depth.reshape(-1)
    nearest = flat[pixel]
    u0, v0 = np.floor(u), np.floor(v)
    fu, fv = u - u0, v - v0
    corner = np.clip(v0, 0, height - 2).astype(np.int32) * width + np.clip(u0, 0, width - 2).astype(np.int32)
    d00, d01, d10, d11 = flat[corner], flat[corner + 1], flat[corner + width], flat[corner + width + 1]
    mixed = (d00 * (1 - fu) + d01 * fu) * (1 - fv) + (d10 * (1 - fu) + d11 * fu) * fv
    smooth = (view.trust.reshape(-1)[pixel] > 0) & (np.abs(mixed - nearest) < 0.003)
    return np.where(smooth, mixed, nearest)


def _across(view: View) -> Map:
    """Return (h, w): distance across the surface per distance along the optical axis, −n·r of the ray r at depth 1 m."""
    rays = view.camera.rays().astype(np.float32)
    return np.clip(-np.einsum("hwi,hwi->hw", view.normals, rays), 0.05, None).astype(np.float32)


def _projected(view: View, grid: Grid) -> tuple[Map, Map, Map]:
    """Return u, v [pixel] and depth z [m] of every point, (nx, ny, nz) each, from sums of what each axis adds."""
    camera = view.camera
    R_CW = camera.R_WC.T
    origin = -R_CW @ camera.p_WC
    axes = grid.axes()
    parts = []
    for row in range(3):
        x, y, z = (np.float32(1) * (R_CW[row, k] * axes[k]).astype(np.float32) for k in range(3))
        parts.append((x + np.float32(origin[row]))[:, None, None] + (y[:, None] + z[None, :])[None])
    X, Y, Z = parts
    safe = np.where(Z > 1e-3, Z, np.float32(1))
    return X / safe * np.float32(camera.fx) + np.float32(camera.cx), Y / safe * np.float32(camera.fy) + np.float32(camera.cy), Z
