"""Noise of torque residuals: its level and colour per joint, and what turns it white.

A joint's noise is taken as autoregressive; filtering both sides of a regression with its prediction-error filter makes
ordinary least squares the generalised one, and gives every sample left the weight of an independent one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz

Array = npt.NDArray[np.float64]

ORDER = 8
"""Coefficients of the noise's colour: a band-limited noise sampled at 2.5 times its edge needs about that many."""


@dataclass(frozen=True)
class Whitener:
    """Prediction-error filters.

    Attributes:
        filters: (n, p + 1) coefficients, first one 1.
        sigma: (n,) standard deviation of the innovations [N·m].
        lengths: samples of each record; filters do not cross from one to the next.
    """

    filters: Array
    sigma: Array
    lengths: tuple[int, ...]

    @property
    def order(self) -> int:
        """Samples that each record loses at its begin."""
        return self.filters.shape[1] - 1

    @property
    def rows(self) -> npt.NDArray[np.int64]:
        """Indices of the samples that are left."""
        starts = np.concatenate([[0], np.cumsum(self.lengths)[:-1]])
        return np.concatenate([np.arange(s + self.order, s + m) for s, m in zip(starts, self.lengths, strict=True)])

    def joint(self, j: int, signal: Array) -> Array:
        """Whitens signals (ΣD, …) on joint j's torque, in standard deviations; answers the rows that are left."""
        rows = self.rows
        result = signal[rows] * (self.filters[j, 0] / self.sigma[j])
        for k in range(1, self.order + 1):
            result += (self.filters[j, k] / self.sigma[j]) * signal[rows - k]
        return result

    def all(self, signal: Array) -> Array:
        """Whitens (ΣD, n, …) to (n, R, …)."""
        return np.stack([self.joint(j, signal[:, j]) for j in range(signal.shape[1])])


def estimate(
    residual: Array, lengths: Sequence[int], freedom: float = 0.0, weights: Array | None = None, order: int = ORDER
) -> Whitener:
    """Level and colour of the noise.

    Args:
        residual: (ΣD, n) of a model that explains all structure [N·m].
        lengths: samples per record.
        freedom: parameters per joint that were fitted to it; their share of the noise is added again.
        weights: (ΣD, n) 0 for samples that are not to count, else 1; None: all count.
        order: of the autoregression (Yule and Walker).
    """
    total, n = residual.shape
    starts = np.concatenate([[0], np.cumsum(lengths)]).astype(int)
    filters = np.zeros((n, order + 1))
    sigma = np.zeros(n)
    for j in range(n):
        covariance, pairs = np.zeros(order + 1), np.zeros(order + 1)
        counts = np.ones(total) if weights is None else weights[:, j]
        for first, last in itertools.pairwise(starts):
            counted = counts[first:last]
            part = residual[first:last, j] * counted
            covariance += [part[: len(part) - k] @ part[k:] for k in range(order + 1)]
            pairs += [counted[: len(part) - k] @ counted[k:] for k in range(order + 1)]
        # Per pair that counts; a taper keeps gaps from making an autocovariance that no process has.
        taper = 1.0 - np.arange(order + 1) / len(residual)
        covariance *= taper / np.maximum(pairs, 1.0) * pairs[0] / max(1.0, pairs[0] - freedom)
        covariance[0] = max(covariance[0] * (1.0 + 1e-4), 1e-24)
        a = solve_toeplitz(covariance[:-1], covariance[1:])
        filters[j] = np.concatenate([[1.0], -a])
        sigma[j] = np.sqrt(max(covariance[0] - a @ covariance[1:], 1e-24))
    return Whitener(filters, sigma, tuple(int(m) for m in lengths))


def mixed(first: Whitener, second: Whitener, use_second: npt.NDArray[np.bool_]) -> Whitener:
    """The one filter on some joints, the other on the rest (n,)."""
    return Whitener(
        np.where(use_second[:, None], second.filters, first.filters),
        np.where(use_second, second.sigma, first.sigma),
        first.lengths,
    )


def effective_samples(whitener: Whitener) -> Array:
    """(n,) how many independent samples would pin a constant as well as the coloured ones do."""
    white = np.sum(1.0 / np.sum(whitener.filters**2, axis=1, keepdims=True), axis=1)
    gain = np.sum(whitener.filters, axis=1) ** 2
    return np.asarray(sum(whitener.lengths) * gain * white)
