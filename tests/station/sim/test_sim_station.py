"""The simulated station: its ports, its physics held against the model, its sensors' defects, its camera's geometry."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from twin_diagram.errors import AssetError, ScenarioError, StationError
from twin_diagram.model.model import Model
from twin_diagram.scenario import (
    ArmDefects,
    ArmModel,
    Camera,
    CameraDefects,
    Driver,
    EffectSpec,
    Fixture,
    Pose,
    Scenario,
    WayPoint,
    WorldObject,
)
from twin_diagram.station import make_station, ports
from twin_diagram.station.depth_units import depth_to_units, units_to_depth
from twin_diagram.station.sim.arm_plant import driver_gains
from twin_diagram.station.sim.camera_defects import edges, spoil_colour, spoil_depth
from twin_diagram.station.sim.driver import TUNING as DRIVER
from twin_diagram.station.sim.driver import follow
from twin_diagram.station.sim.movers import Path
from twin_diagram.station.sim.noise import Stream, generator

FAULTS = {
    "payload": EffectSpec("payload", [], [], {"mass": [2.0], "com": [0.02, 0.0, 0.1]}),
    "viscous_friction": EffectSpec("viscous_friction", ["panda_joint2"], [], {"damping": [20.0]}),
    "coulomb_friction": EffectSpec("coulomb_friction", ["panda_joint2"], [], {"torque": [6.0]}),
    "stribeck_friction": EffectSpec(
        "stribeck_friction", ["panda_joint2"], [], {"coulomb": [5.0], "static": [7.0], "stribeck_velocity": [0.1]}
    ),
    "load_dependent_friction": EffectSpec("load_dependent_friction", ["panda_joint2"], [], {"coefficient": [0.2]}),
    "coupled_friction": EffectSpec(
        "coupled_friction", ["panda_joint2", "panda_joint4"], [], {"damping": [5.0], "torque": [4.0]}
    ),
    "torque_bias": EffectSpec("torque_bias", ["panda_joint2"], [], {"torque": [8.0]}),
    "torque_constant": EffectSpec("torque_constant", ["panda_joint2"], [], {"gain": [1.3]}),
    "actuator_fault": EffectSpec("actuator_fault", ["panda_joint2"], [], {"gain": [0.6]}),
}
"""What may begin and end in a simulated station."""
HOME = [0.3, 0.2, -0.1, -2.0, 0.1, 2.2, 0.9]
JOINTS = [f"panda_joint{k}" for k in range(1, 8)]
PATH = [
    WayPoint(0.0, Pose([0.75, -0.2, 0.12], [0, 0, 0.3])),
    WayPoint(0.2, Pose([0.75, -0.2, 0.12], [0, 0, 0.3])),
    WayPoint(1.4, Pose([0.6, 0.1, 0.12], [0, 0, 1.0])),
]


def small_camera() -> Camera:
    pose = Pose([1.4, 0.0, 0.85], [-2.2689, 0.0, 1.5708])
    return Camera(X_WC=pose, width=160, height=120, focal=150.0)


def scenario(camera: Camera | None = None, **world) -> Scenario:
    plan = Scenario(seed=5)
    plan.world.fixtures = [Fixture("scenes/table.sdf")]
    plan.world.objects = {
        "can": WorldObject("objects/can", Pose([0.45, 0.2, 0.051], [0, 0, 0.4])),
        "mover": WorldObject("objects/mover", path=PATH),
    }
    plan.twin.home = list(HOME)
    plan.twin.camera = camera
    for name, value in world.items():
        setattr(plan.world, name, value)
    return plan


def arm_alone(**world) -> Scenario:
    return scenario(objects={}, fixtures=[], **world)


class Command(LeafSystem):
    """A vector as a function of time."""

    def __init__(self, size: int, law: Callable[[float], np.ndarray]) -> None:
        super().__init__()
        self.DeclareVectorOutputPort(
            "command", size, lambda c, out: out.SetFromVector(law(c.get_time())), {self.time_ticket()}
        )


class Run:
    """A station that is advanced and read."""

    def __init__(self, plan: Scenario, **commands: Callable[[float], np.ndarray]) -> None:
        builder = DiagramBuilder()
        self.station = make_station(plan)
        builder.AddSystem(self.station)
        for name, law in commands.items():
            port = self.station.GetInputPort({"position": ports.POSITION_COMMANDED, "torque": ports.TORQUE_COMMANDED,
                                              "gripper": ports.GRIPPER_COMMANDED}[name])  # fmt: skip
            builder.Connect(builder.AddSystem(Command(port.size(), law)).get_output_port(), port)
        self.simulator = Simulator(builder.Build())
        self.simulator.Initialize()
        self.context = self.station.GetMyContextFromRoot(self.simulator.get_context())

    def to(self, time: float) -> Run:
        self.simulator.AdvanceTo(time)
        return self

    def __getitem__(self, name: str) -> np.ndarray:
        value = self.station.GetOutputPort(name).Eval(self.context)
        return np.array(value if isinstance(value, np.ndarray) else value.data)


# Ports.


def test_ports_are_those_of_the_contract() -> None:
    station = make_station(scenario())
    inputs, outputs = ports.expected(7, 2, ())
    assert set(ports.input_names(station)) == set(inputs) | set(ports.OPTIONAL)
    names = ports.output_names(station)
    assert {n for n in names if not n.startswith(ports.TRUTH)} == set(outputs)
    truth = {ports.ARM_STATE, ports.OBJECT_POSES, ports.QUERY_OBJECT, ports.CONTACT_RESULTS}
    assert {n for n in names if n.startswith(ports.TRUTH)} == truth
    with pytest.raises(StationError, match=r"arm\.\w+ has size 7, not 6"):
        ports.check(station, 6, 2, ())
    with pytest.raises(StationError, match=r"no output port camera\.\w+"):
        ports.check(station, 7, 2, ("camera",))
    with pytest.raises(StationError, match="no input port gripper"):
        ports.check(make_station(panda_without_hand()), 7, 2, ())


def panda_without_hand() -> Scenario:
    plan = arm_alone(arm=ArmModel(model="arms/panda.urdf", tool_frame=""))
    plan.twin.arm = plan.world.arm
    return plan


def test_truth_leads_nowhere_inside_the_station() -> None:
    station = make_station(scenario())
    used = {(source[0].get_name(), source[0].get_output_port(int(source[1])).get_name())
            for source in station.connection_map().values()}  # fmt: skip
    assert not used & {("true_poses", "object_poses"), ("true_state", "arm_state")}
    assert ("true_state", "motor_state") in used  # what encoders and the arm's own driver sense


# Physics.


@pytest.mark.slow
def test_objects_rest_still_for_ten_seconds() -> None:
    plan = scenario()
    for k, (name, height) in enumerate(
        {"cracker_box": 0.105, "sugar_box": 0.0875, "gelatin_box": 0.0365, "mug": 0.05}.items()
    ):
        pose = Pose([0.4 + 0.09 * k, -0.15 - 0.08 * k, height], [0, 0, 0.7 * k])
        plan.world.objects[name] = WorldObject(f"objects/{name}", pose)
    run = Run(plan).to(0.3)
    before = np.delete(run[ports.OBJECT_POSES].reshape(-1, 7), 1, axis=0)
    after = np.delete(run.to(10.3)[ports.OBJECT_POSES].reshape(-1, 7), 1, axis=0)
    assert np.linalg.norm(after[:, 4:] - before[:, 4:], axis=1).max() < 2e-4
    cosine = np.clip(np.abs(np.sum(after[:, :4] * before[:, :4], axis=1)), 0, 1)
    assert 2 * np.arccos(cosine).max() < 1e-3


def test_mover_follows_its_path_and_keeps_its_height() -> None:
    run, path = Run(scenario()), Path(PATH, "path")
    for time in np.arange(0.1, 1.7, 0.1):
        pose = run.to(time)[ports.OBJECT_POSES].reshape(-1, 7)[1]
        wanted, _ = path.state(run.simulator.get_context().get_time())
        assert np.abs(pose[4:6] - wanted[:2]).max() < 2e-3
        assert abs(pose[6] - 0.12) < 1e-6
        assert abs(2 * np.arctan2(pose[3], pose[0]) - wanted[2]) < 5e-3
    assert np.allclose(pose[4:6], [0.6, 0.1], atol=1e-4)


def test_a_moved_object_may_lie_and_turn_about_the_vertical() -> None:
    lying = [WayPoint(0.0, Pose([0.6, 0.0, 0.051], [np.pi / 2, 0.2, 0.5]))]
    pose = Run(scenario(objects={"can": WorldObject("objects/can", path=lying)})).to(0.1)[ports.OBJECT_POSES]
    R = RotationMatrix(Quaternion(pose[:4] / np.linalg.norm(pose[:4])))
    assert np.allclose(R.matrix(), RollPitchYaw([np.pi / 2, 0.2, 0.5]).ToRotationMatrix().matrix(), atol=1e-6)


ONSET, END, OVER = 0.3, 0.6, 1.0


def swinging(*effects: EffectSpec) -> list[np.ndarray]:
    """True states and measured torques before the onset, at the end, and when all is over."""
    plan = arm_alone(arm=ArmModel(effects=list(effects)))
    along = np.array([0.0, 0.25, 0.0, 0.3, 0.0, 0.2, 0.0])
    run = Run(plan, position=lambda t: np.array(HOME) + along * np.sin(5.0 * t))
    return [np.stack([run.to(t)[ports.ARM_STATE][:7], run[ports.TORQUE_MEASURED]]) for t in (ONSET, END, OVER)]


@pytest.fixture(scope="module")
def faultless() -> list[np.ndarray]:
    return swinging()


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_begins_and_ends(name: str, faultless: list[np.ndarray]) -> None:
    """At the station's own step, under its own driver: before it begins all is as without, and soon after its end."""
    before, during, after = (
        np.abs(fault - good)
        for fault, good in zip(swinging(replace(FAULTS[name], onset=ONSET, end=END)), faultless, strict=True)
    )
    # A payload that is not there yet is borne by the acceleration of the step before: it is felt a little.
    assert before[0].max() < (1e-4 if name == "payload" else 1e-12)
    assert before[1].max() < (0.06 if name == "payload" else 1e-9)
    assert during[0].max() > 1e-3 and during[1].max() > 0.5
    assert after[0].max() < 5e-4 and after[1].max() < 0.4, "what is left dies away in the driver"


DELAY = EffectSpec("time_delay", [], [], {"delay": [0.01]}, onset=1.0)
TILT = EffectSpec("gravity_tilt", [], [], {"roll": [0.1], "pitch": [0.0]}, end=1.0)


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (replace(FAULTS["payload"], onset=2.0, end=1.0), r"payload\.end: 1 s is not after the onset"),
        (replace(FAULTS["payload"], onset=-1.0), r"payload\.onset: -1 s is before the run"),
        (replace(FAULTS["torque_bias"], end=-0.5), r"torque_bias\.end: at -0\.5 s the run has not begun"),
        (DELAY, r"time_delay\.onset: a simulator cannot start or end it"),
        (TILT, r"gravity_tilt\.end: a simulator cannot start or end it"),
    ],
)
def test_what_cannot_begin_or_end_is_said_in_one_line(spec: EffectSpec, said: str) -> None:
    with pytest.raises(ScenarioError, match=rf"world\.arm\.effects\.{said}") as raised:
        make_station(arm_alone(arm=ArmModel(effects=[spec])))
    assert "\n" not in str(raised.value)


def test_measured_torque_is_what_the_model_says_the_motors_give() -> None:
    """Friction and payload move the arm, not the log: inverse dynamics with both explains it."""
    friction = [0.8, 1.0, 0.7, 0.9, 0.4, 0.5, 0.3]
    spec = ArmModel(
        effects=[
            EffectSpec("payload", parameters={"mass": [0.9], "com": [0.01, -0.02, 0.15]}),
            EffectSpec("coulomb_friction", JOINTS, parameters={"torque": friction}),
            EffectSpec("viscous_friction", JOINTS, parameters={"damping": [0.5] * 7}),
        ]
    )
    exact = ArmDefects(encoder_bits=40, velocity_noise=0.0, torque_noise=0.0)
    plan = arm_alone(arm=spec, arm_defects=exact, time_step=0.001)
    plan.twin.driver = Driver(rate=1000.0)
    phase = np.arange(7)

    def law(time: float) -> np.ndarray:
        return np.array(HOME) + 0.25 * (1 - np.exp(-4 * time)) * np.sin(3 * time + phase)

    run = Run(plan, position=law).to(0.5)
    times, q, v, tau = [], [], [], []
    for time in np.arange(0.5005, 1.5, 0.001):
        run.to(time)
        times.append(run[ports.MEASUREMENT_TIME][0])
        q.append(run[ports.POSITION_MEASURED])
        v.append(run[ports.VELOCITY_ESTIMATED])
        tau.append(run[ports.TORQUE_MEASURED])
    times, q, v, tau = map(np.array, (times, q, v, tau))
    assert np.allclose(np.diff(times), 0.001)
    a = (v[2:] - v[:-2]) / 0.002
    model = Model.load(spec)
    explained = model.inverse_dynamics(q[1:-1], v[1:-1], a)
    moving = np.abs(v[1:-1]) > 0.1  # elsewhere dry friction is anything up to its level
    error = (tau[1:-1] - explained)[moving]
    assert np.abs(error).max() < 0.35
    assert np.sqrt(np.mean(error**2)) < 0.06
    without = (tau[1:-1] - model.with_effects(model.effects[:1]).inverse_dynamics(q[1:-1], v[1:-1], a))[moving]
    assert np.sqrt(np.mean(without**2)) > 0.5


@pytest.mark.long
def test_a_payload_that_the_driver_does_not_know_lets_the_arm_sag() -> None:
    payload = EffectSpec("payload", parameters={"mass": [1.0], "com": [0.0, 0.0, 0.15]})
    run = Run(arm_alone(arm=ArmModel(effects=[payload]))).to(4.0)
    sag = run[ports.ARM_STATE][:7] - HOME
    bare, loaded = Model.load(ArmModel()), Model.load(ArmModel(effects=[payload]))
    q = run[ports.ARM_STATE][:7]
    stiffness, _ = driver_gains(Driver(), bare.effort_limit)
    lacking = bare.bias(q, np.zeros(7)) - loaded.bias(q, np.zeros(7))
    assert np.allclose(sag, lacking / stiffness, atol=2e-5)
    run = Run(arm_alone(arm=ArmModel(effects=[payload])), torque=lambda t: -lacking).to(4.0)
    assert np.abs(run[ports.ARM_STATE][:7] - HOME).max() < 2e-4  # what the arm's torque port is for


def test_the_arm_holds_its_pose_without_a_command() -> None:
    nothing = Run(arm_alone(), position=lambda t: np.full(7, np.nan), torque=lambda t: np.full(7, np.nan)).to(0.5)
    unconnected = Run(arm_alone()).to(0.5)
    assert np.allclose(nothing[ports.ARM_STATE][:7], HOME, atol=1e-6)
    assert np.array_equal(nothing[ports.ARM_STATE], unconnected[ports.ARM_STATE])
    stops = Run(arm_alone(), position=lambda t: np.array(HOME) + 0.1 if t < 0.2 else np.full(7, np.nan)).to(1.0)
    assert np.allclose(stops[ports.ARM_STATE][:7], np.array(HOME) + 0.1, atol=1e-3)


def test_a_jump_of_the_command_is_followed_at_the_speed_limit() -> None:
    run = Run(arm_alone(), position=lambda t: np.array(HOME) + [1.5, 0, 0, 0, 0, 0, 0])
    speeds = [run.to(time)[ports.ARM_STATE][7] for time in np.arange(0.05, 1.6, 0.05)]
    limit = Model.load(ArmModel()).velocity_limit[0]
    assert 0.9 * limit < max(speeds) < 1.1 * limit
    assert np.allclose(run[ports.ARM_STATE][:7] - HOME, [1.5, 0, 0, 0, 0, 0, 0], atol=2e-3)


def test_motors_keep_to_their_limits() -> None:
    run = Run(arm_alone(), torque=lambda t: np.full(7, 500.0))
    limit = Model.load(ArmModel()).effort_limit
    torque = [run.to(time)[ports.TORQUE_MEASURED] for time in np.arange(0.01, 0.1, 0.01)]
    assert np.all(np.max(torque, axis=0) < limit + 0.5)
    assert np.any(np.max(torque, axis=0) > limit - 0.5)


def test_fingers_go_where_they_are_told() -> None:
    """Together, as a rack holds them: half-way between two commands that differ."""
    run = Run(arm_alone(), gripper=lambda t: np.array([0.03, 0.02])).to(0.02)
    assert run[ports.GRIPPER_MEASURED][:2].max() < 0.01  # at their speed limit
    assert np.allclose(run.to(1.0)[ports.GRIPPER_MEASURED], [0.025, 0.025, 0, 0], atol=1e-3)
    run = Run(arm_alone(), gripper=lambda t: np.array([0.03, 0.03])).to(1.0)
    assert np.allclose(run[ports.GRIPPER_MEASURED], [0.03, 0.03, 0, 0], atol=1e-5)


@given(
    st.floats(-3, 3),
    st.floats(-2, 2),
    st.floats(-3, 3),
    st.floats(1e-4, 0.05),
)
def test_filter_of_commands_is_exact(q: float, v: float, command: float, dt: float) -> None:
    one, limit = np.array([1.0]), np.array([1e3])
    whole = follow(q * one, v * one, command * one, limit, dt)
    half = follow(*follow(q * one, v * one, command * one, limit, dt / 2), command * one, limit, dt / 2)
    assert np.allclose(whole, half, atol=1e-9, rtol=1e-9)
    # The differential equation itself, by a small step.
    h = 1e-7
    q1, v1 = follow(q * one, v * one, command * one, limit, h)
    assert np.allclose((q1 - q) / h, v, atol=1e-2, rtol=1e-3)
    assert np.allclose(
        (v1 - v) / h, DRIVER.bandwidth**2 * (command - q) - 2 * DRIVER.bandwidth * v, atol=5.0, rtol=1e-3
    )


def test_filter_of_commands_lags_a_ramp_by_the_stated_time() -> None:
    q, v = np.zeros(1), np.zeros(1)
    for k in range(1, 401):
        q, v = follow(q, v, np.array([0.5 * k * 0.0025]), np.array([10.0]), 0.0025)
    assert abs(v[0] - 0.5) < 0.02  # the staircase of a sampled ramp
    assert abs((0.5 - q[0]) / 0.5 - 2 / DRIVER.bandwidth) < 1.3e-3  # half a step


def test_driver_gains() -> None:
    stiffness, damping = driver_gains(Driver(), np.array([87.0, 87, 87, 87, 12, 12, 12]))
    assert np.allclose(stiffness, [600] * 4 + [250] * 3)
    assert np.allclose(damping, 2 * np.sqrt(stiffness))
    stiffness, _ = driver_gains(Driver(), np.array([150.0, 150, 150, 28, 28, np.inf]))
    assert np.allclose(stiffness[:4], 600 / 87 * np.array([150, 150, 150, 28]))
    assert stiffness[5] == 250
    with pytest.raises(ScenarioError, match=r"twin\.driver\.stiffness"):
        driver_gains(Driver(stiffness=[1.0]), np.full(7, 10.0))


@pytest.mark.parametrize("model", ["arms/ur5e.urdf", "arms/iiwa7_wsg.urdf"])
def test_other_arms_hold_still(model: str) -> None:
    plan = arm_alone(arm=ArmModel(model=model, tool_frame=""))
    plan.twin.arm = plan.world.arm
    n = len(Model.load(plan.twin.arm).joints)
    plan.twin.home = [0.1, -0.8, 0.9, -0.7, 0.3, 0.2, 0.1][:n]
    run = Run(plan).to(0.5)
    assert np.allclose(run[ports.ARM_STATE][:n], plan.twin.home, atol=1e-4)


# Sensors.


def test_sensor_defects_are_as_told() -> None:
    bias = [0.1, -0.2, 0.3, 0.0, 0.05, 0.0, -0.1]
    defects = ArmDefects(encoder_bits=14, velocity_noise=0.01, torque_noise=0.2, torque_bias=bias)
    spoilt = Run(arm_alone(arm_defects=defects))
    clean = Run(arm_alone(arm_defects=ArmDefects(encoder_bits=40, velocity_noise=0.0, torque_noise=0.0)))
    rows = []
    for time in np.arange(0.201, 2.2, 0.0025):
        spoilt.to(time), clean.to(time)
        rows.append([spoilt[n] - clean[n] for n in (ports.VELOCITY_ESTIMATED, ports.TORQUE_MEASURED)])
    noise = np.array(rows)
    count = 2 * np.pi / 2**14
    assert np.allclose(spoilt[ports.POSITION_MEASURED] / count, np.round(spoilt[ports.POSITION_MEASURED] / count))
    assert np.abs(spoilt[ports.POSITION_MEASURED] - clean[ports.POSITION_MEASURED]).max() <= count / 2 + 1e-9
    assert np.allclose(noise[:, 0].std(axis=0), 0.01, rtol=0.12)
    assert np.allclose(noise[:, 1].std(axis=0), 0.2, rtol=0.12)
    assert np.allclose(noise[:, 1].mean(axis=0), bias, atol=0.03)
    white = np.corrcoef(np.vstack([noise[:, 0].T, noise[:, 1].T, noise[1:, 0, :1].T[:, [*range(len(noise) - 1), 0]]]))
    assert np.abs(white - np.eye(len(white))).max() < 0.15


def test_encoder_offset_is_seen_by_the_encoders_and_not_by_the_truth() -> None:
    offset = EffectSpec("encoder_offset", JOINTS[:1], parameters={"offset": [0.01]})
    run = Run(arm_alone(arm=ArmModel(effects=[offset]))).to(1.0)
    assert abs(run[ports.POSITION_MEASURED][0] - run[ports.ARM_STATE][0] - 0.01) < 1e-4


def test_nothing_is_valid_before_the_first_message() -> None:
    run = Run(scenario())
    assert run[ports.MEASUREMENT_TIME][0] < 0
    assert run.to(0.0024)[ports.MEASUREMENT_TIME][0] < 0
    assert run.to(0.0026)[ports.MEASUREMENT_TIME][0] == 0.0025
    assert np.abs(run[ports.TORQUE_MEASURED][1]) > 10  # the first one, too, holds the arm up
    run.to(0.01)
    assert run[ports.MEASUREMENT_TIME][0] == 0.0075  # an event at the same time still sees the one before


def test_same_seed_same_numbers_other_seed_other_noise() -> None:
    def numbers(seed: int) -> list[np.ndarray]:
        plan = scenario()
        plan.seed = seed
        run = Run(plan).to(0.3)
        return [run[n] for n in (ports.TORQUE_MEASURED, ports.VELOCITY_ESTIMATED, ports.OBJECT_POSES)]

    first, again, other = numbers(3), numbers(3), numbers(4)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])
    assert np.array_equal(first[2], other[2])  # a seed changes sensors, not the world


def test_two_contexts_do_not_touch_each_other() -> None:
    builder = DiagramBuilder()
    station = make_station(scenario())
    builder.AddSystem(station)
    diagram = builder.Build()
    alone, one, two = Simulator(diagram), Simulator(diagram), Simulator(diagram)

    def outputs(simulator: Simulator) -> list[np.ndarray]:
        context = station.GetMyContextFromRoot(simulator.get_context())
        names = (ports.POSITION_MEASURED, ports.TORQUE_MEASURED, ports.OBJECT_POSES, ports.MEASUREMENT_TIME)
        return [np.array(station.GetOutputPort(n).Eval(context)) for n in names]

    alone.AdvanceTo(0.2)
    wanted = outputs(alone)
    for k in range(1, 21):
        two.AdvanceTo(0.017 * k)
        one.AdvanceTo(0.01 * k)
    assert all(np.array_equal(a, b) for a, b in zip(wanted, outputs(one), strict=True))


def test_noise_is_a_function_of_seed_sensor_and_message() -> None:
    def draw(*key: int) -> np.ndarray:
        return generator(key[0], Stream(key[1]), key[2]).standard_normal(8)

    assert np.array_equal(draw(1, 1, 7), draw(1, 1, 7))
    others = [draw(1, 1, 8), draw(1, 2, 7), draw(2, 1, 7), draw(-1, 1, 7), draw(1, 1, 2**40)]
    assert len({tuple(x) for x in [draw(1, 1, 7), *others]}) == 6


# Camera.


@pytest.fixture(scope="module")
def seen(egl) -> Run:
    return Run(scenario(small_camera(), camera_defects=CameraDefects(depth_noise=0.0, colour_noise=0.0))).to(0.2)


def test_image_timing(egl) -> None:
    plan = scenario(small_camera())
    run = Run(plan)
    assert run["camera.image_time"][0] < 0
    assert run["camera.rgb_image"][..., :3].max() == 0 and run["camera.depth_image"].max() == 0
    assert run["camera.rgb_image"].shape == (120, 160, 4) and run["camera.depth_image"].shape == (120, 160, 1)
    assert run.to(0.0349)["camera.image_time"][0] < 0
    assert run.to(0.0351)["camera.image_time"][0] == 0.0
    assert run.to(0.1016)["camera.image_time"][0] == 0.0
    assert run.to(0.1018)["camera.image_time"][0] == 1 / 15


def test_an_image_shows_the_world_as_it_was_at_capture(egl) -> None:
    """While it is on its way the world moves on; the image does not."""
    path = [WayPoint(0.0, Pose([0.5, -0.3, 0.12])), WayPoint(0.4, Pose([0.5, 0.3, 0.12]))]
    plan = scenario(small_camera(), objects={"mover": WorldObject("objects/mover", path=path)})
    run = Run(plan).to(0.1018)
    early = run["camera.rgb_image"]
    assert np.array_equal(run.to(0.168)["camera.rgb_image"], early)
    assert not np.array_equal(run.to(0.169)["camera.rgb_image"], early)
    plan.twin.camera.latency = 0.06
    late = Run(plan).to(0.13)
    assert late["camera.image_time"][0] == 1 / 15
    assert np.array_equal(late["camera.rgb_image"], early)


def test_depth_is_that_of_a_pinhole_camera(seen: Run) -> None:
    """The table and the can's top are where projection by hand puts them."""
    camera = small_camera()
    X_WC = RigidTransform(RollPitchYaw(camera.X_WC.rpy), camera.X_WC.translation)
    v, u = np.mgrid[0:120, 0:160]
    rays = np.stack([(u - 79.5) / camera.focal, (v - 59.5) / camera.focal, np.ones_like(u)], axis=-1)
    down = rays @ X_WC.rotation().matrix().T
    depth = seen["camera.depth_image"][..., 0]
    table = -X_WC.translation()[2] / down[..., 2]
    points = X_WC.translation() + rays @ X_WC.rotation().matrix().T * depth[..., None]
    bare = (depth > 0) & (np.abs(points[..., 1]) > 0.45) & (points[..., 0] > 0.3) & (points[..., 0] < 0.9)
    assert bare.sum() > 500
    assert np.abs(depth - table)[bare].max() < 5e-4
    top = (np.linalg.norm(points[..., :2] - [0.45, 0.2], axis=-1) < 0.028) & (np.abs(points[..., 2] - 0.1) < 0.02)
    assert top.sum() > 15
    assert np.abs(points[top][:, 2] - 0.1015).max() < 1.5e-3


def test_colours_are_those_of_the_texture_and_not_all_alike(seen: Run) -> None:
    rgb = seen["camera.rgb_image"]
    assert (rgb[..., 3] == 255).all()
    assert len(np.unique(rgb[..., :3].reshape(-1, 3), axis=0)) > 200
    assert rgb[..., :3].std(axis=(0, 1)).min() > 15


def test_depth_out_of_range_is_none(egl) -> None:
    camera = replace(small_camera(), depth_range=[0.9, 1.2])
    depth = Run(scenario(camera)).to(0.05)["camera.depth_image"]
    assert (depth == 0).sum() > 1000
    assert depth[depth > 0].min() >= 0.9 - 2.5e-4 and depth.max() <= 1.2 + 2.5e-4
    counts = depth.astype(float) / 0.00025
    assert np.abs(counts - np.round(counts)).max() < 2e-3


def test_a_covered_lens_sees_nothing(egl) -> None:
    run = Run(scenario(small_camera(), camera_defects=CameraDefects(covered=[[0.05, 0.1]]))).to(0.05)
    assert run["camera.depth_image"].max() > 0
    run.to(0.11)
    assert run["camera.image_time"][0] == 1 / 15  # images keep coming, black
    assert run["camera.depth_image"].max() == 0 and run["camera.rgb_image"][..., :3].max() == 0
    assert run.to(0.2)["camera.depth_image"].max() > 0


@pytest.mark.long
def test_the_true_camera_may_stand_elsewhere_than_the_twin_thinks(egl) -> None:
    told = Run(scenario(small_camera())).to(0.05)["camera.depth_image"]
    moved = replace(small_camera().X_WC, translation=[1.4, 0.0, 0.80])
    true = Run(scenario(small_camera(), X_WC=moved)).to(0.05)["camera.depth_image"]
    assert 0.02 < np.median((told - true)[(told > 0) & (true > 0)]) < 0.08


@pytest.mark.long
def test_merged_shapes_look_like_the_shapes_themselves(egl, monkeypatch) -> None:
    clean = CameraDefects(depth_noise=0.0, colour_noise=0.0, edge_dropout=0.0)
    merged = Run(scenario(small_camera(), camera_defects=clean)).to(0.05)
    monkeypatch.setattr("twin_diagram.station.sim.world_plant.merge_shapes", lambda *_: None)
    plain = Run(scenario(small_camera(), camera_defects=clean)).to(0.05)
    difference = np.abs(merged["camera.rgb_image"].astype(int) - plain["camera.rgb_image"]).max(axis=-1)
    assert (difference > 12).mean() < 0.01
    assert (np.abs(merged["camera.depth_image"] - plain["camera.depth_image"]) > 2e-3).mean() < 0.01


def test_defects_of_depth() -> None:
    rng = np.random.default_rng(0)
    for z in (0.5, 1.0, 2.0):
        flat = np.full((200, 300), z, np.float32)
        spoilt = spoil_depth(flat, CameraDefects(depth_noise=0.001, depth_unit=1e-5), [0.2, 3.0], rng)
        if z < 0.65:  # 16 bits of this unit end there
            assert abs(spoilt.std() / (0.001 * z * z) - 1) < 0.05
        coarse = spoil_depth(flat, CameraDefects(depth_noise=0.002, depth_unit=1e-4), [0.2, 3.0], rng)
        assert abs(coarse.std() / (0.002 * z * z) - 1) < 0.05
        assert abs(coarse.mean() - z) < 1e-4
        assert np.array_equal(flat, np.full((200, 300), z, np.float32))
    step = np.where(np.arange(300) < 150, 1.0, 1.5)[None, :].repeat(200, 0).astype(np.float32)
    assert edges(step).sum() == 400 and edges(step)[:, 149:151].all()
    assert edges(step.T).sum() == 400
    ragged = spoil_depth(step, CameraDefects(edge_dropout=0.25), [0.2, 3.0], rng)
    assert abs((ragged == 0).sum() / 400 - 0.25) < 0.08
    slope = np.linspace(1, 2, 300, dtype=np.float32)[None, :].repeat(200, 0)
    assert not edges(slope).any()


@given(
    st.lists(st.one_of(st.floats(0, 4, width=32), st.sampled_from([np.inf, np.nan])), min_size=6, max_size=6),
    st.integers(0, 2**32),
)
def test_spoilt_depth_is_always_whole_units_in_range(values: list[float], seed: int) -> None:
    depth = np.array(values, np.float32).reshape(2, 3)
    unit = 0.00025
    spoilt = spoil_depth(depth, CameraDefects(depth_unit=unit), [0.2, 3.0], np.random.default_rng(seed))
    assert np.all(np.isfinite(spoilt))
    assert np.all((spoilt == 0) | ((spoilt >= 0.2 - unit) & (spoilt <= 3.0 + unit)))
    assert np.array_equal(units_to_depth(depth_to_units(spoilt, unit), unit), spoilt)
    assert np.all(spoilt[~np.isfinite(depth) | (depth == 0)] == 0)


@given(st.integers(0, 65535), st.sampled_from([0.001, 0.00025, 0.0001]))
def test_units_survive_a_recording(count: int, unit: float) -> None:
    counts = np.array([[count]], np.uint16)
    assert np.array_equal(depth_to_units(units_to_depth(counts, unit), unit), counts)


def test_defects_of_colour() -> None:
    rng = np.random.default_rng(0)
    table = np.rint(rng.normal(0, 5, 100 * 100 * 4 + 50)).astype(np.int16)
    grey = np.full((100, 100, 4), 120, np.uint8)
    spoilt = spoil_colour(grey, table, 17)
    assert (spoilt[..., 3] == 255).all() and (grey == 120).all()
    assert abs(spoilt[..., :3].std() - 5) < 0.3 and abs(spoilt[..., :3].mean() - 120) < 0.3
    assert spoil_colour(np.full((100, 100, 4), 254, np.uint8), table, 0).max() == 255


def test_defects_are_quick_enough() -> None:
    rng = np.random.default_rng(0)
    depth = (1.0 + 0.2 * rng.random((480, 640))).astype(np.float32)
    colour, table = np.full((480, 640, 4), 99, np.uint8), np.zeros(480 * 640 * 4 + 9, np.int16)
    best = np.inf
    for _ in range(4):
        start = clock.process_time()
        spoil_depth(depth, CameraDefects(), [0.2, 3.0], rng)
        spoil_colour(colour, table, 3)
        best = min(best, clock.process_time() - start)
    assert best < 0.03  # 6 ms on an idle machine; room for a busy one


# Paths.


@given(
    st.lists(
        st.tuples(st.floats(0.05, 2), st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3)), min_size=1, max_size=6
    )
)
def test_paths_go_through_their_way_points_without_overshoot(steps: list[tuple[float, float, float, float]]) -> None:
    times = np.cumsum([dt for dt, *_ in steps])
    path = Path(
        [WayPoint(t, Pose([x, y, 0.1], [0, 0, yaw])) for t, (_, x, y, yaw) in zip(times, steps, strict=True)], "p"
    )
    points = np.array([path.state(t)[0] for t in times])
    assert np.allclose(points[:, :2], [[x, y] for _, x, y, _ in steps], atol=1e-9)
    assert np.all(np.abs(np.diff(points[:, 2])) <= np.pi + 1e-9)
    assert np.allclose(np.cos(points[:, 2] - [s[3] for s in steps]), 1, atol=1e-9)
    for a, b, left, right in zip(times[:-1], times[1:], points[:-1], points[1:], strict=True):
        between = np.array([path.state(t)[0] for t in np.linspace(a, b, 9)])
        low, high = np.minimum(left, right), np.maximum(left, right)
        assert np.all(between >= low - 1e-6) and np.all(between <= high + 1e-6)
    for t in (times[0] - 1, times[0], times[-1], times[-1] + 1):
        assert np.allclose(path.state(t)[1], 0, atol=1e-6)


# Bad input.


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda p: p.world.objects.update(x=WorldObject("objects/none")), AssetError, r"world\.objects\.x\.asset"),
        (lambda p: p.world.objects.update(x=WorldObject("")), AssetError, r"world\.objects\.x\.asset"),
        (lambda p: p.world.objects.update(x=WorldObject("arms")), AssetError, r"no model\.sdf in"),
        (
            lambda p: p.world.objects.update(x=WorldObject("objects/can", Pose([0.0, float("nan"), 0.0]))),
            ScenarioError,
            r"world\.objects\.x\.X_WO\.translation",
        ),
        (
            lambda p: p.world.objects.update(x=WorldObject("objects/can", path=[PATH[2], PATH[0]])),
            ScenarioError,
            r"world\.objects\.x\.path\[1\]\.time: 0\.0 is not after 1\.4",
        ),
        (
            lambda p: p.world.objects.update(
                x=WorldObject("objects/can", path=[PATH[0], WayPoint(1.0, Pose([0.5, 0.0, 0.3]))])
            ),
            ScenarioError,
            r"path\[1\]\.X_WO: .*x, y and yaw alone",
        ),
        (lambda p: p.world.fixtures.append(Fixture("scenes/none.sdf")), ScenarioError, r"world\.fixtures\[1\]\.model"),
        (lambda p: p.world.fixtures.append(Fixture("package://none/a.sdf")), ScenarioError, r"fixtures\[1\].*'none'"),
        (lambda p: setattr(p.world.arm, "model", "arms/none.urdf"), ScenarioError, r"world\.arm.*arms/none\.urdf"),
        (lambda p: setattr(p.world.arm, "joints", ["elbow"]), ScenarioError, r"world\.arm.*'elbow'.*panda_joint1"),
        (lambda p: setattr(p.twin.arm, "model", "arms/none.urdf"), ScenarioError, r"twin\.arm.*arms/none\.urdf"),
        (lambda p: setattr(p.twin.arm, "model", "arms/ur5e.urdf"), ScenarioError, r"twin\.arm.*panda_tcp"),
        (
            lambda p: (setattr(p.twin.arm, "model", "arms/ur5e.urdf"), setattr(p.twin.arm, "tool_frame", "")),
            ScenarioError,
            r"twin\.arm\.model: has 6 joints where world\.arm has 7",
        ),
        (lambda p: p.world.arm.effects.append(EffectSpec("magic")), ScenarioError, r"world\.arm.*'magic'"),
        (lambda p: setattr(p.world, "q0", [0.0]), ScenarioError, r"world\.q0: 1 numbers for 7 joints"),
        (lambda p: setattr(p.twin, "home", [0.0]), ScenarioError, r"twin\.home: 1 numbers for 7 joints"),
        (lambda p: setattr(p.world, "time_step", 0.0), ScenarioError, r"world\.time_step"),
        (lambda p: setattr(p.twin.driver, "rate", 0.0), ScenarioError, r"twin\.driver\.rate"),
        (lambda p: setattr(p.world.arm_defects, "torque_bias", [1.0]), ScenarioError, r"arm_defects\.torque_bias"),
        (lambda p: setattr(p.world.arm_defects, "encoder_bits", 0), ScenarioError, r"arm_defects\.encoder_bits"),
        (lambda p: setattr(p.world.arm_defects, "torque_noise", -1.0), ScenarioError, r"arm_defects\.torque_noise"),
        (lambda p: setattr(p.twin, "camera", replace(small_camera(), latency=0.1)), ScenarioError, r"camera\.latency"),
        (lambda p: setattr(p.twin, "camera", replace(small_camera(), focal=0.0)), ScenarioError, r"camera\.focal"),
        (lambda p: setattr(p.twin, "camera", replace(small_camera(), name="../x")), ScenarioError, r"camera\.name"),
        (
            lambda p: setattr(p.twin, "camera", replace(small_camera(), depth_range=[2.0, 1.0])),
            ScenarioError,
            r"camera\.depth_range",
        ),
        (lambda p: setattr(p, "station", "moon"), StationError, r"'moon' is none of sim, replay, lcm"),
    ],
)
def test_what_is_wrong_is_said_with_its_field(change, error: type[Exception], words: str) -> None:
    plan = scenario()
    change(plan)
    with pytest.raises(error, match=words):
        make_station(plan)


@pytest.mark.parametrize(
    ("defects", "field"),
    [
        (CameraDefects(depth_noise=-1.0), "depth_noise"),
        (CameraDefects(depth_unit=0.0), "depth_unit"),
        (CameraDefects(depth_unit=1e-6), "depth_unit"),
        (CameraDefects(covered=[[2.0, 1.0]]), r"covered\[0\]"),
    ],
)
def test_impossible_camera_defects_are_refused(egl, defects: CameraDefects, field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"world\.camera_defects\.{field}"):
        make_station(scenario(small_camera(), camera_defects=defects))


def test_an_asset_must_be_one_link_called_object(tmp_path: FilePath) -> None:
    (tmp_path / "model.sdf").write_text(
        "<sdf version='1.9'><model name='a'><link name='b'/></model></sdf>", encoding="utf-8"
    )
    with pytest.raises(AssetError, match="one link called `object`"):
        make_station(scenario(objects={"a": WorldObject(str(tmp_path))}))
    (tmp_path / "model.sdf").write_text("not XML", encoding="utf-8")
    with pytest.raises((AssetError, ScenarioError), match=r"world\.objects\.a"):
        make_station(scenario(objects={"a": WorldObject(str(tmp_path))}))


def test_nothing_is_rendered_where_egl_is_missing(monkeypatch) -> None:
    from twin_diagram.native import NativeLibraryError

    def missing() -> None:
        raise NativeLibraryError(("libEGL.so.1",))

    monkeypatch.setattr("twin_diagram.station.sim.camera.require_egl", missing)
    with pytest.raises(NativeLibraryError, match="libegl1"):
        make_station(scenario(small_camera()))
    make_station(scenario())
