"""The whole loop, camera to command: tracks, keeps clear, weighs, repeats itself to the bit, knows when it is blind.

Images are a quarter of the demo's; `sims/closed_loop.py` and the slow tests run the demo's own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from tests.small_loop import BLIND, estimates, same, small_scenario, watch
from twin_diagram.perception import PerceptionSystem
from twin_diagram.runs.run import summary_of
from twin_diagram.runs.score import within
from twin_diagram.runs.trial import TUNING as TRIAL
from twin_diagram.runs.trial import Trial, run_trial, sample_times
from twin_diagram.scenario import ArmModel, Fixture, Scenario, load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.station import ports
from twin_diagram.station.lcm.fake_arm import LcmArm
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.twin import TwinDiagram, make_twin

DURATION = 2.4
OBJECTS = ("cracker_box", "mover", "can", "mug")
LOOKS = (0.5, 1.0, 2.0, DURATION)


@dataclass
class Run:
    """A run that was scored, and what the twin believed at some times."""

    loop: ClosedLoop
    trial: Trial
    summary: dict[str, Any]
    looks: list[dict[str, Array]] = field(default_factory=list)


class Looker:
    """Called between steps; keeps the estimates at `LOOKS`."""

    def __init__(self, loop: ClosedLoop) -> None:
        self._loop, self._wanted = loop, list(LOOKS)
        self.looks: list[dict[str, Array]] = []

    def __call__(self, context: Context) -> None:
        if self._wanted and context.get_time() > self._wanted[0] - 1e-9:
            self._wanted.pop(0)
            self.looks.append(estimates(self._loop, context))


def trial(loop: ClosedLoop, between: Any = lambda context: None) -> Run:
    """Runs a loop from time 0 in a new Context."""
    looker = Looker(loop)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()

    def both(context: Context) -> None:
        looker(context)
        between(context)

    done = run_trial(loop, simulator, DURATION, between=both)
    return Run(loop, done, summary_of(loop, done, done.timing()), looker.looks)


@pytest.fixture(scope="module")
def alone(egl: None) -> Run:
    return trial(make_closed_loop(small_scenario(f"duration={DURATION}", objects=OBJECTS)))


# What it is worth.


def test_objects_are_tracked_to_5_mm_and_5_degrees(alone: Run) -> None:
    assert set(alone.summary["objects"]) == set(OBJECTS)
    for name, entry in alone.summary["objects"].items():
        assert entry["visible_share"] > 0.8, name
        assert entry["position_error_mm"]["median"] < 5.0, name
        assert entry["rotation_error_deg"]["median"] < 5.0, name
    assert within(alone.summary)["tracked"]
    assert alone.summary["objects"]["can"]["symmetric_axis"] == "z"


def test_nothing_is_touched_while_the_arm_is_under_way(alone: Run) -> None:
    assert within(alone.summary)["untouched"]
    assert alone.summary["clearance_min_mm"] > 10.0
    record = alone.trial.record
    assert record.goal_error[-1] < record.goal_error[0] - 0.1, "it has set off"
    assert np.abs(record.arm_true[:, 7:]).max() > 0.2


def test_the_mover_moves_and_is_followed(alone: Run) -> None:
    record = alone.trial.record
    k = list(record.objects).index("mover")
    assert np.linalg.norm(record.poses_true[-1, k, 4:] - record.poses_true[0, k, 4:]) > 0.1
    assert ObjectStatus.MOVING in record.status[:, k]
    others = [i for i in range(len(OBJECTS)) if i != k]
    assert not np.any(record.status[:, others] == ObjectStatus.MOVING)


def test_the_payload_is_weighed_to_30_percent_early(alone: Run) -> None:
    record = alone.trial.record
    early = record.mass[(record.time > 1.5)]
    assert np.all(np.abs(early - 0.8) < 0.3 * 0.8)
    assert record.mass_std[-1] < record.mass_std[0]


def test_the_arm_is_known_to_a_twentieth_of_a_milliradian(alone: Run) -> None:
    assert alone.summary["arm"]["joint_error_rad"]["rms"] < 3e-5
    assert alone.summary["arm"]["joint_error_rad"]["max"] < 3e-4
    assert list(alone.summary["arm"]["joints"]) == list(alone.loop.model.joints)


def test_samples_are_taken_on_the_plants_steps(alone: Run) -> None:
    """In between, truth is already that of the next step and the estimate of the present."""
    step = alone.loop.scenario.world.time_step
    times = alone.trial.record.time
    assert times == pytest.approx(step * np.rint(times / step), abs=1e-12)
    assert times[-1] == pytest.approx(DURATION)
    assert np.diff(times).max() <= TRIAL.sample_period + 0.5 * step + 1e-9
    assert sample_times(1.0, 0.003)[:2] == [0.021, 0.042]
    assert sample_times(0.0162, 0.005) == [0.015]
    assert sample_times(0.3, 0.1) == [0.1, 0.2, 3 * 0.1], "a plant of large steps: each of them"
    assert sample_times(0.01, 0.02) == [0.0], "over before the first step: the start"


def test_a_healthy_run_raises_no_alarm(alone: Run) -> None:
    assert alone.summary["alarms"] == []


def test_every_system_is_in_the_timing(alone: Run) -> None:
    timing = alone.summary["timing"]
    systems = {"AdaptiveEkf", "DriftMonitor", "IcpPoseEstimator", "Mpc", "Perception", "SceneGraphUpdater", "Station"}
    assert systems <= set(timing["systems"])
    assert sum(timing["systems"].values()) == pytest.approx(1.0, abs=1e-3)
    assert timing["real_time_factor"] > 0.0


# It repeats itself.


def without_timing(summary: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in summary.items() if key != "timing"}


@pytest.mark.long
def test_two_contexts_in_turn_give_what_one_gives_alone(alone: Run) -> None:
    """Another run of the same Diagram, a little ahead, in another Context: neither feels the other."""
    loop = alone.loop
    other, again = Simulator(loop.diagram), Simulator(loop.diagram)
    seen = []
    for k in range(1, 251):
        again.AdvanceTo(0.004 * k)
        if 0.004 * k in LOOKS:
            seen.append(estimates(loop, again.get_context()))
        if other.get_context().get_time() < LOOKS[0]:
            other.AdvanceTo(min(0.004 * k + 0.011, LOOKS[0]))
    assert not same(seen, alone.looks[:2])
    assert not same([estimates(loop, other.get_context())], alone.looks[:1])


@pytest.mark.long
def test_two_contexts_in_turn_give_what_one_gives_alone_to_the_end(alone: Run) -> None:
    """Another run of the same Diagram, a little ahead, in another Context: neither feels the other."""
    loop = alone.loop
    other = Simulator(loop.diagram)
    other.Initialize()
    looker = Looker(loop)

    def between(context: Context) -> None:
        time = context.get_time()
        for step in (time + 0.004, time + 0.011):
            for look in LOOKS[:2]:
                if other.get_context().get_time() < look <= step:
                    other.AdvanceTo(look)
                    looker(other.get_context())
            if step <= LOOKS[1]:
                other.AdvanceTo(step)

    again = trial(loop, between)
    assert without_timing(again.summary) == without_timing(alone.summary)
    assert not same(again.looks, alone.looks)
    assert len(looker.looks) == 2
    assert not same(looker.looks, alone.looks[:2])


@pytest.mark.long
def test_a_second_diagram_gives_the_same_numbers(alone: Run) -> None:
    loop = make_closed_loop(small_scenario(f"duration={DURATION}", objects=OBJECTS))
    assert not same(watch(loop, list(LOOKS[:2])), alone.looks[:2])


@pytest.mark.long
def test_another_seed_gives_other_numbers(alone: Run) -> None:
    scenario = small_scenario(f"duration={DURATION}", "seed=1", objects=OBJECTS)
    assert same(watch(make_closed_loop(scenario), [LOOKS[0]]), alone.looks[:1])


# It knows when it is blind.

COVERED = (0.41, 1.7)


@pytest.fixture(scope="module")
def covered(egl: None) -> tuple[list[float], list[list[Track]]]:
    """Tracks of two objects at rest while a hand is held before the lens."""
    scenario = small_scenario(
        f"world.camera_defects.covered=[[{COVERED[0]}, {COVERED[1]}]]",
        "twin.task.X_WG=null",
        "twin.scene.stale_after=0.3",
        "twin.scene.lost_after=0.9",
    )
    times = [round(0.05 * k, 2) for k in range(1, 46)]
    looks = watch(make_closed_loop(scenario), times)
    rows = [look["tracks"].reshape(-1, TRACK_SIZE) for look in looks]
    return times, [[Track.unpack(row) for row in sample] for sample in rows]


Covered = tuple[list[float], list[list[Track]]]


@pytest.mark.long
def test_under_cover_objects_go_stale_then_lost_then_come_back(covered: Covered) -> None:
    times, samples = covered
    last = 1 / 15 * np.floor(COVERED[0] * 15)  # the last image taken with the lens free
    for k in range(2):
        for time, tracks in zip(times, samples, strict=True):
            track, blind = tracks[k], time - last
            if 0.2 < time < COVERED[0] or time > COVERED[1] + 0.25:
                assert track.status == ObjectStatus.TRACKED, time
            elif time < COVERED[1]:
                if 0.35 < blind < 0.85:
                    assert track.status == ObjectStatus.STALE, time
                elif blind > 0.95:
                    assert track.status == ObjectStatus.LOST, time
            if COVERED[0] + 0.1 < time < COVERED[1]:
                assert track.last_seen == pytest.approx(last)
    assert samples[-1][0].last_seen > COVERED[1]


@pytest.mark.long
def test_under_cover_the_last_pose_is_kept_to_the_bit(covered: Covered) -> None:
    times, samples = covered
    blind = [tracks for time, tracks in zip(times, samples, strict=True) if COVERED[0] + 0.1 < time < COVERED[1]]
    assert len(blind) > 15
    for k in range(2):
        assert {tracks[k].pose.tobytes() for tracks in blind} == {blind[0][k].pose.tobytes()}


@pytest.mark.long
def test_under_cover_the_covariance_grows_and_then_recovers(covered: Covered) -> None:
    times, samples = covered
    blind = [tracks for time, tracks in zip(times, samples, strict=True) if COVERED[0] + 0.1 < time < COVERED[1]]
    for k in range(2):
        for before, after in pairwise(blind):
            grown = np.linalg.eigvalsh(after[k].covariance - before[k].covariance)
            assert grown.min() > -1e-15 and np.trace(after[k].covariance[3:, 3:] - before[k].covariance[3:, 3:]) > 0
        first, worst, last = (np.trace(t[k].covariance[3:, 3:]) ** 0.5 for t in (blind[0], blind[-1], samples[-1]))
        assert worst > 5 * first
        assert last < 1.5 * first


# The same twin, on a bus.


@pytest.mark.slow
def test_the_same_twin_on_a_bus_believes_the_same(egl: None) -> None:
    """Within noise, and a lag of a period of the arm's driver and of the bus each way."""
    looks = [0.2, 0.6, 1.0]
    plan = small_scenario("twin.task.start=0.1", "lcm.url=memq://", "lcm.control=position_and_torque", objects=("can",))
    live_loop = make_closed_loop(plan)
    live = watch(live_loop, looks)
    plan.station = "lcm"

    def arm(builder: DiagramBuilder, station: Diagram, twin: TwinDiagram) -> None:
        builder.AddNamedSystem("arm", LcmArm(plan, station.bus))  # type: ignore[attr-defined]

    bus_loop = make_closed_loop(plan, arm)
    assert ports.input_names(bus_loop.twin.diagram) == ports.input_names(live_loop.twin.diagram)
    assert bus_loop.twin.parameter_names == live_loop.twin.parameter_names
    bus = watch(bus_loop, looks)
    speed = np.abs(live[-1]["arm_state"][7:]).max()
    assert speed > 0.1, "the arm moves"
    lag = 0.0075 + 1e-3  # driver, bus and a tick of the filter, with the planner's own on top
    for ours, theirs in zip(live, bus, strict=True):
        assert np.abs(ours["arm_state"][:7] - theirs["arm_state"][:7]).max() < max(speed, 0.5) * lag + 1e-3
        a, b = (Track.unpack(look["tracks"][:TRACK_SIZE]) for look in (ours, theirs))
        assert a.status == b.status == ObjectStatus.TRACKED
        assert np.linalg.norm(a.pose[4:] - b.pose[4:]) < 1e-3
        mass, std = ours["parameters"][0], np.sqrt(ours["covariance"].reshape(14 + ours["parameters"].size, -1)[14, 14])
        assert abs(theirs["parameters"][0] - mass) < 3.0 * std + 0.02


# Other arms, and loops that lack something.


@pytest.mark.parametrize(
    ("model", "tool"), [("arms/ur5e.urdf", ""), ("arms/iiwa7_wsg.urdf", ""), ("arms/panda.urdf", "")]
)
def test_other_arms_close_the_loop(model: str, tool: str) -> None:
    arm = ArmModel(model=model, tool_frame=tool)
    scenario = Scenario(duration=0.3)
    scenario.world.arm = scenario.twin.arm = arm
    scenario.world.fixtures, scenario.twin.fixtures = [Fixture()], [Fixture()]
    scenario.twin.camera = None
    n = 6 if "ur5e" in model else 7
    scenario.twin.home = [0.3, -1.2, 1.4, -1.6, -1.5, 0.2] if n == 6 else [0.3, 0.4, 0.0, -1.5, 0.0, 1.2, 0.2]
    loop = make_closed_loop(scenario)
    (look,) = watch(loop, [0.3])
    assert np.all(np.isfinite(look["arm_state"]))
    assert look["arm_state"][:n] == pytest.approx(scenario.twin.home, abs=0.05)


def test_without_a_camera_objects_stay_unseen_and_the_arm_is_known() -> None:
    scenario = small_scenario("duration=0.5", *BLIND, objects=("can",))
    loop = make_closed_loop(scenario)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    done = run_trial(loop, simulator, 0.5)
    summary = summary_of(loop, done, {})
    assert summary["objects"]["can"]["visible_share"] == 0.0
    assert np.all(done.record.status == ObjectStatus.UNSEEN)
    assert summary["arm"]["joint_error_rad"]["rms"] < 5e-5


@pytest.mark.parametrize(("arm", "tool"), [("arms/panda_hand.urdf", "panda_tcp"), ("arms/iiwa7_wsg.urdf", "wsg_tcp")])
@pytest.mark.parametrize("station", ["sim", "lcm"])
def test_steps_command_the_gripper_of_any_station(arm: str, tool: str, station: str) -> None:
    """Fingers open, with the force that the step allows; a station that has no gripper is none the worse for it."""
    task = "twin.task=[{kind: pick, object: can, force: 25}]"
    plan = small_scenario(*BLIND, task, "twin.task.start=0.0", "lcm.url=memq://", objects=("can",))
    for model in (plan.twin.arm, plan.world.arm):
        model.model, model.tool_frame, model.effects = arm, tool, []
    plan.station, plan.twin.home = station, [0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0]
    plan.lcm.arm = "panda" if "panda" in arm else "iiwa"
    loop = make_closed_loop(plan)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.35)
    twin = loop.twin.diagram
    own = twin.GetMyContextFromRoot(simulator.get_context())
    force = twin.GetOutputPort(ports.GRIPPER_FORCE_LIMIT).Eval(own)
    fingers = twin.GetOutputPort(ports.GRIPPER_COMMANDED).Eval(own)
    if station == "lcm":  # no message has come, so nothing has begun
        assert np.isnan(force[0])
        return
    assert force[0] == 25.0
    station_context = loop.station.GetMyContextFromRoot(simulator.get_context())
    measured = loop.station.GetOutputPort(ports.GRIPPER_MEASURED).Eval(station_context)
    np.testing.assert_allclose(measured[:2], fingers, atol=2e-3)
    assert np.abs(fingers).sum() == pytest.approx({"panda_tcp": 0.08, "wsg_tcp": 0.11}[tool])


@pytest.mark.parametrize("latency", [0.0, 0.02])
def test_perception_is_told_where_the_fingers_are(latency: float) -> None:
    """Those of a wide hand, taken to be half open, passed for two things beside what it was to take."""
    plan = load_scenario("pick_and_place", [f"twin.perception.latency={latency}"])
    for model in (plan.twin.arm, plan.world.arm):
        model.model, model.tool_frame = "arms/iiwa7_wsg.urdf", "wsg_tcp"
    plan.twin.home = [0.0, 0.45, 0.0, -1.75, 0.0, 0.95, 0.0]
    twin = make_twin(plan.twin)
    perception = cast(PerceptionSystem, twin.diagram.GetSubsystemByName("perception"))
    assert perception.parting.robot.finger_count == 2
    context = twin.diagram.CreateDefaultContext()
    own = twin.diagram.GetSubsystemContext(perception, context)
    port = perception.GetInputPort("gripper_state")
    assert not port.HasValue(own)
    wide = np.array([-0.05, 0.05, 0.0, 0.0])
    twin.diagram.GetInputPort(ports.GRIPPER_MEASURED).FixValue(context, wide)
    np.testing.assert_array_equal(port.Eval(own), wide)
    q, robot = np.array(plan.twin.home), perception.parting.robot
    tool = twin.model.tool_pose(q)
    # A point on the left finger's pad where it is told to be: 5 cm off the middle, along the closing axis.
    for side in (-1.0, 1.0):
        pad = tool.multiply(np.array([0.0, side * 0.06, -0.01]))[None]
        assert robot.near(pad, q, 0.01, wide[:2]).all()
        assert not robot.near(pad, q, 0.01).any(), "half open they are 25 mm nearer"
