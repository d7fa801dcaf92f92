"""IMU and wrist force sensor from the station to the filter: by switches of the scenario, live, recorded and absent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tests.small_loop import estimates, same
from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.runs.run import replay_scenario, run_scenario
from twin_diagram.scenario import ArmModel, EffectSpec, LinkSensor, Pose, Scenario, SensorDefects, SensorSpec, Twin
from twin_diagram.scenario.file import override_scenario
from twin_diagram.station import make_station, ports
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.fused_sensors import fused_sensors
from twin_diagram.twin.twin import make_twin

HOME = [0.0, -1.3, 1.6, -1.8, -1.57, 0.4]
IMU, WRENCH = "wrist_3_link.imu", ports.WRENCH_MEASURED
GYRO_BIAS = [0.012, -0.008, 0.005]
MASS = 1.2


def plan(duration: float = 1.0) -> Scenario:
    """A UR5e with both sensors, each with a bias, and a payload that nobody told the twin of."""
    scenario = Scenario(seed=1003, duration=duration)
    arm = {"model": "arms/ur5e.urdf", "tool_frame": "tool0"}
    payload = EffectSpec("payload", [], ["wrist_3_link"], {"mass": [MASS], "com": [0.0, 0.0, 0.06]})
    twin, world = scenario.twin, scenario.world
    twin.arm, world.arm = ArmModel(**arm), ArmModel(**arm, effects=[payload])
    twin.home, twin.camera, world.objects, world.fixtures = list(HOME), None, {}, []
    twin.task.X_WG, twin.task.start = Pose([0.35, 0.25, 0.45], [3.1, 0.0, 0.4]), 0.1
    twin.planner.acceleration = 2.0  # speeds that lag by a millisecond then tell the gyro's bias to its noise
    twin.sensors = [LinkSensor("imu", X_BS=Pose([0.0, 0.02, 0.03], [0.2, 0.0, 0.4])), LinkSensor("wrench", rate=100.0)]
    twin.filter.sensors = [SensorSpec("imu", name="flange_imu"), SensorSpec("wrench")]
    world.sensor_defects = {IMU: SensorDefects(bias=[*GYRO_BIAS, 0.0, 0.0, 0.0])}
    return scenario


def run(scenario: Scenario, until: float) -> tuple[ClosedLoop, Simulator]:
    loop = make_closed_loop(scenario)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(until)
    return loop, simulator


def belief(loop: ClosedLoop, simulator: Simulator) -> Any:
    ekf = loop.twin.ekf
    return ekf.belief(ekf.GetMyContextFromRoot(simulator.get_context()))


# Wiring.


def test_the_twin_asks_for_the_sensors_that_it_fuses_and_no_others() -> None:
    scenario = plan()
    names = set(ports.input_names(make_twin(scenario.twin).diagram))
    assert {IMU, ports.time_of(IMU), WRENCH, ports.time_of(WRENCH)} <= names
    scenario.twin.filter.sensors = [SensorSpec("wrench")]
    assert IMU not in ports.input_names(make_twin(scenario.twin).diagram)
    scenario.twin.filter.sensors = []
    plain = make_twin(scenario.twin)
    assert plain.fused == () and not {IMU, WRENCH} & set(ports.input_names(plain.diagram))


def test_a_sensors_place_is_that_of_the_arms_unless_the_filter_is_told_another() -> None:
    twin = plan().twin
    imu, wrench = fused_sensors(twin, "wrist_3_link")
    assert imu.spec.X_BS == twin.sensors[0].X_BS and imu.spec.body == "wrist_3_link"
    assert (imu.spec.name, wrench.spec.name) == ("flange_imu", "wrench")
    assert (imu.reading, imu.time, wrench.time) == (IMU, f"{IMU}_time", "wrist.wrench_time")
    twin.filter.sensors[0].X_BS = Pose([0.1, 0.0, 0.0])
    assert fused_sensors(twin, "wrist_3_link")[0].spec.X_BS.translation == [0.1, 0.0, 0.0]
    assert twin.filter.sensors[1].name == "", "what the twin was told stays as it is"


WRONG = {
    "no imu on forearm_link": [SensorSpec("imu", body="forearm_link")],
    "no sonar on wrist_3_link among twin.sensors; there: imu on wrist_3_link, wrench": [SensorSpec("sonar")],
    "twin.lidar is null": [SensorSpec("lidar")],
    "no such sensor on wrist_3_link": [SensorSpec()],
    "fused already": [SensorSpec("imu", name="a"), SensorSpec("imu", name="b")],
    "predicts with the torque measured": [SensorSpec("torque")],
    "'x' already": [SensorSpec("imu", name="x"), SensorSpec("wrench", name="x")],
    "not 2 positive numbers": [SensorSpec("imu", std=[0.1])],
}


@pytest.mark.parametrize("message", WRONG)
def test_what_cannot_be_fused_is_refused_by_its_field(message: str) -> None:
    twin: Twin = plan().twin
    twin.filter.sensors = WRONG[message]
    with pytest.raises(ScenarioError, match=message) as caught:
        make_twin(twin)
    assert "twin.filter" in str(caught.value) and "\n" not in str(caught.value)


def test_the_switch_works_from_the_command_line() -> None:
    scenario = plan()
    scenario.twin.filter.sensors = []
    switched = override_scenario(scenario, ["twin.filter.sensors=[{kind: wrench, std: [0.2, 0.02]}]"])
    assert [f.reading for f in make_twin(switched.twin).fused] == [WRENCH]


# Live.


@pytest.fixture(scope="module")
def live() -> tuple[ClosedLoop, Simulator]:
    return run(plan(), 2.0)


@pytest.mark.long
def test_each_reading_is_used_once_and_the_bias_is_found(live: tuple[ClosedLoop, Simulator]) -> None:
    loop, simulator = live
    found = belief(loop, simulator)
    imu, wrench = found.tracks
    # 200 and 100 readings a second, less the first few.
    assert 390 <= imu[SensorTrack.ACCEPTED] + imu[SensorTrack.REFUSED] <= 400
    assert 190 <= wrench[SensorTrack.ACCEPTED] + wrench[SensorTrack.REFUSED] <= 200
    assert imu[SensorTrack.ACCEPTED] > 0.97 * 390 and wrench[SensorTrack.ACCEPTED] > 0.97 * 190
    assert imu[SensorTrack.INVALID] == wrench[SensorTrack.INVALID] == 0
    # To within the noise of the arm's speeds, which it is told from.
    np.testing.assert_allclose(found.own[:3], GYRO_BIAS, atol=loop.scenario.twin.filter.velocity_std)


@pytest.mark.long
def test_the_wrist_helps_to_weigh(live: tuple[ClosedLoop, Simulator]) -> None:
    """Against the truth, and against the same run without it."""
    loop, simulator = live
    scenario = plan()
    scenario.twin.filter.sensors = []
    plain, other = run(scenario, 2.0)

    def mass(loop: ClosedLoop, simulator: Simulator) -> tuple[float, float]:
        found = belief(loop, simulator)
        n = found.n
        return float(found.theta[0]), float(np.sqrt(found.P[3 * n, 3 * n]))

    (value, std), (_, without) = mass(loop, simulator), mass(plain, other)
    assert value == pytest.approx(MASS, abs=max(4.0 * std, 0.02)) and std < without


# Recorded, and absent.


@pytest.mark.slow
def test_a_recording_plays_them_to_the_bit_whatever_the_world_says(tmp_path: Path) -> None:
    folder, log = tmp_path / "recording", tmp_path / "log.csv"
    scenario = plan(0.8)
    run_scenario(scenario, record=folder, log=log, say=lambda text: None, quiet=True)
    loop, simulator = run(scenario, 0.8)
    expected = estimates(loop, simulator.get_context())

    again = replay_scenario(folder)
    again.world.sensor_defects = {IMU: SensorDefects(noise=[0.5, 0.5], bias=[1.0] * 6)}
    replayed, player = run(again, 0.8)
    assert not same([expected], [estimates(replayed, player.get_context())])
    assert belief(replayed, player).tracks[0][SensorTrack.ACCEPTED] > 100
    assert same([expected], [estimates(*_without(again, 0.8))]), "and they count"

    bare = replay_scenario(folder)
    bare.replay.log = str(log)
    silent, player = run(bare, 0.8)
    found = belief(silent, player)
    assert found.valid and all(track[SensorTrack.ACCEPTED] == track[SensorTrack.INVALID] == 0 for track in found.tracks)


def _without(scenario: Scenario, until: float) -> tuple[ClosedLoop, Any]:
    scenario.twin.filter.sensors = []
    loop, simulator = run(scenario, until)
    return loop, simulator.get_context()


def test_an_older_recording_still_plays(tmp_path: Path) -> None:
    """Whose manifest has never heard of further sensors."""
    folder = tmp_path / "recording"
    scenario = plan(0.1)
    scenario.twin.sensors, scenario.twin.filter.sensors, scenario.world.sensor_defects = [], [], {}
    run_scenario(scenario, record=folder, say=lambda text: None, quiet=True)
    manifest = folder / "manifest.yaml"
    manifest.write_text(manifest.read_text().replace("sensors: []\n", ""))
    again = replay_scenario(folder)
    assert not [name for name in ports.output_names(make_station(again)) if name.endswith(".imu")]
