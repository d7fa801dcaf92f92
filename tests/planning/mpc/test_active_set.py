"""Programs against ProxQP's answers, and those that have none."""

from __future__ import annotations

import numpy as np
import pytest

from tests.planning.mpc.prox_qp import ProxQp
from twin_diagram.planning.mpc.active_set import ActiveSet
from twin_diagram.planning.mpc.quadratic_program import QuadraticProgram

ENDLESS = 1e20


def drawn(seed: int, *, plain: bool) -> QuadraticProgram:
    """Rows that are broken by many of their optima, and slacks that may not be negative."""
    rng = np.random.default_rng(seed)
    size, rows = int(rng.integers(3, 60)), int(rng.integers(1, 50))
    slacks = int(rng.integers(0, size))
    root = rng.standard_normal((size, size))
    low, high = -rng.uniform(0.0, 1.5, rows), rng.uniform(0.0, 1.5, rows)
    low[::4], high[1::4] = -ENDLESS, np.inf
    least = np.full(size, -ENDLESS)
    least[size - slacks :] = 0.0
    return QuadraticProgram(
        np.eye(size) if plain else root @ root.T + 0.3 * np.eye(size), 2.0 * rng.standard_normal(size),
        np.zeros((0, size)), np.zeros(0), rng.standard_normal((rows, size)), low, high, least, np.full(size, ENDLESS),
    )  # fmt: skip


@pytest.mark.parametrize("plain", [True, False])
def test_answers_are_those_of_another_solver(plain: bool) -> None:
    met = 0
    for seed in range(24):
        program = drawn(seed, plain=plain)
        answer, expected = ActiveSet().solve(program), ProxQp().solve(program)
        assert answer.solved and expected.solved
        np.testing.assert_allclose(answer.x, expected.x, atol=2e-6)
        values = program.C @ answer.x
        assert (values > program.low - 1e-7).all() and (values < program.high + 1e-7).all()
        assert (answer.x > program.lower - 1e-9).all()
        met += answer.iterations
        np.testing.assert_array_equal(ActiveSet().solve(program).x, answer.x)
    assert met > 100


def bounded(C: list[list[float]], low: list[float], high: list[float], g: tuple[float, float]) -> QuadraticProgram:
    far = np.full(2, ENDLESS)
    rows = np.array(C), np.array(low), np.array(high)
    return QuadraticProgram(np.eye(2), np.array(g), np.zeros((0, 2)), np.zeros(0), *rows, -far, far)


def test_a_row_that_was_taken_in_may_be_left_out_again() -> None:
    # Seen from (3, 1) the second row is the worse broken, at whose foot the first is; between them lies the corner.
    program = bounded([[1.0, 0.0], [1.0, 1.0], [-1.0, 2.0]], [-9.0] * 3, [1.0, 1.5, 0.0], (-3.0, -1.0))
    answer = ActiveSet().solve(program)
    assert answer.solved
    np.testing.assert_allclose(answer.x, [1.0, 0.5], atol=1e-9)
    nothing = ActiveSet().solve(bounded([[1.0, 0.0]], [-9.0], [9.0], (-3.0, -1.0)))
    assert nothing.solved and nothing.iterations == 0
    np.testing.assert_allclose(nothing.x, [3.0, 1.0])


def test_rows_that_contradict_each_other_have_no_answer() -> None:
    assert not ActiveSet().solve(bounded([[1.0, 0.0], [2.0, 0.0]], [1.0, -9.0], [9.0, 1.0], (0.0, 0.0))).solved
    assert not ActiveSet().solve(bounded([[1.0, 1.0], [0.0, 0.0]], [1.0, -1.0], [0.9, 1.0], (0.0, 0.0))).solved
    assert not ActiveSet().solve(bounded([[1.0, 0.0], [0.0, 0.0]], [-9.0, 0.5], [9.0, 1.0], (0.0, 0.0))).solved


def test_one_that_is_stopped_early_and_one_without_curvature_say_so() -> None:
    program = drawn(3, plain=True)
    assert ActiveSet().solve(program).iterations >= 2 and not ActiveSet(steps=1).solve(program).solved
    flat = QuadraticProgram(**{**vars(program), "H": np.zeros_like(program.H)})
    assert not ActiveSet().solve(flat).solved


def test_equations_are_refused() -> None:
    program = drawn(0, plain=True)
    size = len(program.g)
    with pytest.raises(ValueError, match="1 equations"):
        ActiveSet().solve(QuadraticProgram(**{**vars(program), "A": np.ones((1, size)), "b": np.zeros(1)}))
