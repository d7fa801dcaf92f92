"""The adaptive EKF without any Diagram: its parts against independent figures, and whole against a simulated Panda."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces, RevoluteJoint, SpatialInertia, UnitInertia

from tests.estimation_bench import COULOMB, HOME, JOINTS, VISCOUS, Recording, World, follow, simulate, twin_terms
from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.positive_definite import solve_positive, whiten
from twin_diagram.estimation.dynamics.process_model import jacobians, step
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf, FilterError
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec, Filter
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.layouts import AlarmKind

PAYLOAD = np.array([1.2, 0.03, -0.05, 0.2])
"""Mass and first moment."""


@functools.cache
def terms() -> ArmTerms:
    return twin_terms()


@functools.cache
def recording(seed: int) -> tuple[World, Recording]:
    world = World.draw(seed)
    return world, simulate(world)


def a_state(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return HOME + rng.normal(0.0, 0.4, 7), rng.normal(0.0, 0.6, 7), rng.normal(0.0, 2.0, 7)


# The arm's terms.


def loaded_plant() -> tuple[MultibodyPlant, np.ndarray]:
    """The Panda with the payload as a body of its own, welded on."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(models_dir() / "arms" / "panda_hand.urdf"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("panda_link0"))
    link = plant.GetBodyByName("panda_link7")
    inertia = SpatialInertia(PAYLOAD[0], np.zeros(3), UnitInertia(0.0, 0.0, 0.0))
    body = plant.AddRigidBody("payload", link.model_instance(), inertia)
    plant.WeldFrames(link.body_frame(), body.body_frame(), RigidTransform(PAYLOAD[1:] / PAYLOAD[0]))
    for name, damping in zip(JOINTS, VISCOUS, strict=True):
        plant.GetJointByName(name).set_default_damping(damping)
    plant.Finalize()
    return plant, np.array([plant.GetJointByName(name).velocity_start() for name in JOINTS])


def test_payload_equals_a_welded_body():
    plant, index = loaded_plant()
    context = plant.CreateDefaultContext()
    arm = terms()
    for seed in range(4):
        q, v, a = a_state(seed)
        x = np.zeros(plant.num_velocities())
        x[index] = q
        plant.SetPositions(context, x)
        x[index] = v
        plant.SetVelocities(context, x)
        x[index] = a
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        arm.set_payload(PAYLOAD)
        expected = plant.CalcInverseDynamics(context, x, forces)[index]
        np.testing.assert_allclose(arm.inverse_dynamics(q, v, a), expected, atol=1e-10)
        np.testing.assert_allclose(arm.mass_matrix(q), plant.CalcMassMatrix(context)[np.ix_(index, index)], atol=1e-12)


def test_payload_regressor_is_the_derivative_of_torque():
    arm = terms()
    for seed in range(4):
        q, v, a = a_state(seed)
        Y = arm.payload_regressor(q, v, a)
        for column, size in enumerate((1.0, 0.2, 0.2, 0.2)):
            # Linear but for the inertia about the link's origin, |mc|²/m: a large mass makes that small.
            torque = []
            for sign in (1.0, -1.0):
                payload = np.array([1000.0, 0.0, 0.0, 0.0])
                payload[column] += sign * size
                arm.set_payload(payload)
                torque.append(arm.inverse_dynamics(q, v, a))
            np.testing.assert_allclose(Y[:, column], (torque[0] - torque[1]) / (2 * size), atol=2e-3)


def test_derivatives_match_central_differences():
    arm = terms()
    arm.set_payload(PAYLOAD)
    q, v, a = a_state(1)
    by_q, by_v = arm.derivatives(q, v, a)
    h = 1e-5
    for i, unit in enumerate(np.eye(7)):
        dq = (arm.inverse_dynamics(q + h * unit, v, a) - arm.inverse_dynamics(q - h * unit, v, a)) / (2 * h)
        dv = (arm.inverse_dynamics(q, v + h * unit, a) - arm.inverse_dynamics(q, v - h * unit, a)) / (2 * h)
        np.testing.assert_allclose(by_q[:, i], dq, atol=2e-4)
        np.testing.assert_allclose(by_v[:, i], dv, atol=2e-4)


def test_terms_of_a_model_hold_its_effects():
    joints = list(JOINTS)
    spec = ArmModel(
        effects=[
            EffectSpec("coulomb_friction", joints, [], {"torque": COULOMB.tolist()}),
            EffectSpec("viscous_friction", joints, [], {"damping": VISCOUS.tolist()}),
            EffectSpec("payload", [], ["panda_link7"], {"mass": [0.7], "com": [0.01, 0.0, 0.1]}),
        ]
    )
    model = Model.load(spec)
    arm = ArmTerms.from_model(model)
    q, v, _ = a_state(2)
    np.testing.assert_allclose(arm.damping, VISCOUS)
    np.testing.assert_allclose(arm.mass_matrix(q), model.mass_matrix(q), atol=1e-12)
    friction = model.bias(q, v) - arm.load(q, v, np.zeros(7))
    np.testing.assert_allclose(np.abs(friction), COULOMB, rtol=1e-3)
    np.testing.assert_allclose(arm.dry(q, v, np.zeros(7))[0], COULOMB)
    np.testing.assert_allclose(arm.effort_limit, model.effort_limit)


def test_plants_that_cannot_be_are_refused():
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(models_dir() / "arms" / "ur5e.urdf"))
    with pytest.raises(ModelError, match="not finalized"):
        ArmTerms(plant, ["elbow_joint"])
    plant.Finalize()
    with pytest.raises(ModelError, match="no frame 'claw'"):
        ArmTerms(plant, ["elbow_joint"], tool_frame="claw")
    with pytest.raises(ModelError, match="no joint 'knee'"):
        ArmTerms(plant, ["knee"])


def test_terms_of_any_plant():
    """A pendulum with a prismatic-free, actuator-free plant of the user's own."""
    arm = pendulum()
    assert arm.n == 1
    np.testing.assert_allclose(arm.inverse_dynamics(np.array([0.3]), np.zeros(1), 0.0), 9.81 * 0.5 * 2.0 * np.sin(0.3))
    assert arm.effort_limit[0] > 15.0
    with pytest.raises(ModelError, match="no joint 'elbow'"):
        ArmTerms(arm.plant, ["elbow"])


def pendulum(dry: float = 0.0) -> ArmTerms:
    """2 kg at 0.5 m below a hinge about y."""
    plant = MultibodyPlant(0.0)
    inertia = SpatialInertia(2.0, np.array([0.0, 0.0, -0.5]), UnitInertia(0.26, 0.26, 0.01))
    body = plant.AddRigidBody("bob", inertia)
    hinge = RevoluteJoint("hinge", plant.world_frame(), body.body_frame(), [0.0, 1.0, 0.0])
    plant.AddJoint(hinge)
    plant.Finalize()
    level = np.array([dry])
    return ArmTerms(plant, ["hinge"], laws=Laws(dry=lambda q, v, tau: (level, level)))


# The step.


def test_step_converges_on_fine_steps():
    arm = terms()
    parameters = ParameterSet(arm, Filter())
    none = np.zeros(7)
    for seed in range(3):
        q, v, _ = a_state(seed)
        arm.set_payload(PAYLOAD)
        tau = arm.inverse_dynamics(q, v, np.random.default_rng(seed).normal(0.0, 4.0, 7)) + np.sign(v) * COULOMB
        coarse = step(arm, parameters, q, v, PAYLOAD, tau, none, 0.005)
        fine_q, fine_v = q, v
        for _ in range(100):
            fine = step(arm, parameters, fine_q, fine_v, PAYLOAD, tau, none, 5e-5)
            fine_q, fine_v = fine.q, fine.v
        np.testing.assert_allclose(coarse.v, fine_v, atol=0.05)
        np.testing.assert_allclose(coarse.q, fine_q, atol=2e-4)


@given(
    level=st.floats(0.0, 50.0),
    speed=st.floats(-5.0, 5.0),
    dt=st.floats(1e-4, 0.02),
    seed=st.integers(0, 100),
)
def test_dry_friction_stops_and_never_drives(level, speed, dt, seed):
    """However stiff: kinetic energy that friction alone acts on falls, and no joint is thrown to the other side."""
    arm = terms()
    parameters = ParameterSet(arm, Filter())
    q, v, _ = a_state(seed)
    v = speed * v
    levels = np.full(7, level)
    arm.set_payload(np.zeros(4))
    tau = arm.load(q + 0.5 * dt * v, v, np.zeros(7)) - arm.damping * v  # friction is all that is left
    moved = step(arm, parameters, q, v, parameters.mean, tau, np.zeros(7), dt, (levels, levels))
    before, after = v @ moved.mass @ v, moved.v @ moved.mass @ moved.v
    assert after <= before * (1 + 1e-9)


def test_pendulum_sticks_where_dry_friction_holds_it():
    arm = pendulum(dry=4.0)
    parameters = ParameterSet(arm, Filter(parameters=[]))
    q, v, zero = np.array([0.3]), np.zeros(1), np.zeros(1)  # its weight asks for 2.9 N·m
    for _ in range(200):
        moved = step(arm, parameters, q, v, zero[:0], zero, zero, 0.005)
        q, v = moved.q, moved.v
    assert abs(q[0] - 0.3) < 1.2e-3  # creeps by less than `STUCK_SPEED`
    q = np.array([0.6])  # 5.5 N·m: it falls, and comes to rest within the band that friction holds
    for _ in range(1000):
        moved = step(arm, parameters, q, v, zero[:0], zero, zero, 0.005)
        q, v = moved.q, moved.v
    assert abs(v[0]) < 2e-3
    assert abs(9.81 * np.sin(q[0])) < 4.0


def test_jacobians_match_differences_of_the_step():
    arm = terms()
    parameters = ParameterSet(arm, Filter(parameters=["payload", "torque_bias", "viscous_friction"]))
    theta = np.concatenate([PAYLOAD, np.zeros(14)])
    q, v, _ = a_state(5)
    arm.set_payload(PAYLOAD)
    tau = arm.inverse_dynamics(q, v, np.full(7, 0.5)) + np.sign(v) * COULOMB
    none, dt, h = np.zeros(7), 0.005, 1e-6

    def moved(q, v, theta, d):
        after = step(arm, parameters, q, v, theta, tau, d, dt)
        return np.concatenate([after.q, after.v])

    here = step(arm, parameters, q, v, theta, tau, none, dt)
    by = jacobians(arm, parameters, here, v, theta, dt, here.a)
    for i, unit in enumerate(np.eye(7)):
        rows = (
            (by.state[:, i], moved(q + h * unit, v, theta, none) - moved(q - h * unit, v, theta, none)),
            (by.state[:, 7 + i], moved(q, v + h * unit, theta, none) - moved(q, v - h * unit, theta, none)),
            (by.torque[:, i], moved(q, v, theta, none + h * unit) - moved(q, v, theta, none - h * unit)),
        )
        for column, difference in rows:
            np.testing.assert_allclose(column, difference / (2 * h), atol=0.03 * np.abs(column).max() + 1e-6)
    for i, unit in enumerate(np.eye(len(theta))):
        difference = (moved(q, v, theta + h * unit, none) - moved(q, v, theta - h * unit, none)) / (2 * h)
        # The inertia about the last link, quadratic in c, is no part of the regressor: a tenth at the wrist.
        np.testing.assert_allclose(by.parameters[:, i], difference, atol=0.15 * np.abs(difference).max() + 1e-6)


def test_positive_solver():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    A = A @ A.T + np.eye(6)
    b, B = rng.normal(size=6), rng.normal(size=(6, 3))
    np.testing.assert_allclose(solve_positive(A, b), np.linalg.solve(A, b), atol=1e-12)
    np.testing.assert_allclose(solve_positive(A, B), np.linalg.solve(A, B), atol=1e-12)
    w = whiten(A, b)
    np.testing.assert_allclose(w @ w, b @ np.linalg.solve(A, b))
    with pytest.raises(np.linalg.LinAlgError):
        solve_positive(-A, b)


# The filter.


def test_update_equals_bayes_rule():
    """Against the information form: P⁻¹ + Hᵀ R⁻¹ H, of which the filter computes nothing."""
    ekf = Ekf(terms(), Filter(noise_time=0.0))
    world, run = recording(0)
    for k in range(30):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    belief = ekf.belief
    ekf.predict(run.tau[30], 0.005)
    x, P = belief.x.copy(), belief.P.copy()
    H = ekf.encoder.jacobian(x)
    R = ekf.encoder.noise(x)
    result = ekf.update(ekf.encoder, run.q[30])
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    expected = np.linalg.inv(information)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(belief.P / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)
    mean = x + expected @ H.T @ np.linalg.inv(R) @ (run.q[30] - H @ x)
    np.testing.assert_allclose((belief.x - mean) / scale, 0.0, atol=1e-4)
    innovation = run.q[30] - H @ x
    assert result.nis == pytest.approx(innovation @ np.linalg.solve(H @ P @ H.T + R, innovation), rel=1e-9)
    assert result.accepted and not result.surprise
    assert world.mass > 0


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_learns_the_payload(seed):
    world, run = recording(seed)
    figures = follow(Ekf(terms(), Filter()), world, run)
    print(figures)
    assert abs(figures.mass_error) < 0.08 * world.mass
    assert figures.joint_rms < 1e-5 and figures.joint_max < 1e-4
    assert figures.velocity_rms < 1e-3
    assert abs(figures.mass_error) < 3.0 * figures.mass_std < 0.06
    assert figures.moment_nees < 16.3  # χ² with 3 degrees of freedom, 99.9 %
    assert 0.02 < figures.state_nees < 1.5
    assert figures.counters["openings"] == figures.counters["refused"] == figures.counters["restarts"] == 0


@pytest.mark.slow
def test_payload_over_many_seeds():
    """The bar: 15 % in 9 of 10 seeds; the aim: 8 % in all. Deviations must be honest on the whole."""
    z, worst = [], 0.0
    for seed in range(100, 140):
        world = World.draw(seed)
        figures = follow(Ekf(terms(), Filter()), world, simulate(world))
        worst = max(worst, abs(figures.mass_error) / world.mass)
        z.append(figures.mass_error / figures.mass_std)
    print(f"worst {worst:.3f}, rms z {np.sqrt(np.mean(np.square(z))):.2f}")
    assert worst < 0.08
    assert 0.1 < np.sqrt(np.mean(np.square(z))) < 1.5


@pytest.mark.long
def test_resting_arm_learns_once_and_then_nothing():
    world = World.draw(7, start=1e9)
    run = simulate(world, 8.0)
    ekf = Ekf(terms(), Filter())
    belief = ekf.belief
    theta, std = [], []
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        if run.time[k] in (2.0, 8.0):
            theta.append(belief.theta.copy())
            std.append(np.sqrt(belief.P.diagonal()[21:]))
    # To within stiction: some 0.3 N·m at 0.5 m, that is 60 g.
    assert abs(theta[0][0] - world.mass) < 0.15
    assert np.all(np.abs(theta[1] - theta[0]) < 0.05 * std[0])
    np.testing.assert_allclose(std[1], std[0], rtol=0.05)


def test_what_no_torque_depends_on_is_not_touched():
    """A pendulum that carries a payload straight below its hinge says nothing about the payload's offset along it."""
    arm = pendulum()
    ekf = Ekf(arm, Filter(parameters=["payload"]))
    rng = np.random.default_rng(0)
    parameters, q, v = ParameterSet(arm, Filter(parameters=[])), np.array([0.8]), np.zeros(1)
    zero = np.zeros(1)
    for k in range(600):
        ekf.observe(q + rng.normal(0, 2e-5), v + rng.normal(0, 1e-3), zero, 0.005 * k)
        moved = step(arm, parameters, q, v, zero[:0], zero, zero, 0.005)
        q, v = moved.q, moved.v
    prior = ekf.parameters.covariance
    # Along the hinge's axis, y, no moment arm counts; z and x do.
    walk = (0.002 * 3.0**0.5) ** 2 * prior[2, 2]
    assert ekf.belief.theta[2] == pytest.approx(0.0, abs=1e-9)
    assert prior[2, 2] <= ekf.belief.P[5, 5] <= prior[2, 2] + 1.01 * walk
    assert ekf.belief.P[4, 4] < 0.1 * prior[1, 1]


@pytest.mark.slow
def test_learns_friction_too():
    world = World(mass=0.0, seed=3, period=4.0)
    world.coulomb = COULOMB * 1.5
    run = simulate(world, 10.0)
    ekf = Ekf(terms(), Filter(parameters=["payload", "coulomb_friction"]))
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    learned = ekf.belief.theta[4:]
    assert len(ekf.parameters.labels(JOINTS)) == 11
    np.testing.assert_allclose(learned[[0, 6]], (world.coulomb - COULOMB)[[0, 6]], atol=0.05)
    assert abs(ekf.belief.theta[0]) < 0.1


@pytest.mark.long
def test_abrupt_change_of_payload():
    world = World.draw(3, period=6.0, added_mass=1.0, added_at=4.0)
    run = simulate(world, 6.0)
    ekf = Ekf(terms(), Filter())
    mass = {}
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        mass[round(float(run.time[k]), 3)] = float(ekf.belief.theta[0])
    true = world.mass + world.added_mass
    print({t: round(mass[t] / true - 1, 3) for t in (4.0, 4.1, 4.2, 4.5, 5.0, 6.0)})
    assert abs(mass[4.0] - world.mass) < 0.05
    assert abs(mass[4.6] - true) < 0.05 * true
    assert abs(mass[6.0] - true) < 0.025 * true
    assert ekf.belief.header[Entry.OPENINGS] >= 1


def test_a_load_that_takes_its_time_to_come_is_weighed_once_it_is_there():
    """Fingers bear what they lift after a tenth of a second; what was learnt meanwhile was of neither load."""
    world = World.draw(1, period=6.0, added_mass=1.0, added_at=1.5, added_over=0.1)
    run = simulate(world, 2.3)
    ekf = Ekf(terms(), Filter())
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    error = ekf.belief.theta[0] - world.mass - world.added_mass
    assert abs(error) < 0.03 and abs(error) < 2.0 * np.sqrt(ekf.belief.P[21, 21])


# Robustness.


@pytest.mark.long
def test_outliers_are_refused_and_surprises_are_not():
    _, run = recording(1)
    ekf = Ekf(terms(), Filter())
    rng = np.random.default_rng(0)
    bad, error = 0, []
    for k in range(1200):
        q = run.q[k].copy()
        if k > 50 and rng.random() < 0.15:
            q[rng.integers(7)] += rng.choice([-1, 1]) * rng.uniform(0.005, 0.5)
            bad += 1
        ekf.observe(q, run.v[k], run.tau[k], run.time[k])
        error.append(ekf.belief.q - run.q_true[k])
    header = ekf.belief.header
    assert header[Entry.REFUSED] == bad > 100
    assert header[Entry.SURPRISES] == header[Entry.RESTARTS] == 0
    assert np.abs(error).max() < 3e-4
    assert abs(ekf.belief.theta[0] - World.draw(1).mass) < 0.08 * World.draw(1).mass


@pytest.mark.long
def test_wild_torque_is_a_surprise_not_a_payload():
    world, run = recording(2)
    ekf = Ekf(terms(), Filter())
    for k in range(1600):
        tau = run.tau[k].copy()
        if k in (900, 1000, 1100):
            tau[1] += 60.0
        ekf.observe(run.q[k], run.v[k], tau, run.time[k])
        assert np.abs(ekf.belief.q - run.q_true[k]).max() < 1e-3
    assert ekf.belief.header[Entry.SURPRISES] >= 3
    assert ekf.belief.header[Entry.RESTARTS] == 0
    assert abs(ekf.belief.theta[0] - world.mass) < 0.08 * world.mass


def test_gaps_and_clocks_set_back():
    _, run = recording(0)
    ekf = Ekf(terms(), Filter())
    header = ekf.belief.header
    for k in range(400):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    theta = ekf.belief.theta.copy()
    assert not ekf.observe(run.q[399], run.v[399], run.tau[399], run.time[399])  # seen already
    assert header[Entry.STALE] == 1
    assert not ekf.observe(run.q[10], run.v[10], run.tau[10], run.time[10])  # goes back
    assert ekf.belief.time == run.time[399]
    assert ekf.observe(run.q[600], run.v[600], run.tau[600], run.time[600])  # a second of silence
    assert header[Entry.RESTARTS] == 1
    np.testing.assert_array_equal(ekf.belief.theta, theta)
    np.testing.assert_allclose(ekf.belief.q, run.q[600])
    # A clock that starts again at zero is believed after ten messages.
    header[[Entry.ALARM, Entry.HEEDED]] = run.time[600] + 0.5, run.time[500]
    used = [ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k]) for k in range(40)]
    assert not any(used[:9]) and all(used[10:])
    # What was told before then lasts no longer; what is raised now is heeded, and what was raised then is not.
    assert header[Entry.ALARM] < ekf.belief.time
    openings = header[Entry.OPENINGS]
    for raised, opened in ((run.time[500], 0), (run.time[38], 1)):
        ekf.heed(np.array([1.0, AlarmKind.INNOVATION, raised, 2.0]))
        assert header[Entry.OPENINGS] == openings + opened


def test_bad_calls_are_typed_errors():
    ekf = Ekf(terms(), Filter())
    with pytest.raises(FilterError, match="no state"):
        ekf.predict(np.zeros(7), 0.005)
    with pytest.raises(FilterError, match="no state"):
        ekf.update(ekf.encoder, HOME)
    ekf.start(HOME, np.zeros(7), np.zeros(7), 1.0)
    for u, dt in ((np.zeros(6), 0.005), (np.full(7, np.nan), 0.005), (np.zeros(7), 0.0), (np.zeros(7), np.nan)):
        with pytest.raises(FilterError):
            ekf.predict(u, dt)
    with pytest.raises(FilterError, match="anew"):
        ekf.predict(np.zeros(7), 100.0)
    with pytest.raises(FilterError, match="encoder"):
        ekf.update(ekf.encoder, np.zeros(6))
    with pytest.raises(FilterError, match="lies before"):
        ekf.update(ekf.encoder, HOME, 0.5)
    before = ekf.belief.x.copy()
    assert not ekf.update(ekf.encoder, np.full(7, np.nan)).accepted
    np.testing.assert_array_equal(ekf.belief.x, before)
    for q, v, tau in ((HOME[:5], HOME, HOME), (HOME, None, HOME), (HOME, HOME, "idle")):
        with pytest.raises(FilterError, match="7 numbers"):
            ekf.observe(q, v, tau, 1.01)
    with pytest.raises(FilterError, match="no state can be taken"):
        ekf.start(np.full(7, np.nan), HOME, HOME, 2.0)
    np.testing.assert_array_equal(ekf.belief.x, before)
    for wrong in (Filter(rate=0.0), Filter(encoder_std=-1.0), Filter(torque_std=np.nan)):
        with pytest.raises(ScenarioError, match=r"twin\.filter\.\w+_?\w*: "):
            Ekf(terms(), wrong)
    with pytest.raises(ScenarioError, match=r"twin\.filter\.parameters.*'gravity'"):
        Ekf(terms(), Filter(parameters=["gravity"]))
    with pytest.raises(ScenarioError, match="given twice"):
        Ekf(terms(), Filter(parameters=["payload", "payload"]))


def test_predict_and_update_by_hand_equal_observe():
    _, run = recording(0)
    whole, parts = Ekf(terms(), Filter()), Ekf(terms(), Filter())
    for k in range(60):
        whole.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        parts.load(whole.belief.vector)
    k = 60
    whole.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    parts.predict(0.5 * (run.tau[k] + run.tau[k - 1]), float(run.time[k] - run.time[k - 1]))
    parts.update(parts.encoder, run.q[k])
    parts.update(parts.velocity, run.v[k], float(run.time[k]))
    np.testing.assert_allclose(parts.belief.x, whole.belief.x, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(parts.belief.P, whole.belief.P, rtol=1e-9, atol=1e-18)


@pytest.mark.long
def test_covariance_stays_positive_without_measurements_and_with():
    _, run = recording(4)
    ekf = Ekf(terms(), Filter())
    for k in range(500):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        if k % 50 == 0:
            scale = np.sqrt(ekf.belief.P.diagonal())
            assert np.linalg.eigvalsh(ekf.belief.P / np.outer(scale, scale)).min() > 0.0
    for _ in range(100):
        ekf.predict(run.tau[500], 0.005)
    scale = np.sqrt(ekf.belief.P.diagonal())
    assert np.linalg.eigvalsh(ekf.belief.P / np.outer(scale, scale)).min() > 0.0


def test_without_parameters_and_on_any_plant():
    arm = pendulum(dry=0.2)
    ekf = Ekf(arm, Filter(parameters=[]))
    truth = ParameterSet(arm, Filter(parameters=[]))
    rng = np.random.default_rng(1)
    q, v, zero = np.array([1.0]), np.zeros(1), np.zeros(1)
    for k in range(400):
        ekf.observe(q + rng.normal(0, 2e-5, 1), v + rng.normal(0, 1e-3, 1), zero, 0.005 * k)
        error = np.abs(ekf.belief.q - q)[0]
        moved = step(arm, truth, q, v, zero[:0], zero, zero, 0.005)
        q, v = moved.q, moved.v
    assert error < 5e-5
    assert ekf.belief.outside_covariance().shape == (2, 2)
    assert ekf.belief.header[Entry.REFUSED] == 0


def test_deterministic():
    _, run = recording(0)
    vectors = []
    for _ in range(2):
        ekf = Ekf(twin_terms(), Filter())
        for k in range(150):
            ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        vectors.append(ekf.belief.vector.copy())
    np.testing.assert_array_equal(vectors[0], vectors[1])
