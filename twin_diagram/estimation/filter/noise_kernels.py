"""The compiled parts of `noise_estimate` and `disturbance`: what one message says of noise, joint by joint."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled_in_place


@compiled_in_place
def follow_torque(
    level: Array, moving: Array, by: Array, variance: Array, solved: Array, weighted: Array, step: float, ends: Array
) -> None:
    """Do what `noise_estimate.follow_torque` says to `level` (n,), of joints that are `moving`.

    `ends` are the surprise that counts at most, and how far the logarithm moves.
    """
    for j in range(len(level)):
        expected, told = 0.0, 0.0
        for i in range(len(weighted)):
            expected += by[i, j] * solved[i, j]
            told += weighted[i] * by[i, j]
        surprise = min(told * told / expected, ends[0]) - 1.0
        # One step's share is small where many steps add up, hence the root.
        share = np.sqrt(min(variance[j] * expected, 1.0))
        moved = level[j] + (step * share * surprise if moving[j] else 0.0)
        level[j] = min(max(moved, -ends[1]), ends[1])


@compiled_in_place
def follow_disturbance(
    steady: Array, told: Array, sliding: Array, square: Array, variance: Array, fresh: float, ends: Array
) -> None:
    """Do what `disturbance.follow_disturbance` says to `steady` and `told` (n,), of joints that slide.

    `square` (n,) is the posterior one of d; `ends` are how many times its mean it counts at most, how many values are
    averaged at most, and how low the logarithm falls.
    """
    for j in range(len(steady)):
        if sliding[j] and variance[j] > 0.0:
            surprise = min(square[j] / (variance[j] * np.exp(steady[j])), ends[0]) - 1.0
            told[j] = min(told[j] + fresh, ends[1])
            steady[j] += np.log1p(fresh * surprise / (1.0 + told[j]))
        steady[j] = min(max(steady[j], ends[2]), 0.0)
