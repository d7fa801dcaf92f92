"""The plane on which an object stands, by RANSAC over points with normals (Fischler and Bolles, 1981)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the search, chosen by hand for tables half a metre to two from the camera."""

    trials: int = 300
    """Planes tried: each is one point with its normal, so a plane with a tenth of all points is all but surely among
    them."""

    near: float = 0.006
    """Distance of a point that speaks for a plane [m]: above depth noise and what poses are off by."""

    cosine: float = 0.94
    """Least cosine between a point's normal and that of the plane it speaks for."""

    below: float = 0.02
    """A point so far below a plane speaks against it [m]: a table hides what is under it."""

    least_share: float = 0.08
    """Least share of points that a support must hold."""

    width: float = 3.0
    """Distance at which a point's weight is gone, in standard deviations of what lies near the plane."""

    least_width: float = 0.0005
    """The same at the least [m]."""

    rounds: int = 8
    """Least-squares fits to the points that are near, each after the last one's."""


TUNING = Tuning()


def find_plane(points: Array, normals: Array, above: Array, seed: int = 0) -> Array | None:
    """Return the support plane (4,), unit normal n and offset d with n·p = d [m], or None.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit, towards the cameras.
        above: (3,) a place on its upper side, such as the cameras' mean [m].
        seed: of the trials.
    """
    rng = np.random.default_rng(seed)
    if len(points) < 100:
        return None
    best: Array | None = None
    best_score = TUNING.least_share * len(points)
    for k in rng.integers(0, len(points), TUNING.trials):
        n = normals[k] / np.linalg.norm(normals[k])
        height = (points - points[k]) @ n
        support = (np.abs(height) < TUNING.near) & (normals @ n > TUNING.cosine)
        score = float(np.count_nonzero(support) - np.count_nonzero(height < -TUNING.below))
        if score > best_score and (above - points[k]) @ n > 0:
            best, best_score = np.append(n, points[k] @ n), score
    if best is None:
        return None
    return settled(points, normals, best, above)


def settled(points: Array, normals: Array, plane: Array, above: Array) -> Array:
    """Return a plane (4,) fitted to the points that lie on it, and not to the floor of a cup that stands there.

    Each fit weights points by Tukey's biweight of their distance; its width shrinks with the spread that is left.
    """
    for _ in range(TUNING.rounds):
        height = points @ plane[:3] - plane[3]
        near = (np.abs(height) < TUNING.near) & (normals @ plane[:3] > TUNING.cosine)
        if np.count_nonzero(near) < 50:
            break
        middle = float(np.median(height[near]))
        spread = 1.4826 * float(np.median(np.abs(height[near] - middle)))
        width = np.clip(TUNING.width * spread, TUNING.least_width, TUNING.near)
        weights = np.clip(1 - ((height[near] - middle) / width) ** 2, 0, 1) ** 2
        plane = fit_plane(points[near], above, weights)
    return plane


def fit_plane(points: Array, above: Array, weights: npt.NDArray[np.float64] | None = None) -> Array:
    """Return the plane (4,) of least squared distance to points (N, 3), its normal towards `above` (3,)."""
    w = np.ones(len(points)) if weights is None else weights
    centre = (w[:, None] * points).sum(axis=0) / w.sum()
    _, _, axes = np.linalg.svd((points - centre) * np.sqrt(w)[:, None], full_matrices=False)
    n = axes[2] if (above - centre) @ axes[2] > 0 else -axes[2]
    return np.append(n, centre @ n)
