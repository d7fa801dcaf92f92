"""One picture's camera: focal lengths, principal point and pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ViewCamera:
    """A pinhole camera and its pose; pixel (u, v) has its centre at (u, v), as BOP has it.

    Attributes:
        width, height: [pixel]
        fx, fy, cx, cy: focal lengths and principal point [pixel].
        R_WC: (3, 3); C is the optical frame: x right, y down, z forward.
        p_WC: (3,) [m].
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    R_WC: Array
    p_WC: Array

    def rays(self) -> Array:
        """Return (h, w, 3): in C, the point at depth 1 m that each pixel's centre shows."""
        u = (np.arange(self.width) - self.cx) / self.fx
        v = (np.arange(self.height) - self.cy) / self.fy
        return np.stack([*np.meshgrid(u, v), np.ones((self.height, self.width))], axis=-1)

    def project(self, points_W: Array) -> tuple[Array, Array, Array]:
        """Return pixel coordinates u, v and depth [m] of points (…, 3).

        Depth at or behind the lens gives no finite place.

        Such points come out with u = v = −1e9, outside every image.
        """
        p = (points_W - self.p_WC) @ self.R_WC
        ahead = p[..., 2] > 1e-6
        z = np.where(ahead, p[..., 2], 1.0)
        u = np.where(ahead, p[..., 0] / z * self.fx + self.cx, -1e9)
        v = np.where(ahead, p[..., 1] / z * self.fy + self.cy, -1e9)
        return u, v, p[..., 2]

    def moved(self, R_WC: Array, p_WC: Array) -> ViewCamera:
        """Return the same camera elsewhere."""
        return replace(self, R_WC=R_WC, p_WC=p_WC)
