"""Sensors' figures: noise as told, gates by their odds, readings by hand; one sensor after the other."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia
from scipy.stats import chi2

from tests.estimation.small_arms import crank, gantry
from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.sensors import (
    BodyPose,
    ImuBias,
    Instant,
    JointEncoder,
    JointState,
    JointVelocity,
    LinkImu,
    MotorTorque,
    PoseBias,
    WrenchBias,
    WristWrench,
)
from twin_diagram.estimation.sensors.camera_noise_regressor import camera_noise, features
from twin_diagram.estimation.sensors.from_scenario import make_sensor
from twin_diagram.scenario import Filter, SensorSpec
from twin_diagram.signals.rotations import exp, multiply

Q, V = np.array([0.1, -0.2]), np.array([0.5, -0.4])
X = np.concatenate([Q, V, [0.7, -0.9]])


@pytest.mark.parametrize("size", [1, 2, 4])
def test_a_gate_refuses_one_good_reading_in_a_million(size: int) -> None:
    assert chi2.sf(MotorTorque(size).gate, size) == pytest.approx(1e-6, rel=1e-6)
    assert chi2.sf(JointEncoder(size, 1.0).gate, size) == pytest.approx(1e-6, rel=1e-6)
    assert chi2.sf(JointState(size, 1.0, 1.0).gate, 2 * size) == pytest.approx(1e-6, rel=1e-6)
    assert chi2.sf(BodyPose(gantry(), "car").gate, 6) == pytest.approx(1e-6, rel=1e-6)


@pytest.mark.parametrize(
    ("value", "sound"), [(0.99e6, True), (-0.99e6, True), (1e6, False), (-1.1e6, False), (np.nan, False)]
)
def test_a_reading_is_finite_and_below_a_million(value: float, sound: bool) -> None:
    assert MotorTorque(2).sound(np.array([0.0, value])) == sound


def test_the_arm_s_own_sensors_read_the_state() -> None:
    both = JointState(2, 0.1, 0.3)
    for sensor, entries, std in (
        (JointEncoder(2, 0.1), slice(0, 2), [0.1, 0.1]),
        (JointVelocity(2, 0.3), slice(2, 4), [0.3, 0.3]),
        (both, slice(0, 4), [0.1, 0.1, 0.3, 0.3]),
    ):
        np.testing.assert_array_equal(sensor.reading(X), X[entries])
        np.testing.assert_array_equal(sensor.jacobian(X), np.eye(6)[entries])
        np.testing.assert_array_equal(sensor.jacobian(np.zeros(9)), np.eye(9)[entries])
        np.testing.assert_allclose(sensor.noise(X), np.diag(np.square(std)))
        np.testing.assert_allclose(sensor.innovation(X[entries] + 1.0, X[entries]), 1.0)
        at = sensor.linear(Instant(X, 2, 0, np.zeros(2)))
        np.testing.assert_array_equal(at.reading, X[entries])
        assert sensor.size == sensor.length == len(std) and not sensor.own_labels() and not len(sensor.own_walk())


def test_motor_torque_is_the_disturbance_with_both_noises() -> None:
    sensor = MotorTorque(2, 0.4, 0.3)
    np.testing.assert_array_equal(sensor.reading(X), [0.7, -0.9])
    np.testing.assert_array_equal(sensor.jacobian(X), np.eye(6)[4:])
    np.testing.assert_allclose(sensor.noise(X), 0.25 * np.eye(2))
    np.testing.assert_allclose(MotorTorque(2).noise(X), 0.1 * np.eye(2))
    np.testing.assert_allclose(sensor.linear(Instant(X, 2, 0, np.zeros(2))).reading, [0.7, -0.9])


def test_a_pose_s_noise_is_the_square_of_what_is_told() -> None:
    sensor = BodyPose(gantry(), "car", std_p=0.01, std_r=0.03)
    for noise in (sensor.noise(X), sensor.linear(Instant(X, 2, 0, np.zeros(2))).noise):
        np.testing.assert_allclose(noise, np.diag([9e-4] * 3 + [1e-4] * 3))
    np.testing.assert_allclose(BodyPose(gantry(), "car").noise(X), np.diag([0.02**2] * 3 + [0.003**2] * 3))
    assert sensor.length == 7 and not len(sensor.own_std()) and not sensor.own_labels()


def test_a_pose_s_bias_turns_and_moves_it_in_the_world() -> None:
    sensor = BodyPose(
        gantry(), "car", X_BO=RigidTransform(RollPitchYaw(0.3, 0.2, 0.1), [0.1, 0.2, 0.3]), bias=PoseBias(0.004, 0.02)
    )
    np.testing.assert_allclose(sensor.own_std(), [0.02] * 3 + [0.004] * 3)
    np.testing.assert_allclose(sensor.own_walk(), 0.01 * sensor.own_std())
    assert sensor.own_labels()[0] == "camera.bias_rx [rad]" and sensor.own_labels()[5] == "camera.bias_z [m]"
    sensor.declare(slice(6, 12), None)
    bias = np.array([0.02, -0.01, 0.03, 0.001, 0.002, -0.003])
    plain = sensor.linear(Instant(np.concatenate([X, np.zeros(6)]), 2, 0, np.zeros(2)))
    wrong = sensor.linear(Instant(np.concatenate([X, bias]), 2, 0, np.zeros(2)))
    np.testing.assert_allclose(plain.reading[4:], [0.2, 0.0, 0.3])
    np.testing.assert_allclose(plain.reading, sensor.reading(X))
    np.testing.assert_allclose(wrong.reading[:4], multiply(exp(bias[:3]), plain.reading[:4]))
    np.testing.assert_allclose(wrong.reading[4:], plain.reading[4:] + bias[3:])
    np.testing.assert_allclose(sensor.innovation(wrong.reading, plain.reading), bias, atol=1e-12)
    expected = np.zeros((6, 12))
    expected[3, 0] = expected[4, 1] = 1.0
    expected[:, 6:] = np.eye(6)
    np.testing.assert_allclose(wrong.jacobian, expected, atol=1e-12)
    np.testing.assert_allclose(sensor.jacobian(X), expected[:, :6], atol=1e-12)


@pytest.mark.parametrize(
    ("length", "sound"), [(1.0, True), (1.099, True), (0.901, True), (1.101, False), (0.899, False)]
)
def test_a_quaternion_has_length_one_to_within_a_tenth(length: float, sound: bool) -> None:
    z = np.array([0.6 * length, 0.0, -0.8 * length, 0.0, 1.0, 2.0, 3.0])
    sensor = BodyPose(gantry(), "car")
    assert sensor.sound(z) == sound and not sensor.sound(np.full(7, np.nan))
    np.testing.assert_allclose(
        sensor.innovation(z, np.array([0.6, 0.0, -0.8, 0.0, 0.5, 2.0, 2.0])), [0, 0, 0, 0.5, 0, 1], atol=1e-12
    )


def test_biases_of_a_sensor_on_a_link_drift_as_told() -> None:
    imu = LinkImu(gantry(), "car", gyro_std=0.1, accel_std=0.2, bias=ImuBias(0.3, 0.4, 0.5, 0.6))
    wrench = WristWrench(gantry(), "car", force_std=0.2, moment_std=0.1, bias=WrenchBias(0.4, 0.3, 0.6, 0.5))
    for sensor in (imu, wrench):
        np.testing.assert_allclose(sensor.noise(X), np.diag(np.square(np.repeat([0.1, 0.2], 3))))
        np.testing.assert_allclose(sensor.own_std(), np.repeat([0.3, 0.4], 3))
        np.testing.assert_allclose(sensor.own_walk(), np.repeat([0.5, 0.6], 3))
    assert imu.own_labels()[1] == "imu.gyro_bias_y [rad/s]" and wrench.own_labels()[5] == "wrench.force_bias_z [N]"
    imu, wrench = LinkImu(gantry(), "car"), WristWrench(gantry(), "car")
    np.testing.assert_allclose(imu.own_std(), np.repeat([0.02, 0.1], 3))
    np.testing.assert_allclose(imu.own_walk(), np.repeat([1e-4, 1e-3], 3))
    np.testing.assert_allclose(wrench.own_std(), np.repeat([0.1, 1.0], 3))
    np.testing.assert_allclose(wrench.own_walk(), np.repeat([3e-4, 3e-3], 3))
    np.testing.assert_allclose(LinkImu(gantry(), "car").noise(X), np.diag(np.square(np.repeat([1e-3, 1e-2], 3))))
    np.testing.assert_allclose(WristWrench(gantry(), "car").noise(X), np.diag(np.square(np.repeat([0.01, 0.1], 3))))


def test_an_imu_on_a_crank() -> None:
    """At the hand, 0.8 m out: ω, and in its own axes −r ω² and r α, beside gravity."""
    sensor = LinkImu(crank(), "hand")
    sensor.declare(slice(3, 9), None)
    bias, omega, alpha = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]), 1.5, 2.0
    x = np.concatenate([[0.7, omega, 0.0], bias])
    by_state = np.zeros((1, 9))
    by_state[0, 2] = 2.0  # a unit of disturbance accelerates it by two
    now = Instant(x, 1, 0, np.array([alpha]), by_state, np.array([[0.04]]))
    at = sensor.linear(now)
    expected = np.array([0.0, 0.0, omega, -0.8 * omega**2, 0.8 * alpha, 9.81])
    np.testing.assert_allclose(at.reading, expected + bias, atol=1e-12)
    H = np.zeros((6, 9))
    H[2, 1], H[:, 3:], H[4, 2] = 1.0, np.eye(6), 1.6
    # The faster, the harder it is pulled inwards; wherever the crank has turned to, it feels the same.
    H[3, 1] = -2.0 * 0.8 * omega
    np.testing.assert_allclose(at.jacobian, H, atol=1e-9)
    noise = np.diag(np.square(np.repeat([1e-3, 1e-2], 3)))
    noise[4, 4] += 0.8**2 * 0.04
    np.testing.assert_allclose(at.noise, noise, atol=1e-15)
    np.testing.assert_allclose(sensor.reading(x), expected * [1, 1, 1, 1, 0, 1] + bias, atol=1e-12)
    np.testing.assert_allclose(sensor.jacobian(x)[:3], H[:3], atol=1e-9)


def test_an_imu_on_joints_that_turn_and_slide_knows_what_its_reading_depends_on() -> None:
    """Against differences, by Drake's acceleration at no joint's own; the last joint moves nothing of it."""
    rng, plant = np.random.default_rng(0), MultibodyPlant(0.0)
    before, kinds = plant.world_frame(), (RevoluteJoint, PrismaticJoint, RevoluteJoint, PrismaticJoint, RevoluteJoint)
    for k, kind in enumerate(kinds):
        body = plant.AddRigidBody(f"b{k}", SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.1)))
        place = RigidTransform(RollPitchYaw(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 0.3, 3))
        frame = plant.AddFrame(FixedOffsetFrame(f"f{k}", before, place))
        joint = plant.AddJoint(kind(f"j{k}", frame, body.body_frame(), rng.normal(0.0, 1.0, 3)))
        joint.set_velocity_limits([-9.0], [9.0])
        plant.AddJointActuator(f"m{k}", joint, effort_limit=9.0)
        before = body.body_frame()
    plant.Finalize()
    terms = ArmTerms(plant, [f"j{k}" for k in range(5)])
    sensor, x, a = (
        LinkImu(terms, "b3", RigidTransform([0.1, 0.2, 0.3])),
        rng.normal(0.0, 1.0, 15),
        rng.normal(0.0, 1.0, 5),
    )
    H = sensor.linear(Instant(x, 5, 0, a)).jacobian
    for i, step in enumerate(1e-5 * np.eye(15)[:10]):
        up, down = (sensor.linear(Instant(x + sign * step, 5, 0, a)).reading for sign in (1.0, -1.0))
        np.testing.assert_allclose(H[:, i], (up - down) / 2e-5, atol=1e-7)


def test_an_imu_on_a_fast_crank_is_believed() -> None:
    """At 6 rad/s three readings of ten were refused and errors were 8 times what was claimed, squared."""
    rng, ekf, n = np.random.default_rng(1), Ekf(crank(), Filter(rate=100.0, noise_time=0.0)), 800
    ekf.add(LinkImu(ekf.terms, "hand"))
    bias, step, q, v = rng.normal(0.0, np.repeat([0.02, 0.1], 3)), 0.002, 0.3, 6.0
    ekf.start(np.array([q]), np.array([v]), np.zeros(1), 1.0)
    found = []
    for k in range(1, n):
        a = rng.normal(0.0, 0.3 * np.sqrt(5.0)) / float(ekf.terms.mass_matrix(np.zeros(1))[0, 0])
        q, v, t = q + step * v + 0.5 * step**2 * a, v + step * a, 1.0 + step * k
        ideal = np.array([0.0, 0.0, v, -0.8 * v**2, 0.8 * a, 9.81])
        result = ekf.update("imu", ideal + bias + rng.normal(0.0, np.repeat([1e-3, 1e-2], 3)), t)
        found.append((result.accepted, result.nis / 6.0, (ekf.belief.v[0] - v) ** 2 / ekf.belief.P[1, 1]))
        if k % 5 == 0:
            ekf.observe(np.array([q + rng.normal(0.0, 2e-5)]), np.array([v + rng.normal(0.0, 2e-3)]), np.zeros(1), t)
    used, nis, nees = np.mean(found[100:], axis=0)
    assert used > 0.99 and 0.8 < nis < 1.2 and nees < 2.0


def test_sensors_as_a_scenario_names_them() -> None:
    arm = gantry()
    pose = make_sensor(arm, SensorSpec(kind="body_pose", std=[0.01, 0.03]))
    np.testing.assert_allclose(pose.noise(X), np.diag([9e-4] * 3 + [1e-4] * 3))
    imu = make_sensor(arm, SensorSpec(kind="imu", name="mine", body="bridge", std=[0.1, 0.2]))
    np.testing.assert_allclose(imu.noise(X).diagonal(), np.square(np.repeat([0.1, 0.2], 3)))
    wrench = make_sensor(arm, SensorSpec(kind="wrench", std=[0.2, 0.1]))
    np.testing.assert_allclose(wrench.noise(X).diagonal(), np.square(np.repeat([0.1, 0.2], 3)))
    torque = make_sensor(arm, SensorSpec(kind="torque", std=[0.4]))
    np.testing.assert_allclose(torque.noise(X), (0.16 + 0.09) * np.eye(2))
    assert [sensor.name for sensor in (pose, imu, wrench, torque)] == ["body_pose", "mine", "wrench", "torque"]
    assert [type(sensor) for sensor in (pose, imu, wrench, torque)] == [BodyPose, LinkImu, WristWrench, MotorTorque]
    assert pose.frame.pose(Q)[1] == pytest.approx([0.1, -0.2, 0.0])  # the last link
    assert imu.frame.pose(Q)[1] == pytest.approx([0.1, 0.0, 0.0])
    make_sensor(arm, SensorSpec(kind="imu"))
    for kind, std in (
        ("imu", [0.1]),
        ("imu", [0.1, 0.0]),
        ("imu", [0.1, -1.0]),
        ("torque", [0.1, 0.2]),
        ("wrench", [0.1, 0.2, 0.3]),
    ):
        with pytest.raises(ScenarioError, match="positive numbers"):
            make_sensor(arm, SensorSpec(kind=kind, std=std))
    with pytest.raises(ScenarioError, match="'sonar'"):
        make_sensor(arm, SensorSpec(kind="sonar"))


# A camera's noise by its looks.


def test_a_good_look_is_as_sure_as_what_was_learnt_from() -> None:
    """Nothing covered and a brightness of 0.4: 1.14 mrad and 95 µm."""
    good = camera_noise(0.0, 0.4)
    np.testing.assert_allclose(good, np.repeat([1.144e-3, 9.506e-5], 3), rtol=1e-3)
    np.testing.assert_allclose(camera_noise(0.0, 0.4, np.array([0.01, 0.002])), np.repeat([0.01, 0.002], 3))
    np.testing.assert_allclose(features(0.3, 0.6), [1.0, 0.3, 0.09, 0.2, 0.04])
    np.testing.assert_allclose(features(-1.0, 2.0), [1.0, 0.0, 0.0, 0.6, 0.36])
    np.testing.assert_allclose(features(2.0, -1.0), [1.0, 1.0, 1.0, -0.4, 0.16])


@pytest.mark.parametrize(
    ("covered", "brightness", "worse"),
    [
        (0.5, 0.4, (2.6635, 3.0241)),
        (0.0, 0.0, (1.1555, 1.5019)),
        (0.0, 1.0, (3.2517, 20.0)),
        (0.2, 0.7, (1.7636, 3.7554)),
        (1.0, 1.0, (20.0, 20.0)),
    ],
)
def test_a_bad_look_is_worse_by_what_was_fitted(covered: float, brightness: float, worse: tuple[float, float]) -> None:
    """The fit of `train_camera_noise.py`, worked out on paper; twenty times at most."""
    np.testing.assert_allclose(
        camera_noise(covered, brightness) / camera_noise(0.0, 0.4), np.repeat(worse, 3), rtol=2e-3
    )


def test_a_look_is_never_half_as_good_again_and_one_of_nothing_is_the_worst() -> None:
    steep = np.array([[0.0, -5.0, 0.0, 0.0, 0.0], [0.0, 5.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(camera_noise(0.9, 0.4, None, steep), np.repeat([0.5, 20.0], 3))
    for covered, brightness in ((np.nan, 0.4), (0.0, np.nan), (np.inf, 0.4)):
        np.testing.assert_allclose(camera_noise(covered, brightness, np.ones(2)), 20.0)
