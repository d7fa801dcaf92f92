"""Torques and shape together: the posterior of an object's ten inertial parameters, as bodies drawn from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.estimation.weighing.held import WeighingError
from twin_diagram.estimation.weighing.shape_prior import Hypotheses
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    step: float = 1e-5
    """Of finite differences by logarithms and E; by offsets times 0.1 m."""

    steps: int = 30
    """Of Gauss and Newton with damping; from even mass 6 to 10 are needed."""

    draws: int = 3000
    """Bodies drawn: standard errors to 1.3 %."""


TUNING = Tuning()


@dataclass(frozen=True)
class Posterior:
    """Bodies drawn from a mixture of Gaussians in the coordinates of `Hypotheses`, all of them physical.

    Attributes:
        bodies: (S, 10) inertial parameters in O.
        weights: (H,) probability of each hypothesis.
        modes: (H, 10) most probable coordinates under each.
        likeliest: (S,) which bodies have the share of mass in their walls that is most probable.
    """

    bodies: Array
    weights: Array
    modes: Array
    likeliest: npt.NDArray[np.bool_]

    @property
    def mean(self) -> Array:
        """(10,) of the bodies with the most probable wall; physical, as means of physical bodies are.

        Half-way between a solid and a shell no body lies: where torques do not tell which it is, the mean of all is
        wrong of both.
        """
        return np.asarray(self.bodies[self.likeliest].mean(axis=0))

    @property
    def covariance(self) -> Array:
        """(10, 10) of all bodies about `mean`: that the wall may be another one is in it."""
        off = self.bodies - self.mean
        return np.asarray(off.T @ off / len(off))


def posterior(matrix: Array, vector: Array, hypotheses: Hypotheses, start: float | Array, seed: int = 0) -> Posterior:
    """Return what torques, −½ φᵀΛφ + ηᵀφ, and the ways in which the mass may lie say together.

    Each hypothesis' most probable body is found by Gauss and Newton with damping, its weight by Laplace's method
    (Kass and Raftery 1995, "Bayes factors", eq. 4).

    Args:
        matrix: (10, 10) Λ.
        vector: (10,) η.
        hypotheses: with their weights.
        start: mass to begin with [kg], or coordinates (H, 10).
        seed: of the draws.

    Raises:
        WeighingError: no hypothesis leads to a body.
    """
    count = len(hypotheses)
    if np.ndim(start):
        u = np.array(start, dtype=float)
    else:
        u = np.zeros((count, 10))
        u[:, 0] = np.log(start)
    prior = hypotheses.information
    damping = np.full(count, 1e-3)
    cost = _cost(u, matrix, vector, hypotheses)
    curvature = prior
    for _ in range(TUNING.steps):
        phi, J = _slopes(u, hypotheses)
        gradient = np.einsum("hij,hi->hj", J, phi @ matrix - vector) + np.einsum("hij,hj->hi", prior, u)
        curvature = np.einsum("hik,ij,hjl->hkl", J, matrix, J) + prior
        scale = np.einsum("hii->hi", curvature) + 1e-12
        damped = curvature + damping[:, None, None] * np.einsum("hi,ij->hij", scale, np.eye(10))
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        step *= np.minimum(1.0, 1.0 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
        there = _cost(u + step, matrix, vector, hypotheses)
        better = there < cost
        u = np.where(better[:, None], u + step, u)
        damping = np.where(better, 0.2 * damping, np.minimum(10.0 * damping, 1e6))
        moved = np.where(better, cost - there, 0.0)
        cost = np.where(better, there, cost)
        if better.any() and moved.max() < 1e-6:
            break
    if not np.all(np.isfinite(cost)):
        raise WeighingError("torques and shape fit no body; look at the logs")
    _, J = _slopes(u, hypotheses)
    curvature = np.einsum("hik,ij,hjl->hkl", J, matrix, J) + prior
    told = np.linalg.slogdet(hypotheses.information[:, 1:, 1:])[1] - np.linalg.slogdet(curvature)[1]
    score = hypotheses.log_weight - cost - hypotheses.outside(u) + 0.5 * told
    weights = np.exp(score - score.max())
    weights /= weights.sum()
    bodies, which = _drawn(u, curvature, weights, hypotheses, seed)
    walls = np.unique(hypotheses.wall)
    wall = walls[np.argmax([weights[hypotheses.wall == w].sum() for w in walls])]
    return Posterior(bodies, weights, u, hypotheses.wall[which] == wall)


def _cost(u: Array, matrix: Array, vector: Array, hypotheses: Hypotheses) -> Array:
    phi = hypotheses.parameters(u)
    fit = 0.5 * np.einsum("hi,ij,hj->h", phi, matrix, phi) - phi @ vector
    return np.asarray(fit + 0.5 * np.einsum("hi,hij,hj->h", u, hypotheses.information, u))


def _slopes(u: Array, hypotheses: Hypotheses) -> tuple[Array, Array]:
    """Return parameters (H, 10) and their derivatives (H, 10, 10) by u."""
    step = TUNING.step * np.array([1.0, 0.1, 0.1, 0.1, *6 * [1.0]])
    moved = np.concatenate(
        [u[None] + step[:, None, None] * np.eye(10)[:, None], u[None] - step[:, None, None] * np.eye(10)[:, None]]
    )
    every = hypotheses.parameters(moved)
    slopes = (every[:10] - every[10:]) / (2.0 * step[:, None, None])
    return hypotheses.parameters(u), slopes.transpose(1, 2, 0)


def _drawn(
    u: Array, curvature: Array, weights: Array, hypotheses: Hypotheses, seed: int
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return bodies (S, 10), of each hypothesis as many as its weight says, and whose each is (S,)."""
    random = np.random.default_rng(seed)
    which = random.choice(len(weights), size=TUNING.draws, p=weights)
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("hii->hi", curvature), 1e-30))
    values, vectors = np.linalg.eigh(curvature * scale[:, :, None] * scale[:, None, :])
    root = scale[:, :, None] * vectors / np.sqrt(np.maximum(values, 1e-12))[:, None, :]
    draws = u[which] + np.einsum("nij,nj->ni", root[which], random.normal(size=(TUNING.draws, 10)))
    return hypotheses.parameters(draws, which), which
