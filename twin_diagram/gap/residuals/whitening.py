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
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    rounds: int = 25
    """Of expectation and maximisation at most; `settled` ends them before."""

    most_freedom: float = 0.5
    """Share of a joint's samples that regressors may take up."""

    settled: float = 1e-4
    """Ends where the noise's level changes by less than this share: a nat of evidence in ten thousand samples."""

    share: float = 0.2
    """Weight of the noise expected beforehand, in records: no frequency is thought freer of noise than this share."""

    spell: float = 1.0
    """Time over which a push or a change shows in the mean [s]."""

    extraordinary: float = 5.0
    """Robust standard deviations that such a mean must be off by to be no noise."""

    order: int = 8
    """Coefficients of the noise's colour: a band-limited noise sampled at 2.5 times its edge needs about that many."""


TUNING = Tuning()


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
        """Whiten signals (ΣD, …) on joint j's torque, in standard deviations; answer the rows that are left."""
        return self.joints([j], signal.reshape(len(signal), 1, -1))[0].reshape(-1, *signal.shape[1:])

    def joints(self, some: Sequence[int], signal: Array) -> Array:
        """Return signals (ΣD, r, k) on some joints' torques whitened likewise (r, R, k)."""
        taps = (self.filters[some] / self.sigma[some, None])[:, :, None, None]
        signal = np.ascontiguousarray(signal.transpose(1, 0, 2))
        left = [max(length - self.order, 0) for length in self.lengths]
        result = np.empty((len(some), sum(left), signal.shape[2]))
        first = done = 0
        for length, count in zip(self.lengths, left, strict=True):
            begin = first + self.order
            end = begin + count
            part = result[:, done : done + count]
            np.multiply(signal[:, begin:end], taps[:, 0], out=part)
            for k in range(1, self.order + 1):
                part += taps[:, k] * signal[:, begin - k : end - k]
            first, done = first + length, done + count
        return result

    def all(self, signal: Array) -> Array:
        """Whiten (ΣD, n, …) to (n, R, …)."""
        return np.stack([self.joint(j, signal[:, j]) for j in range(signal.shape[1])])


def ordinary(residual: Array, lengths: Sequence[int], rate: float) -> Array:
    """Return where what is left of a torque may be noise: a push of a few seconds must not make its colour redder.

    Args:
        residual: (ΣD, n) of a model that explains most structure [N·m].
        lengths: samples per record.
        rate: samples per second [1/s].

    Returns:
        (ΣD, n) 0 where the mean over a spell is far out among all such means, else 1.
    """
    width = max(3, round(TUNING.spell * rate))
    bounds = np.cumsum(lengths)[:-1]
    slow = np.concatenate([uniform_filter1d(part, width, axis=0) for part in np.split(residual, bounds)])
    off = np.abs(slow - np.median(slow, axis=0))
    far = off > TUNING.extraordinary * 1.4826 * np.median(off, axis=0) + 1e-12
    wide = np.concatenate([maximum_filter1d(part.astype(float), width, axis=0) for part in np.split(far, bounds)])
    return np.asarray(1.0 - wide)


def estimate(
    residual: Array,
    lengths: Sequence[int],
    freedom: float = 0.0,
    weights: Array | None = None,
    order: int = TUNING.order,
) -> Whitener:
    """Return the level and colour of the noise.

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


def restricted(
    residual: Array,
    columns: Sequence[Array],
    start: Whitener,
    weights: Array,
    white: Array,
    rounds: int = TUNING.rounds,
) -> Whitener:
    """Return the level and colour of noise beside any combination of regressors: maximum restricted likelihood, by EM.

    What regressors could explain of the noise is added again at the frequencies where they would (the covariance of
    their coefficients), so that the spectrum has no hole where there are many of them.

    Args:
        residual: (ΣD, n) [N·m].
        columns: (ΣD, m) per joint, each times the prior standard deviation of its coefficient [N·m].
        start: a first guess.
        weights: (n, R) of the whitened samples.
        white: (p + 1,) autocorrelation of white noise in the same band: what noise is thought to be beforehand.
        rounds: of EM.
    """
    expected = TUNING.share * white[np.abs(np.subtract.outer(np.arange(start.order + 1), np.arange(start.order + 1)))]
    filters, sigma = start.filters.copy(), start.sigma.copy()
    rows, order = start.rows, start.order
    for j, X in enumerate(columns):
        kept = weights[j] > 0.0
        count = max(1.0, float(np.sum(kept)))
        # Directions that no size which is thought possible lifts out of the noise are left out; half of the samples'
        # freedom stays with the noise, however short a log is.
        values, vectors = np.linalg.eigh(X.T @ X)
        largest = min(int(np.sum(values > sigma[j] ** 2)), int(TUNING.most_freedom * count))
        Q = X @ vectors[:, len(values) - largest :]
        lagged = [np.column_stack([residual[rows[kept] - k, j], Q[rows[kept] - k]]) for k in range(order + 1)]
        for _ in range(rounds):
            white = sum(f * part for f, part in zip(filters[j], lagged, strict=True)) / sigma[j]
            y, Z = white[:, 0], white[:, 1:]
            factor = np.linalg.cholesky(Z.T @ Z + np.eye(Z.shape[1]))
            c = np.linalg.solve(factor.T, np.linalg.solve(factor, Z.T @ y))
            spread = np.linalg.inv(factor).T
            parts = [np.column_stack([part[:, 0] - part[:, 1:] @ c, part[:, 1:] @ spread]) for part in lagged]
            R = np.array([[np.vdot(a, b) for b in parts] for a in parts])
            believed = R + (R[0, 0] + 1e-30) * expected
            f = np.concatenate([[1.0], -np.linalg.solve(believed[1:, 1:], believed[1:, 0])])
            before, filters[j], sigma[j] = sigma[j], f, np.sqrt(max(float(f @ R @ f) / count, 1e-24))
            if abs(sigma[j] / before - 1.0) < TUNING.settled:
                break
    return Whitener(filters, sigma, start.lengths)


def noise_below(whitener: Whitener, rate: float, cutoff: float = DIFFERENTIATION.residual_cutoff) -> Array:
    """Return (n,) root mean square of coloured noise after the residual's low-pass [N·m].

    It is read off the noise's own spectrum, which was told from structure before anything had a name; what a corrected
    model leaves on the runs that it was fitted to would be a floor that it cannot miss.

    Args:
        whitener: prediction-error filters of the noise.
        rate: samples per second that they are for [1/s].
        cutoff: of the low-pass [Hz].
    """
    frequency = np.linspace(0.0, 0.5 * rate, 513)
    z = np.exp(-2j * np.pi * frequency / rate)
    answer = np.abs(whitener.filters @ z ** np.arange(whitener.order + 1)[:, None])
    density = (whitener.sigma[:, None] / answer) ** 2
    # Forward and backward, so that the amplitude goes with the square of the filter's.
    passed = 1.0 / (1.0 + (frequency / cutoff) ** 8) ** 2
    return np.asarray(np.sqrt(np.trapezoid(density * passed, frequency, axis=1) / (0.5 * rate)))
