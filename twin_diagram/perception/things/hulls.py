"""Convex pieces with few corners, and which points lie in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.perception.registration.model_cloud import fibonacci_sphere
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    kept: int = 512
    """Hulls that are kept at hand: more than all slots hold."""

    least: float = 1e-4
    """A hull whose middle is no farther than this from one of its faces is flat, and stays as it is [m]."""


TUNING = Tuning()


def few_corners(corners: Array, most: int) -> Array:
    """Return the corners (≤ `most`, 3) of a hull that holds those given (V, 3), little larger than theirs.

    The corners farthest out in directions spread evenly are kept, and moved outwards until nothing is left outside.
    """
    if len(corners) <= most:
        return corners
    chosen = corners[np.unique(np.argmax(corners @ fibonacci_sphere(most).T, axis=0))]
    planes = _planes(chosen.tobytes(), len(chosen))
    if planes is None:
        return chosen
    middle = chosen.mean(axis=0)
    inner = -(planes[:, :3] @ middle + planes[:, 3])
    if inner.min() < TUNING.least:
        return chosen
    outer = ((corners - middle) @ planes[:, :3].T).max(axis=0)
    return np.asarray(middle + max(1.0, float((outer / inner).max())) * (chosen - middle))


def inside(points: Array, pieces: Sequence[Array], margin: float) -> npt.NDArray[np.bool_]:
    """Return which of the points (N, 3) lie in one of the pieces, or within about `margin` [m] of it."""
    result = np.zeros(len(points), dtype=bool)
    for corners in pieces:
        planes = _planes(np.ascontiguousarray(corners, dtype=float).tobytes(), len(corners))
        if planes is not None:
            result |= (points @ planes[:, :3].T + planes[:, 3] < margin).all(axis=1)
    return result


@lru_cache(maxsize=TUNING.kept)
def _planes(corners: bytes, count: int) -> Array | None:
    """Return (F, 4) outward normals and offsets of a hull; None where the corners span no volume."""
    try:
        return np.asarray(ConvexHull(np.frombuffer(corners).reshape(count, 3)).equations)
    except (QhullError, ValueError):
        return None
