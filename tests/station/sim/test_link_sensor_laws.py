"""Further sensors' laws: held against moving points of mass, and each sensor by itself on given motions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialAcceleration, SpatialForce, SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import ArmModel, LinkSensor, Pose, Scenario, SensorDefects
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.signals.rotations import exp
from twin_diagram.station.sim.arm_plant import ArmPlant, add_arm
from twin_diagram.station.sim.link_sensors import (
    LinkSensorSystem,
    Load,
    _checked,
    load_wrench,
    specific_force,
)
from twin_diagram.station.sim.noise import Stream, generator

G = np.array([0.3, -0.2, -9.81])
RNG = np.random.default_rng(2051)
OMEGA, ALPHA, A = RNG.normal(size=(3, 3)) * [[2.0], [5.0], [3.0]]
R0 = RollPitchYaw(0.4, -0.7, 1.2).ToRotationMatrix().matrix()


def turned(t: float) -> Array:
    """R(t) of a body that turns with OMEGA and ALPHA at t = 0, to second order."""
    from pydrake.common.eigen_geometry import Quaternion

    wxyz = exp(OMEGA * t + 0.5 * ALPHA * t**2)
    return np.asarray(RotationMatrix(Quaternion(wxyz / np.linalg.norm(wxyz))).matrix() @ R0)


def acceleration(p_B: Array, h: float = 1e-3) -> Array:
    """Of a point fixed to it, whose origin accelerates with A, by differences."""
    at = [turned(t) @ p_B + 0.5 * A * t**2 for t in (-h, 0.0, h)]
    return np.asarray((at[0] - 2.0 * at[1] + at[2]) / h**2)


def test_an_imu_feels_the_acceleration_of_its_place_less_gravity() -> None:
    p_B = np.array([0.1, -0.3, 0.2])
    found = specific_force(OMEGA, ALPHA, A, R0 @ p_B, G)
    np.testing.assert_allclose(found, acceleration(p_B) - G, atol=1e-3)


def test_what_moving_a_body_takes_is_what_moving_its_points_of_mass_takes() -> None:
    masses, places = RNG.uniform(0.1, 1.0, 12), RNG.normal(0.0, 0.2, (12, 3))
    com = masses @ places / masses.sum()
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, places, strict=True))
    moment, force = load_wrench(Load(1, float(masses.sum()), com, inertia), R0, OMEGA, ALPHA, A, G)
    pulls = [m * (acceleration(p) - G) for m, p in zip(masses, places, strict=True)]
    np.testing.assert_allclose(force, np.sum(pulls, axis=0), atol=1e-2)
    wanted = np.sum([np.cross(R0 @ p, pull) for p, pull in zip(places, pulls, strict=True)], axis=0)
    np.testing.assert_allclose(moment, wanted, atol=1e-2)


# Defects.


def test_where_nothing_is_told_noise_is_that_of_its_kind_and_there_is_no_bias() -> None:
    noise, bias = _checked(SensorDefects(), "imu", "x.imu")
    np.testing.assert_allclose(noise, [1e-3] * 3 + [1e-2] * 3)
    assert not bias.any() and bias.shape == (6,)
    noise, _ = _checked(SensorDefects(), "wrench", "wrist")
    np.testing.assert_allclose(noise, [0.01] * 3 + [0.1] * 3)
    noise, bias = _checked(SensorDefects(noise=[0.0, 2.0], bias=list(range(6)), missing=[[1.0, 1.0]]), "imu", "x.imu")
    np.testing.assert_array_equal(noise, [0.0] * 3 + [2.0] * 3)
    np.testing.assert_array_equal(bias, np.arange(6.0))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"noise": [1.0]}, "noise"),
        ({"noise": [1.0, 1.0, 1.0]}, "noise"),
        ({"noise": [1.0, -1e-9]}, "noise"),
        ({"noise": [float("inf"), 1.0]}, "noise"),
        ({"bias": [0.0] * 5}, "bias"),
        ({"bias": [0.0] * 7}, "bias"),
        ({"bias": [0.0] * 5 + [float("nan")]}, "bias"),
        ({"missing": [[0.0, 1.0], [1.0]]}, "missing"),
        ({"missing": [[1.0, 2.0], [1.0, 0.9]]}, "missing"),
        ({"missing": [[1.0, 2.0, 3.0]]}, "missing"),
    ],
)
def test_defects_that_cannot_be_are_refused(change: dict[str, Any], field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"world\.sensor_defects\.hand\.{field}"):
        _checked(SensorDefects(**change), "imu", "hand")


# A sensor by itself, on a motion that is given.

BARE = SensorDefects(noise=[0.0, 0.0])


@pytest.fixture(scope="module")
def arm() -> tuple[MultibodyPlant, ArmPlant, Scenario]:
    plan = Scenario(seed=13)
    plan.twin.arm, plan.world.arm = (ArmModel("arms/ur5e.urdf", tool_frame="tool0") for _ in range(2))
    plan.twin.home = []
    plant = MultibodyPlant(0.001)
    found = add_arm(plant, plan)
    plant.Finalize()
    return plant, found, plan


Arm = tuple[MultibodyPlant, ArmPlant, Scenario]


def given(system: LinkSensorSystem, plant: MultibodyPlant, context: Any) -> dict[str, list[Any]]:
    """Fix the same arbitrary motion and reactions at the ports; return them."""
    rng = np.random.default_rng(2052)
    bodies, joints = plant.num_bodies(), plant.num_joints()
    values: dict[str, list[Any]] = {
        "body_poses": [RigidTransform(RollPitchYaw(*rng.normal(size=3)), rng.normal(size=3)) for _ in range(bodies)],
        "body_velocities": [SpatialVelocity(*rng.normal(size=(2, 3))) for _ in range(bodies)],
        "body_accelerations": [SpatialAcceleration(*rng.normal(size=(2, 3))) for _ in range(bodies)],
        "reaction_forces": [SpatialForce(*rng.normal(size=(2, 3))) for _ in range(joints)],
    }
    for name, value in values.items():
        system.GetInputPort(name).FixValue(context, Value(value))
    return values


def readings(arm: Arm, sensor: LinkSensor, defects: SensorDefects, times: list[float], place: int = 0) -> list[Any]:
    """What stands on the ports at these times: reading (6,) and its time."""
    plant, found, plan = arm
    system = LinkSensorSystem(sensor, defects, plant, found, place, plan)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    given(system, plant, context)
    rows = []
    for time in times:
        simulator.AdvanceTo(time)
        rows.append([np.array(system.GetOutputPort(name).Eval(context)) for name in ("reading", "time")])
    return rows


def taken(arm: Arm, sensor: LinkSensor, defects: SensorDefects, times: list[float]) -> list[float]:
    return [round(float(time[0]), 9) for _, time in readings(arm, sensor, defects, times)]


def test_readings_come_at_k_over_the_rate_and_none_at_zero(arm: Arm) -> None:
    assert taken(arm, LinkSensor(rate=100.0), BARE, [0.009, 0.011, 0.029, 0.031]) == [NEVER, 0.01, 0.02, 0.03]


@pytest.mark.parametrize(("latency", "periods"), [(0.0, 0), (0.02, 2), (0.021, 3), (0.07, 7), (0.0699999, 7)])
def test_latency_is_rounded_up_to_whole_periods(arm: Arm, latency: float, periods: int) -> None:
    """0.07 times 100 is a little more than 7 by rounding, which is no eighth period."""
    first = 0.01 * (1 + periods)
    sensor = LinkSensor(rate=100.0, latency=latency)
    assert taken(arm, sensor, BARE, [first - 0.001, first + 0.001, first + 0.011]) == [NEVER, 0.01, 0.02]


def test_in_an_outage_the_newest_reading_stays(arm: Arm) -> None:
    sensor = LinkSensor(rate=8.0)  # periods that floats hold exactly
    missing = SensorDefects(noise=[0.0, 0.0], missing=[[0.25, 0.5], [1.0, 1.125]])
    times = [0.125 * k + 0.01 for k in range(1, 11)]
    wanted = [0.125, 0.125, 0.125, 0.5, 0.625, 0.75, 0.875, 0.875, 1.125, 1.25]
    assert taken(arm, sensor, missing, times) == wanted


def test_noise_and_bias_are_those_of_seed_sensor_and_message(arm: Arm) -> None:
    sensor, bias = LinkSensor(rate=100.0), [0.1, 0.2, 0.3, -0.4, -0.5, 0.6]
    (clean, _), (noisy, _) = (
        readings(arm, sensor, defects, [0.031], place=2)[0]
        for defects in (BARE, SensorDefects(noise=[0.02, 0.5], bias=bias))
    )
    noise = generator(13 + 3 * 1_000_003, Stream.LINK, 3).standard_normal(6)
    np.testing.assert_allclose(noisy - clean - bias, noise * [0.02, 0.02, 0.02, 0.5, 0.5, 0.5], atol=1e-12)
    drawn = [readings(arm, sensor, SensorDefects(noise=[1.0, 1.0]), [0.031], place=k)[0][0] for k in range(3)]
    assert len({tuple(reading) for reading in drawn}) == 3, "each sensor has its own"


def test_an_imu_reads_the_motion_of_its_own_frame(arm: Arm) -> None:
    plant, found, plan = arm
    pose = Pose([0.1, 0.2, -0.3], [0.5, -0.4, 0.3])
    system = LinkSensorSystem(LinkSensor(body="forearm_link", X_BS=pose), BARE, plant, found, 0, plan)
    context = system.CreateDefaultContext()
    motion = given(system, plant, context)
    body = int(plant.GetBodyByName("forearm_link").index())
    R_WB = motion["body_poses"][body].rotation().matrix()
    R_WS = R_WB @ RollPitchYaw(0.5, -0.4, 0.3).ToRotationMatrix().matrix()
    V, A_WB = motion["body_velocities"][body], motion["body_accelerations"][body]
    force = specific_force(
        V.rotational(), A_WB.rotational(), A_WB.translational(), R_WB @ [0.1, 0.2, -0.3], np.array([0.0, 0.0, -9.81])
    )
    wanted = np.concatenate([R_WS.T @ V.rotational(), R_WS.T @ force])
    np.testing.assert_allclose(system.ideal(context), wanted, atol=1e-12)


def test_a_wrench_is_what_the_last_joint_bears_but_for_what_is_described(arm: Arm) -> None:
    """The reaction, shifted to the sensor by hand, less what moving each described body takes."""
    plant, found, plan = arm
    pose = Pose([0.02, -0.03, 0.05], [0.5, -0.4, 0.3])
    system = LinkSensorSystem(LinkSensor("wrench", X_BS=pose), BARE, plant, found, 0, plan)
    context = system.CreateDefaultContext()
    motion = given(system, plant, context)
    joint = found.joints[-1]
    child = joint.child_body()
    X_WC = motion["body_poses"][int(child.index())]
    X_WJ = X_WC @ joint.frame_on_child().GetFixedPoseInBodyFrame()
    X_WS = motion["body_poses"][int(plant.get_body(found.arm.last_link).index())] @ RigidTransform(
        RollPitchYaw(0.5, -0.4, 0.3), [0.02, -0.03, 0.05]
    )
    at = [int(index) for index in plant.GetJointIndices()].index(int(joint.index()))
    F = motion["reaction_forces"][at]
    force = X_WJ.rotation().matrix() @ F.translational()
    moment = X_WJ.rotation().matrix() @ F.rotational()
    moment = moment + np.cross(X_WJ.translation() - X_WS.translation(), force)
    loads = 0
    for index in plant.GetBodiesKinematicallyAffectedBy([joint.index()]):
        inertia = plant.get_body(index).default_spatial_inertia()
        if not inertia.get_mass() > 0.0:
            continue
        loads += 1
        X, V = motion["body_poses"][int(index)], motion["body_velocities"][int(index)]
        A_WB = motion["body_accelerations"][int(index)]
        full = inertia.CalcRotationalInertia().CopyToFullMatrix3()
        load = Load(int(index), inertia.get_mass(), inertia.get_com(), full)
        motion_of = (X.rotation().matrix(), V.rotational(), A_WB.rotational(), A_WB.translational())
        m, f = load_wrench(load, *motion_of, np.array([0.0, 0.0, -9.81]))
        force = force - f
        moment = moment - m - np.cross(X.translation() - X_WS.translation(), f)
    assert loads >= 1
    R = X_WS.rotation().matrix()
    np.testing.assert_allclose(system.ideal(context), np.concatenate([R.T @ moment, R.T @ force]), atol=1e-9)


@pytest.mark.parametrize(
    "wrong", [{"rate": 0.0}, {"rate": float("inf")}, {"latency": -1e-9}, {"latency": float("inf")}, {"rate": -1.0}]
)
def test_a_rate_or_latency_that_cannot_be_is_refused(arm: Arm, wrong: dict[str, float]) -> None:
    plant, found, plan = arm
    with pytest.raises(ScenarioError, match=r"twin\.sensors\[1\]"):
        LinkSensorSystem(LinkSensor(**wrong), BARE, plant, found, 1, plan)
