"""Poses as vectors (qw, qx, qy, qz, px, py, pz): composed, inverted, compared. Pure functions on arrays."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


def compose(X_AB: Array, X_BC: Array) -> Array:
    """Return X_AC (7) of two poses (7)."""
    q = rotations.normalized(rotations.multiply(X_AB[:4], X_BC[:4]))
    return np.concatenate([q, X_AB[4:] + rotations.matrix(X_AB[:4]) @ X_BC[4:]])


def inverse(X_AB: Array) -> Array:
    """Return X_BA (7) of a pose (7)."""
    q = rotations.conjugate(X_AB[:4])
    return np.concatenate([q, -(rotations.matrix(q) @ X_AB[4:])])


def moved(X_AB: Array, p_A: Array) -> Array:
    """Return a pose (7) carried on by `p_A` (3) [m], in A's axes."""
    return np.concatenate([X_AB[:4], X_AB[4:] + p_A])


def errors(X_AB: Array, X_AC: Array) -> tuple[float, float]:
    """Return how far two poses (7) are apart: between origins [m], and the angle between axes [rad]."""
    turn = rotations.log(rotations.multiply(X_AC[:4], rotations.conjugate(X_AB[:4])))
    return float(np.linalg.norm(X_AC[4:] - X_AB[4:])), float(np.linalg.norm(turn))


def as_matrix(X_AB: Array) -> Array:
    """Return a pose (7) as a (4, 4) matrix."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = rotations.matrix(X_AB[:4]), X_AB[4:]
    return X


def from_matrix(X: Array) -> Array:
    """Return the inverse of `as_matrix`."""
    return np.concatenate([rotations.from_matrix(X[:3, :3]), X[:3, 3]])
