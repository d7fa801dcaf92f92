"""Programs with answers in closed form, of strong and weak curvature side by side."""

from __future__ import annotations

import numpy as np
import pytest

from tests.planning.mpc.prox_qp import ProxQp
from twin_diagram.planning.mpc.quadratic_program import QuadraticProgram


def boxed(curvature: np.ndarray, g: np.ndarray, bound: float = 1.0) -> QuadraticProgram:
    n = len(g)
    none = np.zeros((0, n)), np.zeros(0)
    return QuadraticProgram(
        np.diag(curvature), g, *none, none[0], none[1], none[1], np.full(n, -bound), np.full(n, bound)
    )


@pytest.mark.parametrize("weakest", [1e-6, 1e-3, 10.0])
def test_the_weakest_curvature_sets_the_scale(weakest: float) -> None:
    rng = np.random.default_rng(0)
    curvature = weakest * np.array([1.0, 1e3, 30.0, 2.0, 1e4, 5.0])
    g = -curvature * rng.uniform(-1.6, 1.6, 6)
    answer = ProxQp().solve(boxed(curvature, g))
    assert answer.solved and 0 < answer.iterations <= 400
    np.testing.assert_allclose(answer.x, np.clip(-g / curvature, -1.0, 1.0), atol=2e-7)


def test_without_curvature_the_answer_is_a_corner() -> None:
    g = np.array([1.0, -2.0, 0.5])
    answer = ProxQp().solve(boxed(np.zeros(3), g))
    assert answer.solved
    np.testing.assert_allclose(answer.x, -np.sign(g), atol=1e-5)


def test_a_solver_that_is_stopped_early_says_so() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((20, 20))
    rows = rng.standard_normal((30, 20))
    hard = QuadraticProgram(
        root @ root.T + 1e-3 * np.eye(20), rng.standard_normal(20), np.zeros((0, 20)), np.zeros(0),
        rows, np.full(30, -0.01), np.full(30, 0.02), np.full(20, -1.0), np.full(20, 1.0),
    )  # fmt: skip
    assert not ProxQp(iterations=1).solve(hard).solved
    assert ProxQp().solve(hard).solved
