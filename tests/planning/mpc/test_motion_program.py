"""The reduced program with rows as they are needed, against the whole one, dense."""

from __future__ import annotations

import numpy as np
import pytest

from tests.planning.mpc.prox_qp import ProxQp
from twin_diagram.planning.mpc.motion_program import MotionProgram, Rows
from twin_diagram.planning.mpc.quadratic_program import QpSolution, QpSolver, QuadraticProgram
from twin_diagram.signals.arrays import Array

K, N, M = 6, 3, 5


class Counting(QpSolver):
    """ProxQP, with what it was asked."""

    def __init__(self) -> None:
        self.asked: list[QuadraticProgram] = []

    def solve(self, program: QuadraticProgram) -> QpSolution:
        self.asked.append(program)
        return ProxQp().solve(program)


def drawn(seed: int) -> tuple[Array, Array, Array, Array, Array, Array, Rows]:
    """Prices, told combination, prices of slack, slope, end and rows."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((K, K))
    rest = rng.standard_normal(K)
    loose = Rows(
        rng.standard_normal((12, K)), rng.standard_normal((12, N)), rng.uniform(-0.5, 1.5, 12), np.full(12, np.inf),
        rng.integers(0, M, 12),
    )  # fmt: skip
    tight = Rows.of_joints(np.eye(K), np.full((K, N), -1.2), np.full((K, N), 1.2))
    linear, square = rng.uniform(0.5, 2.0, M), rng.uniform(1.0, 5.0, M)
    end = 0.3 * rng.standard_normal(N)
    return root @ root.T + np.eye(K), rest, linear, square, 4 * rng.standard_normal((K, N)), end, Rows.joined(
        [loose, tight]
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_its_answer_is_that_of_the_whole_program(seed: int) -> None:
    P, rest, linear, square, gradient, end, rows = drawn(seed)
    solver = Counting()
    found = MotionProgram(P, rest, linear, square).solve(gradient, end, rows, solver)
    assert found is not None
    np.testing.assert_allclose(rest @ found, end, atol=1e-9)
    size = K * N
    H = np.zeros((size + M, size + M))
    H[:size, :size], H[size:, size:] = np.kron(P, np.eye(N)), np.diag(square)
    C = np.zeros((len(rows.low), size + M))
    C[:, :size] = np.einsum("rk,rn->rkn", rows.left, rows.right).reshape(-1, size)
    loose = np.flatnonzero(rows.slack >= 0)
    C[loose, size + rows.slack[loose]] = 1.0
    whole = QuadraticProgram(
        H=H,
        g=np.concatenate([gradient.ravel(), linear]),
        A=np.hstack([np.kron(rest[None], np.eye(N)), np.zeros((N, M))]),
        b=end,
        C=C,
        low=rows.low,
        high=np.minimum(rows.high, 1e20),
        lower=np.concatenate([np.full(size, -1e20), np.zeros(M)]),
        upper=np.full(size + M, 1e20),
    )
    expected = ProxQp().solve(whole)
    assert expected.solved
    np.testing.assert_allclose(found.ravel(), expected.x[:size], atol=2e-5)
    # Only rows that were broken were ever shown to the solver, and some slack was needed.
    assert 1 <= len(solver.asked) <= 6 and len(solver.asked[-1].low) < len(rows.low)
    assert expected.x[size:].max() > 1e-3


def test_a_motion_that_breaks_nothing_needs_no_solver() -> None:
    P, rest, linear, square, gradient, end, rows = drawn(0)
    wide = Rows(rows.left, rows.right, np.full(len(rows.low), -1e6), np.full(len(rows.low), 1e6), rows.slack)
    solver = Counting()
    found = MotionProgram(P, rest, linear, square).solve(gradient, end, wide, solver)
    assert found is not None and not solver.asked
    # Its slope is zero but along what is told.
    slope = P @ found + gradient
    np.testing.assert_allclose(slope - np.outer(rest, rest @ slope) / (rest @ rest), 0.0, atol=1e-9)
    np.testing.assert_allclose(rest @ found, end, atol=1e-12)


def test_where_rows_contradict_each_other_there_is_no_motion() -> None:
    P, rest, linear, square, gradient, end, _ = drawn(0)
    first, second = np.eye(K)[:1], np.eye(K)[:1]
    rows = Rows.joined(
        [
            Rows.of_joints(first, np.full((1, N), 2.0), np.full((1, N), 3.0)),
            Rows.of_joints(second, np.full((1, N), -3.0), np.full((1, N), -2.0)),
        ]
    )
    assert MotionProgram(P, rest, linear, square).solve(gradient, end, rows, ProxQp()) is None
