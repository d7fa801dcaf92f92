"""Joins what hovers to what it hangs on: a mug's handle, the neck of a bottle that lies.

A hollow edge parts two things that touch, but also a thing and what sticks out of it. What the table does not hold up,
nor what it leans over, is no thing of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

Labels = npt.NDArray[np.int32]
Small = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Tuning:
    """Constants of the join, set by `sims/benchmarks/segmentation.py` (seeds 1 to 9) and scenes of stacks."""

    share: float = 0.5
    """What hangs on a thing shows less than this share of its pixels."""

    margin: float = 1.2
    """A part hovers if it begins this many times higher than a ball as wide would be seen from."""

    steady: float = 2.0
    """Lower and higher points than the rest are noise [%]."""

    shown: float = 0.5
    """Share of its lower outline that nothing nearer may hide, so that a part is seen to hover."""

    beneath: int = 2
    """How far below the outline is looked for what hides it [pixel of the working grid]."""

    border: float = 0.5
    """Of the root of the smaller part's pixels: over so many pixels' edges two parts touch, at the least."""


TUNING = Tuning()


@dataclass(frozen=True)
class Sight:
    """How a camera looks at a table.

    Attributes:
        down, right: (rows, columns) to the one of a pixel's eight neighbours that lies below; none from straight above.
        level: cosine of the angle that the sight comes down at.
        pitch: distance between neighbouring rays at depth 1 m [m].
    """

    down: int
    right: int
    level: float
    pitch: float

    @staticmethod
    def of(R_WC: Array, up: Array, pitch: float) -> Sight:
        """Return it for a camera's axes (3, 3) in W and the table's normal."""
        x, y, z = -(R_WC.T @ up)
        flat = max(float(np.hypot(x, y)), 1e-9)
        return Sight(round(float(y) / flat), round(float(x) / flat), float(np.sqrt(max(0.0, 1.0 - z * z))), pitch)


def touching(label: Labels, depth: Small, count: int, gap: float) -> Array:
    """Return over how many pixel edges each two parts touch (count, count): neighbours within the gap in depth."""
    edges = np.zeros(count * count)
    for a, b in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        meet = np.flatnonzero((label[a] != label[b]) & (label[a] >= 0) & (label[b] >= 0))
        near = np.abs(depth[a].ravel()[meet] - depth[b].ravel()[meet]) < gap
        pair = label[a].ravel()[meet].astype(np.int64) * count + label[b].ravel()[meet]
        edges += np.bincount(pair[near], minlength=count * count)
    table = edges.reshape(count, count)
    return np.asarray(table + table.T)


def without_hovering(label: Labels, depth: Small, height: Small, least: float, gap: float, sight: Sight) -> Labels:
    """Join parts that nothing holds up to the larger ones that they touch.

    Args:
        label: (h, w) numbers from 0, below 0 where there is none.
        depth: (h, w) [m]
        height: (h, w) above the table [m], where there is a part.
        least: points lower than this count as the table's [m].
        gap: neighbouring pixels farther apart in depth do not touch [m].
        sight: of the camera.

    Returns:
        Labels from 0, in the same order.
    """
    count = int(label.max(initial=-1)) + 1
    if count < 2:
        return label
    edges = touching(label, depth, count, gap)
    size = np.bincount(label[label >= 0], minlength=count)
    root = np.sqrt(size)
    pairs = np.argwhere(np.triu(edges) > TUNING.border * np.minimum(root[:, None], root))
    if not len(pairs):
        return label
    into = np.arange(count)
    for pair in pairs[np.argsort(-edges[pairs[:, 0], pairs[:, 1]])]:
        small, large = pair if size[pair[0]] < size[pair[1]] else pair[::-1]
        if into[small] == small and size[small] < TUNING.share * size[large]:
            if _hangs(label, depth, height - least, gap, sight, int(small), int(large)):
                into[small] = large
    while (into != into[into]).any():
        into = into[into]
    kept = np.unique(into)
    number = np.searchsorted(kept, into).astype(np.int32)
    return np.where(label >= 0, number[np.maximum(label, 0)], label)


def _hangs(label: Labels, depth: Small, height: Small, gap: float, sight: Sight, small: int, large: int) -> bool:
    """Say whether a part hovers, beside another and not on it, and is seen to do so."""
    down, right = sight.down, sight.right
    if not (down or right):
        return False
    row, column = np.divmod(np.flatnonzero(label == small), label.shape[1])
    own = height[row, column]
    low, top = np.percentile(own, [TUNING.steady, 100.0 - TUNING.steady])
    if np.percentile(height[label == large], 100.0 - TUNING.steady) < (low + top) / 2.0:
        return False
    along, across = down * row + right * column, right * row - down * column
    order = np.lexsort((along, across))
    last = order[np.append(np.diff(across[order]) != 0, True)]
    row, column, foot = row[last], column[last], own[last]
    r = np.clip(row + TUNING.beneath * down, 0, label.shape[0] - 1)
    c = np.clip(column + TUNING.beneath * right, 0, label.shape[1] - 1)
    hidden = (label[r, c] >= 0) & (label[r, c] != small) & (depth[r, c] < depth[row, column] + gap)
    if np.mean(~hidden) < TUNING.shown:
        return False
    # Of a ball's outline, the height a quarter of its width beside its middle: the median.
    width = len(last) * sight.pitch * float(np.median(depth[row, column])) / max(1.0, np.hypot(down, right))
    ball = 0.5 * width * (1.0 - np.sqrt(0.75) * sight.level)
    return bool(np.median(foot[~hidden]) > TUNING.margin * ball)
