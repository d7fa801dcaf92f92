"""Generalised least squares with Gaussian priors, and what the evidence gains by it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs, dtrtri

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    smallest: float = 3e-3
    """An effect may be this much smaller than what its prior speaks of: a tenth of a newton metre on a joint that
    carries forty."""

    scale_price: float = 1.5
    """Price of saying how much smaller it is [nats]."""

    simple: int = 2
    """Of more coefficients than this, which follow any curve, it is not said."""


TUNING = Tuning()


def smaller(c: Array, variance: Array, spread: Array) -> Array:
    """Return how much smaller than its prior says an effect most likely is, along the last axis; at most 1.

    Args:
        c: (…, k) coefficients.
        variance: (…, k) of what is left to know of them.
        spread: (…, k) of the prior.

    The width of most evidence, as MacKay (1992, Bayesian interpolation) finds it in turn with the coefficients.
    """
    if c.shape[-1] > TUNING.simple:
        return np.ones(c.shape[:-1])
    return np.sqrt(np.clip(np.mean((c**2 + variance) / spread**2, axis=-1), TUNING.smallest**2, 1.0))


def smaller_each(sizes: npt.NDArray[np.int64], c: Array, variance: Array, spread: Array) -> Array:
    """Return (m,) `smaller` of effects side by side: of `sizes` (m,), coefficients, variances and spreads (K,)."""
    sums = np.add.reduceat((c**2 + variance) / spread**2, np.cumsum(sizes) - sizes)
    return np.where(sizes > TUNING.simple, 1.0, np.sqrt(np.clip(sums / sizes, TUNING.smallest**2, 1.0)))


def coefficients(right: Array, between: Array, variance: Array, spread: Array) -> tuple[Array, Array, float]:
    """Solve generalised least squares: coefficients, the lower Cholesky factor of S, and log det of S Λ⁻¹.

    Args:
        right: (n, K) inner products of each joint's residual with the columns.
        between: (n, K, K) of the columns with one another.
        variance: (n,) of the joints.
        spread: (K,) of the prior.

    Raises:
        LinAlgError: the columns are too much alike.
    """
    if not len(spread):
        return np.zeros(0), np.zeros((0, 0)), 0.0
    K = len(spread)
    S = ((1.0 / variance) @ between.reshape(len(between), -1)).reshape(K, K)
    S.flat[:: K + 1] += spread**-2.0
    # The routines behind `cho_solve`, whose checks take longer than they do.
    factor, wrong = dpotrf(S, lower=1)
    if wrong:
        raise LinAlgError("not positive definite")
    c, _ = dpotrs(factor, (1.0 / variance) @ right, lower=1)
    return c, factor, 2.0 * float(np.sum(np.log(np.diag(factor)) + np.log(spread)))


def covariance_of(factor: Array) -> Array:
    """Return S⁻¹ (K, K) of the lower Cholesky factor of S."""
    if not len(factor):
        return np.zeros((0, 0))
    half = dpotri(factor, lower=1)[0]  # above whose diagonal there is nothing, as in the factor
    covariance = half + half.T
    covariance.flat[:: len(factor) + 1] *= 0.5
    return np.asarray(covariance)


def variances_of(factor: Array) -> Array:
    """Return the diagonal (K,) of S⁻¹ alone, for half the work."""
    if not len(factor):
        return np.zeros(0)
    inverse = dtrtri(factor, lower=1)[0]
    return np.asarray(np.einsum("ij,ij->j", inverse, inverse))


def increments(G: Array, b: Array, spread: Array) -> Array:
    """Return (m,) rises of the evidence, for information G (m, k, k), right sides b (m, k) and priors (m, k)."""
    return solutions(G, b, spread)[0]


def solutions(G: Array, b: Array, spread: Array) -> tuple[Array, Array]:
    """Return the same, and the coefficients (m, k)."""
    if b.shape[1] > TUNING.simple:
        return _curve(G, b, spread)
    wide, c, variance = _solution(G, b, spread)
    scale = smaller(c, variance, spread)[:, None]
    narrow, closer, _ = _solution(G, b, spread * scale)
    better = narrow - TUNING.scale_price > wide
    return np.where(better, narrow - TUNING.scale_price, wide), np.where(better[:, None], closer, c)


def _solution(G: Array, b: Array, spread: Array) -> tuple[Array, Array, Array]:
    """Return of one width of the prior the rises (m,), coefficients (m, k), and their variances (m, k)."""
    scaled = spread[:, :, None] * G * spread[:, None, :] + np.eye(G.shape[1])
    if G.shape[1] == 1:  # most are
        alone = scaled[:, 0]
        c = spread**2 * b / alone
        return 0.5 * np.sum(b * c, axis=1) - 0.5 * np.log(np.abs(alone[:, 0])), c, spread**2 / alone
    inverse: Any = np.linalg.inv(scaled)
    c = spread * np.einsum("mij,mj->mi", inverse, spread * b)
    _, logdet = np.linalg.slogdet(scaled)
    return 0.5 * np.sum(b * c, axis=1) - 0.5 * logdet, c, spread**2 * np.einsum("mii->mi", inverse)


def _curve(G: Array, b: Array, spread: Array) -> tuple[Array, Array]:
    """Return rises and coefficients alone, of effects of which no width is asked, without an inverse."""
    scaled = spread[:, :, None] * G * spread[:, None, :]
    scaled += np.eye(G.shape[1])
    c = spread * np.linalg.solve(scaled, (spread * b)[:, :, None])[:, :, 0]
    return 0.5 * np.sum(b * c, axis=1) - 0.5 * np.linalg.slogdet(scaled)[1], c


def increment(G: Array, b: Array, spread: Array, candidates: list[Candidate]) -> Array:
    """Return the same, −∞ where the coefficients are not physical."""
    result, c = solutions(G, b, spread)
    physical = [candidate.allows(own) for candidate, own in zip(candidates, c, strict=True)]
    return np.where(physical, result, -np.inf)
