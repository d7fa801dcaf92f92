"""The compiled parts of the filter's prediction against the same as products and solutions of whole matrices."""

from __future__ import annotations

import numpy as np

from twin_diagram.estimation.dynamics import step_kernels
from twin_diagram.signals.arrays import Array

N, P, OWN, DT = 3, 4, 2, 0.005
RNG = np.random.default_rng(5)


def positive(size: int) -> Array:
    root = RNG.normal(size=(size, size))
    return root @ root.T + np.eye(size)


def test_covariances_spread_as_the_products_say() -> None:
    size = 3 * N + P + OWN
    F = np.diag(RNG.uniform(0.5, 1.0, size))
    F[: 2 * N] = RNG.normal(size=(2 * N, size))
    before, white, walk = positive(size), RNG.normal(size=(2 * N, N)), RNG.uniform(size=size - 2 * N)
    noise = np.zeros((size, size))
    noise[: 2 * N, : 2 * N] = white @ white.T
    noise[:N, :N] += DT**2 / 12.0 * noise[N : 2 * N, N : 2 * N]
    noise[2 * N :, 2 * N :] = np.diag(walk)
    after, Q = before.copy(), np.zeros((size, size))
    step_kernels.spread(F, after, Q, white, walk, DT)
    np.testing.assert_allclose(Q, noise, rtol=1e-12)
    np.testing.assert_allclose(after, F @ before @ F.T + noise, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(after, after.T)


def test_derivatives_solve_the_step() -> None:
    mass, drag, damping = positive(N), RNG.uniform(size=N), RNG.uniform(size=N)
    by_q, by_v, Y = RNG.normal(size=(N, N)), RNG.normal(size=(N, N)), RNG.normal(size=(N, P))
    solved, whole = step_kernels.differentiate(mass, drag, by_q, by_v, Y, damping, DT)
    by_speed = mass - DT * by_v - 0.5 * DT**2 * by_q + DT * np.diag(damping)
    right = np.hstack([-DT * by_q, by_speed, DT * np.eye(N), -DT * Y])
    velocity = np.linalg.solve(mass + DT * np.diag(drag), right)
    start = np.hstack([np.eye(N), 0.5 * DT * np.eye(N), np.zeros((N, N + P))])
    assert solved
    np.testing.assert_allclose(whole, np.vstack([start + 0.5 * DT * velocity, velocity]), rtol=1e-12, atol=1e-15)


def test_what_cannot_be_solved_says_so() -> None:
    none, ones, bounds = np.zeros(N), np.ones(N), np.zeros((2, N))
    for mass in (-np.eye(N), np.full((N, N), np.nan)):
        assert not step_kernels.slide(mass, ones, none, none, none, bounds, DT, 1e-3, 3)[0]
        assert not step_kernels.differentiate(mass, none, mass, mass, np.zeros((N, P)), none, DT)[0]
