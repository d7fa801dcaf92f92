"""A filter that starts from parameters that are 50 % wrong gets home, or says that it cannot."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation_bench import COULOMB, JOINTS, VISCOUS, Recording, World, simulate, twin_terms
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.parameter_adaptation import TUNING as PARAMETER_ADAPTATION
from twin_diagram.estimation.filter.parameter_adaptation import refute
from twin_diagram.estimation.filter.parameter_status import ParameterStatus, Standing, at_bound, standings
from twin_diagram.scenario import Filter
from twin_diagram.signals.layouts import AlarmKind

FRICTION = ["payload", "viscous_friction", "coulomb_friction"]
MOVING = (0, 6)
"""Joints that travel; the others go a few hundredths of a radian."""


@functools.cache
def terms() -> ArmTerms:
    return twin_terms()


def learnt(run: Recording, names: list[str], rule: str = "covariance") -> dict[str, Standing]:
    ekf = Ekf(terms(), Filter(parameters=names, rule=rule))
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    return {standing.label.split(" ")[0]: standing for standing in ekf.standings(JOINTS)}


@pytest.mark.parametrize("share", [0.5, 1.5])
@pytest.mark.slow
def test_friction_that_is_half_wrong_gets_home(share: float) -> None:
    """All 14 frictions off by half, beside a payload that nobody told of."""
    world = World(mass=0.8, seed=1011, period=4.0, coulomb=COULOMB * share, viscous=VISCOUS * share)
    found = learnt(simulate(world, 8.0), FRICTION)
    assert found["payload.mass"].status is ParameterStatus.SETTLED
    assert found["payload.mass"].value == pytest.approx(world.mass, rel=0.03)
    for k, joint in enumerate(JOINTS):
        dry, wet = found[f"coulomb_friction.{joint}"], found[f"viscous_friction.{joint}"]
        assert dry.status is ParameterStatus.SETTLED
        assert dry.value == pytest.approx((share - 1.0) * COULOMB[k], abs=3.0 * dry.std)
        if k not in MOVING:
            assert wet.status is ParameterStatus.NOT_EXCITED, "it hardly moves: nothing tells its damping"
        assert wet.value == pytest.approx((share - 1.0) * VISCOUS[k], abs=3.0 * wet.std)
    swinging = found[f"viscous_friction.{JOINTS[0]}"]
    assert swinging.status is ParameterStatus.SETTLED
    assert swinging.value == pytest.approx((share - 1.0) * VISCOUS[0], abs=0.2 * VISCOUS[0])


@functools.cache
def half_a_motor() -> tuple[World, Recording]:
    world = World(mass=0.8, seed=1012, period=4.0, dead_joint=1, dead_at=0.0, motor_left=0.5)
    return world, simulate(world, 8.0)


@pytest.mark.slow
def test_motor_of_half_the_strength_gets_home() -> None:
    world, run = half_a_motor()
    found = learnt(run, ["payload", "torque_constant"])
    motor, mass = found[f"torque_constant.{JOINTS[1]}"], found["payload.mass"]
    assert motor.status is ParameterStatus.SETTLED and motor.value == pytest.approx(-0.5, abs=0.02)
    assert mass.status is ParameterStatus.SETTLED and mass.value == pytest.approx(world.mass, abs=3.0 * mass.std)


@pytest.mark.parametrize("joint", [0, 2])
@pytest.mark.slow
def test_motor_that_its_data_sheet_is_far_from_is_not_paid_for_by_the_payload(joint: int) -> None:
    """Half as strong again, 25 deviations of its prior, which held it: the payload came out at 0.3 kg."""
    world = World(mass=0.8, seed=1003, period=4.0, dead_joint=joint, dead_at=0.0, motor_left=1.5)
    found = learnt(simulate(world, 5.0), ["payload", "torque_constant"])
    mass = found["payload.mass"]
    assert mass.status is ParameterStatus.SETTLED and mass.value == pytest.approx(world.mass, abs=0.05)
    for k, name in enumerate(JOINTS):
        motor = found[f"torque_constant.{name}"]
        assert motor.value == pytest.approx(0.5 * (k == joint), abs=3.0 * motor.std)


def test_a_refuted_prior_is_given_up_once_and_takes_back_what_was_learnt_beside_it() -> None:
    ekf = Ekf(terms(), Filter(parameters=["torque_constant", "torque_bias", "payload"]))
    still = np.zeros(7)
    ekf.start(still, still, still, 0.0)
    belief, parameters = ekf.belief, ekf.parameters
    assert list(np.flatnonzero(parameters.freeable)) == list(range(7))  # a payload or a bias is all that its prior says
    belief.theta[:] = 0.9 * PARAMETER_ADAPTATION.refuted * parameters.scale
    before = belief.vector.copy()
    refute(ekf, 0.0)
    np.testing.assert_array_equal(belief.vector, before)
    belief.theta[3] = 1.1 * PARAMETER_ADAPTATION.refuted * parameters.scale[3]
    kept = belief.theta.copy()
    refute(ekf, 0.0)
    at = slice(21, 21 + belief.p)
    expected = parameters.covariance.copy()
    expected[3, 3] = parameters.opening[3, 3]
    np.testing.assert_allclose(belief.P[at, at], expected)
    np.testing.assert_array_equal(belief.theta[[3, 14, 15, 16, 17]], kept[[3, 14, 15, 16, 17]])
    np.testing.assert_array_equal(np.delete(belief.theta[:14], 3), 0.0)
    belief.theta[3] = 0.6  # far from its prior, which does not count any more
    before = belief.vector.copy()
    refute(ekf, 0.0)
    np.testing.assert_array_equal(belief.vector, before)


@pytest.mark.long
def test_a_filter_that_may_not_learn_what_is_wrong_says_that_it_cannot() -> None:
    """Half a motor looks like a payload that is not there: the one that may be learnt never settles."""
    _, run = half_a_motor()
    found = learnt(run, ["payload"])
    assert found["payload.mass"].status is not ParameterStatus.SETTLED


def test_resting_arm_tells_no_damping_and_no_lies() -> None:
    """What it calls settled (stiction may tell a level within a few tenths of a N·m) is within its deviation."""
    run = simulate(World(mass=0.0, seed=1013, start=1e9, coulomb=COULOMB * 1.5, viscous=VISCOUS * 1.5), 3.0)
    found = learnt(run, FRICTION)
    for k, joint in enumerate(JOINTS):
        assert found[f"viscous_friction.{joint}"].status is ParameterStatus.NOT_EXCITED
        dry = found[f"coulomb_friction.{joint}"]
        assert dry.value == pytest.approx(0.5 * COULOMB[k], abs=3.0 * dry.std)
        assert dry.std > 0.25 * COULOMB[k]


def test_what_lies_out_of_reach_is_said_to_be_at_a_bound() -> None:
    found = learnt(simulate(World(mass=14.0, seed=1014, period=4.0), 3.0), ["payload"])
    assert found["payload.mass"].status is ParameterStatus.AT_BOUND
    assert "10 ± " in str(found["payload.mass"]) and str(found["payload.mass"]).endswith("at a bound")


def test_nothing_settles_while_an_alarm_stands() -> None:
    """What is told by readings is in doubt then; what is not, and what is at a bound, is as it was."""
    ekf = Ekf(terms(), Filter(parameters=["payload"]))
    theta, covariance = ekf.parameters.mean.copy(), ekf.parameters.covariance.copy()
    theta[0] += 0.5
    covariance[0, 0] *= 0.01
    calm, alarmed = (
        [each.status for each in standings(ekf.parameters, theta, covariance, JOINTS, alarm=alarm)]
        for alarm in (False, True)
    )
    assert calm == [ParameterStatus.SETTLED, *[ParameterStatus.NOT_EXCITED] * 3]
    assert alarmed == [ParameterStatus.IN_DOUBT, *[ParameterStatus.NOT_EXCITED] * 3]
    freed = np.array([0.0, 1.0, 0.0, 0.0])  # opened since it changed: told once, and not any more
    opened, later = (
        [each.status for each in standings(ekf.parameters, theta, covariance, JOINTS, alarm=alarm, freed=freed)]
        for alarm in (True, False)
    )
    assert opened == [ParameterStatus.IN_DOUBT] * 2 + [ParameterStatus.NOT_EXCITED] * 2
    assert later == calm
    theta[0] = 10.0
    bound = standings(ekf.parameters, theta, covariance, JOINTS, alarm=True)
    assert bound[0].status is ParameterStatus.AT_BOUND
    # The filter knows of an alarm by what a monitor told it, and for no longer than it stands.
    still = np.zeros(7)
    ekf.start(still, still, still, 0.0)
    ekf.belief.theta[0], ekf.belief.P[21, 21] = 0.5, covariance[0, 0]
    assert ekf.standings(JOINTS)[0].status is ParameterStatus.SETTLED
    ekf.heed(np.array([1.0, AlarmKind.SENSOR, 0.0, 2.0]))
    assert ekf.standings(JOINTS)[0].status is ParameterStatus.IN_DOUBT
    ekf.belief.header[Entry.TIME] += 2.5 * ekf.period  # messages later without one
    assert ekf.standings(JOINTS)[0].status is ParameterStatus.SETTLED


def test_what_an_alarm_opens_is_in_doubt_while_it_stands() -> None:
    """A motor's fault opens what its joint's readings had told: that is neither an answer nor for want of motion."""
    ekf = Ekf(terms(), Filter(parameters=["payload"]))
    still = np.zeros(7)
    ekf.start(still, still, still, 0.0)
    ekf.belief.header[Entry.TIME] = 10.0
    ekf.belief.theta[0], ekf.belief.P[21, 21] = 0.5, 1e-4
    assert ekf.standings(JOINTS)[0].status is ParameterStatus.SETTLED
    ekf.belief.score[:, :-1] = 100.0 * np.eye(4)
    ekf.belief.score[0, -1] = 1000.0  # recent innovations speak for another mass
    ekf.heed(np.array([1.0, AlarmKind.INNOVATION, 10.0, 2.0]))
    mass = ekf.standings(JOINTS)[0]
    assert mass.std > 0.5 * ekf.parameters.scale[0]
    assert mass.status is ParameterStatus.IN_DOUBT
    ekf.belief.header[Entry.TIME] += 2.5 * ekf.period
    assert ekf.standings(JOINTS)[0].status is ParameterStatus.NOT_EXCITED


def test_before_the_first_message_and_under_the_gradient_rule_nothing_is_told() -> None:
    ekf = Ekf(terms(), Filter(parameters=["payload", "coulomb_friction"]))
    prior = standings(ekf.parameters, ekf.parameters.mean, ekf.parameters.covariance, JOINTS)
    assert {standing.status for standing in prior} == {ParameterStatus.NOT_EXCITED}
    assert {standing.status for standing in ekf.standings(JOINTS)} == {ParameterStatus.NOT_EXCITED}
    run = simulate(World(seed=1015), 0.5)
    assert {s.status for s in learnt(run, ["coulomb_friction"], "gradient").values()} == {ParameterStatus.UNKNOWN}


@given(st.lists(st.floats(-50.0, 50.0), min_size=18, max_size=18))
def test_at_a_bound_is_what_clipping_moved(values: list[float]) -> None:
    parameters = ParameterSet(terms(), Filter(parameters=["viscous_friction", "torque_bias", "payload"]))
    wanted = np.array(values)
    theta = wanted.copy()
    parameters.clip(theta)
    again = theta.copy()
    parameters.clip(again)
    held = at_bound(parameters, again)
    boxes = slice(0, 14)  # a payload's centre is held by its distance, not axis by axis
    moved = np.abs(theta - wanted) > 2e-3 * parameters.scale
    assert np.all(held[boxes] >= moved[boxes])
    assert held[14] >= moved[14]
    inside = 0.5 * theta
    inside[:14] = np.maximum(inside[:14], -0.5 * np.concatenate([VISCOUS, np.full(7, np.inf)]))
    assert not np.any(at_bound(parameters, inside)[boxes])
    assert np.isfinite(theta).all() and np.array_equal(again, theta) | np.allclose(again, theta)
