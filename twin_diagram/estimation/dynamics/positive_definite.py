"""Linear systems with a symmetric positive definite matrix.

At a filter's sizes LAPACK, called directly, takes a third of the time of numpy's general solver.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import lapack

from twin_diagram.signals.arrays import Array


def solve_positive(matrix: Array, right: Array) -> Array:
    """Solve matrix · x = right by Cholesky's factors; only the upper triangle of the matrix is read.

    Args:
        matrix: (n, n) symmetric positive definite.
        right: (n,) or (n, k).

    Raises:
        LinAlgError: the matrix is not positive definite.
    """
    result: Any
    _, result, info = lapack.dposv(matrix, right)
    if info != 0:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return np.asarray(result.reshape(right.shape))


def whiten(covariance: Array, vector: Array) -> Array:
    """Return L⁻¹ vector (n,) or (n, k) with covariance = L Lᵀ (n, n): a vector of that covariance becomes white.

    Raises:
        LinAlgError: the covariance is not positive definite.
    """
    factor: Any
    white: Any
    factor, info = lapack.dpotrf(covariance, lower=1)
    if info != 0:
        raise np.linalg.LinAlgError("the covariance is not positive definite")
    white, _ = lapack.dtrtrs(factor, vector, lower=1)
    return np.asarray(white.reshape(vector.shape))


def joseph(x: Array, P: Array, H: Array, R: Array, innovation: Array) -> tuple[Array, Array]:
    """Return a Kalman update in Joseph's form, which keeps P positive whatever rounding does to the gain.

    Args:
        x: (N,) mean.
        P: (N, N) covariance.
        H: (m, N).
        R: (m, m) noise.
        innovation: (m,).

    Returns:
        Mean (N,) and covariance (N, N) after it.

    Raises:
        LinAlgError: the innovation's covariance is not positive definite.
    """
    HP = H @ P
    K = solve_positive(HP @ H.T + R, HP).T
    A = K @ -H
    A.flat[:: len(x) + 1] += 1.0
    P = A @ P @ A.T + K @ R @ K.T
    return x + K @ innovation, 0.5 * (P + P.T)
