"""A box that turns before a camera in a hand that is not seen: ray-cast, so that every pose is known exactly."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tests.synthetic_scene import box_hit
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.runs.learning.display import HeldPicture

Array = npt.NDArray[np.float64]

HALF = np.array([0.03, 0.045, 0.06])


def turned(angle: float, tilt: float = 0.6) -> Array:
    """X_WT (4, 4) of a tool that is turned about its own z axis, which leans towards the camera."""
    c, s = np.cos(tilt), np.sin(tilt)
    axes = np.array([[c, 0.0, s], [0.0, -1.0, 0.0], [s, 0.0, -c]])
    a, b = np.cos(angle), np.sin(angle)
    X = np.eye(4)
    X[:3, :3] = axes @ np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, 1.0]])
    X[:3, 3] = [0.0, 0.0, 0.4]
    return X


def camera() -> ViewCamera:
    """Half a metre before the tool, at its height."""
    R = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    return ViewCamera(240, 200, 240.0, 240.0, 119.5, 99.5, R, np.array([0.5, 0.0, 0.35]))


def shown(X_WT: Array, X_TB: Array, number: int, noise: float = 0.0005) -> HeldPicture:
    """The picture of a box at X_TB in the tool, with white noise of depth."""
    view = camera()
    X_WB = X_WT @ X_TB
    R, p = X_WB[:3, :3], X_WB[:3, 3]
    rays = view.rays() @ view.R_WC.T
    t, _ = box_hit(R.T @ (view.p_WC - p), rays @ R, HALF)
    mask = np.isfinite(t)
    rng = np.random.default_rng(number)
    depth = np.where(mask, t + noise * rng.standard_normal(t.shape), 2.0).astype(np.float32)
    rgb = np.zeros((*t.shape, 3), np.uint8)
    picture = Picture(rgb, depth, view, 0.1 * number, np.zeros(7), np.zeros(2))
    return HeldPicture(picture, X_WT, mask, np.zeros_like(mask), 0)
