"""The filter's past: readings in any order say the same, as by one least squares over all of them."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.dynamics.positive_definite import joseph
from twin_diagram.estimation.filter.delayed_measurements import History
from twin_diagram.signals.arrays import Array

N_JOINTS, P, N = 1, 1, 4


class Line:
    """A linear filter of its own that runs beside a history."""

    def __init__(self, seed: int, capacity: int = 8) -> None:
        self.rng = np.random.default_rng([1340, seed])
        self.history = History(N_JOINTS, P, N, capacity)
        self.x, self.P = self.rng.normal(size=N), np.diag([1.0, 2.0, 0.5, 3.0])
        self.history.begin(0.0, self.x, self.P)
        self.steps: list[tuple[Array, Array, Array]] = []
        self.reads: dict[int, list[tuple[Array, Array, Array]]] = {}
        self.start = self.x.copy(), self.P.copy()

    def step(self) -> None:
        F = np.eye(N) + 0.2 * self.rng.normal(size=(N, N))
        A = self.rng.normal(size=(N, N))
        Q, push = 0.1 * A @ A.T, self.rng.normal(size=N)
        self.steps.append((F, push, Q))
        self.x, self.P = F @ self.x + push, F @ self.P @ F.T + Q
        t = 0.1 * len(self.steps)
        by = self.rng.normal(size=(N_JOINTS, N))
        self.history.push(t, 0.1, self.x, np.ones(1), np.ones(1), by, F, Q)
        self.history.settle(self.x, self.P)

    def reading(self, m: int = 2) -> tuple[Array, Array, Array]:
        A = self.rng.normal(size=(m, m))
        return self.rng.normal(size=(m, N)), A @ A.T + 0.3 * np.eye(m), self.rng.normal(size=m)

    def read(self, H: Array, R: Array, z: Array, back: int = 0) -> None:
        """Now, or late."""
        self.reads.setdefault(len(self.steps) - back, []).append((H, R, z))
        self.history.read(H, R, z, back)
        if back == 0:
            self.x, self.P = joseph(self.x, self.P, H, R, z - H @ self.x)
            self.history.settle(self.x, self.P)
        else:
            _, x, P = self.history.state(back)
            x, P = joseph(x, P, H, R, z - H @ x)
            self.x, self.P = self.history.rerun(back, x, P, np.zeros((1, 1)), lambda theta: None)

    def in_order(self) -> tuple[Array, Array]:
        x, P = self.start
        for k in range(len(self.steps) + 1):
            if k:
                F, push, Q = self.steps[k - 1]
                x, P = F @ x + push, F @ P @ F.T + Q
            for H, R, z in self.reads.get(k, []):
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
                x, P = x + K @ (z - H @ x), P - K @ H @ P
        return x, P


@pytest.mark.parametrize("seed", range(4))
def test_late_readings_say_what_they_would_have_said_in_time(seed: int) -> None:
    line = Line(seed)
    for k in range(6):
        line.step()
        for _ in range(3 * (k % 2)):  # six rows for four states: they are compressed
            line.read(*line.reading())
    for back in (3, 1, 5, 3, 3):
        line.read(*line.reading(), back=back)
    x, P = line.in_order()
    np.testing.assert_allclose(line.x, x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(line.P, P, rtol=1e-8, atol=1e-10)
    _, stored, stored_P = line.history.state(0)
    np.testing.assert_array_equal(stored, line.x)
    np.testing.assert_array_equal(stored_P, line.P)


def test_openings_and_added_noise_are_repeated() -> None:
    """Noise in a step counts before its readings; an opening of θ after them, by prior ∘ room roomᵀ."""
    line = Line(7)
    line.step()
    line.read(*line.reading())
    added = np.diag([0.5, 0.0, 1.0, 0.0])
    line.step()
    F, push, Q = line.steps[-1]
    line.P = line.P + added
    line.history.widen(added)
    line.history.settle(line.x, line.P)
    line.steps[-1] = (F, push, Q + added)
    line.read(*line.reading())
    opened = np.zeros((N, N))
    opened[3, 3] = 2.0 * 0.6**2
    line.P = line.P + opened
    line.history.opened(np.array([0.6]))
    line.history.settle(line.x, line.P)
    line.step()
    F, push, Q = line.steps[-1]
    line.steps[-1] = (F, push, Q + F @ opened @ F.T)
    H, R, z = line.reading()
    line.reads.setdefault(1, []).append((H, R, z))
    line.history.read(H, R, z, 2)
    _, x, P = line.history.state(2)
    x, P = joseph(x, P, H, R, z - H @ x)
    clipped = []
    x, P = line.history.rerun(2, x, P, np.array([[2.0]]), lambda theta: clipped.append(theta.copy()))
    expected, covariance = line.in_order()
    np.testing.assert_allclose(x, expected, rtol=1e-9)
    np.testing.assert_allclose(P, covariance, rtol=1e-8, atol=1e-10)
    assert len(clipped) == 2 and clipped[-1][0] == pytest.approx(x[3])


def test_bounds_hold_on_the_way() -> None:
    line = Line(8)
    line.step()
    line.step()
    _, x, P = line.history.state(1)

    def clip(theta: Array) -> None:
        theta[:] = 0.25

    x, _ = line.history.rerun(1, x + 5.0, P, np.zeros((1, 1)), clip)
    assert x[3] == 0.25


def test_a_ring_of_the_newest_steps() -> None:
    line = Line(9, capacity=4)
    history = line.history
    assert (history.count, history.state(0)[0], history.oldest) == (1, 0.0, 0.0)
    for _ in range(6):
        line.step()
    assert history.count == 4 and history.state(0)[0] == pytest.approx(0.6) and history.oldest == pytest.approx(0.3)
    assert history.find(0.3 - 1e-6) is None and history.find(0.3) == 3 and history.find(0.3 - 1e-10) == 3
    assert history.find(0.44) == 2 and history.find(0.46) == 1 and history.find(9.0) == 0
    assert history.knows(0.5) and history.knows(0.5 + 0.9e-6) and not history.knows(0.5 + 1.1e-6)
    assert not history.knows(0.2)
    history.retime(0.61)
    assert history.state(0)[0] == 0.61
    history.clear()
    assert history.count == 0 and history.oldest == np.inf
    assert history.find(0.5) is None and not history.knows(0.6)


def test_a_step_s_acceleration_is_unknown_at_a_start() -> None:
    line = Line(10)
    still, by, noise = line.history.motion(0)
    assert not still.any() and not by.any()
    np.testing.assert_array_equal(noise, [[100.0]])
    line.step()
    still, by, noise = line.history.motion(0)
    np.testing.assert_array_equal(still, [1.0])
    np.testing.assert_allclose(noise, line.steps[-1][2][1:2, 1:2] / 0.1**2)
    np.testing.assert_array_equal(line.history.steady(0), [1.0])
    np.testing.assert_array_equal(line.history.steady(1), [0.0])
