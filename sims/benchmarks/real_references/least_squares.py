"""Two estimators that are told the structure: one by a weak ridge, one physical and drawn to the description."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from real_references.regression import Equations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module; the last three so that the references are no worse than those of the data's page."""

    ridge: float = 1e-6
    """Of the classical one, over the largest eigenvalue of the normal equations."""

    together: float = 0.3
    """Residuals nearer than this say the same thing [s]."""

    spread: float = 0.3
    """Prior deviation of a link's logarithmic coordinates about the description."""

    rotor: float = 0.5
    """Prior deviation of rotors [kg·m²]."""


TUNING = Tuning()


def classical(eqs: Equations) -> Array:
    """(P,) by least squares; each parameter counts in units of its column, joints by what is left on them."""
    weight = 1.0 / np.maximum(eqs.left(eqs.start), 1e-9)
    found = eqs.start
    for _ in range(3):
        A = np.concatenate(list(eqs.columns * weight[:, None, None]))
        y = ((eqs.torque - eqs.columns @ eqs.start) * weight[:, None]).ravel()
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-9)
        A = A / scale
        H = A.T @ A
        ridge = TUNING.ridge * np.linalg.eigvalsh(H)[-1]
        found = eqs.start + np.linalg.solve(H + ridge * np.eye(len(H)), A.T @ y) / scale
        weight = 1.0 / eqs.left(found)
    return found


def physical(eqs: Equations) -> Array:
    """(P,) of positive definite pseudo-inertias, with frictions and rotors that are not negative."""
    n, P = eqs.n, len(eqs.start)
    mean = np.concatenate([log_cholesky(link) for link in eqs.described.reshape(n, 10)] + [np.zeros(4 * n)])
    scale = [link_scale(z) for z in mean[: 10 * n].reshape(n, 10)]
    lower = np.concatenate([np.full(10 * n, -np.inf), np.zeros(2 * n), np.full(n, -np.inf), np.zeros(n)])
    found, z = classical(eqs), np.where(np.isfinite(lower), 1e-6, mean)
    for _ in range(3):
        left = eqs.left(found)
        R, y = reduced(eqs, 1.0 / np.maximum(left, 1e-9))
        spread = np.concatenate(
            [
                TUNING.spread * np.concatenate(scale),
                *(10.0 * left * x for x in (1.0, 1.0, 1.0)),
                np.full(n, TUNING.rotor),
            ]
        )

        def cost(z: Array, R: Array = R, y: Array = y, spread: Array = spread) -> Array:
            return np.concatenate([R @ parameters(z, n) - y, (z - mean) / spread])

        def slope(z: Array, R: Array = R, spread: Array = spread) -> Array:
            J = R.copy()
            for k in range(n):
                J[:, 10 * k : 10 * k + 10] = R[:, 10 * k : 10 * k + 10] @ jacobian(z[10 * k : 10 * k + 10])
            return np.concatenate([J, np.diag(1.0 / spread)])

        solved = scipy.optimize.least_squares(cost, z, slope, (lower, np.full(P, np.inf)), x_scale=spread, max_nfev=60)
        z = solved.x
        found = parameters(z, n)
    return found


def reduced(eqs: Equations, weight: Array) -> tuple[Array, Array]:
    """The weighted equations as a triangle, each sample counted as the share of an independent one that it is."""
    share = min(1.0, eqs.seconds / TUNING.together / eqs.torque.shape[1])
    A = np.concatenate(list(eqs.columns * weight[:, None, None]))
    y = (eqs.torque * weight[:, None]).ravel()
    triangle = np.linalg.qr(np.column_stack([A, y]) * np.sqrt(share), mode="r")
    return triangle[:, :-1], triangle[:, -1]


def parameters(z: Array, n: int) -> Array:
    """(P,) from coordinates (P,)."""
    return np.concatenate([*(from_log_cholesky(part) for part in z[: 10 * n].reshape(n, 10)), z[10 * n :]])


def log_cholesky(link: Array) -> Array:
    """(10,) of inertial parameters (10,) about a frame's origin: logarithms of the factor's diagonal, then the rest."""
    m, h, (xx, yy, zz, xy, xz, yz) = link[0], link[1:4], link[4:]
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    pseudo = np.empty((4, 4))
    pseudo[:3, :3], pseudo[:3, 3], pseudo[3, :3], pseudo[3, 3] = 0.5 * np.trace(tensor) * np.eye(3) - tensor, h, h, m
    values, vectors = np.linalg.eigh(pseudo)
    pseudo = (vectors * np.maximum(values, 1e-5 * values[-1])) @ vectors.T
    factor = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]
    return np.concatenate([np.log(np.diag(factor)), factor[np.triu_indices(4, 1)]])


def from_log_cholesky(z: Array) -> Array:
    """The inverse of `log_cholesky`."""
    factor = np.diag(np.exp(np.clip(z[:4], -20.0, 10.0)))
    factor[np.triu_indices(4, 1)] = z[4:]
    pseudo = factor @ factor.T
    tensor = np.trace(pseudo[:3, :3]) * np.eye(3) - pseudo[:3, :3]
    second = [*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    return np.array([pseudo[3, 3], *pseudo[:3, 3], *second])


def link_scale(z: Array) -> Array:
    """(10,) in which a link's coordinates are of the order of one: off the diagonal, of the rows' own diagonal."""
    size = np.exp(z[:4])
    row, column = np.triu_indices(4, 1)
    return np.concatenate(
        [np.ones(4), np.where(column == 3, np.maximum(size[3] * 0.15, size[row]), np.maximum(size[row], 1e-3))]
    )


def jacobian(z: Array) -> Array:
    """(10, 10) of `from_log_cholesky`, by central differences."""
    steps = 1e-6 * np.eye(10)
    return np.stack([(from_log_cholesky(z + s) - from_log_cholesky(z - s)) / 2e-6 for s in steps], axis=1)
