"""Terms of an arm's equation: payload, assumed limits, joints by name, and what effects add."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BallRpyJoint, PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia

from tests.estimation.small_arms import EFFORT, INERTIA, RADIUS, SPEED, crank, gantry
from tests.estimation_bench import HOME, twin_terms
from twin_diagram.errors import ModelError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws, skew
from twin_diagram.estimation.dynamics.link_frame import LinkFrame, turned_rate

GRAVITY = 9.81


def pendulum(limits: tuple[float, float] | None = None, kind: str = "revolute") -> MultibodyPlant:
    """2 kg at 0.5 m below a hinge about y, 0.3 kg·m² about its centre; or on a slide along z."""
    plant = MultibodyPlant(0.0)
    inertia = SpatialInertia(2.0, np.array([0.0, 0.0, -0.5]), UnitInertia(0.4, 0.4, 0.15))
    body = plant.AddRigidBody("bob", inertia)
    axis = np.array([0.0, 1.0, 0.0]) if kind == "revolute" else np.array([0.0, 0.0, 1.0])
    make = RevoluteJoint if kind == "revolute" else PrismaticJoint
    joint = plant.AddJoint(make("hinge", plant.world_frame(), body.body_frame(), axis))
    if limits is not None:
        joint.set_velocity_limits([-limits[0]], [limits[0]])
        if limits[1] > 0.0:
            plant.AddJointActuator("motor", joint, effort_limit=limits[1])
    plant.Finalize()
    return plant


@pytest.mark.parametrize("mass", [0.0, 1.5])
def test_a_payload_is_a_point_on_the_last_link(mass: float) -> None:
    arm, c = ArmTerms(pendulum(), ["hinge"]), np.array([0.1, 0.2, -0.3])
    arm.set_payload(np.concatenate([[mass], mass * c]))
    inertia = 0.3 + 2.0 * 0.25 + mass * (0.1**2 + 0.3**2)
    q, v, a = np.array([0.7]), np.array([1.3]), np.array([2.0])
    np.testing.assert_allclose(arm.mass_matrix(q), [[inertia]])
    x_moment = (2.0 * 0.0 + mass * 0.1) * np.cos(0.7) + (2.0 * -0.5 + mass * -0.3) * np.sin(0.7)
    np.testing.assert_allclose(arm.inverse_dynamics(q, v, a), inertia * a - GRAVITY * x_moment)
    Y = arm.payload_regressor(q, v, a)
    np.testing.assert_allclose(Y[0, [0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose(Y[0, [1, 3]], [-GRAVITY * np.cos(0.7), -GRAVITY * np.sin(0.7)])


def test_a_payload_s_centre_lies_within_half_a_metre_and_its_mass_is_not_negative() -> None:
    arm = ArmTerms(pendulum(), ["hinge"])
    for distance, counts in ((0.49, 0.49), (0.51, 0.5), (3.0, 0.5)):
        arm.set_payload(np.array([1.0, 0.6 * distance, 0.0, -0.8 * distance]))
        np.testing.assert_allclose(arm.mass_matrix(np.zeros(1)), [[0.8 + counts**2]])
    for payload in ([-1.0, 0.5, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0]):
        arm.set_payload(np.array(payload))
        np.testing.assert_allclose(arm.mass_matrix(np.zeros(1)), [[0.8]])


def test_a_payload_at_a_far_tool_counts_where_it_is() -> None:
    """A hand of 0.8 m: the inertia of what it carries is that at its place, up to twice as far."""
    arm, still = crank(), np.zeros(1)
    for distance, counts in ((0.8, 0.8), (1.59, 1.59), (3.0, 1.6)):
        arm.set_payload(np.zeros(4))
        bare = arm.mass_matrix(still)
        arm.set_payload(np.array([2.0, 2.0 * distance, 0.0, 0.0]))
        np.testing.assert_allclose(arm.mass_matrix(still) - bare, [[2.0 * counts**2]])


def test_limits_that_no_description_names_come_from_weight_and_inertia() -> None:
    """Twice the largest weight and 10 rad/s²; a turn, or a metre, from rest with all of it."""
    level = crank(effort=np.inf)
    np.testing.assert_allclose(level.effort_limit, 10.0 * INERTIA)
    np.testing.assert_allclose(level.velocity_limit, 10.0)
    slide = ArmTerms(pendulum(kind="prismatic"), ["hinge"])
    effort = 2.0 * 2.0 * GRAVITY + 10.0 * 2.0
    np.testing.assert_allclose(slide.effort_limit, effort)
    np.testing.assert_allclose(slide.velocity_limit, np.sqrt(2.0 * effort / 2.0))
    hinge = ArmTerms(pendulum(), ["hinge"])
    effort = 2.0 * GRAVITY * 1.0 + 10.0 * 0.8  # the largest weight of sixteen poses is all but that of a level arm
    np.testing.assert_allclose(hinge.effort_limit, 2.0 * GRAVITY + 8.0, rtol=0.02)
    np.testing.assert_allclose(hinge.velocity_limit, np.sqrt(2.0 * hinge.effort_limit * 2.0 * np.pi / 0.8))
    assert hinge.effort_limit[0] <= effort and slide.prismatic[0] and not hinge.prismatic[0]
    named = gantry()
    np.testing.assert_array_equal(named.effort_limit, EFFORT)
    np.testing.assert_array_equal(named.velocity_limit, SPEED)
    assert named.assumptions() == [] and len(hinge.assumptions()) == 2
    assert "m/s" in slide.assumptions()[0] and "rad/s" in hinge.assumptions()[0]
    given = ArmTerms(pendulum((3.0, 0.0)), ["hinge"])
    assert given.velocity_limit[0] == 3.0 and len(given.assumptions()) == 1


def test_the_tool_is_where_a_payload_is_expected() -> None:
    np.testing.assert_allclose(crank().tool, [RADIUS, 0.0, 0.0])
    np.testing.assert_array_equal(gantry().tool, np.zeros(3))
    with pytest.raises(ModelError, match="'claw'"):
        ArmTerms(crank().plant, ["pin"], tool_frame="claw")


def test_joints_are_found_by_name_and_take_one_degree_of_freedom() -> None:
    plant = crank().plant
    model = plant.GetModelInstanceName(plant.GetJointByName("pin").model_instance())
    assert ArmTerms(plant, [f"{model}::pin"]).n == 1
    for wrong in ("nail", "nobody::pin", f"{model}::nail"):
        with pytest.raises(ModelError, match=wrong):
            ArmTerms(plant, [wrong])
    with pytest.raises(ModelError, match="at least one"):
        ArmTerms(plant, [])
    ball = MultibodyPlant(0.0)
    body = ball.AddRigidBody("b", SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.1)))
    ball.AddJoint(BallRpyJoint("ball", ball.world_frame(), body.body_frame()))
    with pytest.raises(ModelError, match="Finalize"):
        ArmTerms(ball, ["ball"])
    ball.Finalize()
    with pytest.raises(ModelError, match="3 degrees"):
        ArmTerms(ball, ["ball"])


def test_effects_add_to_the_plant_s_torque() -> None:
    plain, laws = gantry(), Laws(load=lambda q, v, tau: q + 2.0 * v + 3.0 * tau, applied=lambda tau: 0.5 * tau)
    with_laws = gantry(laws, damping=(0.7, 0.3))
    q, v, tau = np.array([0.1, 0.2]), np.array([0.3, 0.4]), np.array([5.0, 6.0])
    np.testing.assert_allclose(with_laws.load(q, v, tau), [0.7 * 0.3, 0.3 * 0.4] + q + 2.0 * v + 3.0 * tau)
    np.testing.assert_allclose(plain.load(q, v, tau), 0.0, atol=1e-12)
    np.testing.assert_array_equal(with_laws.damping, [0.7, 0.3])
    np.testing.assert_array_equal(with_laws.applied(tau), 0.5 * tau)
    assert plain.applied(tau) is tau and plain.true_position(q) is q
    assert not np.any(plain.dry(q, v, tau))


def test_a_payload_s_torque_is_linear_in_mass_and_moment_but_for_its_own_inertia() -> None:
    """On seven joints: a mass on the link's origin, and moments of a mass that is next to nothing."""
    arm, rng = twin_terms(), np.random.default_rng(1373)
    for _ in range(3):
        q, v, a = HOME + rng.normal(0, 0.4, 7), rng.normal(size=7), 3.0 * rng.normal(size=7)
        arm.set_payload(np.zeros(4))
        bare, Y = arm.inverse_dynamics(q, v, a), arm.payload_regressor(q, v, a)
        arm.set_payload(np.array([2.0, 0.0, 0.0, 0.0]))
        np.testing.assert_allclose(arm.inverse_dynamics(q, v, a) - bare, 2.0 * Y[:, 0], atol=1e-9)
        for k in range(3):
            both = []
            for sign in (1.0, -1.0):
                moment = sign * 0.02 * np.eye(3)[k]
                arm.set_payload(np.concatenate([[1.0], moment]))
                both.append(arm.inverse_dynamics(q, v, a))
            np.testing.assert_allclose((both[0] - both[1]) / 0.04, Y[:, 1 + k], atol=1e-9)


def test_frames_on_links_move_as_their_positions_do() -> None:
    """Jacobian, velocity, accelerations and the turning of ω, each against central differences of the pose."""
    from pydrake.math import RigidTransform, RollPitchYaw

    arm, rng = twin_terms(), np.random.default_rng(1374)
    frame = LinkFrame(arm, "panda_link5", RigidTransform(RollPitchYaw(0.3, -0.2, 0.5), [0.02, -0.03, 0.08]))
    q, v, h = HOME + rng.normal(0, 0.3, 7), rng.normal(size=7), 1e-5
    motion = frame.motion(q, v)
    R, p, J = frame.jacobian(q)
    np.testing.assert_array_equal(motion.R_WF, R)
    np.testing.assert_array_equal(motion.p_WF, p)
    np.testing.assert_allclose(np.vstack([motion.J_w, motion.J_v]), J, atol=1e-12)
    np.testing.assert_allclose([*motion.omega, *motion.velocity], J @ v, atol=1e-12)
    (R_a, p_a), (R_b, p_b) = frame.pose(q - h * v), frame.pose(q + h * v)
    np.testing.assert_allclose((p_b - p_a) / (2 * h), motion.velocity, atol=1e-7)
    np.testing.assert_allclose((R_b - R_a) / (2 * h), skew(motion.omega) @ R, atol=1e-7)
    after, before = frame.motion(q + h * v, v), frame.motion(q - h * v, v)
    np.testing.assert_allclose((after.omega - before.omega) / (2 * h), motion.bias_alpha, atol=1e-6)
    np.testing.assert_allclose((after.velocity - before.velocity) / (2 * h), motion.bias_a, atol=1e-6)
    turned = turned_rate(motion, v)
    for i, unit in enumerate(np.eye(7)):
        change = frame.motion(q + h * unit, v).omega - frame.motion(q - h * unit, v).omega
        np.testing.assert_allclose(turned[:, i], change / (2 * h), atol=1e-6)
    np.testing.assert_allclose(skew(v[:3]) @ v[3:6], np.cross(v[:3], v[3:6]))
    with pytest.raises(ModelError, match="'tail'"):
        LinkFrame(arm, "tail")


def test_derivatives_of_torque_leave_the_arm_where_it_was() -> None:
    arm, rng = twin_terms(), np.random.default_rng(1375)
    q, v, a = HOME + rng.normal(0, 0.3, 7), rng.normal(size=7), rng.normal(size=7)
    by_q, by_v = arm.derivatives(q, v, a)
    for i, unit in enumerate(np.eye(7)):
        for column, change in ((by_q[:, i], (1e-4 * unit, 0.0 * unit)), (by_v[:, i], (0.0 * unit, 1e-4 * unit))):
            ahead = arm.inverse_dynamics(q + change[0], v + change[1], a)
            behind = arm.inverse_dynamics(q - change[0], v - change[1], a)
            np.testing.assert_allclose(column, (ahead - behind) / 2e-4, atol=2e-4)
