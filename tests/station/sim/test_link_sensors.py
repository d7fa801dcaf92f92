"""Further sensors of the simulated station: held against kinematics and against the weight of what the arm carries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import ArmModel, EffectSpec, LinkSensor, Pose, Scenario, SensorDefects
from twin_diagram.scenario.resources import resolve
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import make_station, ports

HOME = [0.0, -1.3, 1.6, -1.8, -1.57, 0.4]
IMU, WRENCH = "wrist_3_link.imu", ports.WRENCH_MEASURED
PERFECT = SensorDefects(noise=[0.0, 0.0])


def plan(*sensors: LinkSensor, payload: float = 0.0, **defects: SensorDefects) -> Scenario:
    scenario = Scenario(seed=4)
    scenario.twin.arm = ArmModel("arms/ur5e.urdf", tool_frame="tool0")
    scenario.twin.home, scenario.twin.camera = list(HOME), None
    scenario.twin.sensors = list(sensors)
    scenario.world.arm = ArmModel("arms/ur5e.urdf", tool_frame="tool0")
    scenario.world.objects, scenario.world.fixtures, scenario.world.time_step = {}, [], 0.001
    if payload:
        parameters = {"mass": [payload], "com": [0.01, -0.02, 0.08]}
        scenario.world.arm.effects = [EffectSpec("payload", links=["wrist_3_link"], parameters=parameters)]
    scenario.world.sensor_defects = {{"imu": IMU, "wrench": WRENCH}[k]: v for k, v in defects.items()}
    return scenario


def readings(scenario: Scenario, port: str, until: float, goal: np.ndarray | None = None, step: float = 0.01):
    """Times of polling, readings (K, 6), their times (K,), arm state (K, 12)."""
    station = make_station(scenario)
    assert isinstance(station, Diagram)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.GetInputPort(ports.POSITION_COMMANDED).FixValue(context, np.array(HOME) if goal is None else goal)
    rows = []
    for now in np.arange(1, round(until / step) + 1) * step:
        simulator.AdvanceTo(now)
        rows.append(
            [now]
            + [v for p in (port, ports.time_of(port), ports.ARM_STATE) for v in station.GetOutputPort(p).Eval(context)]
        )
    table = np.array(rows)
    return table[:, 0], table[:, 1:7], table[:, 7], table[:, 8:]


def test_without_further_sensors_the_ports_are_those_of_every_station() -> None:
    names = ports.output_names(make_station(plan()))
    assert not [name for name in names if name.endswith((".imu", "_time")) and name != ports.MEASUREMENT_TIME]
    assert WRENCH not in names


def test_an_imu_at_rest_feels_gravity_in_its_own_frame() -> None:
    pose = Pose([0.02, 0.0, 0.03], [0.3, -0.2, 1.0])
    scenario = plan(LinkSensor("imu", X_BS=pose), imu=PERFECT)
    _, z, t, _ = readings(scenario, IMU, 2.0)
    from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
    from twin_diagram.estimation.dynamics.link_frame import LinkFrame
    from twin_diagram.model.model import Model

    R_WB, _ = LinkFrame(ArmTerms.from_model(Model.load(scenario.twin.arm)), "wrist_3_link").pose(np.array(HOME))
    up = (R_WB @ RollPitchYaw(*pose.rpy).ToRotationMatrix().matrix()).T @ [0.0, 0.0, 9.81]
    np.testing.assert_allclose(z[-1, 3:], up, atol=0.05)
    np.testing.assert_allclose(z[-1, :3], 0.0, atol=1e-3)
    assert t[-1] >= 1.99


def test_the_gyroscope_is_the_turn_of_the_link() -> None:
    scenario = plan(LinkSensor("imu", rate=1000.0), imu=PERFECT)
    goal = np.array(HOME) + [0.4, -0.2, 0.3, 0.2, -0.3, 0.5]
    _, z, t, x = readings(scenario, IMU, 0.5, goal, 0.001)
    from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
    from twin_diagram.estimation.dynamics.link_frame import LinkFrame
    from twin_diagram.model.model import Model

    frame = LinkFrame(ArmTerms.from_model(Model.load(scenario.twin.arm)), "wrist_3_link")
    k = 300
    motion = frame.motion(x[k, :6], x[k, 6:])
    at = int(np.argmin(np.abs(t - 0.301)))
    np.testing.assert_allclose(z[at, :3], motion.R_WF.T @ motion.omega, atol=0.02)
    assert np.linalg.norm(z[at, :3]) > 0.1
    a = (x[k + 1, 6:] - x[k - 1, 6:]) / 0.002
    force = motion.R_WF.T @ (motion.J_v @ a + motion.bias_a + [0.0, 0.0, 9.81])
    np.testing.assert_allclose(z[at, 3:], force, atol=0.1)


@pytest.mark.long
def test_the_wrist_feels_what_is_not_described_alone() -> None:
    _, empty, _, _ = readings(plan(LinkSensor("wrench"), wrench=PERFECT), WRENCH, 1.5)
    np.testing.assert_allclose(empty[-1], 0.0, atol=0.02)
    _, z, _, _ = readings(plan(LinkSensor("wrench"), payload=2.0, wrench=PERFECT), WRENCH, 2.0)
    force = z[-1, 3:]
    assert np.linalg.norm(force) == pytest.approx(2.0 * 9.81, rel=0.01)
    np.testing.assert_allclose(z[-1, :3], np.cross([0.01, -0.02, 0.08], force), atol=0.02)


HAND = """<robot name="hand">
  <link name="base_link"><inertial><mass value="{}"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""


def test_links_of_hand_and_arm_may_have_the_same_name(tmp_path: Path) -> None:
    """A hand with a `base_link` as the arm has: its weight, and not the base's, is that which is described."""
    arm = resolve("arms/ur5e.urdf")
    models = []
    for mass in (0.7, 1.0):
        (tmp_path / f"hand{mass}.urdf").write_text(HAND.format(mass))
        both = tmp_path / f"both{mass}.dmd.yaml"
        both.write_text(
            f"""directives:
- add_model: {{name: arm, file: "file://{arm}"}}
- add_model: {{name: hand, file: "file://{tmp_path}/hand{mass}.urdf"}}
- add_weld: {{parent: "arm::tool0", child: "hand::base_link"}}
"""
        )
        models.append(ArmModel(str(both), tool_frame="tool0"))
    scenario = plan(LinkSensor("wrench"), LinkSensor("imu"), wrench=PERFECT, imu=PERFECT)
    scenario.twin.arm = models[0]
    for scenario.world.arm, heavier in zip(models, (0.0, 0.3), strict=True):
        _, z, _, _ = readings(scenario, WRENCH, 0.5)
        assert np.linalg.norm(z[-1, 3:]) == pytest.approx(9.81 * heavier, abs=0.02)


@pytest.mark.long
def test_latency_noise_bias_and_outages() -> None:
    sensor = LinkSensor("imu", rate=100.0, latency=0.025)
    bias = [0.01, -0.02, 0.03, 0.1, 0.2, -0.3]
    spoiled = SensorDefects(noise=[2e-3, 3e-2], bias=bias, missing=[[0.8, 1.0]])
    now, z, t, _ = readings(plan(sensor, imu=spoiled), IMU, 3.0)
    assert np.all(t[now < 0.03] == NEVER)
    seen = (t > 0.0) & (now < 0.8)
    late = now[seen] - t[seen]
    assert late.min() >= 0.025 and late.max() < 0.056
    stuck = (now > 0.85) & (now < 1.0)
    assert np.unique(t[stuck]).size == 1
    _, clean, _, _ = readings(plan(sensor, imu=PERFECT), IMU, 3.0)
    rest = now > 1.5
    error = (z - clean)[rest]
    np.testing.assert_allclose(error.mean(axis=0), bias, atol=0.02)
    np.testing.assert_allclose(error.std(axis=0), np.repeat([2e-3, 3e-2], 3), rtol=0.3)
    _, again, _, _ = readings(plan(sensor, imu=spoiled), IMU, 1.0)
    np.testing.assert_array_equal(again, z[: len(again)])


@pytest.mark.parametrize(
    ("scenario", "field"),
    [
        (plan(LinkSensor("sonar")), "kind"),
        (plan(LinkSensor(body="nose")), "body"),
        (plan(LinkSensor(rate=0.0)), "rate"),
        (plan(LinkSensor(latency=-1.0)), "latency"),
        (plan(LinkSensor(), LinkSensor()), "already"),
        (plan(imu=PERFECT), "sensor_defects"),
        (plan(LinkSensor(), imu=SensorDefects(noise=[1.0])), "noise"),
        (plan(LinkSensor(), imu=SensorDefects(bias=[1.0])), "bias"),
        (plan(LinkSensor(), imu=SensorDefects(missing=[[1.0]])), "missing"),
    ],
)
def test_nonsense_is_refused_by_name(scenario: Scenario, field: str) -> None:
    with pytest.raises(ScenarioError, match=field):
        make_station(scenario)
