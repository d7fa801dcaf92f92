"""The twin says when it is blind: each lack is caused, on a bus in memory or in the simulated station."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drake import lcmt_image_array, lcmt_panda_status
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem

from tests.small_loop import BLIND, small_scenario
from twin_diagram import cli
from twin_diagram.estimation.drift import alarm_lifecycle
from twin_diagram.runs.health_watch import HealthWatch, unheard
from twin_diagram.runs.run import beliefs, run_scenario
from twin_diagram.scenario import Camera, Pose, Scenario
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.layouts import NEVER, AlarmKind
from twin_diagram.station.lcm.messages import write_images
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.health import FIELDS, Lack, Patience, Reason, ceased, noted, told
from twin_diagram.twin.health import TUNING as HEALTH
from twin_diagram.twin.twin import TwinDiagram

HOME = [0.6, 0.2, 0.0, -2.1, 0.0, 2.3, 1.4]


class Robot(LeafSystem):
    """An arm's driver and a camera at the other end of a bus, which fall silent, or whose clock runs ahead."""

    def __init__(
        self,
        bus: DrakeLcmInterface,
        plan: Scenario,
        *,
        until: float,
        images_until: float = np.inf,
        clock: float = 1.0,
        nothing_after: float = np.inf,
    ) -> None:
        super().__init__()
        self._nothing_after = nothing_after
        self._bus, self._plan, self._until, self._images_until = bus, plan, until, images_until
        self._clock = clock
        self.DeclarePeriodicPublishEvent(1.0 / plan.twin.driver.rate, 1e-4, self._status)
        if plan.twin.camera is not None:
            self.DeclarePeriodicPublishEvent(1.0 / plan.twin.camera.rate, plan.twin.camera.latency, self._image)

    def _status(self, context: Context) -> EventStatus:
        if context.get_time() > self._until:
            return EventStatus.DidNothing()
        message, still = lcmt_panda_status(), [0.0] * 7
        message.utime, message.num_joints = round(1e6 * self._clock * context.get_time()), 7
        for name in ("joint_position", "joint_position_desired"):
            setattr(message, name, [np.nan] * 7 if context.get_time() > self._nothing_after else list(HOME))
        for name in (
            "joint_velocity", "joint_velocity_desired", "joint_acceleration_desired", "joint_torque",
            "joint_torque_desired", "joint_torque_external",
        ):  # fmt: skip
            setattr(message, name, list(still))
        self._bus.Publish(self._plan.lcm.status_channel or "PANDA_STATUS", message.encode())
        return EventStatus.Succeeded()

    def _image(self, context: Context) -> EventStatus:
        camera = self._plan.twin.camera
        assert camera is not None
        taken = context.get_time() - camera.latency
        if taken > self._images_until:
            return EventStatus.DidNothing()
        colour = np.zeros((camera.height, camera.width, 4), np.uint8)
        depth = np.zeros((camera.height, camera.width), np.float32)
        message: lcmt_image_array = write_images(round(1e6 * taken), camera.name, colour, depth)
        self._bus.Publish(self._plan.lcm.image_channel, message.encode())
        return EventStatus.Succeeded()


def on_a_bus(camera: bool = False) -> Scenario:
    plan = small_scenario(
        *([] if camera else BLIND), "station=lcm", "lcm.url=memq://", "twin.task.X_WG=null", objects=()
    )
    if camera:
        plan.twin.camera = Camera(X_WC=Pose([1.4, 0.0, 0.85], [-2.27, 0.0, 1.57]), width=80, height=60, focal=75.0)
    return plan


def run(
    plan: Scenario, duration: float, **robot: Any
) -> tuple[ClosedLoop, list[dict[str, Any]], list[str], dict[str, Any]]:
    """A loop with a robot at the other end of its bus: what was lacking, what was said of it, what is believed."""

    def add(builder: DiagramBuilder, station: Diagram, twin: TwinDiagram) -> None:
        builder.AddNamedSystem("robot", Robot(station.bus, plan, **robot))  # type: ignore[attr-defined]

    loop = make_closed_loop(plan, add if robot else None)
    simulator, said = Simulator(loop.diagram), list[str]()
    watch = HealthWatch(loop.twin, said.append)
    for tick in range(1, round(duration / 0.02) + 1):
        simulator.AdvanceTo(0.02 * tick)
        watch.poll(simulator.get_context())
    own = loop.twin.diagram.GetMyContextFromRoot(simulator.get_context())
    # The port says what the list does.
    rows = np.array(loop.twin.diagram.GetOutputPort("health").Eval(own)).reshape(-1, FIELDS)
    found = loop.twin.lacking(own)
    assert sorted(round(float(row[1]), 4) for row in rows if row[1] >= 0.0) == [each["first"] for each in found]
    json.dumps(found, allow_nan=False)
    return loop, found, said, beliefs(loop, simulator.get_context())


# Messages and images.


def test_a_silent_bus_is_said_and_the_command_exits_3(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """It printed the configured home as the joints, no warning, and 0."""
    argv = [
        "fault",
        "--set",
        "station=lcm",
        "--set",
        "lcm.url=memq://",
        "--set",
        "twin.healing=null",
        "--duration",
        "0.4",
    ]
    assert cli.main(["run", *argv, "--out", str(tmp_path / "out")]) == 3
    printed, complained = capfd.readouterr()
    assert "no message from the arm: none has come, since 0.00 s" in printed
    assert "nothing that can be used came on PANDA_STATUS at memq://" in complained
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["joints"] is None and '"joints": null' in printed and unheard(summary)
    (lack,) = summary["health"]
    assert (lack["reason"], lack["what"], lack["first"]) == ("no_arm_message", "none has come", 0.0)
    assert lack["last"] == pytest.approx(0.4, abs=0.03)


def test_an_arm_that_falls_silent_is_said_from_its_last_message_on() -> None:
    plan = on_a_bus()
    _, found, said, believed = run(plan, 0.6, until=0.3)
    (lack,) = found
    assert (lack["reason"], lack["what"]) == ("no_arm_message", "they have ceased")
    assert lack["first"] == pytest.approx(0.3, abs=0.004) and lack["last"] == pytest.approx(0.6, abs=0.03)
    assert len(said) == 1 and said[0].endswith("no message from the arm: they have ceased, since 0.30 s")
    # Said as soon as so many periods have passed without one, and not before.
    assert float(said[0].split(" s:")[0]) == pytest.approx(0.3 + HEALTH.messages / plan.twin.driver.rate, abs=0.04)
    assert believed["joints"] is not None and not unheard(believed), "it was heard once"
    assert unheard({"joints": None}) and not unheard({"arm": {}})


def test_an_arm_that_sends_no_numbers_is_blind_however_fresh_its_stamps() -> None:
    """A second of NaN went unseen, with the planner's commands passed on."""
    _, found, said, _ = run(on_a_bus(), 0.6, until=np.inf, nothing_after=0.3)
    (lack,) = found
    assert lack["reason"] == "no_arm_message" and "no numbers" in lack["what"] and "no numbers" in said[0]
    assert lack["first"] == pytest.approx(0.3, abs=0.006)


def test_a_robot_that_speaks_lacks_nothing() -> None:
    _, found, said, _ = run(on_a_bus(camera=True), 0.5, until=np.inf)
    assert found == [] and said == []


def test_a_slow_driver_is_not_taken_for_a_silent_one() -> None:
    plan = on_a_bus()
    plan.twin.driver.rate = 10.0
    _, found, _, _ = run(plan, 0.6, until=np.inf)
    assert found == []


@pytest.mark.long
def test_images_that_never_come_and_images_that_cease() -> None:
    _, found, said, _ = run(on_a_bus(camera=True), 0.7, until=np.inf, images_until=-1.0)
    assert [(lack["reason"], lack["what"], lack["first"]) for lack in found] == [("no_image", "none has come", 0.0)]
    assert "no image: none has come" in said[0]
    _, found, said, _ = run(on_a_bus(camera=True), 0.9, until=np.inf, images_until=0.3)
    (lack,) = found
    assert (lack["reason"], lack["what"]) == ("no_image", "they have ceased")
    assert lack["first"] == pytest.approx(0.2667, abs=0.01), "the newest image's capture"


def test_a_loop_that_is_slower_than_the_arms_clock_says_so() -> None:
    """The arm's stamps run ahead of the loop's time where the loop does not keep up."""
    plan = on_a_bus()
    _, found, said, _ = run(plan, 0.4, until=np.inf, clock=1.5)
    (lack,) = found
    assert lack["reason"] == "slower_than_real_time" and "slower than real time" in said[0]
    assert lack["first"] == pytest.approx(HEALTH.plans / plan.twin.planner.rate / 0.5, abs=0.03)


def test_an_arm_ahead_of_a_slow_loop_that_falls_silent_is_said_at_once() -> None:
    """By the arm's clock alone its last message stayed new until the loop was there: 0.24 s here."""
    _, found, said, _ = run(on_a_bus(), 0.6, until=0.3, clock=1.8)
    assert [lack["reason"] for lack in found] == ["slower_than_real_time", "no_arm_message"]
    assert found[1]["what"] == "they have ceased" and found[1]["first"] == pytest.approx(0.3, abs=0.04)
    at = [float(line.split(" s:")[0]) for line in said if "no message" in line]
    assert at == [pytest.approx(0.3 + HEALTH.messages / on_a_bus().twin.driver.rate, abs=0.08)]


# Objects and goals.


@pytest.mark.long
def test_an_object_that_the_camera_never_sees_is_named(egl: None) -> None:
    plan = small_scenario("twin.scene.stale_after=0.2", "twin.scene.lost_after=0.4", "duration=0.9", *STILL)
    del plan.world.objects["sugar_box"]  # the twin is told of it, and it is not there
    said: list[str] = []
    summary = run_scenario(plan, quiet=True, say=said.append)
    (lack,) = summary["health"]
    assert (lack["reason"], lack["what"], lack["first"]) == ("object_not_seen", "sugar_box", 0.0)
    assert any("the camera has not seen sugar_box" in line for line in said)
    assert any(line.startswith("health") and "sugar_box" in line for line in said[-1].splitlines())


STILL = ("twin.task.X_WG=null",)


@pytest.mark.long
def test_a_goal_out_of_reach_is_said_with_where_it_is() -> None:
    far = "twin.task.X_WG={translation: [3.0, 0.0, 0.4], rpy: [3.141593, 0.0, 0.0]}"
    plan = small_scenario(*BLIND, far, "twin.task.start=0.2", "twin.planner.rate=10", "duration=3.3", objects=())
    said: list[str] = []
    summary = run_scenario(plan, quiet=True, say=said.append)
    (lack,) = summary["health"]
    assert lack["reason"] == "goal_out_of_reach" and "panda_tcp" in lack["what"] and "(3, 0, 0.4) m" in lack["what"]
    assert lack["first"] == pytest.approx(0.2 + plan.twin.planner.route_after, abs=0.11), "from the first search on"
    assert any("the goal is out of reach" in line for line in said)


@pytest.mark.long
def test_healthy_scenarios_lack_nothing(egl: None) -> None:
    """Those that come along, and a loop with a camera that sees all that it is told of."""
    summary = run_scenario(
        load_scenario("fault", ["duration=0.6", "twin.healing=null"]), quiet=True, say=lambda text: None
    )
    assert summary["health"] == []
    plan = small_scenario("twin.scene.lost_after=0.6", "twin.task.start=0.1", "duration=0.7")
    said: list[str] = []
    assert run_scenario(plan, quiet=True, say=said.append)["health"] == []
    assert "nothing is lacking" in said[-1]


# Standings.


@pytest.mark.long
def test_nothing_is_settled_while_an_alarm_stands() -> None:
    """With the filter sure of the payload, an alarm makes it doubtful, for `beliefs` and for the filter itself."""
    loop = make_closed_loop(load_scenario("fault", ["world.arm.effects=[]", "twin.healing=null"]))
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(2.0)

    def status() -> str:
        return str(beliefs(loop, simulator.get_context())["parameters"]["payload.mass"]["status"])

    assert status() == "settled"
    drift = loop.twin.drift
    own = loop.twin.diagram.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    context = loop.twin.diagram.GetMutableSubsystemContext(drift, own)
    drift.monitor.vector[:] = context.get_discrete_state(0).value()
    alarm_lifecycle.raise_alarm(drift.monitor.state, AlarmKind.INNOVATION, simulator.get_context().get_time(), 3.0)
    context.SetDiscreteState(0, drift.monitor.vector)
    assert status() == "in doubt"
    simulator.AdvanceTo(2.01)
    ekf = loop.twin.ekf
    filter_ = ekf.ekf
    filter_.load(np.array(loop.twin.diagram.GetSubsystemContext(ekf, own).get_discrete_state(0).value()), None)
    found = {standing.label.split(" ")[0]: standing.status.value for standing in filter_.standings(loop.model.joints)}
    assert "settled" not in found.values() and found["payload.mass"] in ("in doubt", "not excited")


# The rules by themselves.


def test_when_messages_count_as_ceased() -> None:
    assert ceased(0.04, NEVER, 0.05) == [np.inf, np.inf]
    assert ceased(0.06, NEVER, 0.05) == [0.0, np.inf]
    assert ceased(1.04, 1.0, 0.05) == [np.inf, np.inf]
    assert ceased(1.06, 1.0, 0.05) == [np.inf, 1.0]
    assert ceased(100.04, NEVER, 0.05, 100.0) == [np.inf, np.inf]
    assert ceased(100.06, NEVER, 0.05, 100.0) == [100.0, np.inf]


def test_first_and_last_times_are_kept() -> None:
    each = [Lack(Reason.NO_IMAGE, "late"), Lack(Reason.NO_ARM_MESSAGE, "early"), Lack(Reason.OBJECT_NOT_SEEN, "never")]
    rows = np.tile([0.0, NEVER, NEVER], (3, 1))
    for now, since in ((1.0, [np.inf, 0.9]), (2.0, [1.5, 0.9]), (3.0, [np.inf, np.inf]), (4.0, [3.5, np.inf])):
        rows = noted(rows, np.array([*since, np.inf]), now)
    np.testing.assert_array_equal(rows, [[1.0, 1.5, 4.0], [0.0, 0.9, 2.0], [0.0, NEVER, NEVER]])
    assert told(rows, each) == [
        {"reason": "no_arm_message", "what": "early", "first": 0.9, "last": 2.0},
        {"reason": "no_image", "what": "late", "first": 1.5, "last": 4.0},
    ]


def test_patience_follows_from_the_scenarios_periods() -> None:
    twin = load_scenario("tabletop").twin
    assert twin.camera is not None
    before = Patience.of(twin)
    twin.driver.rate, twin.camera.rate, twin.planner.rate = 0.5 * 400.0, 0.5 * 15.0, 0.5 * 50.0
    twin.scene.lost_after = 10.0
    after = Patience.of(twin)
    assert (after.message, after.behind) == pytest.approx((2.0 * before.message, 2.0 * before.behind))
    # A search that is made anew after 2 s, two answers, and the ticks that hear them.
    for patience, rate in ((before, load_scenario("tabletop").twin.planner.rate), (after, twin.planner.rate)):
        assert patience.goal == pytest.approx(2.0 + 2 * twin.planner.route_after + 2.0 / rate)
    (borne,), (less,) = after.images, before.images
    assert borne - twin.camera.latency == pytest.approx(2.0 * (less - twin.camera.latency))
    assert (before.unseen, after.unseen) == (5.0, 10.0)
    twin.camera = None
    assert Patience.of(twin).images == ()
