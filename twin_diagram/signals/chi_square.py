"""The chi-square distribution's quantiles, and the mean of its root.

As `scipy.stats.chi2` and `chi` answer them, whose import takes longer than all the filter's mathematics: every command
would wait for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import gammaincinv, poch

from twin_diagram.signals.arrays import Array


def quantile(probability: float, degrees: Any) -> Any:
    """Return what chi-square of so many degrees of freedom (any shape) stays below with a probability."""
    return 2.0 * gammaincinv(0.5 * np.asarray(degrees, dtype=float), probability)


def mean_of_root(degrees: Array) -> Array:
    """Return the expected root of chi-square of so many degrees of freedom (any shape)."""
    return np.sqrt(2.0) * np.asarray(poch(0.5 * np.asarray(degrees, dtype=float), 0.5))


def variance_of_root(degrees: Array) -> Array:
    """Return the variance of the root of chi-square of so many degrees of freedom (any shape)."""
    return np.asarray(degrees, dtype=float) - mean_of_root(degrees) ** 2
