"""Which parameters an abrupt change is about: a likelihood ratio for each group that may have changed alone.

Were a group c of parameters off by δ, the whitened innovations w would have the mean W_c δ, W being their derivative
by θ. Least squares over recent messages gives δ, and 2 log of the likelihood ratio is gᵀ I⁻¹ g with g = Σ W_cᵀ w and
I = Σ W_cᵀ W_c. Both sums forget exponentially, so two small matrices are all that is kept.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin_diagram.signals import Array

FORGETTING: Final = 0.9
"""10 messages."""
CAP: Final = 8.0
"""An innovation counts for no more than this many standard deviations."""
UNDECIDED: Final = 9.0
"""Groups whose 2 log likelihood ratio is within this of the best may have changed as well."""
_RIDGE: Final = 1e-9


def keep_score(score: Array, W: Array, white: Array) -> None:
    """Adds a message.

    Args:
        score: (p, p + 1) information and gradient, in place.
        W: (n, p) derivative of the whitened innovation by θ.
        white: (n,) whitened innovation.
    """
    score *= FORGETTING
    score[:, :-1] += W.T @ W
    score[:, -1] += W.T @ np.clip(white, -CAP, CAP)


def evidence(score: Array, groups: list[slice]) -> Array:
    """(G,) 2 log likelihood ratio of each group's having changed alone, less what its size gains by chance."""
    found = np.zeros(len(groups))
    for i, group in enumerate(groups):
        information, gradient = score[group, group], score[group, -1]
        scale = np.sqrt(np.maximum(information.diagonal(), np.finfo(float).tiny))
        information = information / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
        gain = gradient / scale @ np.linalg.solve(information, gradient / scale)
        found[i] = gain * (1.0 + FORGETTING) - 2.0 * len(scale)
    return found


def suspects(score: Array, groups: list[slice]) -> np.ndarray:
    """(p,) whether each parameter may be what changed."""
    changed = np.zeros(len(score), dtype=bool)
    told = evidence(score, groups)
    for group, value in zip(groups, told, strict=True):
        changed[group] = value >= told.max() - UNDECIDED
    return changed
