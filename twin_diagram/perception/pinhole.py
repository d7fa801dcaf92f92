"""Points in W from a depth image, and the pinhole camera that links the two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform

from twin_diagram.scenario import Camera
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.arrays import Array

DepthImage = npt.NDArray[np.float32]
ColourImage = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Tuning:
    """Constants of the camera's model, chosen by hand above the depth noise of the simulated camera.

    What it does to poses shows in `sims/closed_loop.py --seeds 20` (object errors) and in what
    `sims/benchmarks/train_camera_noise.py` prints.
    """

    depth_noise: float = 0.0008
    """Standard deviation of depth at 1 m [m] that is allowed for; it grows with depth squared, as in stereo cameras."""


TUNING = Tuning()


@dataclass(frozen=True)
class Pinhole:
    """A calibrated camera: its size [pixel], focal length and principal point [pixel], and X_WC.

    Pixel (u, v) has its centre at (u, v); so the image's centre is at ((width - 1) / 2, (height - 1) / 2).
    """

    width: int
    height: int
    focal: float
    R_WC: Array
    p_WC: Array

    @staticmethod
    def from_scenario(camera: Camera) -> Pinhole:
        """Return the camera as the twin was told of it."""
        X_WC = pose(camera.X_WC)
        return Pinhole(
            camera.width, camera.height, camera.focal, X_WC.rotation().matrix().copy(), X_WC.translation().copy()
        )

    @property
    def X_WC(self) -> RigidTransform:
        """Pose of the optical frame C (X right, Y down, Z forward) in W."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.R_WC, self.p_WC
        return RigidTransform(matrix)

    @property
    def centre(self) -> tuple[float, float]:
        """Principal point (u, v) [pixel]."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    def rays(self, stride: int = 1) -> Array:
        """Return (h, w, 3): the vector in W from the camera to the point at depth 1 m, for every `stride`-th pixel."""
        cu, cv = self.centre
        u = (np.arange(0, self.width, stride) - cu) / self.focal
        v = (np.arange(0, self.height, stride) - cv) / self.focal
        grid = np.stack([*np.meshgrid(u, v), np.ones((len(v), len(u)))], axis=-1)
        return grid @ self.R_WC.T

    def project(self, points_W: Array) -> tuple[Array, Array, Array]:
        """Return the pixel coordinates u, v and the depth of points (..., 3)."""
        p_C = (points_W - self.p_WC) @ self.R_WC
        cu, cv = self.centre
        scale = self.focal / np.maximum(p_C[..., 2], 1e-6)
        return p_C[..., 0] * scale + cu, p_C[..., 1] * scale + cv, p_C[..., 2]


def back_project(depth: DepthImage, rays: Array, p_WC: Array) -> Array:
    """Return the points (h, w, 3) in W of a depth image whose pixels look along `rays`; p_WC without depth."""
    return p_WC + depth[..., None].astype(float) * rays


def grid_normals(
    points: Array, valid: npt.NDArray[np.bool_], at: tuple[npt.NDArray[np.int64], ...], p_WC: Array
) -> Array:
    """Return the normals of an organised cloud, towards the camera.

    Args:
        points: (h, w, 3) in W.
        valid: (h, w), where there is depth.
        at: row and column indices (N,) of the points whose normals are wanted.
        p_WC: the camera's place.

    Returns:
        (N, 3) unit vectors; the direction to the camera where neighbours lack depth or lie across an edge.
    """
    height, width = valid.shape
    row, column = at
    centre = points[row, column]
    steps = []
    for dr, dc in ((0, 2), (2, 0)):
        r1, c1 = np.minimum(row + dr, height - 1), np.minimum(column + dc, width - 1)
        r0, c0 = np.maximum(row - dr, 0), np.maximum(column - dc, 0)
        high = np.where(valid[r1, c1][:, None], points[r1, c1], centre)
        low = np.where(valid[r0, c0][:, None], points[r0, c0], centre)
        # Over a jump in depth the difference belongs to no surface.
        near_high = np.einsum("ni,ni->n", high - centre, high - centre) < 0.02**2
        near_low = np.einsum("ni,ni->n", low - centre, low - centre) < 0.02**2
        steps.append(np.where(near_high[:, None], high, centre) - np.where(near_low[:, None], low, centre))
    view = p_WC - centre
    view = view / np.maximum(np.linalg.norm(view, axis=1, keepdims=True), 1e-9)
    normal = np.cross(steps[1], steps[0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-9, normal / np.maximum(length, 1e-9), view)
    return np.asarray(normal * np.where(np.einsum("ni,ni->n", normal, view) < 0, -1.0, 1.0)[:, None])
