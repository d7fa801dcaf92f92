"""Weighted non-linear least squares with honest standard errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    rounds: int = 6

    settled: float = 0.02
    """Ends where no coordinate moves by more than this share of its standard error."""


TUNING = Tuning()


@dataclass(frozen=True)
class Solution:
    """Where the iterations ended.

    Attributes:
        vector: (p,) coordinates.
        covariance: (p, p): the larger, coordinate by coordinate, of the model's own and the sandwich over clusters.
        cost: half the sum of squares.
    """

    vector: Array
    covariance: Array
    cost: float


def minimise(
    residual: Callable[[Array], Array],
    start: Array,
    steps: Array,
    clusters: npt.NDArray[np.int64],
    prior: tuple[Array, Array],
    shared: Array | None = None,
    rounds: int = TUNING.rounds,
) -> Solution:
    """Gauss-Newton with step halving.

    Args:
        residual: of coordinates (p,): (R,), whitened.
        start: (p,)
        steps: (p,) of the finite differences.
        clusters: (R,) which residuals may hang together.
        prior: mean and standard deviation (p,) of the coordinates, infinite where there is none.
        shared: (R, m) columns of nuisances that are linear and whitened likewise, each with a prior of deviation 1.
        rounds: at most.
    """
    mean, spread = prior
    weight = np.where(np.isfinite(spread), 1.0 / np.square(spread), 0.0)
    vector, r = start.copy(), residual(start)
    inner = np.zeros((len(r), 0)) if shared is None else shared
    project = np.linalg.inv(np.eye(inner.shape[1]) + inner.T @ inner) @ inner.T if inner.shape[1] else inner.T

    def without(x: Array) -> Array:
        return x - inner @ (project @ x) if inner.shape[1] else x

    def cost(r: Array, vector: Array) -> float:
        return 0.5 * float(r @ without(r)) + 0.5 * float(weight @ np.square(vector - mean))

    def jacobian(vector: Array, r: Array) -> Array:
        J = np.empty((len(r), len(vector)))
        for k in range(len(vector)):
            moved = vector.copy()
            moved[k] += steps[k]
            J[:, k] = (residual(moved) - r) / steps[k]
        return J

    now = cost(r, vector)
    J = jacobian(vector, r)
    for _ in range(rounds):
        H = J.T @ without(J) + np.diag(weight)
        gradient = J.T @ without(r) + weight * (vector - mean)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
        scaled = H / np.outer(scale, scale) + 1e-10 * np.eye(len(H))
        step = -np.linalg.solve(scaled, gradient / scale) / scale
        share = 1.0
        while share > 0.02:
            trial = vector + share * step
            r_trial = residual(trial)
            if np.all(np.isfinite(r_trial)) and cost(r_trial, trial) < now:
                break
            share *= 0.4
        else:
            break
        vector, r, now = trial, r_trial, cost(r_trial, trial)
        if np.all(np.abs(share * step) * scale < TUNING.settled):
            break
        J = jacobian(vector, r)
    own = np.linalg.pinv(J.T @ without(J) + np.diag(weight), hermitian=True)
    left = without(r)
    sums = np.zeros((int(clusters.max()) + 1, len(vector)))
    np.add.at(sums, clusters, without(J) * left[:, None])
    sandwich = own @ (sums.T @ sums) @ own
    ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(own), 1e-300), 1.0))
    return Solution(vector, own * np.outer(ratio, ratio), now)
