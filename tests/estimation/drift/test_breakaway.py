"""A resting joint that moves although nothing known should move it, in a simulation of dry friction of its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_diagram.estimation.drift import breakaway
from twin_diagram.signals.arrays import Array

LEVEL, INERTIA, DT = 6.0, 2.0, 0.005
FLOOR = np.array([0.3])


class Joint:
    """Dry friction that rises to its level over `smooth` rad/s; a drive holds it at `goal`, gravity pulls it down."""

    def __init__(self, smooth: float, seed: int) -> None:
        self.q = self.v = self.goal = 0.0
        self.smooth, self.gain, self.rng = smooth, 1.0, np.random.default_rng(seed)
        self.memory: Array = np.zeros((breakaway.SIZE, 1))
        self.weight = -20.0

    def step(self) -> float:
        """One message; answers the statistic."""
        before, logged = self.v, 0.0
        for _ in range(50):
            h = DT / 50
            torque = 20.0 + 300.0 * (self.goal - self.q) - 40.0 * self.v
            push = self.gain * torque + self.weight
            # Implicit in the speed, so that it rests where it should.
            free = self.v + h * push / INERTIA
            hold = h * LEVEL / INERTIA
            self.v = (
                free - hold * np.sign(free)
                if abs(free) > hold + self.smooth
                else free * self.smooth / (hold + self.smooth)
            )
            self.q += h * self.v
            logged += torque / 50
        rho = INERTIA * (self.v - before) / DT + LEVEL * np.sign(0.5 * (self.v + before)) - self.weight - logged
        q = self.q + 1e-5 * self.rng.normal()
        v, rho = self.v + 3e-4 * self.rng.normal(), rho + 0.2 * self.rng.normal()
        calm = self.gain == 1.0
        found, _ = breakaway.slow_moves(
            self.memory,
            np.array([q]),
            np.array([v]),
            np.array([rho]),
            0.004,
            np.array([True]),
            FLOOR,
            6.0,
            calm,
        )
        return float(found[0])

    def wander(self, seconds: float) -> float:
        """Small moves about its place, with rests; answers the largest statistic."""
        largest = 0.0
        for k in range(round(seconds / DT)):
            self.goal = 0.03 * np.sin(0.8 * DT * k) ** 3
            largest = max(largest, self.step())
        return largest


@pytest.mark.long
@pytest.mark.parametrize("smooth", [1e-5, 0.02])
def test_a_weak_motor_is_noticed_while_its_joint_gives_way(smooth: float) -> None:
    """10 N·m of 20 are gone, 4 more than friction holds; before, a minute in which nothing is wrong."""
    joint = Joint(smooth, 1041)
    assert joint.wander(60.0) < 0.8
    assert joint.memory[3, 0] > breakaway.TUNING.least
    for _ in range(400):
        joint.goal = joint.q  # the drive rests
        joint.step()
    joint.gain = 0.5
    found = [joint.step() for _ in range(40)]
    first = next((k for k, value in enumerate(found) if value > 1.0), None)
    assert first is not None and first < 12


def test_it_is_one_sided_and_wants_some_way() -> None:
    """What holds a joint back raises nothing, nor does what pushes it over less than it yields."""
    for sign, speed, alarms in ((-1.0, 0.02, False), (1.0, 0.02, True), (1.0, 0.005, False)):
        memory = np.zeros((breakaway.SIZE, 1))
        memory[3], memory[5] = 1000.0, 0.01
        largest = 0.0
        for k in range(8):
            q, v = np.array([speed * DT * k]), np.array([speed])
            found, _ = breakaway.slow_moves(
                memory, q, v, np.array([sign * 9.0]), 0.004, np.array([True]), FLOOR, 6.0, False
            )
            largest = max(largest, float(found[0]))
        assert (largest > 1.0) == alarms


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), max_size=30), st.booleans())
def test_whatever_comes_it_stays_finite(messages: list[tuple[float, float, float]], calm: bool) -> None:
    memory = np.zeros((breakaway.SIZE, 1))
    for q, v, rho in messages:
        found, beyond = breakaway.slow_moves(
            memory, np.array([q]), np.array([v]), np.array([rho]), 0.004, np.array([True]), FLOOR, 6.0, calm
        )
        assert np.isfinite(found).all() and np.isfinite(beyond).all() and np.isfinite(memory).all()
        assert memory[5, 0] >= 0.0
