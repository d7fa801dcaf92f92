"""Generalised least squares with Gaussian priors, and what the evidence gains by it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from twin_diagram.gap.candidate import Candidate

Array = npt.NDArray[np.float64]


def coefficients(
    joints: list[tuple[npt.NDArray[np.int64], Array]], variance: Array, spread: Array
) -> tuple[Array, Array, float]:
    """Generalised least squares: coefficients, their covariance, and log det of S Λ⁻¹."""
    S, b = np.diag(spread**-2.0), np.zeros(len(spread))
    for (index, G), level in zip(joints, variance, strict=True):
        S[np.ix_(index, index)] += G[1:, 1:] / level
        b[index] += G[1:, 0] / level
    if not len(spread):
        return b, S, 0.0
    factor: Any = cho_factor(S, lower=True)
    logdet = 2.0 * float(np.sum(np.log(np.diag(factor[0])) + np.log(spread)))
    return cho_solve(factor, b), cho_solve(factor, np.eye(len(b))), logdet


def increments(G: Array, b: Array, spread: Array) -> Array:
    """(m,) rises of the evidence, for information G (m, k, k), right sides b (m, k) and priors (m, k)."""
    return solutions(G, b, spread)[0]


def solutions(G: Array, b: Array, spread: Array) -> tuple[Array, Array]:
    """The same, and the coefficients (m, k)."""
    scaled = spread[:, :, None] * G * spread[:, None, :] + np.eye(G.shape[1])
    c = spread * np.linalg.solve(scaled, (spread * b)[..., None])[..., 0]
    _, logdet = np.linalg.slogdet(scaled)
    return 0.5 * np.sum(b * c, axis=1) - 0.5 * logdet, c


def increment(G: Array, b: Array, spread: Array, candidates: list[Candidate]) -> Array:
    """The same, −∞ where the coefficients are not physical."""
    result, c = solutions(G, b, spread)
    physical = [candidate.allows(own) for candidate, own in zip(candidates, c, strict=True)]
    return np.where(physical, result, -np.inf)
