"""Which parameters an abrupt change is about: a likelihood ratio for each group that may have changed alone.

Were a group c of parameters off by δ, the whitened innovations w would have the mean W_c δ, W being their derivative
by θ. Least squares over recent messages gives δ, and 2 log of the likelihood ratio is gᵀ I⁻¹ g with g = Σ W_cᵀ w and
I = Σ W_cᵀ W_c. Both sums forget exponentially, so two small matrices are all that is kept.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.dynamics.positive_definite import solve_positive
from twin_diagram.signals import chi_square
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a group of parameters must have changed: chosen by hand.

    `make hrt-tables` shows which faults are found, and `sims/benchmarks/false_alarms.py` which are imagined.
    """

    forgetting: float = 0.9
    """10 messages."""

    cap: float = 20.0
    """An innovation is shortened to this many standard deviations, its direction kept: that tells who is to blame."""

    undecided: float = 9.0
    """Groups whose 2 log likelihood ratio is within this of the best may have changed as well."""

    worth: float = 16.0
    """A further group must raise 2 log of the likelihood by this."""

    false_rate: float = 1e-9
    """Probability that what did not change exceeds its threshold, per message and group."""

    ridge: float = 1e-9
    """Added to the scaled information's diagonal, so that what no reading told of yet can be inverted, too."""


TUNING = Tuning()


def keep_score(score: Array, W: Array, white: Array) -> None:
    """Add a message.

    Args:
        score: (p, p + 1) information and gradient, in place.
        W: (n, p) derivative of the whitened innovation by θ.
        white: (n,) whitened innovation.
    """
    score *= TUNING.forgetting
    score[:, :-1] += W.T @ W
    score[:, -1] += W.T @ (white * min(1.0, TUNING.cap / max(float(np.linalg.norm(white)), TUNING.cap)))


def alarming(score: Array, groups: list[slice]) -> bool:
    """Return whether some group's likelihood ratio is beyond what innovations as white as the filter claims ever make.

    Args:
        score: (p, p + 1) information and gradient.
        groups: parameters that change together.
    """
    for group in groups:
        size = group.stop - group.start
        scale = np.sqrt(np.maximum(score[group, group].diagonal(), np.finfo(float).tiny))
        information = score[group, group] / np.outer(scale, scale) + TUNING.ridge * np.eye(size)
        gradient = score[group, -1] / scale
        if (1.0 + TUNING.forgetting) * float(gradient @ solve_positive(information, gradient)) > _threshold(size):
            return True
    return False


@functools.cache
def _threshold(size: int) -> float:
    return float(chi_square.quantile(1.0 - TUNING.false_rate, size))


def suspects(score: Array, groups: list[slice]) -> np.ndarray:
    """Return which groups must have changed, chosen one after the other.

    Each by what it explains beyond those before it.

    Args:
        score: (p, p + 1) information and gradient.
        groups: parameters that change together.

    Returns:
        (p,) whether each parameter may be what changed: the chosen, and those that explain as much as the first.
    """
    p = len(score)
    scale = np.sqrt(np.maximum(score[:, :-1].diagonal(), np.finfo(float).tiny))
    information = score[:, :-1] / np.outer(scale, scale) + TUNING.ridge * np.eye(p)
    gradient = score[:, -1] / scale
    changed = np.zeros(p, dtype=bool)
    explained = 0.0
    for _ in groups:
        gains = np.zeros(len(groups))
        for i, group in enumerate(groups):
            if changed[group].all():
                continue
            at = changed.copy()
            at[group] = True
            total = gradient[at] @ np.linalg.solve(information[np.ix_(at, at)], gradient[at])
            gains[i] = (total - explained) * (1.0 + TUNING.forgetting) - 2.0 * (group.stop - group.start)
        best = float(gains.max())
        if changed.any() and best < TUNING.worth:
            break
        for group, gain in zip(groups, gains, strict=True):
            # At the first choice, what does all but as well cannot be told apart.
            if gain >= best - (0.0 if changed.any() and explained > 0.0 else TUNING.undecided) and gain > 0.0:
                changed[group] = True
        if not changed.any():
            changed[groups[int(gains.argmax())]] = True
        explained = float(gradient[changed] @ np.linalg.solve(information[np.ix_(changed, changed)], gradient[changed]))
        if changed.all():
            break
    return changed
