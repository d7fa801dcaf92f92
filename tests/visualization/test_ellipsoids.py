"""What is drawn of the filter's covariance, and that the covariance stays one."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation_bench import World, simulate, twin_terms
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Filter
from twin_diagram.visualization.ellipsoids import ellipsoid


def test_ellipsoid_has_the_covariance():
    rng = np.random.default_rng(0)
    for _ in range(20):
        A = rng.normal(size=(3, 3))
        R_WE, lengths = ellipsoid(A @ A.T, deviations=2.0, smallest=0.0)
        R = R_WE.matrix()
        np.testing.assert_allclose(R @ np.diag((lengths / 2.0) ** 2) @ R.T, A @ A.T, atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
    _, lengths = ellipsoid(np.diag([1e-6, -1e-20, 0.0]), scale=2.0, smallest=1e-4)
    np.testing.assert_allclose(np.sort(lengths), [1e-4, 1e-4, 6e-3])


def worst(ekf: Ekf) -> float:
    """Smallest eigenvalue of the covariance, scaled to ones on the diagonal."""
    scale = np.sqrt(ekf.belief.P.diagonal())
    return float(np.linalg.eigvalsh(ekf.belief.P / np.outer(scale, scale)).min())


def drive(duration: float) -> float:
    """The arm to and fro with outliers, gaps and silences; the worst that the covariance ever was."""
    run = simulate(World.draw(31, period=6.0), 12.0)
    params = Filter(parameters=["payload", "torque_bias", "viscous_friction", "coulomb_friction", "torque_constant"])
    ekf, rng, smallest = Ekf(twin_terms(), params), np.random.default_rng(2), 1.0
    count, period = round(duration * 200), 1200
    for k in range(count):
        i = 100 + k % period if k >= 100 else k  # twelve seconds hold two whole periods
        q = run.q[i].copy()
        if rng.random() < 0.02:
            q[rng.integers(7)] += 0.05
        if k % 9000 < 8960:
            ekf.observe(q, run.v[i], run.tau[i], 0.005 * k)
        if k % 500 == 0 and k:
            assert np.all(np.isfinite(ekf.belief.vector))
            np.testing.assert_array_equal(ekf.belief.P, ekf.belief.P.T)
            smallest = min(smallest, worst(ekf))
    return smallest


@pytest.mark.slow
def test_covariance_stays_positive_for_twenty_seconds():
    assert drive(20.0) > 0.0


@pytest.mark.slow
def test_covariance_stays_positive_for_an_hour():
    assert drive(3600.0) > 0.0
