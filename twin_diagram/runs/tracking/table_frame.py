"""Finds the frame in which tracking works: z up from what things stand on, whatever W the pictures came with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.assets.building.support_plane import find_plane
from twin_diagram.perception.pinhole import DepthImage, Pinhole, surface_at
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, chosen by hand for depth images of some 640 × 480 pixels."""

    columns: int = 160
    """Pixels across the image that are looked at."""

    beyond: float = 0.2
    """Where no plane is in view, what counts as standing begins this far behind the deepest point [m]."""


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


def table_frame(depth: DepthImage, camera: Pinhole, seed: int = 0) -> TableFrame:
    """Return the frame of the plane that things stand on; the camera's own, turned to look down, where there is none.

    Args:
        depth: (H, W) [m], 0 where there is none.
        camera: that took it, posed in W.
        seed: of the search for the plane.
    """
    stride = max(1, depth.shape[1] // TUNING.columns)
    coarse = np.ascontiguousarray(depth[::stride, ::stride])
    valid = coarse > 0
    points, normals = surface_at(coarse, camera.rays(stride), np.nonzero(valid), camera.p_WC)
    plane = find_plane(points, normals, camera.p_WC, seed)
    if plane is None:
        up = -camera.R_WC[:, 2]
        deepest = float(coarse.max()) if valid.any() else 1.0
        return TableFrame(_upright(up), camera.p_WC - (deepest + TUNING.beyond) * up, False)
    up, offset = plane[:3], float(plane[3])
    middle = points.mean(axis=0)
    return TableFrame(_upright(up), middle - (middle @ up - offset) * up, True)


def _upright(up: Array) -> Array:
    """Return a rotation whose third column is a unit vector."""
    aside = np.eye(3)[int(np.argmin(np.abs(up)))]
    x = aside - (aside @ up) * up
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(up, x), up])
