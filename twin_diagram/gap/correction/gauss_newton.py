"""Weighted non-linear least squares with honest standard errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    rounds: int = 6
    """Steps at most: `settled` ends it before, this only bounds the time."""

    settled: float = 0.02
    """Ends where no coordinate moves by more than this share of its standard error."""

    shorter: float = 0.4
    """A step that does not lower the cost is shortened to this share of itself."""

    shortest_step: float = 0.02
    """Ends where a step would have to be a smaller share than this of the whole one."""


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
    worth: Callable[[Array], bool] | None = None,
) -> Solution:
    """Minimise half a sum of squares by Gauss-Newton with shorter steps where a whole one does not help.

    Args:
        residual: of coordinates (p,): (R,), whitened.
        start: (p,)
        steps: (p,) of the finite differences.
        clusters: (R,) which residuals may hang together, from 0.
        prior: mean and standard deviation (p,) of the coordinates, infinite where there is none.
        shared: (R, m) columns of nuisances that are linear and whitened likewise, each with a prior of deviation 1.
        rounds: at most.
        worth: whether more than one step is, by the covariance (p, p) at the start; None: it is.
    """
    problem = _Problem.of(residual, steps, prior, len(clusters), shared)
    vector, r = start.copy(), residual(start)
    now = problem.cost(r, vector)
    J = problem.jacobian(vector, r)
    whole = worth is None or worth(problem.covariance(J, r, clusters))
    for _ in range(rounds if whole else 1):
        step, scale = problem.step(J, r, vector)
        share = 1.0
        while share > TUNING.shortest_step:
            trial = vector + share * step
            r_trial = residual(trial)
            if np.all(np.isfinite(r_trial)) and problem.cost(r_trial, trial) < now:
                break
            share *= TUNING.shorter
        else:
            break
        vector, r, now = trial, r_trial, problem.cost(r_trial, trial)
        if not whole or np.all(np.abs(share * step) * scale < TUNING.settled):
            break
        J = problem.jacobian(vector, r)
    return Solution(vector, problem.covariance(J, r, clusters), now)


@dataclass(frozen=True)
class _Problem:
    """Least squares whose linear nuisances are projected out.

    Attributes:
        residual: of coordinates (p,): (R,), whitened.
        steps: (p,) of the finite differences.
        mean: (p,) of the prior.
        weight: (p,) its precision, 0 where there is none.
        shared: (R, m) columns of the nuisances.
        project: (m, R) their coefficients in a residual.
    """

    residual: Callable[[Array], Array]
    steps: Array
    mean: Array
    weight: Array
    shared: Array
    project: Array

    @staticmethod
    def of(
        residual: Callable[[Array], Array], steps: Array, prior: tuple[Array, Array], rows: int, shared: Array | None
    ) -> _Problem:
        mean, spread = prior
        weight = np.where(np.isfinite(spread), 1.0 / np.square(spread), 0.0)
        inner = np.zeros((rows, 0)) if shared is None else shared
        project = np.linalg.inv(np.eye(inner.shape[1]) + inner.T @ inner) @ inner.T if inner.shape[1] else inner.T
        return _Problem(residual, steps, mean, weight, inner, project)

    def without(self, x: Array) -> Array:
        """Return columns (R, …) less what the nuisances take of them."""
        return x - self.shared @ (self.project @ x) if self.shared.shape[1] else x

    def cost(self, r: Array, vector: Array) -> float:
        """Return half the sum of squares, the prior's counted."""
        return 0.5 * float(r @ self.without(r)) + 0.5 * float(self.weight @ np.square(vector - self.mean))

    def jacobian(self, vector: Array, r: Array) -> Array:
        """Return (R, p) forward differences of the residual."""
        J = np.empty((len(r), len(vector)))
        for k in range(len(vector)):
            moved = vector.copy()
            moved[k] += self.steps[k]
            J[:, k] = (self.residual(moved) - r) / self.steps[k]
        return J

    def step(self, J: Array, r: Array, vector: Array) -> tuple[Array, Array]:
        """Return the Gauss-Newton step (p,) and one over the coordinates' standard errors (p,)."""
        H = J.T @ self.without(J) + np.diag(self.weight)
        gradient = J.T @ self.without(r) + self.weight * (vector - self.mean)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
        scaled = H / np.outer(scale, scale) + 1e-10 * np.eye(len(H))
        return -np.linalg.solve(scaled, gradient / scale) / scale, scale

    def covariance(self, J: Array, r: Array, clusters: npt.NDArray[np.int64]) -> Array:
        """Return the larger, coordinate by coordinate, of the model's own (p, p) and the sandwich over clusters."""
        own = np.linalg.pinv(J.T @ self.without(J) + np.diag(self.weight), hermitian=True)
        left = self.without(r)
        sums = np.zeros((int(clusters.max()) + 1, J.shape[1]))
        np.add.at(sums, clusters, self.without(J) * left[:, None])
        sandwich = own @ (sums.T @ sums) @ own
        ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(own), 1e-300), 1.0))
        return own * np.outer(ratio, ratio)
