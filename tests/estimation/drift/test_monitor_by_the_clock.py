"""When the monitor learns, arms itself, begins anew: to the message; on an arm that never moves."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

from tests.estimation.small_arms import gantry
from twin_diagram.estimation.drift.monitor import DriftEntry, Monitor
from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.scenario import Drift, Filter
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, AlarmKind

ARM = gantry()
DT, STEPS = 0.0078125, 32
"""A message every 128th of a second: a quarter of a second is 32, to the bit."""
MOMENT = np.array([1.0, 0.0, 0.0, 0.0])
STILL, NONE = np.zeros(4), np.zeros(2)
DRIFT = Drift(learning_time=1.0)


def monitor(drift: Drift = DRIFT, sensors: dict[str, int] | None = None, mass_std: float = 1.0) -> Monitor:
    return Monitor(ARM, drift, Filter(mass_std=mass_std), sensors)


def say(
    made: Monitor,
    t: float,
    nis: float = 4.0,
    theta: Array | None = None,
    q: Array = NONE,
    tau: Array = NONE,
    **more: Any,
) -> None:
    made.observe(STILL, np.zeros(4) if theta is None else theta, nis, q, tau, t, **more)


@functools.cache
def settled_vector(learning_time: float, seconds: float, sensors: tuple[tuple[str, int], ...]) -> tuple[Array, float]:
    made, t = monitor(Drift(learning_time=learning_time), dict(sensors)), 1.0
    for _ in range(round(seconds / DT)):
        say(made, t)
        t += DT
    return made.vector, t


def settled(
    learning_time: float = 1.0, seconds: float = 1.5, sensors: dict[str, int] | None = None
) -> tuple[Monitor, float]:
    """A monitor that has heard nothing wrong since the first second, and the time of the message to come."""
    vector, t = settled_vector(learning_time, seconds, tuple((sensors or {}).items()))
    made = monitor(Drift(learning_time=learning_time), sensors)
    made.vector[:] = vector
    return made, t


def test_it_arms_itself_when_normal_operation_has_lasted_the_learning_time() -> None:
    """A quarter of a second after the first message parameters have settled; that message is the first to learn."""
    made, armed = monitor(), []
    for k in range(300):
        say(made, 1.0 + DT * k)
        armed.append(made.armed)
    first = STEPS + round(1.0 / DT) - 1
    assert armed.index(True) == first
    assert made.header[DriftEntry.NORMAL] == pytest.approx(1.0)


@pytest.mark.parametrize(("mass_std", "rate", "learns"), [(1.0, 0.049, True), (1.0, 0.051, False), (2.0, 0.09, True)])
def test_parameters_have_settled_that_change_by_a_twentieth_in_a_quarter_of_a_second(
    mass_std: float, rate: float, learns: bool
) -> None:
    made = monitor(mass_std=mass_std)
    for k in range(4 * STEPS):
        say(made, 1.0 + DT * k, theta=rate * (k // STEPS) * MOMENT)
    assert (made.header[DriftEntry.NORMAL] > 0.0) == learns
    assert made.header[DriftEntry.SETTLED] == float(learns)


def test_after_five_learning_times_it_is_taken_for_granted() -> None:
    made, began = monitor(Drift(learning_time=0.25)), 0.0
    for k in range(260):
        say(made, 1.0 + DT * k, theta=float(k // STEPS % 2) * MOMENT)
        if made.header[DriftEntry.NORMAL] > 0.0 and not began:
            began = DT * k
    assert began == pytest.approx(1.5)  # checked every quarter of a second, later than five of them


def test_a_gap_or_a_clock_set_back_joins_nothing_up() -> None:
    for ahead, joined in ((0.25, True), (0.2578125, False), (-0.5, False)):
        made, t = settled(10.0)
        normal = float(made.header[DriftEntry.NORMAL])
        say(made, t - DT + ahead, nis=5.0, theta=(0.0 if joined else 0.5) * MOMENT)
        h = made.header
        assert h[DriftEntry.NORMAL] == pytest.approx(normal + joined * ahead)
        if not joined:
            now = t - DT + ahead
            assert h[DriftEntry.SETTLED] == 0.0 and h[DriftEntry.STARTED] == NEVER
            assert h[DriftEntry.TIME] == h[DriftEntry.CHECKED] == h[DriftEntry.NEXT] == now
            assert h[DriftEntry.SINCE] == 1.0
            assert made.state.checked[0] == 0.5
    made, t = settled()
    say(made, 0.25)
    assert made.header[DriftEntry.SINCE] == 0.25


def test_a_message_seen_before_or_unsound_is_left_out() -> None:
    made, t = settled()
    before = made.vector.copy()
    say(made, t - DT, nis=1e9)
    for nis, when in ((np.nan, t), (np.inf, t), (-1.0, t), (4.0, -1.0), (4.0, np.inf), (4.0, np.nan)):
        say(made, when, nis=nis)
    for wild in (1e6, -1e6, np.nan, -np.inf):
        say(made, t, theta=np.array([wild, 0.0, 0.0, 0.0]))
        say(made, t, q=np.array([0.0, wild]))
        say(made, t, tau=np.array([wild, 0.0]))
        say(made, t, innovation=np.array([wild, 0.0]))
    np.testing.assert_array_equal(made.vector, before)
    say(made, t, tau=np.array([0.999e6, 0.0]))
    assert made.header[DriftEntry.TIME] == t


def test_at_first_the_average_is_that_of_the_first_message_but_no_more_than_is_normal() -> None:
    for nis, first in ((3.0, 3.0), (50.0, 4.0)):
        made = monitor()
        say(made, 0.0, nis=nis, theta=0.25 * MOMENT)
        h = made.header
        assert h[DriftEntry.NIS] == first and h[DriftEntry.SINCE] == h[DriftEntry.CHECKED] == 0.0
        assert h[DriftEntry.NEXT] == 0.25 and h[DriftEntry.TIME] == 0.0
        assert made.state.checked[0] == 0.25 and not made.active


def test_nothing_is_an_alarm_before_it_is_armed_and_a_jump_is_one_with_its_second_message() -> None:
    made, t = settled(seconds=1.0)
    assert not made.armed
    for k in range(3):
        say(made, t + DT * k, nis=1e5)
    np.testing.assert_array_equal(made.alarm(), [0.0, AlarmKind.NONE, NEVER, 0.0])
    made, t = settled()
    say(made, t, nis=1e5)
    assert not made.active
    say(made, t + DT, nis=1e5)
    assert made.active
    active, kind, raised, statistic = made.alarm()
    assert (active, kind, raised) == (1.0, AlarmKind.INNOVATION, t + DT)
    assert statistic == pytest.approx(4.0 / 3.0, rel=0.3) and statistic > 1.0


def test_an_alarm_ends_and_its_shape_is_told() -> None:
    made, t = settled()
    end = 0.0
    for k in range(200):
        say(made, t + DT * k, nis=1e5 if k in (5, 6) else 4.0)
        if made.active:
            end = DT * k
        if k == 20:
            assert made.header[DriftEntry.SHAPE] == 1.0  # a spike: it is gone
    assert 6 * DT + 0.5 - 0.01 < end < 6 * DT + 0.65
    assert made.header[DriftEntry.ALARMS] == 1.0


def test_parameters_that_move_during_an_alarm_make_a_step_of_it() -> None:
    for mass, moved in ((0.2, 1.0), (0.01, 0.0)):
        made, t = settled()
        for k in range(80):
            say(made, t + DT * k, nis=1e5 if k in (5, 6) else 4.0, theta=(mass if k > 10 else 0.0) * MOMENT)
        assert made.header[DriftEntry.MOVED] == moved
        assert made.header[DriftEntry.SHAPE] == (2.0 if moved else 1.0)
    made, t = settled()
    for k in range(80):
        say(made, t + DT * k, theta=0.2 * k * MOMENT)
    assert made.header[DriftEntry.MOVED] == 0.0


def test_a_rollout_that_misses_is_an_alarm_that_outlasts_a_period() -> None:
    made, t = settled()
    raised = 0.0
    for k in range(100):
        say(made, t + DT * k, q=np.array([0.05, 0.0]))
        if made.active and not raised:
            raised = t + DT * k
    assert raised and made.header[DriftEntry.KIND] == AlarmKind.ROLLOUT
    assert made.header[DriftEntry.QUIET] >= raised + 0.5 + 0.5
    assert made.header[DriftEntry.ROLLOUT] > 1.0


def test_a_torque_gained_on_a_sliding_joint_names_it() -> None:
    made = monitor(Drift(learning_time=1.0))
    t, q = 1.0, 0.0
    for k in range(900):
        tau = np.array([0.0, 3.0 * (k > 700)])
        made.observe(np.array([q, -q, 0.5, -0.5]), np.zeros(4), 4.0, np.array([q, -q]), tau, t)
        t, q = t + DT, q + 0.5 * DT
        if made.active:
            break
    assert 700 < k < 730
    assert made.header[DriftEntry.JOINT] == 1.0
    gained = made.evidence[0, 9]
    assert -3.1 < gained < -1.0


def test_a_sensor_s_reading_comes_after_a_message() -> None:
    made, t = settled(sensors={"imu": 6, "torque": 2})
    assert made.sensors == ("imu", "torque")
    fresh = monitor(sensors={"torque": 2})
    fresh.reading("torque", np.zeros(2), True)
    assert not fresh.state.sensors.any()
    rng = np.random.default_rng(0)
    for _ in range(450):
        t += DT
        say(made, t)
        made.reading("imu", rng.normal(size=6), True)
        made.reading("torque", rng.normal(size=2), True)
    assert not made.active
    for _ in range(20):
        t += DT
        say(made, t)
        made.reading("torque", np.array([5.0, 0.0]), True)
    assert made.active and made.alarm()[1] == AlarmKind.SENSOR
    assert made.header[DriftEntry.SENSOR] == 1.0
    assert made.header[DriftEntry.TENTH] > 0.0 or made.state.tenths.max() > 1.0


def test_a_corrected_model_begins_anew_and_keeps_what_is_normal() -> None:
    made, t = settled()
    for k in range(60):
        say(made, t + DT * k, nis=1e5 if k < 5 else 4.0, theta=0.5 * MOMENT)
    assert made.active
    h = made.header
    now, count = float(h[DriftEntry.TIME]), float(h[DriftEntry.COUNT])
    h[[DriftEntry.ROLLOUT, DriftEntry.SUM, DriftEntry.TENTH]] = 2.0
    made.begin_anew()
    assert not made.active and made.armed and h[DriftEntry.COUNT] == count
    assert h[DriftEntry.NEXT] == now + 0.25 and h[DriftEntry.CHECKED] == now and h[DriftEntry.SETTLED] == 0.0
    entries = [DriftEntry.ROLLOUT, DriftEntry.SUM, DriftEntry.TENTH, DriftEntry.TENTHS, DriftEntry.CHANGE]
    assert not h[entries].any() and not made.state.motors.any() and not made.state.checked.any()
    h[DriftEntry.QUIET] = 1.5
    made.begin_anew()
    assert h[DriftEntry.QUIET] == 1.5


def test_watching_a_belief_is_observing_what_it_holds() -> None:
    first, _ = settled()
    second, t = settled()
    belief = Belief(2, 4)
    belief.x[:4], belief.theta[:] = [0.1, 0.2, 0.3, 0.4], 0.02
    belief.innovation[:] = [0.5, -0.5]
    belief.header[[Entry.NIS, Entry.TIME]] = 6.0, t
    q, tau = np.array([0.11, 0.19]), np.array([1.0, 2.0])
    assert not first.watch(belief, q, tau)
    second.observe(belief.x[:4].copy(), belief.theta.copy(), 6.0, q, tau, t, innovation=np.array([0.5, -0.5]))
    np.testing.assert_array_equal(first.vector, second.vector)
    first.header[DriftEntry.QUIET] = t + 9.0
    belief.header[Entry.TIME] = t + DT
    assert first.watch(belief, q, tau)


def test_three_tests_share_the_rate_and_one_more_for_each_further_sensor() -> None:
    for sensors, tests in ((None, 3), ({"a": 3, "b": 3}, 5)):
        made = monitor(sensors=sensors)
        assert made.state.margins.size == 1 + tests * (5 + 16)
