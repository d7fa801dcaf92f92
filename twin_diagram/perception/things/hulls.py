"""Convex pieces with few corners, and which points lie in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    kept: int = 512
    """Hulls that are kept at hand: more than all slots hold."""

    least: float = 1e-4
    """Lengths below this do not matter [m]: a tenth of a millimetre."""


TUNING = Tuning()


def few_corners(corners: Array, most: int) -> Array:
    """Return the corners (≤ `most`, 3) of a hull that holds those given (V, 3), little larger than theirs.

    Beginning with the outermost along the axes, the corner that is farthest outside is added, one after another; what
    is left outside then is held by moving all a little outwards.
    """
    if len(corners) <= most:
        return corners
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    chosen = list(dict.fromkeys(np.argmax(corners @ axes.T, axis=0).tolist()))
    while True:
        planes = _planes(corners[chosen].tobytes(), len(chosen))
        if planes is None:  # flat so far: whatever is farthest from its middle helps
            away = np.linalg.norm(corners - corners[chosen].mean(axis=0), axis=1)
            away[chosen] = 0.0
        else:
            away = (corners @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        if len(chosen) == most or away.max() < TUNING.least:
            break
        chosen.append(int(np.argmax(away)))
    if planes is None:
        return np.asarray(corners[chosen])
    middle = corners[chosen].mean(axis=0)
    inner = -(planes[:, :3] @ middle + planes[:, 3])
    outer = ((corners - middle) @ planes[:, :3].T).max(axis=0)
    larger = max(1.0, float((outer / np.maximum(inner, TUNING.least)).max()))
    return np.asarray(middle + larger * (corners[chosen] - middle))


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
