"""Finds what of an image is a wall, and no thing: flat, and larger than things are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.segmentation.planes import TUNING as PLANES
from twin_diagram.perception.segmentation.planes import Noise, Told, find_plane
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of walls, chosen by hand."""

    least_area: float = 0.3
    """What is flat and shows more surface than this [m²] is no thing: a carton's side of half a metre by half a metre
    has 0.25."""

    most: int = 3
    """Walls that are looked for: those of a corner, and a cupboard's."""

    on: tuple[float, float] = (0.01, 4.0)
    """What is this near to a wall is its own [m], [standard deviations of depth]: walls are not even."""

    whole: float = 0.9
    """What depth's noise leaves of a wall lies in specks: of a patch of which this share is the wall's, all is."""

    patch: int = 9
    """Edge of that patch [pixel]."""


TUNING = Tuning()


def walls(depth: npt.NDArray[np.floating[Any]], standing: Mask, rays: Array, p_WC: Array, noise: Noise) -> Mask:
    """Return which of the pixels that stand out (h, w) are walls.

    Args:
        depth: (h, w) [m], 0 where there is none.
        standing: (h, w) what stands out of the table.
        rays: (h, w, 3) in W, from the camera to the point at depth 1 m.
        p_WC: (3,) the camera's place.
        noise: standard deviation of depth by depth.
    """
    result = np.zeros(depth.shape, dtype=bool)
    step = max(1, depth.shape[1] // PLANES.columns)
    left = np.where(standing, depth, 0)[::step, ::step].astype(float)
    coarse = np.ascontiguousarray(rays[::step, ::step])
    pitch = float(np.linalg.norm(coarse[0, 1] - coarse[0, 0]))
    for _ in range(TUNING.most):
        if float((left**2).sum()) * pitch**2 < TUNING.least_area:
            break  # not even seen square on
        plane = find_plane(left, coarse, p_WC, noise, Told())
        if plane is None or plane.area < TUNING.least_area:
            break
        off = _off(plane.height, left, coarse, p_WC)
        left[(left > 0) & (off < _reach(left, noise))] = 0.0
        near = _off(plane.height, depth, rays, p_WC) < _reach(depth, noise)
        result |= _without_specks(near & (depth > 0) & standing, standing)
    return result


def _reach(depth: npt.NDArray[np.floating[Any]], noise: Noise) -> Array:
    return np.asarray(np.maximum(TUNING.on[0], TUNING.on[1] * noise(np.asarray(depth, dtype=float))))


def _off(height: Callable[[Array], Array], depth: npt.NDArray[np.floating[Any]], rays: Array, p_WC: Array) -> Array:
    return np.abs(height(p_WC + depth[..., None].astype(float) * rays))


def _without_specks(wall: Mask, standing: Mask) -> Mask:
    """Return a wall (h, w) with what stands in specks within it."""
    box = (TUNING.patch, TUNING.patch)
    own, all_ = (cv2.boxFilter(m.astype(np.float32), -1, box, normalize=False) for m in (wall, standing))
    return np.asarray(wall | (standing & (own >= TUNING.whole * np.maximum(all_, 1.0))))
