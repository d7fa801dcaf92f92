"""How an alarm begins, goes on and ends: on the monitor's state alone."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.drift import alarm_lifecycle
from twin_diagram.estimation.drift.likelihood_ratio import AlarmShape
from twin_diagram.estimation.drift.state import DriftEntry, DriftState, Evidence
from twin_diagram.signals.layouts import NEVER, AlarmKind

N = 4
INNOVATION, ROLLOUT = AlarmKind.INNOVATION, AlarmKind.ROLLOUT
DEVIATIONS = 1.0 / np.sqrt(1.0 - 0.8**2)
"""A sum over five messages of one standard deviation."""


def state_with(*shares: float) -> DriftState:
    """Nothing alarmed yet; each joint's share of the change in standard deviations."""
    state = DriftState(N, 0, 3, 4, 0, 0, 0)
    state.sums[1, : len(shares)] = np.array(shares) * DEVIATIONS
    return state


def test_an_alarm_stands_for_half_a_second_after_its_test_was_quiet() -> None:
    state = state_with()
    h = state.header
    alarm_lifecycle.raise_alarm(state, INNOVATION, 2.0, 1.5, dt=0.005)
    alarm_lifecycle.raise_alarm(state, INNOVATION, 2.1, 1.2, dt=0.005)
    for t, stands in ((2.1, True), (2.599, True), (2.6, False), (2.7, False)):
        h[DriftEntry.TIME] = t
        assert alarm_lifecycle.stands(state) == stands
    assert h[DriftEntry.ALARMS] == 1 and h[DriftEntry.RAISED] == 2.0
    assert h[DriftEntry.STATISTIC] == 1.5 and h[DriftEntry.ABOVE] == pytest.approx(0.01)
    np.testing.assert_allclose(state.log[0], [2.0, INNOVATION, 1.5])
    alarm_lifecycle.raise_alarm(state, ROLLOUT, 2.6, 1.1, longer=0.7)
    assert h[DriftEntry.ALARMS] == 2 and h[DriftEntry.KIND] == ROLLOUT
    assert h[DriftEntry.QUIET] == pytest.approx(2.6 + 0.5 + 0.7)
    np.testing.assert_allclose(state.log[:2, 0], [2.0, 2.6])
    assert state.log[2, 0] == NEVER
    alarm_lifecycle.raise_alarm(state, INNOVATION, 2.7, 3.0)  # ends before the rollout's would: the later end counts
    assert h[DriftEntry.QUIET] == pytest.approx(3.8) and h[DriftEntry.ALARMS] == 2
    np.testing.assert_allclose(state.log[1], [2.6, ROLLOUT, 3.0])


def test_the_newest_thirty_two_are_kept() -> None:
    state = state_with()
    for k in range(33):
        alarm_lifecycle.raise_alarm(state, INNOVATION, float(k), 1.0 + 0.01 * k)
    assert state.log[0, 0] == 32.0 and state.log[1, 0] == 1.0 and state.log[31, 0] == 31.0
    alarm_lifecycle.raise_alarm(state, INNOVATION, 32.1, 9.0)
    assert state.log[0, 2] == 9.0 and state.log[31, 2] == pytest.approx(1.31)


def test_a_sensor_is_named_by_the_first_that_is_one() -> None:
    state = state_with()
    assert state.header[DriftEntry.SENSOR] == -1.0
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.0, 2.0)
    assert state.evidence[0, Evidence.SENSOR] == -1.0
    alarm_lifecycle.raise_alarm(state, AlarmKind.SENSOR, 1.1, 1.5, sensor=0)
    assert state.header[DriftEntry.SENSOR] == state.evidence[0, Evidence.SENSOR] == 0.0
    alarm_lifecycle.raise_alarm(state, AlarmKind.SENSOR, 1.2, 1.5, sensor=2)
    assert state.evidence[0, Evidence.SENSOR] == 0.0
    alarm_lifecycle.raise_alarm(state, INNOVATION, 9.0, 2.0)
    assert state.evidence[1, Evidence.SENSOR] == -1.0


@pytest.mark.parametrize(
    ("shares", "joint"),
    [
        ((3.9, 0.0, 0.0, 0.0), -1.0),  # nothing stands out by four deviations
        ((0.0, 4.1, 0.0, 0.0), 1.0),
        ((0.0, 0.0, -4.1, 0.0), 2.0),
        ((0.0, 4.5, 9.0, 9.0), 1.0),  # the first that is two fifths of the largest, whatever the sign
        ((0.0, 4.5, -10.9, 0.0), 1.0),
        ((0.0, 4.5, -11.6, 0.0), 2.0),
        ((4.1, 30.0, 13.0, 0.0), 1.0),
    ],
)
def test_the_joint_that_stands_out_is_named(shares: tuple[float, ...], joint: float) -> None:
    state = state_with(*shares)
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.0, 2.0)
    assert state.header[DriftEntry.JOINT] == state.evidence[0, Evidence.JOINT] == joint
    np.testing.assert_allclose(state.evidence[0, len(Evidence) :], shares, atol=1e-9)


def test_a_name_is_kept_after_a_tenth_of_a_second() -> None:
    for later, joint in ((1.099, 2.0), (1.101, 1.0)):
        state = state_with(0.0, 8.0)
        alarm_lifecycle.raise_alarm(state, INNOVATION, 1.0, 2.0)
        state.sums[1] = np.array([0.0, 0.0, 8.0, 0.0]) * DEVIATIONS
        alarm_lifecycle.raise_alarm(state, INNOVATION, later, 2.5)
        assert state.header[DriftEntry.JOINT] == joint
    state = state_with()  # and one that had none gets one whenever it comes
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.0, 2.0)
    state.sums[1] = np.array([8.0, 0.0, 0.0, 0.0]) * DEVIATIONS
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.3, 1.9)  # no worse: the evidence stays
    assert state.header[DriftEntry.JOINT] == -1.0
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.3, 2.1)
    assert state.header[DriftEntry.JOINT] == 0.0


def test_a_joint_that_gained_torque_is_named_where_none_or_the_same_stands_out() -> None:
    for shares, joint, torque in (((), 3.0, -2.5), ((0.0, 0.0, 0.0, 8.0), 3.0, -2.5), ((0.0, 8.0), 1.0, 0.0)):
        state = state_with(*shares)
        alarm_lifecycle.raise_alarm(state, INNOVATION, 1.0, 2.0, gained=(3, -2.5))
        assert state.evidence[0, Evidence.JOINT] == joint and state.evidence[0, Evidence.TORQUE] == torque


def test_evidence_is_that_of_the_worst_moment() -> None:
    state = state_with()
    h = state.header
    at = [DriftEntry.NIS, DriftEntry.CHANGE, DriftEntry.ROLLOUT, DriftEntry.SUM, DriftEntry.HAND]
    rows = [Evidence.NIS, Evidence.CHANGE, Evidence.ROLLOUT, Evidence.SUM, Evidence.HAND]
    h[at] = [16.0, 1.0, 2.0, 3.0, 4.0]
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.0, 2.0)
    expected = [16.0 / (2 * N), 1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(state.evidence[0, rows], expected)
    h[at] = [32.0, 5.0, 6.0, 7.0, 8.0]
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.1, 2.0)
    np.testing.assert_allclose(state.evidence[0, rows], expected)
    alarm_lifecycle.raise_alarm(state, INNOVATION, 1.2, 2.01)
    np.testing.assert_allclose(state.evidence[0, rows], [4.0, 5.0, 6.0, 7.0, 8.0])


def test_the_largest_statistic_of_each_tenth_is_kept() -> None:
    state = state_with()
    h = state.header
    for k in range(100):  # 40 ms apart: three messages to a tenth, then four
        t = 0.04 * k
        alarm_lifecycle.turn_over(state, t)
        alarm_lifecycle.note(state, 0.01 * k)
    assert h[DriftEntry.TENTHS] == 30.0
    starts = [0]
    for k in range(100):
        if 0.04 * k - 0.04 * starts[-1] >= 0.1:
            starts.append(k)
    largest = [0.01 * (k - 1) for k in starts[1:]]
    np.testing.assert_allclose(state.tenths, largest[-30:])
    alarm_lifecycle.note(state, 0.005)
    assert h[DriftEntry.TENTH] == pytest.approx(0.99)


def test_tenths_go_on_where_a_clock_was_set_back() -> None:
    state = state_with()
    for t in (1000.0, 1000.1, 1.0, 1.1):
        alarm_lifecycle.turn_over(state, t)
        alarm_lifecycle.note(state, 1e-3 * t)
    assert state.header[DriftEntry.FROM] == 1.1 and state.header[DriftEntry.TENTH] == pytest.approx(1.1e-3)


def test_tenths_that_were_never_seen_tell_no_shape() -> None:
    """Five tenths in which it grew are too few; with a sixth it is a trend."""
    for seen, shape in ((5.0, AlarmShape.STEP), (6.0, AlarmShape.TREND)):
        state = state_with()
        state.tenths[-6:] = [0.1, 0.2, 0.3, 0.5, 0.6, 0.7]
        state.header[DriftEntry.TENTHS] = seen
        alarm_lifecycle.raise_alarm(state, INNOVATION, 1.0, 2.0)
        assert state.header[DriftEntry.SHAPE] == state.evidence[0, Evidence.SHAPE] == shape


@pytest.mark.parametrize(
    ("above", "tenth", "moved", "shape"),
    [
        (0.059, 0.9, 0.0, AlarmShape.SPIKE),
        (0.06, 0.9, 0.0, AlarmShape.SPIKE),
        (0.061, 0.9, 0.0, AlarmShape.STEP),
        (0.01, 1.0, 0.0, AlarmShape.STEP),
        (0.01, 0.9, 1.0, AlarmShape.STEP),
    ],
)
def test_what_is_gone_at_once_was_a_spike(above: float, tenth: float, moved: float, shape: AlarmShape) -> None:
    state = state_with()
    h = state.header
    alarm_lifecycle.raise_alarm(state, INNOVATION, 0.5, 2.0)
    alarm_lifecycle.raise_alarm(state, INNOVATION, 5.0, 2.0)
    h[[DriftEntry.ABOVE, DriftEntry.TENTH, DriftEntry.MOVED]] = above, tenth, moved
    alarm_lifecycle.reshape(state)
    assert h[DriftEntry.SHAPE] == state.evidence[1, Evidence.SHAPE] == shape
    assert state.evidence[0, Evidence.SHAPE] == AlarmShape.STEP
    assert state.evidence[1, Evidence.ABOVE] == above
    h[DriftEntry.SHAPE] = AlarmShape.TREND
    alarm_lifecycle.reshape(state)
    assert h[DriftEntry.SHAPE] == state.evidence[1, Evidence.SHAPE] == AlarmShape.TREND
