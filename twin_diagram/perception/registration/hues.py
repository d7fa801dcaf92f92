"""Which colours a thing has, however bright: by them it is told from others before its shape is looked at."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array

BINS: Final = 12
"""Cells per colour share: fine enough to tell the library apart, coarse enough for noise; chosen by hand."""


def hues(colours: Array) -> Array:
    """Return a histogram (144,) over red's and green's share in RGB colours (N, 3).

    Light and shade hardly change it.
    """
    total = colours.sum(axis=1)
    bright = total > 0.1
    share = colours[bright, :2] / total[bright, None]
    cell = np.minimum((share * BINS).astype(np.int64), BINS - 1)
    count = np.bincount(cell[:, 0] * BINS + cell[:, 1], minlength=BINS * BINS).astype(float)
    return count / max(count.sum(), 1.0)


def alike(first: Array, second: Array) -> float:
    """Return the Bhattacharyya coefficient of two histograms, 0 to 1."""
    return float(np.sqrt(first * second).sum())
