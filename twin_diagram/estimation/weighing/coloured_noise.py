"""Noise whose samples know of each other, and what makes it white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    memory: int = 10
    """Most samples that one may remember: 0.4 s at 25 a second, half a period of slow motion."""

    rare: float = 3.0
    """Residuals beyond so many deviations count as that many: joints that stick as they turn round are no noise."""

    least: float = 1e-9
    """Noise is at least this [N·m]: logs without any exist in tests."""


TUNING = Tuning()


@dataclass(frozen=True)
class Colour:
    """An autoregression e(t) = Σ aₖ e(t − k) + σ·white, order by Schwarz's criterion.

    Attributes:
        memory: (p,) a.
        sigma: σ [N·m].
        size: standard deviation of e itself [N·m].
    """

    memory: Array
    sigma: float
    size: float

    @staticmethod
    def white(sigma: float) -> Colour:
        """Return noise without memory."""
        return Colour(np.zeros(0), sigma, sigma)

    @staticmethod
    def of(residuals: Sequence[Array]) -> Colour:
        """Return the noise that residuals (N,) of several logs show (Yule and Walker's equations)."""
        most_usual = TUNING.rare * 1.4826 * float(np.median(np.abs(np.concatenate(residuals))))
        residuals = [np.clip(r, -most_usual, most_usual) for r in residuals]
        count = sum(len(r) for r in residuals)
        most = min(TUNING.memory, min(len(r) for r in residuals) // 8)
        lags = np.array([sum(float(r[k:] @ r[: len(r) - k]) for r in residuals) for k in range(most + 1)]) / count
        size = max(float(np.sqrt(lags[0])), TUNING.least)
        best, found = np.inf, Colour.white(size)
        if size <= TUNING.least:
            return found
        for order in range(most + 1):
            a = scipy.linalg.solve_toeplitz(lags[:order], lags[1 : order + 1]) if order else np.zeros(0)
            left = max(float(lags[0] - a @ lags[1 : order + 1]), TUNING.least**2)
            price = count * np.log(left) + order * np.log(count)
            if price < best:
                best, found = price, Colour(a, float(np.sqrt(left)), size)
        return found

    def whitened(self, signal: Array) -> Array:
        """Return columns (N − p, …) of (N, …) in which this noise is white and of size one."""
        p = len(self.memory)
        result = signal[p:].copy()
        for k, a in enumerate(self.memory, start=1):
            result -= a * signal[p - k : len(signal) - k]
        return result / self.sigma
