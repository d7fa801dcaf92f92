"""How many of a residual's samples are independent: neighbours hang together."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


def independent(left: Array, gaps: npt.NDArray[np.bool_]) -> Array:
    """Return (n,) share of samples (N, n) that are independent: one over the sum of their autocorrelation.

    Args:
        left: what a fit leaves.
        gaps: (N,) whether a sample is the first of its log.
    """
    lags, n = max(2, len(left) // 4), left.shape[1]
    products, pairs = np.zeros((lags, n)), np.zeros((lags, 1))
    for part in np.split(left, np.flatnonzero(gaps)[1:]):
        spectrum = np.fft.rfft(part, 2 * len(part), axis=0)  # as long again in zeros, or ends would meet
        some = min(lags, len(part))
        products[:some] += np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:some]
        pairs[:some, 0] += len(part) - np.arange(some)
    rho = products[1:] / np.maximum(pairs[1:], 1.0) / np.maximum(np.mean(left**2, axis=0), 1e-30)
    total = 1.0 + 2.0 * np.sum(np.where(np.logical_and.accumulate(rho > 0.0), rho, 0.0), axis=0)
    return 1.0 / total
