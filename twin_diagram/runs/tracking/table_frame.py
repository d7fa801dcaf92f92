"""Finds the frame in which tracking works: z up from what things stand on, whatever W the pictures came with.

A table may be the smaller part of a picture, beside floor and walls. Nothing tells where up is, so planes are found one
after the other, whichever way they lie; things stand on the one on which most of what is no plane has its feet.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import DepthImage, Pinhole
from twin_diagram.perception.segmentation.planes import Plane, Told, find_plane
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants, chosen by hand for depth images of some 640 × 480 pixels."""

    columns: int = 160
    """Pixels across the image that are looked at."""

    beyond: float = 0.2
    """Where no plane is in view, what counts as standing begins this far behind the deepest point [m]."""

    planes: int = 5
    """Planes that are looked for: table, floor, and the walls of a corner, and one more."""

    least_area: float = 0.05
    """A plane of less surface is a thing's side, or lid [m²]: a cereal box has 0.035, a small table in view 0.1."""

    on: tuple[float, float] = (0.008, 5.0)
    """What is this near to a plane is its own [m], [standard deviations of depth]: depth bends by some."""

    foot: float = 0.03
    """What stands on a plane has points no higher above it [m], …"""

    beside: int = 3
    """… so near to the plane's own, in the image [pixel] …"""

    touching: float = 0.06
    """… and in space: not in front of it [m]."""

    over: float = 0.3
    """From above no feet are seen: then what is seen against a plane, no higher above it than this, stands on it
    [m]."""

    upright: tuple[float, float] = (-0.3, 0.3)
    """Cameras are mostly held upright: a plane's normal that goes down in the image, by this share of it, counts a
    tenth; one that goes up by this share counts whole."""

    through: float = 0.05
    """A point so far below the support is seen through it [m], but beside its edge, …"""

    least_shown: float = 0.002
    """… and a frame of which less than this share of the pixels shows what is not, or shows anything, tells of no
    thing: it is empty, or full of a camera's longest range."""

    least_feet: float = 20.0
    """Fewer pixels of feet are noise: then the largest surface is taken [pixel]."""


TUNING = Tuning()


@dataclass(frozen=True)
class TableFrame:
    """A frame T with z up: X_WT is (R_WT, p_WT); `found` says whether a support plane was in view."""

    R_WT: Array
    p_WT: Array
    found: bool

    def camera(self, camera: Pinhole) -> tuple[Array, Array]:
        """Return R_TC and p_TC of a camera posed in W."""
        return self.R_WT.T @ camera.R_WC, self.R_WT.T @ (camera.p_WC - self.p_WT)

    def told(self, depth: DepthImage, camera: Pinhole) -> DepthImage:
        """Return a frame's depth (H, W), or none where it looks through the support wherever it shows anything [m].

        Where no support was found nothing tells what is beyond: a camera that steps back sees things there.
        """
        if not self.found:
            return depth
        stride = max(1, depth.shape[1] // TUNING.columns)
        z = np.ascontiguousarray(depth[::stride, ::stride]).astype(float)
        up = self.R_WT[:, 2]
        height = (camera.p_WC - self.p_WT) @ up + z * (camera.rays(stride) @ up)
        shown = np.count_nonzero((z > 0) & (height > -TUNING.through))
        return depth if shown >= TUNING.least_shown * z.size else np.zeros_like(depth)


def table_frame(depth: DepthImage, camera: Pinhole) -> TableFrame:
    """Return the frame of the plane that things stand on; the camera's own, turned to look down, where there is none.

    Args:
        depth: (H, W) [m], 0 where there is none.
        camera: that took it, posed in W.
    """
    stride = max(1, depth.shape[1] // TUNING.columns)
    z = np.ascontiguousarray(depth[::stride, ::stride]).astype(float)
    rays = camera.rays(stride)
    found = _planes(z, rays, camera)
    if not found:
        up = -camera.R_WC[:, 2]
        deepest = float(z.max()) if (z > 0).any() else 1.0
        return TableFrame(_upright(up), camera.p_WC - (deepest + TUNING.beyond) * up, False)
    plane, own = found[_support(found, z, rays, camera)]
    middle = (camera.p_WC + z[own][:, None] * rays[own]).mean(axis=0)
    return TableFrame(_upright(plane.normal), middle - float(plane.height(middle)) * plane.normal, True)


def _planes(z: Array, rays: Array, camera: Pinhole) -> list[tuple[Plane, Mask]]:
    """Return the planes of a depth image (h, w), the largest surface first, and which pixels are theirs."""
    left, found = z.copy(), []
    for _ in range(TUNING.planes):
        plane = find_plane(left, rays, camera.p_WC, camera.depth_noise, Told())
        if plane is None or plane.area < TUNING.least_area:
            break
        off = np.abs(_heights(plane, z, rays, camera))
        own = (left > 0) & (off < np.maximum(TUNING.on[0], TUNING.on[1] * camera.depth_noise(z)))
        if not own.any():
            break
        found.append((plane, own))
        left[own] = 0.0
    return found


def _heights(plane: Plane, z: Array, rays: Array, camera: Pinhole) -> Array:
    """Return how far each pixel's point (h, w) lies off a plane [m]."""
    return np.asarray(plane.height(camera.p_WC + z[..., None] * rays))


def _support(found: list[tuple[Plane, Mask]], z: Array, rays: Array, camera: Pinhole) -> int:
    """Return the number of the plane that things stand on."""
    things = (z > 0) & ~np.any([own for _, own in found], axis=0)
    low, high = TUNING.upright
    ups = np.array([-float(plane.normal @ camera.R_WC[:, 1]) for plane, _ in found])
    held = np.clip((ups - low) / (high - low), 0.1, 1.0)
    heights = [_heights(plane, z, rays, camera) for plane, _ in found]
    for highest, touching in ((TUNING.foot, TUNING.touching), (TUNING.over, np.inf)):
        feet = np.array(
            [_feet(things, own, z, h, highest, touching) for (_, own), h in zip(found, heights, strict=True)]
        )
        if feet.max() >= TUNING.least_feet:
            return int(np.argmax(held * feet))
    return int(np.argmax(held * [plane.area for plane, _ in found]))


def _feet(things: Mask, own: Mask, z: Array, height: Array, highest: float, touching: float) -> float:
    """Return how many pixels of what is no plane are low above one, and beside its own.

    Args:
        things: (h, w) what is no plane.
        own: (h, w) the plane.
        z: (h, w) depth [m].
        height: (h, w) above the plane [m].
        highest: of what counts [m].
        touching: how far in front of the plane's pixels beside it that may be [m].
    """
    around = np.ones((2 * TUNING.beside + 1,) * 2, np.uint8)
    # The plane's depth about each pixel, at its nearest.
    near = cv2.erode(np.where(own, z, 1e3).astype(np.float32), around)
    there = (near < 1e3) & (np.abs(near - z) < touching)
    return float(np.count_nonzero(things & there & (height > 0.0) & (height < highest)))


def _upright(up: Array) -> Array:
    """Return a rotation whose third column is a unit vector."""
    aside = np.eye(3)[int(np.argmin(np.abs(up)))]
    x = aside - (aside @ up) * up
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(up, x), up])
