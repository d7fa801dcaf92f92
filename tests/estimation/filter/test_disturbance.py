"""The disturbance torque: how large it is thought, what is kept of it, when a joint slides."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from tests.estimation.small_arms import INERTIA, crank
from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.disturbance import (
    creep_std,
    disturbance_std,
    follow_disturbance,
    follow_regimes,
    sure_to_slide,
)
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Filter

PARAMS = Filter()
LEVEL = np.array([4.0, 4.0])


def belief_of(*speeds: float) -> Belief:
    belief = Belief(len(speeds), 0)
    belief.v[:] = belief.drift[:] = speeds
    return belief


def test_a_resting_joint_may_hold_its_stiction_and_a_sliding_one_a_share_of_it() -> None:
    """15 % of dry friction, 5 % where its level is learnt, beside 0.1 N·m."""
    both = np.array([True, False])
    np.testing.assert_allclose(disturbance_std(PARAMS, both, LEVEL), [np.hypot(0.1, 0.6), np.hypot(0.1, 4.0)])
    learnt = Filter(parameters=["coulomb_friction"])
    np.testing.assert_allclose(disturbance_std(learnt, both, LEVEL), [np.hypot(0.1, 0.2), np.hypot(0.1, 4.0)])


def test_creeping_joints_have_white_friction() -> None:
    speeds = np.array([0.0, 0.025, -0.05, 0.5])
    np.testing.assert_allclose(creep_std(speeds, np.full(4, 3.0)), 3.0 * np.exp(-((speeds / 0.025) ** 2)))
    # Where the speed is known to σ, it may be none within two of them.
    found = creep_std(np.array([0.1]), np.array([3.0]), np.array([0.04**2]))
    np.testing.assert_allclose(found, 3.0 * np.exp(-0.01 / (0.025**2 + 0.08**2)))


def test_how_sure_it_is_that_a_joint_slides_is_the_mean_of_its_speed_s_sign() -> None:
    belief = belief_of(0.03, -0.01, 0.5, 0.02)
    belief.regime[:] = [1.0, -1.0, 1.0, 0.0]
    std = np.array([0.02, 0.02, 0.0, 0.02])
    belief.P[np.arange(4, 8), np.arange(4, 8)] = std**2
    with np.errstate(divide="ignore"):
        expected = [2.0 * norm.cdf(0.03 / 0.02) - 1.0, 2.0 * norm.cdf(0.01 / 0.02) - 1.0, 1.0, 0.0]
    np.testing.assert_allclose(sure_to_slide(belief), expected)


@pytest.mark.parametrize(
    ("params", "starts", "stops"),
    [(Filter(), 0.004, 0.002), (Filter(excitation=0.01), 0.01, 0.005), (Filter(velocity_std=1e-3), 0.003, 0.0015)],
)
def test_a_joint_slides_beyond_excitation_and_noise_and_goes_on_at_half_that(
    params: Filter, starts: float, stops: float
) -> None:
    """Two deviations of the velocity sensor, or the filter's excitation."""
    for before, speed, regime in (
        (0.0, 1.01 * starts, 1.0),
        (0.0, 0.99 * starts, 0.0),
        (0.0, -1.01 * starts, -1.0),
        (1.0, 1.01 * stops, 1.0),
        (1.0, 0.99 * stops, 0.0),
        (1.0, -1.01 * stops, -1.0),
    ):
        belief = belief_of(speed)
        belief.regime[:] = before
        _, _, changed = follow_regimes(belief, params, 0.005, np.ones(1))
        assert belief.regime[0] == regime
        assert changed[0] == (regime != before)


def test_speeds_are_low_passed_over_a_fiftieth_of_a_second() -> None:
    belief = belief_of(1.0)
    belief.drift[:] = 0.2
    follow_regimes(belief, PARAMS, 0.005, np.ones(1))
    assert belief.drift[0] == pytest.approx(0.4)
    follow_regimes(belief, PARAMS, 0.05, np.ones(1))
    assert belief.drift[0] == pytest.approx(1.0)


def test_what_is_kept_of_it() -> None:
    """Sliding: forgotten within a second, its variance kept; resting: kept and never drawn back; changed: afresh."""
    belief = belief_of(0.5, 0.0, 0.5, 0.0)
    belief.regime[:] = [1.0, 0.0, 0.0, -1.0]
    belief.steady[:] = [np.log(0.25), np.log(0.5), np.log(0.25), 0.0]
    level, dt = np.array([4.0, 4.0, 4.0, 4.0]), 0.01
    keep, fresh, changed = follow_regimes(belief, PARAMS, dt, level)
    slides, rests = 0.1**2 + 0.6**2, 0.1**2 + 4.0**2
    forget = np.exp(-0.01)
    np.testing.assert_array_equal(changed, [False, False, True, True])
    np.testing.assert_allclose(keep, [forget, 1.0, 0.0, 0.0])
    stationary = (1.0 - forget**2) * slides * 0.25
    np.testing.assert_allclose(fresh, [stationary, rests * dt / 0.1, slides * 0.25, rests])


@pytest.mark.parametrize(
    ("speed", "regime", "learns"),
    [(0.051, 1.0, True), (-0.051, -1.0, True), (0.05, 1.0, False), (0.049, 1.0, False), (0.2, 0.0, False)],
)
def test_how_large_it_is_is_learnt_of_joints_that_slide(speed: float, regime: float, learns: bool) -> None:
    belief = belief_of(speed)
    belief.regime[:] = regime
    follow_disturbance(belief, PARAMS, np.array([0.04]), 0.1)
    assert (belief.steady[0] < 0.0) == learns and (belief.told[0] > 0.0) == learns


def test_it_is_the_mean_of_its_posterior_squares_beside_one_as_given() -> None:
    """Slowly: each independent value (one a second) counts as one, thirty of them at most; none for more than nine."""
    belief, variance, dt = belief_of(0.5), np.array([0.04]), 0.02
    belief.regime[:] = 1.0
    factor, told = 1.0, 0.0
    rng = np.random.default_rng(1310)
    for k in range(3000):
        belief.disturbance[:] = rng.normal(0.0, 0.05) * (60.0 if k % 97 == 0 else 1.0)
        belief.P[2, 2] = 0.0009
        square = min((belief.disturbance[0] ** 2 + 0.0009) / (0.04 * factor), 9.0)
        told = min(told + dt, 30.0)
        factor = float(np.clip(factor * (1.0 + dt * (square - 1.0) / (1.0 + told)), 0.01, 1.0))
        follow_disturbance(belief, PARAMS, variance, dt)
        if k in (10, 500, 2999):
            assert np.exp(belief.steady[0]) == pytest.approx(factor, rel=1e-9)
            assert belief.told[0] == pytest.approx(told)
    assert told == 30.0 and 0.05 < factor < 0.5


def test_it_is_never_thought_larger_than_given_nor_below_a_hundredth() -> None:
    for d, P, expected in ((5.0, 0.0, 0.0), (0.0, 0.0, -2.0 * np.log(10.0))):
        belief = belief_of(0.5)
        belief.regime[:] = 1.0
        for _ in range(400):
            belief.disturbance[:], belief.P[2, 2] = d, P
            follow_disturbance(belief, PARAMS, np.array([0.04]), 0.5)
        assert belief.steady[0] == pytest.approx(expected)


def test_a_disturbance_that_is_told_to_be_none_stays_none() -> None:
    """On an arm without friction: of no variance no share can be learnt, and the filter began anew at each message."""
    ekf = Ekf(crank(), Filter(torque_drift_std=0.0))
    for k in range(120):
        t = 1.0 + k / 200.0
        q, v, tau = (np.array([x]) for x in (np.sin(t), np.cos(t), -INERTIA * np.sin(t)))
        ekf.observe(q, v, tau, t)
    assert ekf.belief.header[Entry.RESTARTS] == 0.0 and ekf.belief.header[Entry.ACCEPTED] == 119.0
    assert not ekf.belief.disturbance.any() and not ekf.belief.steady.any()
