"""Rollouts of arms whose motion fits on a line: what they miss, when they run, and what is allowed them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import INERTIA, RADIUS, constant_friction, crank, gantry
from twin_diagram.estimation.drift.rollout_statistic import RolloutTest, white_std
from twin_diagram.estimation.drift.state import DriftEntry, DriftState
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.scenario import Drift, Filter
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER

TUNING = Filter(parameters=[])
DRIFT = Drift()
DT, SPAN, SIGMA = 0.005, 0.1, 6.0


def rollout_test(terms: ArmTerms) -> tuple[RolloutTest, DriftState]:
    rollouts = RolloutTest(terms, ParameterSet(terms, TUNING), DRIFT, TUNING)
    state = DriftState(terms.n, 0, 3, RolloutTest.rows(DRIFT, TUNING), 0, 0, 0)
    return rollouts, state


def run(
    rollouts: RolloutTest, state: DriftState, x: Array, q_end: Array, tau: Array, start: float, learning: bool
) -> float:
    """One rollout from x under a constant torque to a measured end; answers the statistic."""
    found = []
    state.header[[DriftEntry.STARTED, DriftEntry.NEXT]] = NEVER, start
    for k in range(round(SPAN / DT) + 1):
        t = start + DT * k
        found.append(rollouts.follow(state, x, np.zeros(0), q_end, tau, t, t, learning, not learning))
    assert not any(found[:-1])
    return found[-1]


def ends(x: Array, tau: float, inertia: float) -> float:
    return float(x[0] + SPAN * x[1] + 0.5 * SPAN**2 * tau / inertia)


def test_the_error_is_a_torque_and_a_way_of_the_hand() -> None:
    """A crank that ends 0.02 rad ahead: as much as 2 I e / T² of torque, 2 r sin(e/2) at the hand."""
    rollouts, state = rollout_test(crank())
    x, tau, e = np.array([0.3, 1.0]), np.array([2.0]), 0.02
    end = ends(x, 2.0, INERTIA)
    for k, error in enumerate((e, -e, 2.0 * e, 0.0)):
        assert run(rollouts, state, x, np.array([end + error]), tau, 1.0 + k, True) == 0.0
    assert state.header[DriftEntry.ROLLOUTS] == 4.0
    torque = 2.0 * INERTIA / SPAN**2 * np.array([e, e, 2.0 * e, 0.0])
    hand = 2.0 * RADIUS * np.sin(0.5 * np.array([e, e, 2.0 * e, 0.0]))
    for row, values in enumerate((torque, hand)):
        assert state.roll_mean[row] == pytest.approx(np.mean(values), rel=1e-3)
        assert state.roll_squares[row] == pytest.approx(4.0 * np.var(values), rel=1e-3)


@pytest.mark.parametrize("level", [(0.0, 0.0), (4.0, 2.0)])
def test_what_the_filter_allows_is_k_deviations(level: tuple[float, float]) -> None:
    """Nothing learnt: drift of 0.1 N·m and 15 % of dry friction, white torque, and what both do to the hand."""
    forward, backward = level
    rollouts, state = rollout_test(crank(laws=constant_friction(forward, backward=(backward,))))
    x, tau = np.array([0.3, 2.0]), np.array([5.0])
    end = ends(x, 5.0 - forward, INERTIA)
    std = np.hypot(np.hypot(0.1, 0.15 * 0.5 * (forward + backward)), 0.3 * np.sqrt(4.0 / (3.0 * 20.0)))
    for error in (0.005, 0.01):
        found = run(rollouts, state, x, np.array([end + error]), tau, 1.0 + error, False)
        assert found == pytest.approx(2.0 * INERTIA * error / SPAN**2 / (SIGMA * std), rel=2e-2 if forward else 1e-3)
        assert state.header[DriftEntry.ROLLOUT] == found
        assert state.header[DriftEntry.HAND] == pytest.approx(2.0 * RADIUS * np.sin(0.5 * error), rel=3e-2)


def test_each_joint_has_its_own_and_the_hand_counts_too() -> None:
    """A gantry's hand goes as far as its slides do: what the slides' torques may do to it stands below its error."""
    rollouts, state = rollout_test(gantry())
    still, none = np.zeros(4), np.zeros(2)
    masses, std = np.array([5.0, 2.0]), np.hypot(0.1, 0.3 * np.sqrt(4.0 / 60.0))
    for error in (np.array([0.004, 0.0]), np.array([0.0, 0.01]), np.array([-0.004, 0.009])):
        found = run(rollouts, state, still, error, none, 1.0 + abs(float(error[1])), False)
        torque = 2.0 * masses * np.abs(error) / SPAN**2 / (SIGMA * std)
        way = 0.5 * SPAN**2 * std / masses
        hand = np.linalg.norm(error) / (SIGMA * np.linalg.norm(way))
        assert found == pytest.approx(max(torque.max(), hand), rel=1e-6)


def test_what_was_learnt_widens_it() -> None:
    """μ + kσ of normal operation, wider by 2/√N: beyond what the filter allows."""
    rollouts, state = rollout_test(crank())
    still, none = np.zeros(2), np.zeros(1)
    h = state.header
    h[DriftEntry.ROLLOUTS] = 16.0
    state.roll_mean[:], state.roll_squares[:] = [5.0, 0.5], [16.0 * 4.0, 16.0 * 0.01]
    usual = 5.0 + SIGMA * 1.5 * 2.0
    found = run(rollouts, state, still, np.array([0.4]), none, 1.0, False)
    assert found == pytest.approx(2.0 * INERTIA * 0.4 / SPAN**2 / usual, rel=1e-6)
    assert found > h[DriftEntry.HAND] / (0.5 + SIGMA * 1.5 * 0.1)


def test_a_hand_on_its_joint_s_axis_raises_nothing() -> None:
    arm = ArmTerms(crank().plant, ["pin"])  # the tool is the link's own origin, on the pin
    rollouts, state = rollout_test(arm)
    found = run(rollouts, state, np.zeros(2), np.array([0.001]), np.zeros(1), 1.0, False)
    assert found == pytest.approx(
        2.0 * INERTIA * 0.001 / SPAN**2 / (SIGMA * np.hypot(0.1, 0.3 / np.sqrt(15.0))), rel=1e-6
    )


def test_a_rollout_that_runs_away_is_a_million_off() -> None:
    rollouts, state = rollout_test(crank())
    run(rollouts, state, np.array([0.0, 1e9]), np.zeros(1), np.zeros(1), 1.0, True)
    np.testing.assert_array_equal(state.roll_mean, 1e6)


def test_rollouts_follow_each_other_until_armed_and_then_every_period() -> None:
    rollouts, state = rollout_test(gantry())
    starts: dict[bool, list[float]] = {}
    for armed in (False, True):
        state.header[[DriftEntry.STARTED, DriftEntry.NEXT]] = NEVER, 0.0
        seen: list[float] = []
        for k in range(400):
            t = 10.0 + DT * k
            rollouts.follow(state, np.zeros(4), np.zeros(0), np.zeros(2), np.zeros(2), t, t, False, armed)
            if state.header[DriftEntry.STARTED] not in (NEVER, *seen):
                seen.append(float(state.header[DriftEntry.STARTED]))
        starts[armed] = seen
    np.testing.assert_allclose(np.diff(starts[False]), DRIFT.horizon, atol=1e-9)
    np.testing.assert_allclose(np.diff(starts[True]), DRIFT.period, atol=1e-9)
    assert len(starts[False]) == 20 and len(starts[True]) == 4


def test_torques_are_those_since_the_state() -> None:
    """A state carried on beyond its message starts the rollout there; the torque then is the newest before it."""
    rollouts, state = rollout_test(gantry())
    h, none = state.header, np.zeros(2)
    rollouts.follow(state, np.arange(4.0), np.zeros(0), none, np.array([1.0, 1.0]), 1.0, 1.004, False, True)
    assert h[DriftEntry.STARTED] == 1.004 and h[DriftEntry.FILLED] == 1.0
    np.testing.assert_array_equal(state.from_state, np.arange(4.0))
    np.testing.assert_array_equal(state.torques[0], [1.004, 1.0, 1.0])
    rollouts.follow(state, none, np.zeros(0), none, np.array([2.0, 2.0]), 1.004, 1.004, False, True)
    np.testing.assert_array_equal(state.torques[0], [1.004, 2.0, 2.0])
    rollouts.follow(state, none, np.zeros(0), none, np.array([3.0, 4.0]), 1.009, 1.01, False, True)
    np.testing.assert_array_equal(state.torques[:2], [[1.004, 2.0, 2.0], [1.009, 3.0, 4.0]])
    assert h[DriftEntry.FILLED] == 2.0
    np.testing.assert_array_equal(state.from_state, np.arange(4.0))


def test_messages_twice_as_fast_as_expected_fit_and_faster_ones_end_a_rollout() -> None:
    assert RolloutTest.rows(DRIFT, TUNING) == 2 * 20 + 4
    for step, ended in ((0.0025, False), (0.002, True)):
        rollouts, state = rollout_test(gantry())
        h = state.header
        k = 0
        while h[DriftEntry.STARTED] < 0.0 or k == 0:
            rollouts.follow(
                state, np.zeros(4), np.zeros(0), np.zeros(2), np.zeros(2), 1.0 + step * k, 1.0 + step * k, True, False
            )
            k += 1
        while h[DriftEntry.STARTED] == 1.0:
            rollouts.follow(
                state, np.zeros(4), np.zeros(0), np.zeros(2), np.zeros(2), 1.0 + step * k, 1.0 + step * k, True, False
            )
            k += 1
        assert (h[DriftEntry.ROLLOUTS] == 0.0) == ended


@pytest.mark.parametrize("span", [1e-3, 0.1, 0.5])
def test_white_torque_over_a_span(span: float) -> None:
    """No span is shorter than one step of the filter."""
    assert white_std(TUNING, span) == pytest.approx(0.3 * np.sqrt(4.0 / (3.0 * max(200.0 * span, 1.0))))
