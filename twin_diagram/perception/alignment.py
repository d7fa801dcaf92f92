"""Brings a camera's images onto one grid without distortion: that of the colours.

Depth from a grid of its own is warped point by point, the nearest point wins (a z-buffer); each point covers as many
colour pixels as its own pixel is wide there, so that a finer grid gets no holes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import ColourImage, DepthImage, Pinhole
from twin_diagram.scenario import Camera
from twin_diagram.scenario.lenses import depth_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.between_pixels import depth_between
from twin_diagram.signals.lens import Lens, straightening, unit_rays


@dataclass(frozen=True)
class Tuning:
    """Constants of the warp, with what set them."""

    nearest: float = 0.01
    """Depth below this is none [m]."""

    overlap: float = 1.1
    """Width of a point's footprint beside its pixel's: neighbours on a surface that turns away still touch."""


TUNING = Tuning()


@dataclass(frozen=True)
class DepthGrid:
    """A depth camera of its own, ready to be warped onto the grid of the colours.

    Attributes:
        rays: (H, W, 3), its third axis outermost in memory, in the colour camera's frame, from the depth camera to the
            points at depth `scale`.
        p_CD: (3,) where the depth camera is in the colour camera's frame [m].
        target: lens of the grid, without distortion.
        half: half the width and height of a point's footprint [px].
    """

    rays: npt.NDArray[np.float32]
    p_CD: npt.NDArray[np.float32]
    target: Lens
    half: tuple[float, float]

    @staticmethod
    def of(lens: Lens, R_CD: Array, p_CD: Array, target: Lens, scale: float = 1.0) -> DepthGrid:
        """Return the grid of a depth camera.

        Args:
            lens: the depth camera's.
            R_CD: (3, 3) its axes in the colour camera's frame.
            p_CD: (3,) its place there [m].
            target: the colour camera's lens.
            scale: what depth is multiplied by to become metres.
        """
        planes = np.moveaxis(scale * unit_rays(lens) @ R_CD.T, -1, 0)
        rays = np.moveaxis(np.ascontiguousarray(planes, dtype=np.float32), 0, -1)
        half = (max(1.0, TUNING.overlap * f / own) / 2.0 for f, own in ((target.fx, lens.fx), (target.fy, lens.fy)))
        return DepthGrid(rays, np.asarray(p_CD, dtype=np.float32), target.straight, (next(half), next(half)))

    def points(self, depth: DepthImage) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Return the points (N, 3) [m] of a depth image in the colour camera's frame, and which pixels they are of."""
        with np.errstate(invalid="ignore"):
            there = np.isfinite(depth) & (depth > 0.0)
        return depth[there][:, None] * self.rays[there] + self.p_CD, there

    def warped(self, depth: DepthImage) -> DepthImage:
        """Return the depth (H, W) [m] on the colours' grid, 0 where none is known."""
        lens = self.target
        with np.errstate(invalid="ignore"):
            depth = np.where(depth < np.inf, depth, np.float32(0.0))  # not a number is no depth either
        x, y, z = (depth * self.rays[..., k] + self.p_CD[k] for k in range(3))
        known = (depth > 0.0) & (z > TUNING.nearest)
        over = np.float32(1.0) / np.where(known, z, np.float32(1.0))
        low_u, high_u = _covered(x * over * np.float32(lens.fx) + np.float32(lens.cx), self.half[0], lens.width)
        low_v, high_v = _covered(y * over * np.float32(lens.fy) + np.float32(lens.cy), self.half[1], lens.height)
        z = np.where(known, z, np.float32(np.inf)).ravel()
        nearest = np.full((lens.height + 2) * (lens.width + 2), np.inf, dtype=np.float32)
        wide = lens.width + 2
        first = (low_v * wide + low_u).ravel().astype(np.intp)
        np.minimum.at(nearest, first, z)
        # Points that cover more than one pixel: few, where the grids are alike.
        more = np.flatnonzero(((high_u > low_u) | (high_v > low_v)).ravel())
        first, z, du, dv = (a[more] for a in (first, z, (high_u - low_u).ravel(), (high_v - low_v).ravel()))
        for k in range(int(2.0 * self.half[1]) + 1):
            for j in range(int(2.0 * self.half[0]) + 1):
                there = (du >= j) & (dv >= k)
                np.minimum.at(nearest, first[there] + (k * wide + j), z[there])
        nearest[np.isinf(nearest)] = 0.0
        return np.ascontiguousarray(nearest.reshape(lens.height + 2, wide)[1:-1, 1:-1])


def _covered(
    at: npt.NDArray[np.float32], half: float, size: int
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return the first and last pixel within `half` of places `at`, counted from a rim of one for all beyond."""
    low, high = np.ceil(at - np.float32(half)), np.floor(at + np.float32(half))
    return tuple(np.clip(edge + 1.0, 0, size + 1).astype(np.int32) for edge in (low, high))  # type: ignore[return-value]


@dataclass(frozen=True)
class Alignment:
    """Takes images as they are delivered to images of one camera without distortion.

    Attributes:
        camera: whose images come out.
        lens: of the colours that come in.
        depth_grid: of the depth that comes in; None: that of the colours.
    """

    camera: Pinhole
    lens: Lens
    depth_grid: DepthGrid | None = None

    @staticmethod
    def of(camera: Camera) -> Alignment:
        """Return the way from a told camera's images.

        Raises:
            ScenarioError: intrinsics that cannot be.
        """
        colours = Pinhole.from_scenario(camera)
        grid = None
        if camera.depth is not None:
            X_CD = pose(camera.depth.X_DC).inverse()
            R_CD, p_CD = X_CD.rotation().matrix(), X_CD.translation()
            grid = DepthGrid.of(depth_lens(camera), R_CD, p_CD, colours.optics, camera.depth.scale)
        return Alignment(colours.straight, colours.optics, grid)

    def colours(self, rgb: ColourImage) -> ColourImage:
        """Return the colours (H, W, C) without distortion; the same array where there is none."""
        if not self.lens.distortion:
            return rgb
        return np.asarray(cv2.remap(rgb, *straightening(self.lens), cv2.INTER_LINEAR))

    def depth(self, depth: DepthImage) -> DepthImage:
        """Return the depth [m] on the colours' grid, 0 where there is none; the same array where it is there."""
        if self.depth_grid is not None:
            return self.depth_grid.warped(depth)
        if not self.lens.distortion:
            return depth
        return depth_between(depth, *straightening(self.lens))
