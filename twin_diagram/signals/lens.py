"""Lenses: focal lengths, principal point, and the distortion of Brown and Conrady with OpenCV's coefficients.

Normalised coordinates (x, y) = (X / Z, Y / Z) of a point in the camera's frame become

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y

and the pixel (fx x' + cx, fy y' + cy). The way back has no closed form: it is solved once for every pixel of a lens and
kept in a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints

Map = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Tuning:
    """Constants of the way back, with what set them."""

    steps: int = 30
    """Of Newton's method at most; lenses that are in use take four."""

    exact: float = 1e-10
    """Where it ends, in normalised coordinates: 1e-7 px."""

    folded: float = 0.05
    """Least determinant of the map's derivative: below it an image folds over itself, and no lens does that."""


TUNING = Tuning()


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a camera; hashable.

    Attributes:
        width, height: of its images [px].
        fx, fy: focal lengths [px].
        cx, cy: principal point [px]; pixel (u, v) has its centre at (u, v).
        distortion: k1, k2, p1, p2, k3; empty: none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    @staticmethod
    def centred(width: int, height: int, focal: float) -> Lens:
        """Return square pixels with the principal point in the image's centre."""
        return Lens(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @property
    def centre(self) -> tuple[float, float]:
        """Principal point (u, v) [px]."""
        return self.cx, self.cy

    @property
    def straight(self) -> Lens:
        """The same lens without distortion."""
        return Lens(self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    def pixel(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the pixel coordinates of normalised coordinates, any shape."""
        if self.distortion:
            x, y = distort(x, y, self.distortion)
        return self.fx * x + self.cx, self.fy * y + self.cy


def distort(x: Array, y: Array, distortion: tuple[float, ...]) -> tuple[Array, Array]:
    """Return where a lens shows normalised coordinates (x, y), any shape, in normalised coordinates."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xy = 2.0 * x * y
    return x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x), y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy


def distortion_derivative(x: Array, y: Array, distortion: tuple[float, ...]) -> tuple[Array, Array, Array]:
    """Return ∂x'/∂x, ∂x'/∂y = ∂y'/∂x and ∂y'/∂y of `distort`."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # of `radial`, by r²/2
    xx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return xx, x * y * slope + 2.0 * (p1 * x + p2 * y), yy


def undistort(x: Array, y: Array, distortion: tuple[float, ...]) -> tuple[Array, Array]:
    """Return the inverse of `distort` by Newton's method; not a number where there is none: the image folds over."""
    a, b = x, y
    good = np.ones(np.shape(x), dtype=bool)
    miss = np.zeros(np.shape(x))
    for _ in range(TUNING.steps):
        u, v = distort(a, b, distortion)
        du, dv = u - x, v - y
        xx, xy, yy = distortion_derivative(a, b, distortion)
        det = xx * yy - xy * xy
        good &= det > TUNING.folded
        det = np.where(good, det, np.inf)  # stays where it is
        a, b = a - (yy * du - xy * dv) / det, b - (xx * dv - xy * du) / det
        miss = np.maximum(np.abs(du), np.abs(dv))
        if not (miss > TUNING.exact)[good].any():
            break
    good &= miss <= TUNING.exact
    return np.where(good, a, np.nan), np.where(good, b, np.nan)


@lru_cache(maxsize=8)
def unit_rays(lens: Lens) -> Array:
    """Return (H, W, 3): of each pixel the point at depth 1 that it shows, in the camera's frame; read-only.

    Not a number where the distortion has no inverse.
    """
    rays = rays_through(lens, *np.meshgrid(np.arange(lens.width), np.arange(lens.height)))
    rays.setflags(write=False)
    return rays


def rays_through(lens: Lens, u: Array | Ints, v: Array | Ints) -> Array:
    """Return (…, 3) what `unit_rays` does, of the places u, v (…) alone [px]."""
    x = np.asarray((u - lens.cx) / lens.fx, dtype=float)
    y = np.asarray((v - lens.cy) / lens.fy, dtype=float)
    if lens.distortion:
        x, y = undistort(x, y, lens.distortion)
    return np.stack([x, y, np.ones_like(x)], axis=-1)


@lru_cache(maxsize=8)
def folds(lens: Lens) -> bool:
    """Return whether a straight picture of a lens would show some place twice: no lens bends so much."""
    x, y, _ = np.moveaxis(unit_rays(lens.straight), -1, 0)
    xx, xy, yy = distortion_derivative(x, y, lens.distortion)
    return bool((xx * yy - xy * xy < TUNING.folded).any())


@lru_cache(maxsize=8)
def straightening(lens: Lens) -> tuple[Map, Map]:
    """Return for each pixel of `lens.straight` where `lens` shows it: u and v (H, W) [px]; read-only."""
    x, y, _ = np.moveaxis(unit_rays(lens.straight), -1, 0)
    u, v = (np.ascontiguousarray(place, dtype=np.float32) for place in lens.pixel(x, y))
    u.setflags(write=False)
    v.setflags(write=False)
    return u, v
