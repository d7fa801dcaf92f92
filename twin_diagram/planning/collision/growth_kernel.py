"""The compiled part of `forecast_growth`: short loops over a surface's points, for each object at each tick."""

from __future__ import annotations

import numpy as np
from numba import njit

from twin_diagram.signals.arrays import Array


@njit(cache=True)  # type: ignore[untyped-decorator]
def spread(rows: Array, covariance: Array, R: Array) -> Array:
    """Return (S, 2), see `forecast_growth.spread`."""
    # The covariance along the object's own axes.
    half, own = np.zeros((6, 6)), np.zeros((6, 6))
    for i in range(6):
        for j in range(6):
            block = j // 3 * 3
            for k in range(3):
                half[i, j] += 0.5 * (covariance[i, block + k] + covariance[block + k, i]) * R[k, j - block]
    for i in range(6):
        block = i // 3 * 3
        for j in range(6):
            for k in range(3):
                own[i, j] += R[k, i - block] * half[block + k, j]
    result = np.empty((len(rows), 2))
    for s in range(len(rows)):
        variance = 0.0
        for i in range(6):
            along = 0.0
            for j in range(6):
                along += own[i, j] * rows[s, j]
            variance += along * rows[s, i]
        result[s, 0] = max(variance, 0.0)
        result[s, 1] = rows[s, 0] ** 2 + rows[s, 1] ** 2 + rows[s, 2] ** 2
    return result


@njit(cache=True)  # type: ignore[untyped-decorator]
def outermost(spread_: Array) -> Array:
    """Return those rows that may be the worst, see `forecast_growth.outermost`."""
    kept, count = np.empty_like(spread_), 0
    for s in range(len(spread_)):
        variance, lever = spread_[s, 0], spread_[s, 1]
        worse = False
        for k in range(count):
            if kept[k, 0] >= variance and kept[k, 1] >= lever:
                worse = True
                break
        if worse:
            continue
        left = 0
        for k in range(count):
            if kept[k, 0] > variance or kept[k, 1] > lever:
                kept[left, 0], kept[left, 1] = kept[k, 0], kept[k, 1]
                left += 1
        kept[left, 0], kept[left, 1] = variance, lever
        count = left + 1
    return kept[:count].copy()


@njit(cache=True)  # type: ignore[untyped-decorator]
def growth(spread_: Array, shift: Array, turn: Array, sigmas: float, cap: float) -> Array:
    """Return (N,), see `forecast_growth.growth`."""
    result = np.empty(len(turn))
    for at in range(len(turn)):
        worst = -np.inf
        for s in range(len(spread_)):
            worst = max(worst, spread_[s, 0] + spread_[s, 1] * turn[at])
        result[at] = min(sigmas * np.sqrt(worst + shift[at]), cap)
    return result
