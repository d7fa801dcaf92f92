"""Linear systems of positive matrices, against numpy's general solver."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.dynamics.positive_definite import joseph, solve_positive, whiten


def test_solving_and_whitening() -> None:
    rng = np.random.default_rng(1371)
    A = rng.normal(size=(4, 4))
    S, b, B = A @ A.T + np.eye(4), rng.normal(size=4), rng.normal(size=(4, 3))
    for right in (b, B):
        np.testing.assert_allclose(solve_positive(S, right), np.linalg.inv(S) @ right, rtol=1e-9)
        np.testing.assert_allclose(whiten(S, right), np.linalg.inv(np.linalg.cholesky(S)) @ right, rtol=1e-9)
        assert solve_positive(S, right).shape == whiten(S, right).shape == right.shape
    for wrong in (-S, np.zeros((4, 4))):
        for solve in (solve_positive, whiten):
            with pytest.raises(np.linalg.LinAlgError):
                solve(wrong, b)


def test_joseph_s_update_is_bayes_rule() -> None:
    rng = np.random.default_rng(1372)
    A, H, C = rng.normal(size=(5, 5)), rng.normal(size=(2, 5)), rng.normal(size=(2, 2))
    P, R, x, y = A @ A.T + np.eye(5), C @ C.T + np.eye(2), rng.normal(size=5), rng.normal(size=2)
    before = P.copy()
    mean, covariance = joseph(x, P, H, R, y)
    information = np.linalg.inv(P) + H.T @ np.linalg.solve(R, H)
    np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(mean, x + np.linalg.solve(information, H.T @ np.linalg.solve(R, y)), rtol=1e-8)
    np.testing.assert_array_equal(covariance, covariance.T)
    np.testing.assert_array_equal(P, before)
