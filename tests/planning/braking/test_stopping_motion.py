"""How the arm comes to rest and joins a plan again: limits, ends, smoothness, against closed forms and derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_diagram.planning.braking.stopping_motion import (
    TUNING,
    Rejoin,
    StraightStop,
    heading,
    pace,
    stopping_time,
    travelled,
)

FREE = np.full(2, 1e9)


def test_without_torque_limits_the_joint_that_needs_longest_sets_the_time() -> None:
    time = stopping_time(np.array([1.0, -3.0]), np.array([10.0, 6.0]), np.eye(2), np.zeros(2), FREE)
    assert time == pytest.approx(0.5)
    assert stopping_time(np.zeros(2), np.array([10.0, 6.0]), np.eye(2), np.zeros(2), FREE) == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_torques_while_braking_stay_within_limits_and_one_is_used_up(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, 3))
    mass, v, bias = A @ A.T + 0.5 * np.eye(3), rng.standard_normal(3), rng.uniform(-3.0, 3.0, 3)
    effort = np.full(3, 8.0)
    time = stopping_time(v, np.full(3, 200.0), mass, bias, effort)
    if time < TUNING.slowest:
        torque = bias - mass @ v / time
        assert np.all(np.abs(torque) <= effort + 1e-9)
        used = np.isclose(np.abs(torque), effort, atol=1e-9).any()
        assert used or time == pytest.approx(np.abs(v).max() / 200.0)


def test_an_arm_that_cannot_hold_its_weight_stops_all_the_same() -> None:
    time = stopping_time(np.array([1.0]), np.array([10.0]), np.eye(1), np.array([-9.0]), np.array([5.0]))
    assert time == pytest.approx(0.1), "what it lacks anyway does not count"
    slow = stopping_time(np.array([1.0]), np.array([10.0]), 100 * np.eye(1), np.zeros(1), np.array([5.0]))
    assert slow == TUNING.slowest


def test_a_stop_ends_half_its_time_at_full_speed_ahead_and_rests() -> None:
    stop = StraightStop(2.0, np.array([1.0, -1.0]), np.array([0.4, -0.8]), 0.5)
    assert stop.at(2.5) == pytest.approx([1.1, -1.2])
    assert stop.at(7.0) == pytest.approx(stop.at(2.5))
    assert stop.rate(2.0) == pytest.approx([0.4, -0.8])
    assert stop.rate(2.5) == pytest.approx([0.0, 0.0])
    assert stop.rate(9.0) == pytest.approx([0.0, 0.0])
    for t in (2.05, 2.2, 2.45):
        assert stop.rate(t) == pytest.approx((stop.at(t + 1e-6) - stop.at(t - 1e-6)) / 2e-6, abs=1e-6)
    assert StraightStop(0.0, np.ones(1), np.zeros(1), 0.0).at(1.0) == pytest.approx([1.0])


def test_before_it_slows_down_an_arm_goes_on_at_full_speed() -> None:
    assert travelled(0.03, 0.04, 0.2) == pytest.approx(0.03)
    assert travelled(1.0, 0.04, 0.2) == pytest.approx(0.04 + 0.1)
    assert travelled(-1.0, 0.04, 0.2) == 0.0
    assert pace(0.03, 0.04, 0.2) == 1.0
    assert pace(0.14, 0.04, 0.2) == pytest.approx(0.5)
    assert pace(0.3, 0.04, 0.2) == 0.0
    for t in (0.05, 0.1, 0.23):
        slope = (travelled(t + 1e-6, 0.04, 0.2) - travelled(t - 1e-6, 0.04, 0.2)) / 2e-6
        assert pace(t, 0.04, 0.2) == pytest.approx(slope, abs=1e-5)


def test_a_plan_is_joined_smoothly_and_within_a_share_of_the_limits() -> None:
    offset, speed, acceleration = np.array([0.5, -0.1]), np.array([2.0, 2.0]), np.array([10.0, 10.0])
    fade = Rejoin.within(1.0, offset, np.zeros(2), speed, acceleration)
    assert fade.at(1.0) == pytest.approx(offset)
    assert fade.at(1.0 + fade.time) == pytest.approx([0.0, 0.0])
    assert fade.at(99.0) == pytest.approx([0.0, 0.0])
    t = np.linspace(1.0, 1.0 + fade.time, 2001)
    q = np.array([fade.at(float(x)) for x in t])
    v = np.gradient(q, t, axis=0)
    a = np.gradient(v, t, axis=0)
    assert np.abs(v).max() <= TUNING.rejoin_share * 2.0 * 1.001
    assert np.abs(a[2:-2]).max() <= TUNING.rejoin_share * 10.0 * 1.01
    used = max(np.abs(v).max() / (TUNING.rejoin_share * 2.0), np.abs(a[2:-2]).max() / (TUNING.rejoin_share * 10.0))
    assert used > 0.98, "and no slower than that"
    assert np.abs(v[0]).max() < 1e-3 and np.abs(v[-1]).max() < 1e-3


@pytest.mark.long
@settings(max_examples=60)
@given(offset=st.floats(-0.5, 0.5), rate=st.floats(-1.0, 1.0), acceleration=st.floats(2.0, 20.0))
def test_joining_keeps_its_share_of_acceleration_whatever_the_plan_does(
    offset: float, rate: float, acceleration: float
) -> None:
    limits = np.array([2.0]), np.array([acceleration])
    fade = Rejoin.within(0.0, np.array([offset]), np.array([rate]), *limits)
    t = np.linspace(0.0, fade.time, 4001)
    q = np.array([fade.at(float(x))[0] for x in t])
    a = np.diff(q, 2) / (t[1] - t[0]) ** 2
    assert np.abs(a).max() <= TUNING.rejoin_share * acceleration * 1.01


def test_an_arm_at_rest_joins_a_plan_that_moves_without_a_jerk() -> None:
    fade = Rejoin(0.0, 0.4, np.zeros(1), np.array([-0.3]))
    assert (fade.at(1e-6) - fade.at(0.0)) / 1e-6 == pytest.approx([-0.3], abs=1e-4)
    assert fade.at(0.4) == pytest.approx([0.0])
    assert (fade.at(0.4) - fade.at(0.4 - 1e-6)) / 1e-6 == pytest.approx([0.0], abs=1e-4)


def test_commands_pass_to_the_bit_unless_they_leave_where_they_were_heading() -> None:
    before, rate = np.array([1.0, 2.0]), np.array([0.5, -0.5])
    near = np.array([1.0 + 0.05 + 0.019, 2.0 - 0.05 - 0.019])
    command, held = heading(near, before, rate, 0.1, 0.02)
    assert not held and command.tobytes() == near.tobytes()
    command, held = heading(np.array([1.0 + 0.05 + 0.03, 5.0]), before, rate, 0.1, 0.02)
    assert held
    assert command == pytest.approx([1.07, 1.97])
    command, held = heading(np.array([np.nan, 2.0]), before, rate, 0.1, 0.02)
    assert held
    assert command == pytest.approx([1.05, 1.95])
