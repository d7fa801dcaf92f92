"""The momentum observer: it learns what each joint always lacks, and names the joint that lacks something new."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.estimation.small_arms import constant_friction, gantry
from tests.estimation_bench import HOME, twin_terms
from twin_diagram.estimation.drift.breakaway import TUNING as BREAKAWAY
from twin_diagram.estimation.drift.momentum_observer import TUNING as MOMENTUM_OBSERVER
from twin_diagram.estimation.drift.momentum_observer import TorqueTest
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

TERMS = twin_terms()
TUNING = Filter()
TEST = TorqueTest(TERMS, ParameterSet(TERMS, TUNING), TUNING, 6.0)
DT = 0.005


def moves(count: int, start: float = 0.0) -> tuple[Array, Array, Array]:
    """Times, states (K, 2n) and the torques (K, n) that the described arm needs for them, mean since the last."""
    t = start + DT * np.arange(1, count + 1)
    phase = np.arange(7)
    angle = 2.0 * t[:, None] + phase
    q, v = HOME + 0.3 * np.sin(angle), 0.6 * np.cos(angle)
    middle = 2.0 * (t[:, None] - 0.5 * DT) + phase
    q_mid, v_mid, a_mid = HOME + 0.3 * np.sin(middle), 0.6 * np.cos(middle), -1.2 * np.sin(middle)
    TERMS.set_payload(np.zeros(4))
    tau = np.empty((count, 7))
    for k in range(count):
        level = TERMS.dry(q_mid[k], v_mid[k], np.zeros(7))[0]
        tau[k] = TERMS.mass_matrix(q_mid[k]) @ a_mid[k] + TERMS.load(q_mid[k], v_mid[k], np.zeros(7))
        tau[k] += level * np.sign(v_mid[k])
    return t, np.hstack([q, v]), tau


def feed(vector: Array, t: Array, x: Array, tau: Array, learning: bool = True) -> list[tuple[float, int, float]]:
    theta = np.zeros(4)
    return [TEST.follow(vector, x[k], theta, tau[k], float(t[k]), learning, True) for k in range(len(t))]


@pytest.fixture(scope="module")
def normal() -> tuple[Array, float]:
    """What six seconds teach of an arm whose friction is off by a constant, its torques noisy."""
    vector = np.zeros(TEST.size)
    t, x, tau = moves(1200)
    rng = np.random.default_rng(0)
    found = feed(vector, t, x, tau + 0.5 * np.sign(x[:, 7:]) + 0.2 * rng.normal(size=tau.shape))
    assert max(f for f, _, _ in found) < 0.6
    return vector, float(t[-1])


@pytest.mark.parametrize("joint", [1, 3])
def test_names_the_joint_and_what_it_gained(normal, joint: int) -> None:
    vector, start = normal[0].copy(), normal[1]
    t, x, tau = moves(60, start)
    logged = tau + 0.5 * np.sign(x[:, 7:])
    logged[20:, joint] += 4.0  # the motor gives 4 N·m less than it logs
    found = feed(vector, t, x, logged, learning=False)
    assert max(f for f, _, _ in found[:20]) < 1.0
    first = next(k for k, (f, _, _) in enumerate(found) if f > 1.0)
    assert 20 < first < 32
    assert found[first][1] == joint
    assert found[-1][2] == pytest.approx(-4.0, abs=0.5)


@pytest.mark.parametrize("speed", [0.012, 0.2])
def test_friction_that_grows_is_noticed_on_slow_slides(speed: float) -> None:
    """A slide at 12 mm/s is under way, as a joint at 0.05 rad/s is: 3 cm/s were asked of it."""
    terms, params = gantry(constant_friction(4.0, 4.0)), Filter(parameters=[])
    test, rng = TorqueTest(terms, ParameterSet(terms, params), params, 6.0), np.random.default_rng(0)
    t = DT * np.arange(1, 1601)
    v = speed * np.tanh(4.0 * np.sin(2.0 * t))
    q, a = np.cumsum(v) * DT, np.diff(v, prepend=0.0) / DT
    vector, found = np.zeros(test.size), []
    for k in range(len(t)):
        tau = np.array([5.0, 2.0]) * a[k] + (4.0 + 4.0 * np.array([t[k] > 6.0, 0.0])) * np.sign(v[k])
        x = np.repeat([q[k], v[k]], 2) + np.repeat([0.0, 2e-4], 2) * rng.normal(size=4)
        noisy = tau + 0.05 * rng.normal(size=2)
        found.append(test.follow(vector, x, np.zeros(0), noisy, float(t[k]), bool(t[k] < 6.0), True))
    assert max(f for f, _, _ in found[:1195]) < 0.5
    worst = max(found[1205:])
    assert worst[0] > 2.0 and worst[1] == 0 and abs(worst[2]) == pytest.approx(4.0, abs=0.3)


def test_silent_at_rest_and_just_after(normal) -> None:
    vector, start = normal[0].copy(), normal[1]
    still = np.tile(np.concatenate([HOME, np.zeros(7)]), (100, 1))
    t = start + DT * np.arange(1, 101)
    assert all(found == (0.0, -1, 0.0) for found in feed(vector, t, still, np.full((100, 7), 5.0)))
    t, x, tau = moves(BREAKAWAY.long_enough - 1, float(t[-1]))
    assert all(f == 0.0 for f, _, _ in feed(vector, t, x, tau + 30.0))


def test_nothing_is_tested_before_it_is_known() -> None:
    vector = np.zeros(TEST.size)
    t, x, tau = moves(MOMENTUM_OBSERVER.least + MOMENTUM_OBSERVER.begun - 1)
    tau[MOMENTUM_OBSERVER.least :] += 40.0
    assert max(f for f, _, _ in feed(vector, t, x, tau)) == 0.0


def test_a_gap_joins_nothing_up(normal) -> None:
    vector, start = normal[0].copy(), normal[1]
    t, x, tau = moves(40, start + 3.0)
    assert max(f for f, _, _ in feed(vector, t, x, tau)) < 1.0
    TEST.begin(vector)
    assert not vector.any()


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1.0, 1.0)), min_size=1, max_size=20))
def test_whatever_comes_the_state_stays_finite(normal, messages: list[tuple[float, float, float]]) -> None:
    vector, t = normal[0].copy(), normal[1]
    for speed, torque, ahead in messages:
        t += ahead
        x, tau = np.concatenate([HOME, np.zeros(7)]), np.zeros(7)
        x[9], tau[2] = speed, torque
        found = TEST.follow(vector, x, np.zeros(4), tau, t, True, True)
        assert np.isfinite(found[0]) and np.all(np.isfinite(vector))
