"""The stop monitor in the loop: planners that go wrong drive an arm at its table; the twin's own goes on after."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from tests.small_loop import BLIND, small_scenario
from twin_diagram.errors import ScenarioError
from twin_diagram.model.model import Model
from twin_diagram.planning.braking.stop_monitor import StopMonitor
from twin_diagram.runs.brake_watch import BrakeWatch
from twin_diagram.runs.true_clearance import TrueClearance
from twin_diagram.scenario import Pose
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.things import THING_SIZE, Thing
from twin_diagram.station import ports
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop

N = 7
DOWN = np.array([0.0, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0])
"""What takes the hand down into the table [rad/s]."""


class Wrong(LeafSystem):
    """Goes down from rest, and sends no numbers or makes no plans from some time on."""

    def __init__(self, home: list[float], kind: str, since: float) -> None:
        super().__init__()
        self._home, self._kind, self._since = np.array(home), kind, since
        now = {self.time_ticket()}
        self.DeclareVectorOutputPort("position_commanded", N, self._calc, prerequisites_of_calc=now)
        self.DeclareVectorOutputPort("plan_time", 1, self._calc_time, prerequisites_of_calc=now)

    def _calc(self, context: Context, output: BasicVector) -> None:
        t = max(0.0, context.get_time() - 0.1)
        speeding = min(t, 0.2)
        slow = 0.3 if self._kind == "freezes" else 1.0
        q = self._home + slow * DOWN * (speeding * speeding / 0.4 + max(0.0, t - 0.2))
        wrong = self._kind == "nan" and context.get_time() > self._since
        output.SetFromVector(np.full(N, np.nan) if wrong else q)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        t = context.get_time()
        output[0] = min(t, self._since) if self._kind == "freezes" else t


class Ran:
    """A loop that ran, with what was touched and told."""

    def __init__(self, loop: ClosedLoop, duration: float) -> None:
        self.loop, self.contacts, self.events = loop, 0, list[dict[str, Any]]()
        self.simulator = Simulator(loop.diagram)
        self.simulator.Initialize()
        self.true = TrueClearance(loop.station)
        self.watch = BrakeWatch(loop.twin, lambda event: self.events.append(dict(event)))
        self.go(duration)

    def go(self, until: float) -> None:
        context = self.simulator.get_mutable_context()
        own = self.loop.station.GetMyContextFromRoot(context)
        while context.get_time() < until - 1e-9:
            self.simulator.AdvanceTo(min(until, context.get_time() + 0.02))
            self.watch.poll(context)
            self.nearest, contacts = self.true.evaluate(own, 0.2)
            self.contacts += contacts

    def arm(self) -> Array:
        own = self.loop.station.GetMyContextFromRoot(self.simulator.get_context())
        return np.array(self.loop.station.GetOutputPort(ports.ARM_STATE).Eval(own))

    def summary(self) -> dict[str, Any]:
        return dict(self.watch.told(self.simulator.get_context())["brakes"])


def ran(kind: str, since: float = 9.0, duration: float = 1.0, *overrides: str) -> Ran:
    scenario = small_scenario(*BLIND, *overrides, objects=("can",))
    controller = Wrong(scenario.twin.home, kind, since)
    return Ran(make_closed_loop(scenario, controller=controller), duration)


def test_without_the_monitor_the_hand_hits_the_table_and_with_it_not() -> None:
    bare = ran("drives", 9.0, 0.9, "twin.stop_monitor=null")
    assert bare.contacts > 0, "the planner is as bad as it should be"
    assert bare.watch.told(bare.simulator.get_context()) == {}
    assert bare.loop.twin.monitor is None
    kept = ran("drives", 9.0, 1.2)
    assert kept.contacts == 0
    assert 0.0005 < kept.nearest < 0.04, "it stands, above the table"
    assert np.abs(kept.arm()[N:]).max() < 0.05
    (brake,) = kept.events
    assert brake["event"] == "brake" and brake["cause"] == "clearance" and brake["object"] == "table"
    assert kept.summary() == {
        "count": 1,
        "seconds": pytest.approx(1.2 - brake["time"], abs=1e-3),
        "braking": True,
        "causes": {"clearance": 1},
    }


@pytest.mark.parametrize(
    ("kind", "cause"), [("nan", "not_a_number"), pytest.param("freezes", "hanging_planner", marks=pytest.mark.long)]
)
def test_a_planner_that_fails_leaves_the_arm_at_rest(kind: str, cause: str) -> None:
    failed = ran(kind, 0.3, 0.9)
    assert failed.events[0]["cause"] == cause
    assert failed.contacts == 0
    assert np.isfinite(failed.arm()).all() and np.abs(failed.arm()[N:]).max() < 0.05


@pytest.mark.long
def test_the_twins_own_planner_goes_on_from_where_it_was_stopped() -> None:
    """The monitor alone is told of a thing in the way; when that is gone the arm reaches its goal all the same."""
    scenario = small_scenario(*BLIND, "twin.task.start=0.1", "twin.planner.velocity_share=0.4", objects=("can",))
    start = Model.load(scenario.twin.arm).tool_pose(np.array(scenario.twin.home)).translation()
    goal = start + [0.0, -0.35, 0.05]
    scenario.twin.task.X_WG = Pose(translation=goal.tolist(), rpy=[np.pi, 0.0, 0.0])
    loop = make_closed_loop(scenario)
    run = Ran(loop, 0.1)
    monitor = loop.twin.monitor
    assert isinstance(monitor, StopMonitor)
    own = monitor.GetMyMutableContextFromRoot(run.simulator.get_mutable_context())
    middle = start + [0.0, -0.25, 0.0]
    box = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) + middle
    rows = np.zeros((scenario.twin.slots.unknown, THING_SIZE))
    rows[0] = Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, middle, (box,)).pack()
    things = monitor.GetInputPort("things").FixValue(own, rows.ravel())
    run.go(1.0)
    stood = model_tool(loop, run)
    assert run.events and all(event.get("cause", "clearance") == "clearance" for event in run.events)
    braking = []
    for time in (1.05, 1.1, 1.15, 1.2):  # it tries to set off for 40 ms every quarter of a second
        run.go(time)
        braking.append(run.summary()["braking"])
        assert np.linalg.norm(model_tool(loop, run) - stood) < 0.001
    assert sum(braking) >= 3
    assert np.linalg.norm(stood - goal) > 0.1
    things.GetMutableData().set_value(np.zeros(rows.size))
    run.go(3.6)
    assert run.events[-1]["event"] == "resume"
    assert run.contacts == 0
    assert np.linalg.norm(model_tool(loop, run) - goal) < 0.02


def model_tool(loop: ClosedLoop, run: Ran) -> Array:
    """Where the tool is [m]."""
    return np.array(loop.model.tool_pose(run.arm()[:N]).translation())


@pytest.mark.parametrize(
    ("field", "value"), [("rate", "0"), ("acceleration", "-1"), ("torque_share", "1.5"), ("clearance", "-0.1")]
)
def test_senseless_tuning_is_refused_by_name(field: str, value: str) -> None:
    scenario = small_scenario(*BLIND, f"twin.stop_monitor.{field}={value}", objects=("can",))
    with pytest.raises(ScenarioError, match=f"twin.stop_monitor.{field}"):
        make_closed_loop(scenario)
