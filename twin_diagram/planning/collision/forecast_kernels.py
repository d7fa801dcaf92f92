"""The compiled part of forecasts: short loops, for each object at each tick."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
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


@compiled
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


@compiled
def growth(spread_: Array, shift: Array, turn: Array, sigmas: float, cap: float) -> Array:
    """Return (N,), see `forecast_growth.growth`."""
    result = np.empty(len(turn))
    for at in range(len(turn)):
        worst = -np.inf
        for s in range(len(spread_)):
            worst = max(worst, spread_[s, 0] + spread_[s, 1] * turn[at])
        result[at] = min(sigmas * np.sqrt(worst + shift[at]), cap)
    return result


@compiled
def added_variance(variance: float, density: float, times: Array, reaction: float) -> Array:
    """Return (N,), see `forecast_growth.added_variance`."""
    # Settled: P = √2 q^¼ r^¾, with the speed √q √r, and of the speed √2 q^¾ r^¼.
    r = (max(variance, 0.0) / (np.sqrt(2.0) * density**0.25)) ** (4.0 / 3.0)
    both, speed = np.sqrt(density * r), np.sqrt(2.0) * density**0.75 * r**0.25
    result = np.empty(len(times))
    for at in range(len(times)):
        t = min(times[at], reaction)
        result[at] = 2.0 * both * t + speed * t**2 + density * t**3 / 3.0
    return result


@compiled
def moved(R_WO: Array, p_WO: Array, spin: Array, velocity: Array, travelled: Array) -> Array:
    """Return poses (K, N, 4, 4) of bodies that go on with spin and velocity (K, 3) for so many seconds (N,)."""
    bodies, count = len(R_WO), len(travelled)
    result, turn = np.zeros((bodies, count, 4, 4)), np.empty((3, 3))
    for b in range(bodies):
        rate = np.sqrt(spin[b, 0] ** 2 + spin[b, 1] ** 2 + spin[b, 2] ** 2)
        for at in range(count):
            X = result[b, at]
            X[3, 3] = 1.0
            for i in range(3):
                X[i, 3] = p_WO[b, i] + velocity[b, i] * travelled[at]
                for j in range(3):
                    X[i, j] = R_WO[b, i, j]
            if rate == 0.0:
                continue
            # Rodrigues.
            x, y, z = spin[b, 0] / rate, spin[b, 1] / rate, spin[b, 2] / rate
            s, c = np.sin(rate * travelled[at]), np.cos(rate * travelled[at])
            d = 1.0 - c
            turn[0, 0], turn[0, 1], turn[0, 2] = c + d * x * x, d * x * y - s * z, d * x * z + s * y
            turn[1, 0], turn[1, 1], turn[1, 2] = d * x * y + s * z, c + d * y * y, d * y * z - s * x
            turn[2, 0], turn[2, 1], turn[2, 2] = d * x * z - s * y, d * y * z + s * x, c + d * z * z
            for i in range(3):
                for j in range(3):
                    X[i, j] = turn[i, 0] * R_WO[b, 0, j] + turn[i, 1] * R_WO[b, 1, j] + turn[i, 2] * R_WO[b, 2, j]
    return result
