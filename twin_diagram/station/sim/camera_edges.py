"""What real depth cameras do at edges: they put them a pixel aside, and see points that float between both sides."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.station.depth_units import Depth
from twin_diagram.station.sim.camera_defects import TUNING as DEFECTS
from twin_diagram.station.sim.camera_defects import edges
from twin_diagram.station.sim.camera_noise import correlated

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    band: float = 4.0
    """Pixels so many times the jitter from an edge may be taken by its other side."""


TUNING = Tuning()


def jittered(depth: Depth, jitter: float, sigma: float, rng: np.random.Generator) -> Depth:
    """Return the depth with its edges aside by what a smooth field says; surfaces stay as they are.

    Args:
        depth: (H, W) [m], 0 where there is none.
        jitter: RMS of the displacement in each direction [px].
        sigma: of the Gaussian over which it is alike [px].
        rng: of this frame.
    """
    if jitter <= 0:
        return depth
    shape = (depth.shape[0], depth.shape[1])
    radius = max(1, round(TUNING.band * jitter))
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    index = np.flatnonzero(cv2.dilate(edges(depth).view(np.uint8), kernel).view(bool))
    row, column = np.divmod(index, shape[1])
    there = []
    for at, size in zip((row, column), shape, strict=True):
        aside = jitter * correlated(shape, sigma, rng).take(index)
        there.append(np.clip(np.rint(at + aside), 0, size - 1).astype(np.intp))
    own, other = depth.take(index), depth.take(there[0] * shape[1] + there[1])
    # Within a surface nothing moves: its noise is told by the RMS already.
    across = edge_between(own, other)
    result = depth.copy()
    result.ravel()[index[across]] = other[across]
    return result


def edge_between(first: Depth, second: Depth) -> Mask:
    """Return where two depths a few pixels apart are those of two sides of an edge: twice the step of neighbours."""
    return np.asarray(np.abs(first - second) > 2.0 * DEFECTS.edge * np.maximum(first, second))


def flying(depth: Depth, at: Mask, share: float, rng: np.random.Generator) -> Depth:
    """Return the depth with a share of the pixels at edges between the nearest and the farthest depth around them.

    Args:
        depth: (H, W) [m], 0 where there is none.
        at: (H, W) the pixels next to edges.
        share: of them that float.
        rng: of this frame.
    """
    if share <= 0:
        return depth
    index = np.flatnonzero(at & (depth > 0))
    index = index[rng.random(len(index), dtype=np.float32) < np.float32(share)]
    row, column = np.divmod(index, depth.shape[1])
    rows = np.clip(row + np.array([[-1], [0], [1]]), 0, depth.shape[0] - 1)
    columns = np.clip(column + np.array([[-1], [0], [1]]), 0, depth.shape[1] - 1)
    around = depth[rows[:, None], columns].reshape(9, -1)
    near, far = np.where(around > 0, around, np.float32(np.inf)).min(axis=0), around.max(axis=0)
    result = depth.copy()
    result.ravel()[index] = near + rng.random(len(index), dtype=np.float32) * (far - near)
    return result
