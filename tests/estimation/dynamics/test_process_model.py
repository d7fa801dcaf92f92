"""A step and its derivatives on arms whose equations fit on a line, friction by secants among them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import INERTIA, constant_friction, crank, gantry
from twin_diagram.estimation.dynamics.arm_dynamics import Laws
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.process_model import jacobians, step
from twin_diagram.estimation.dynamics.short_rollout import short_rollout, torque_error
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

MASS = np.array([5.0, 2.0])
DAMPING = np.array([6.0, 0.5])
UP, DOWN = np.array([2.0, 1.0]), np.array([4.0, 3.0])
ALL = ["payload", "torque_bias", "viscous_friction", "coulomb_friction", "torque_constant"]
THETA = np.array([1.5, 0.0, 0.0, 0.0, 0.4, -0.1, 0.3, -0.2, 0.25, -0.15, 0.06, -0.04])
Q, DT = np.array([0.1, -0.2]), 0.005
NONE = np.zeros(2)


def by_hand(v: Array, tau: Array, d: Array, theta: Array, dt: float) -> tuple[Array, Array]:
    """Speed after a step, and the slope of all friction there: three secants one after the other."""
    mass, damping = MASS + theta[0], DAMPING + theta[6:8]
    push = tau + theta[4:6] + theta[10:12] * tau + d
    at, drag = v.copy(), np.zeros(2)
    for i in range(2):
        for _ in range(3):
            level = max((UP if at[i] > 0.0 else DOWN)[i] + theta[8 + i], 0.0)
            width = np.hypot(at[i], 1e-3)
            drag[i] = damping[i] + level / width * (1e-3 / width) ** 2
            at[i] = (mass[i] * v[i] + dt * push[i]) / (mass[i] + dt * (damping[i] + level / width))
    return at, drag


@pytest.mark.parametrize("v", [(0.5, -0.4), (0.004, -0.002), (-1e-3, 5e-4), (0.0, 0.0)])
@pytest.mark.parametrize("tau", [(3.0, -2.0), (-30.0, 9.0)])
def test_a_step_of_a_gantry(v: tuple[float, float], tau: tuple[float, float]) -> None:
    arm = gantry(constant_friction(*UP, backward=tuple(DOWN)), tuple(DAMPING))
    parameters = ParameterSet(arm, Filter(parameters=ALL))
    speed, torque, d = np.array(v), np.array(tau), np.array([0.2, -0.1])
    for theta in (np.zeros(12), THETA, np.array([0.0] * 8 + [-3.0, -1.5, 0.0, 0.0])):
        moved = step(arm, parameters, Q, speed, theta, torque, d, DT)
        expected, drag = by_hand(speed, torque, d, theta, DT)
        np.testing.assert_allclose(moved.v, expected, rtol=1e-10, atol=1e-15)
        np.testing.assert_allclose(moved.q, Q + 0.5 * DT * (speed + expected), rtol=1e-12)
        np.testing.assert_allclose(moved.a, (expected - speed) / DT, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(moved.drag, drag, rtol=1e-8)
        np.testing.assert_allclose(moved.middle, Q + 0.5 * DT * speed)
        np.testing.assert_allclose(moved.mass, np.diag(MASS + theta[0]), atol=1e-12)


def test_bounds_of_dry_friction_may_be_given() -> None:
    arm = gantry(constant_friction(*UP, backward=tuple(DOWN)), tuple(DAMPING))
    parameters = ParameterSet(arm, Filter(parameters=[]))
    free = step(arm, parameters, Q, np.array([0.5, 0.5]), np.zeros(0), NONE, NONE, DT, (NONE, NONE))
    np.testing.assert_allclose(free.v, 0.5 * MASS / (MASS + DT * DAMPING))


def test_effects_of_the_model_act_at_the_middle() -> None:
    laws = Laws(
        load=lambda q, v, tau: 3.0 * q + 0.5 * v + 0.1 * tau,
        applied=lambda tau: 0.9 * tau,
        true_position=lambda q: q + 0.2,
    )
    arm = gantry(laws)
    v, tau = np.array([0.5, -0.4]), np.array([3.0, -2.0])
    moved = step(arm, ParameterSet(arm, Filter(parameters=[])), Q, v, np.zeros(0), tau, NONE, DT)
    middle = Q + 0.5 * DT * v + 0.2
    np.testing.assert_allclose(moved.middle, middle)
    np.testing.assert_allclose(moved.v, v + DT * (0.9 * tau - 3.0 * middle - 0.5 * v - 0.1 * tau) / MASS)


@pytest.mark.parametrize("sure", [None, (0.5, 0.25)])
def test_derivatives_of_a_gantry_s_step(sure: tuple[float, float] | None) -> None:
    """By torque over mass and drag; those of θ by what the observed acceleration, not the predicted, excites."""
    arm = gantry(constant_friction(*UP, backward=tuple(DOWN)), tuple(DAMPING))
    parameters = ParameterSet(arm, Filter(parameters=ALL))
    v, tau, a = np.array([0.5, -0.004]), np.array([3.0, -2.0]), np.array([7.0, -3.0])
    moved = step(arm, parameters, Q, v, THETA, tau, NONE, DT)
    sliding = None if sure is None else np.array(sure)
    by = jacobians(arm, parameters, moved, v, THETA, DT, a, tau, sliding)
    mass, share = MASS + 1.5, np.ones(2) if sliding is None else sliding
    resist = mass + DT * moved.drag
    speed = np.diag(mass / resist)
    np.testing.assert_allclose(by.state[2:], np.hstack([np.zeros((2, 2)), speed]), atol=1e-7)
    np.testing.assert_allclose(by.state[:2], np.hstack([np.eye(2), 0.5 * DT * (np.eye(2) + speed)]), atol=1e-9)
    by_torque = np.diag(DT / resist)
    np.testing.assert_allclose(by.torque, np.vstack([0.5 * DT * by_torque, by_torque]), atol=1e-15)
    Y = np.zeros((2, 12))
    Y[:, 0], Y[:, 4:6], Y[:, 10:] = a, -np.eye(2), np.diag(-tau)
    Y[:, 6:8], Y[:, 8:10] = np.diag(share * v), np.diag(share * v / np.hypot(v, 1e-3))
    expected = -by_torque @ Y
    np.testing.assert_allclose(by.parameters, np.vstack([0.5 * DT * expected, expected]), atol=1e-12)
    if sure is None:
        still = jacobians(arm, parameters, moved, v, THETA, DT, a)
        np.testing.assert_allclose(still.parameters[:, 10:], 0.0, atol=1e-15)
        np.testing.assert_allclose(still.parameters[:, :10], by.parameters[:, :10])


def test_derivatives_of_an_arm_that_gravity_pulls() -> None:
    """A pendulum of 2 kg at 0.5 m, with damping: forward, by its equation."""
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import RevoluteJoint, SpatialInertia, UnitInertia

    from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms

    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("bob", SpatialInertia(2.0, np.array([0.0, 0.0, -0.5]), UnitInertia(0.26, 0.26, 0.01)))
    plant.AddJoint(
        RevoluteJoint("hinge", plant.world_frame(), body.body_frame(), np.array([0.0, 1.0, 0.0]), damping=0.4)
    )
    plant.Finalize()
    arm = ArmTerms(plant, ["hinge"])
    parameters = ParameterSet(arm, Filter(parameters=[]))
    q, v, tau, inertia, moment = np.array([0.7]), np.array([1.3]), np.array([2.0]), 0.52, 9.81
    dt = 0.01
    moved = step(arm, parameters, q, v, np.zeros(0), tau, np.zeros(1), dt)
    middle = q + 0.5 * dt * v
    expected = (inertia * v + dt * (tau - moment * np.sin(middle))) / (inertia + dt * 0.4)
    np.testing.assert_allclose(moved.v, expected)
    by = jacobians(arm, parameters, moved, v, np.zeros(0), dt, moved.a)
    slope = moment * float(np.cos(middle[0]))
    whole = inertia + dt * 0.4
    np.testing.assert_allclose(by.state[1], [-dt * slope / whole, (inertia - 0.5 * dt**2 * slope) / whole], rtol=1e-4)
    np.testing.assert_allclose(by.state[0], [1.0 + 0.5 * dt * by.state[1, 0], 0.5 * dt * (1.0 + by.state[1, 1])])


def test_a_short_rollout_takes_the_mean_of_each_step_s_torques() -> None:
    arm = crank()
    parameters = ParameterSet(arm, Filter(parameters=[]))
    times, torques = np.array([1.0, 1.01, 1.03, 1.04]), np.array([[1.0], [2.0], [4.0], [-3.0]])
    q, v = 0.3, 0.5
    for k in range(3):
        dt, a = times[k + 1] - times[k], 0.5 * float(torques[k, 0] + torques[k + 1, 0]) / INERTIA
        q, v = q + dt * v + 0.5 * dt**2 * a, v + dt * a
    end = short_rollout(arm, parameters, np.array([0.3, 0.5]), np.zeros(0), times, torques)
    np.testing.assert_allclose([float(end[0][0]), float(end[1][0])], [q, v], rtol=1e-10)
    alone = short_rollout(arm, parameters, np.array([0.3, 0.5]), np.zeros(0), times[:1], torques[:1])
    np.testing.assert_array_equal([alone[0][0], alone[1][0]], [0.3, 0.5])


@pytest.mark.parametrize(("speed", "steps"), [(999.0, 10), (1001.0, 1), (-1001.0, 1)])
def test_a_rollout_ends_where_a_joint_left_a_hundred_times_its_limit(speed: float, steps: int) -> None:
    arm = crank()
    q, _ = short_rollout(
        arm,
        ParameterSet(arm, Filter(parameters=[])),
        np.array([0.0, speed]),
        np.zeros(0),
        0.01 * np.arange(11),
        np.zeros((11, 1)),
    )
    assert float(q[0]) == pytest.approx(0.01 * steps * speed, rel=1e-9)


def test_one_joint_that_ran_away_ends_it_for_all() -> None:
    arm = gantry()  # limits of 2 and 1 m/s
    parameters, times = ParameterSet(arm, Filter(parameters=[])), 0.01 * np.arange(11)
    for state, steps in (([0.0, 0.0, 0.5, 101.0], 1), ([0.0, 0.0, 201.0, 0.5], 1), ([0.0, 0.0, 199.0, 99.0], 10)):
        q, _ = short_rollout(arm, parameters, np.array(state), np.zeros(0), times, np.zeros((11, 2)))
        np.testing.assert_allclose(q, 0.01 * steps * np.array(state[2:]))


def test_an_error_as_torque() -> None:
    """A constant torque moves a joint by ½ τ T² / I; the payload that was learnt counts."""
    arm = gantry()
    parameters = ParameterSet(arm, Filter())
    for mass in (0.0, 1.5):
        found = torque_error(arm, parameters, Q, np.array([mass, 0.0, 0.0, 0.0]), np.array([0.01, -0.02]), 0.1)
        np.testing.assert_allclose(found, 2.0 * (MASS + mass) * [0.01, -0.02] / 0.01)
