"""Depth noise as real cameras have it, for ray-cast pictures: correlated over pixels, ragged at edges."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from pose_truth.raycast import Picture

Array = npt.NDArray[np.float64]

COLOUR = 4.0
"""Deviation of a colour's noise [of 255]."""

PROFILES = ("ideal", "d415", "d435", "kinect1")


def rms(profile: str, z: Array) -> Array:
    """Return the depth RMS [m] at depth z [m]: the makers' formulas of the profiles."""
    if profile == "ideal":
        return 0.0008 * z**2
    if profile == "kinect1":
        return 1.2e-3 + 1.9e-3 * (z - 0.4) ** 2
    return {"d415": 1.5e-3, "d435": 3.8e-3}[profile] * z**2


def field(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Return a field of unit variance, correlated by a Gaussian of `sigma` pixels."""
    margin = int(4 * sigma) + 1
    white = rng.standard_normal((shape[0] + 2 * margin, shape[1] + 2 * margin), dtype=np.float32)
    blurred = cv2.GaussianBlur(white, (0, 0), sigma)[margin:-margin, margin:-margin]
    kernel = cv2.getGaussianKernel(8 * int(np.ceil(sigma)) + 1, sigma)[:, 0]
    return blurred / np.float32((kernel**2).sum())


def spoiled(
    picture: Picture, profile: str, rng: np.random.Generator, fixed: npt.NDArray[np.float32] | None = None
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
    """Return depth [m] and colour as a camera of the profile delivers them; `fixed` waves (H, W) are those of a run."""
    depth, shape = picture.depth.copy(), picture.depth.shape
    rgb = np.clip(picture.rgb + rng.normal(0.0, COLOUR, picture.rgb.shape), 0, 255).astype(np.uint8)
    if profile == "ideal":
        noise = rng.standard_normal(shape, dtype=np.float32)
        return np.where(depth > 0, depth + noise * rms(profile, depth), 0.0).astype(np.float32), rgb
    # Edges jitter by 0.8 pixels; a fifth of what lies there flies between the two depths.
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    du, dv = (0.8 * field(shape, 2.0, rng) for _ in range(2))
    jittered = cv2.remap(depth, u + du, v + dv, cv2.INTER_NEAREST)
    high, low = cv2.dilate(jittered, np.ones((3, 3))), cv2.erode(jittered, np.ones((3, 3)))
    edge = (high - low > 0.02 * np.maximum(high, 0.1)) & (low > 0)
    fly = edge & (rng.random(shape) < 0.2)
    share = rng.random(shape, dtype=np.float32)
    depth = np.where(fly, low + share * (high - low), jittered)
    noise = np.sqrt(0.1) * rng.standard_normal(shape, dtype=np.float32)
    waves = field(shape, 15.0, rng) if fixed is None else fixed
    noise = noise + np.sqrt(0.6) * field(shape, 2.5, rng) + np.sqrt(0.3) * waves
    noisy = depth + noise * rms(profile, depth)
    steep = picture.facing < np.cos(np.radians(75.0))
    return np.where((depth > 0) & ~steep, noisy, 0.0).astype(np.float32), rgb
