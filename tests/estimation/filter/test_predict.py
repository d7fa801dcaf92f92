"""A prediction of a gantry, whose equations fit on a line: mean, covariance, and how far the model is followed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import begun, constant_friction
from twin_diagram.estimation.dynamics.arm_dynamics import Laws
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.predict import unmodelled
from twin_diagram.estimation.sensors import LinkImu
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

PARAMS = Filter(parameters=["torque_bias", "torque_constant"])
SCALE = np.array([0.8, 0.4, 0.02, 0.02])
MASS = np.array([5.0, 2.0])
TAU = np.array([3.0, -2.0])
DT = 0.004


def sliding(params: Filter = PARAMS, laws: Laws | None = None, v: tuple[float, float] = (0.5, -0.4)) -> Ekf:
    """A filter whose joints have slid for a step, so that no regime changes in the next; all is correlated."""
    ekf = begun(params, laws, v)
    ekf.predict(np.zeros(2), DT)
    belief, rng = ekf.belief, np.random.default_rng(1350)
    N = belief.size
    A = rng.normal(size=(N, N)) * np.concatenate([[1e-3] * 2, [1e-2] * 2, [0.3] * 2, [0.01] * (N - 6)])[:, None]
    belief.P[:] = A @ A.T
    belief.disturbance[:] = [0.2, -0.3]
    return ekf


def newest_noise(ekf: Ekf) -> Array:
    return np.asarray(ekf.history._Q[int(ekf.history._at[0])])


def by_hand(ekf: Ekf, theta: Array) -> tuple[Array, Array]:
    """F of a step (10, 10) and how θ moves [q, v] (4, 4): no friction, no coupling."""
    by_torque = np.vstack([np.diag(0.5 * DT**2 / MASS), np.diag(DT / MASS)])
    by_theta = np.hstack([by_torque, by_torque * TAU])
    F = np.eye(10)
    F[:2, 2:4] = DT * np.eye(2)
    F[:4, 4:6], F[:4, 6:] = by_torque, by_theta
    F[4:6, 4:6] = np.exp(-DT) * np.eye(2)
    return F, by_theta


def test_what_was_just_learnt_moves_the_state_before_the_physics_takes_it_over() -> None:
    ekf = sliding()
    belief = ekf.belief
    belief.theta[:] = 0.04 * SCALE * [1.0, -1.0, 1.0, -1.0]
    belief.model[:] = 0.01 * SCALE
    theta, q, v, d = belief.theta.copy(), belief.q.copy(), belief.v.copy(), belief.disturbance.copy()
    ekf.predict(TAU, DT)
    a = (TAU + theta[:2] + theta[2:] * TAU + d) / MASS
    np.testing.assert_allclose(belief.v, v + DT * a, rtol=1e-10)
    np.testing.assert_allclose(belief.q, q + DT * v + 0.5 * DT**2 * a, rtol=1e-12)
    np.testing.assert_allclose(belief.disturbance, np.exp(-DT) * d)
    np.testing.assert_array_equal(belief.theta, theta)
    np.testing.assert_array_equal(belief.model, 0.01 * SCALE)
    assert belief.time == pytest.approx(1.0 + 2 * DT)


@pytest.mark.parametrize("std", [0.3, 0.05])
def test_the_covariance_is_that_of_the_linear_step_and_its_noise(std: float) -> None:
    """White torque as of one filter period, acting any time within the step; friction's drift; a walk of θ."""
    ekf = sliding()
    belief = ekf.belief
    belief.noise[2] = np.log([4.0, 0.25])
    P, (F, _) = belief.P.copy(), by_hand(ekf, belief.theta)
    ekf.predict(TAU, DT, None if std == 0.3 else std)
    Q = np.zeros((10, 10))
    white = np.diag((std * np.array([2.0, 0.5])) ** 2 * 0.005 / DT)
    Q[:4, :4] = F[:4, 4:6] @ white @ F[:4, 4:6].T
    Q[:2, :2] += DT**2 / 12.0 * Q[2:4, 2:4]
    Q[4:6, 4:6] = (1.0 - np.exp(-2.0 * DT)) * 0.1**2 * np.eye(2)
    Q[6:, 6:] = np.diag((0.002 * SCALE) ** 2 * DT)
    np.testing.assert_allclose(newest_noise(ekf), Q, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(belief.P, F @ P @ F.T + Q, rtol=1e-5, atol=1e-14)
    np.testing.assert_array_equal(belief.P, belief.P.T)
    np.testing.assert_allclose(ekf.F, F, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(ekf.by_torque, F[:4, 4:6], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(ekf.step_mass, np.diag(MASS), atol=1e-12)
    np.testing.assert_allclose(ekf.wander, 0.01)
    assert not ekf.creep.any()


def test_parameters_do_not_walk_while_all_rests_nor_by_the_gradient_rule() -> None:
    for params, v, walks in (
        (PARAMS, (0.5, 0.0), True),
        (PARAMS, (0.0, 0.0), False),
        (Filter(parameters=PARAMS.parameters, rule="gradient"), (0.5, 0.0), False),
    ):
        ekf = begun(params, v=v)
        ekf.predict(np.zeros(2), DT)
        assert newest_noise(ekf)[6:, 6:].any() == walks


def test_biases_of_sensors_walk() -> None:
    ekf = begun(Filter(parameters=[]))
    ekf.add(LinkImu(ekf.terms, "car"))
    ekf.predict(np.zeros(2), DT)
    walk = np.repeat([1e-4, 1e-3], 3) ** 2 * DT
    np.testing.assert_allclose(newest_noise(ekf)[6:, 6:], np.diag(walk))


def test_friction_of_joints_that_creep_is_white() -> None:
    """At 0.02 rad/s of a level of 2 N, and as far as the speed may be none."""
    ekf = sliding(Filter(parameters=[]), constant_friction(2.0, 1.0, backward=(4.0, 3.0)), v=(0.02, 0.6))
    variance = ekf.belief.P.diagonal()[2:4].copy()
    v = ekf.belief.v.copy()
    ekf.predict(np.array([3.0, 1.0]), DT)
    level = np.array([3.0, 2.0])
    creep = level * np.exp(-(v**2) / (0.025**2 + 4.0 * variance))
    np.testing.assert_allclose(ekf.creep, creep**2 * 0.005 / DT)
    by = ekf.by_torque
    assert by is not None
    white = by @ np.diag((0.3**2 + creep**2) * 0.005 / DT) @ by.T
    np.testing.assert_allclose(newest_noise(ekf)[2:4, 2:4], white[2:, 2:], rtol=1e-9)
    np.testing.assert_allclose(newest_noise(ekf)[:2, 2:4], white[:2, 2:], rtol=1e-9)
    np.testing.assert_allclose(ekf.wander, 0.1**2 + (0.15 * level) ** 2)


def test_learnt_friction_counts_and_is_never_negative() -> None:
    params = Filter(parameters=["coulomb_friction"])
    for theta, level in ((0.5, 2.5), (-9.0, 0.0)):
        ekf = sliding(params, constant_friction(2.0, 2.0))
        ekf.belief.theta[:] = ekf.belief.model[:] = theta
        ekf.predict(np.array([3.0, 1.0]), DT)
        np.testing.assert_allclose(ekf.wander, 0.1**2 + (0.05 * level) ** 2)


def test_what_is_drawn_afresh_has_nothing_to_do_with_what_was() -> None:
    ekf = sliding()
    belief = ekf.belief
    belief.regime[0] = -1.0
    belief.header[Entry.SPAN] = 0.0
    belief.v[:] = [0.5, -0.4]
    still = belief.disturbance.copy()
    ekf.predict(np.zeros(2), DT)
    assert belief.disturbance[0] == 0.0 and belief.disturbance[1] == pytest.approx(np.exp(-DT) * still[1])
    assert not belief.P[4, :4].any() and belief.P[5, :4].all() and not belief.P[4, 5:].any()
    assert belief.P[4, 4] == pytest.approx(0.1**2)
    # Sensors that feel the step's acceleration still see it by that torque.
    _, by_state, _ = ekf.history.motion(0)
    np.testing.assert_allclose(by_state[:, 4:6], np.diag(1.0 / MASS), rtol=1e-6)
    np.testing.assert_allclose(by_state[:, 2:4], 0.0, atol=1e-6)
    np.testing.assert_allclose(by_state[:, :2], 0.0, atol=1e-6)


@pytest.mark.parametrize(("dt", "parts"), [(0.01, 1), (0.0101, 2), (0.02, 2), (0.025, 3), (0.001, 1)])
def test_a_long_prediction_is_cut_into_steps_of_ten_milliseconds(dt: float, parts: int) -> None:
    ekf = begun(PARAMS)
    ekf.predict(TAU, dt)
    assert ekf.history.count == 1 + parts and ekf.belief.header[Entry.SPAN] == pytest.approx(dt / parts)
    assert ekf.belief.time == pytest.approx(1.0 + dt)


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_no_joint_is_predicted_beyond_twice_its_speed_limit_or_its_own_speed(push: float) -> None:
    """Limits of 2 and 1: followed to 4 and 2, or to twice what was measured."""
    dt, tau = 0.01, push * np.array([1e4, 1e4])
    for v, limit in (((0.5, -0.4), (4.0, 2.0)), ((3.0, -1.5), (6.0, 3.0))):
        ekf = begun(Filter(parameters=[]), v=v)
        q = ekf.belief.q.copy()
        ekf.predict(tau, dt)
        np.testing.assert_allclose(ekf.belief.v, push * np.array(limit))
        np.testing.assert_allclose(ekf.belief.q, q + 0.5 * dt * (np.array(v) + ekf.belief.v))


@pytest.mark.parametrize(("silent", "blind"), [(0.099, False), (0.101, True)])
def test_white_torque_that_was_found_small_counts_as_given_while_nobody_watches(silent: float, blind: bool) -> None:
    ekf = sliding(Filter(parameters=[]), constant_friction(2.0, 1.0))
    belief = ekf.belief
    belief.noise[2] = np.log([0.25, 4.0])
    belief.header[Entry.HEARD] = belief.time - silent
    ekf.predict(np.array([5.0, -5.0]), DT)
    by = ekf.by_torque
    assert by is not None
    std = 0.3 * np.array([1.0 if blind else 0.5, 2.0])
    np.testing.assert_allclose(newest_noise(ekf)[2:4, 2:4], by[2:] @ np.diag(std**2 * 0.005 / DT) @ by[2:].T, rtol=1e-6)


def test_stiction_that_nobody_watches_may_have_let_go() -> None:
    """A joint at rest answers a torque as one that creeps: drag of level over 0.025, not over 0.001."""
    for silent, drag in ((0.0, 2.0 / 1e-3), (0.2, 2.0 / 0.025)):
        ekf = begun(Filter(parameters=[]), constant_friction(2.0, 2.0), v=(0.0, 0.0))
        ekf.belief.header[Entry.HEARD] = ekf.belief.time - silent
        ekf.predict(np.zeros(2), DT)
        assert ekf.by_torque is not None
        np.testing.assert_allclose(ekf.by_torque[2:], np.diag(DT / (MASS + DT * drag)), rtol=1e-6)


def test_accelerations_are_those_observed_low_passed_over_a_fiftieth_of_a_second() -> None:
    ekf = begun(Filter(parameters=[]))
    belief = ekf.belief
    ekf.predict(np.zeros(2), DT)
    assert not belief.acceleration.any()
    belief.v[:] += [0.01, 0.02]
    ekf.predict(np.zeros(2), 0.008)
    np.testing.assert_allclose(belief.acceleration, np.array([2.5, 5.0]) * DT / 0.02)
    kept = belief.acceleration.copy()
    belief.v[:] += [0.01, -0.02]
    ekf.predict(np.zeros(2), DT)
    np.testing.assert_allclose(belief.acceleration, kept + 0.4 * (np.array([1.25, -2.5]) - kept))
    np.testing.assert_allclose(ekf.history.steady(0), belief.acceleration)
    belief.drift[1] = belief.v[1] = 0.0
    ekf.predict(np.zeros(2), DT)
    assert ekf.history.steady(0)[1] == 0.0 and ekf.history.steady(0)[0] == belief.acceleration[0]


def test_an_unmodelled_torque_is_as_large_as_the_efforts() -> None:
    """A jump of speed moved a joint by any share of it within the step."""
    ekf = sliding(Filter(parameters=[]))
    ekf.predict(np.zeros(2), DT)
    by = np.vstack([np.diag(0.5 * DT**2 / MASS), np.diag(DT / MASS)]) * [40.0, 20.0]
    added = unmodelled(ekf, np.array([0.3, -0.6]))
    expected = np.zeros((6, 6))
    expected[:4, :4] = by @ by.T
    expected[[0, 1], [0, 1]] += (np.array([0.3, 0.6]) * DT) ** 2 / 12.0
    np.testing.assert_allclose(added, expected, rtol=1e-6, atol=1e-15)
