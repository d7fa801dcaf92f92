"""A goal that no way leads to is told of once it lasts, with what is in the way, and when a way is found."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.runs.test_search_watch import GOAL, behind_a_wall
from twin_diagram.planning.paths.no_way import Hindrance, HindranceKind
from twin_diagram.planning.tasks.step_state import SENTENCES, Why
from twin_diagram.runs import run_scenario
from twin_diagram.runs.goal_watch import TUNING, GoalWatch, explained
from twin_diagram.runs.many_seeds import seed_line
from twin_diagram.runs.object_watch import ObjectWatch
from twin_diagram.runs.run_folder import EVENTS
from twin_diagram.scenario import Pose, TaskStep

BOX = Hindrance(HindranceKind.BLOCKED, 2, 0.00902, 0.01, "box")
WORDS = "at the goal the arm would come within 9 mm of box and keeps 10 mm"


class Watched:
    """A twin whose planner is stuck when it is told to be."""

    def __init__(self) -> None:
        self.now, self.asked = 0.0, 0
        self.why: Hindrance | None = BOX
        self.events: list[dict[str, Any]] = []
        route = SimpleNamespace(to_goal=True)
        self.memory = SimpleNamespace(stuck=False, route=route, goal=np.ones(7))
        mpc = SimpleNamespace(memory=lambda context: self.memory, why_no_way=self.answer)
        diagram = SimpleNamespace(GetMyContextFromRoot=lambda c: c, GetSubsystemContext=lambda system, c: c)
        twin: Any = SimpleNamespace(mpc=mpc, diagram=diagram, names=lambda c: SimpleNamespace(of=None))
        self.watch = GoalWatch(twin, lambda event: self.events.append(dict(event)))

    def answer(self, context: Any, name: Any) -> Hindrance | None:
        self.asked += 1
        return self.why

    def until(self, time: float, *, stuck: bool, goal: float = 1.0) -> None:
        self.memory.stuck, self.memory.route.to_goal = stuck, not stuck
        self.memory.goal = np.full(7, goal)
        while self.now < time - 1e-9:
            self.now += 0.02
            context: Any = SimpleNamespace(get_time=lambda: self.now)
            self.watch.poll(context)


def test_what_goes_by_is_no_news() -> None:
    run = Watched()
    run.until(1.0, stuck=False)
    run.until(1.9, stuck=True)
    run.until(2.5, stuck=False)
    run.until(3.4, stuck=True)
    assert run.events == [] and run.asked == 0 and run.watch.why(run.now) is None and run.watch.health() == []


def test_what_lasts_is_told_once_with_its_end() -> None:
    run = Watched()
    run.until(1.0, stuck=False)
    run.until(6.0, stuck=True)
    assert run.watch.why(run.now) == WORDS and run.asked <= 5
    assert run.watch.health() == [{"reason": "no_way", "what": WORDS, "first": 1.02, "last": 6.0}]
    run.until(6.3, stuck=False)  # a moment's way is no end
    run.until(7.0, stuck=True)
    run.until(9.0, stuck=False)
    began, ended = run.events
    assert began == {
        "time": 2.02, "event": "no_way", "since": 1.02, "reason": "blocked", "why": WORDS, "object": "box",
        "distance_mm": 9.02, "kept_mm": 10.0,
    }  # fmt: skip
    assert ended == {"time": 7.0, "event": "no_way_over", "found": True, "after_s": 5.98}
    assert run.watch.why(run.now) is None and run.watch.health() == []


def test_a_goal_that_is_gone_ends_it_at_once_and_its_step_still_learns_why() -> None:
    run = Watched()
    run.until(3.0, stuck=True)
    run.until(3.04, stuck=False, goal=0.0)
    assert run.events[-1]["event"] == "no_way_over" and not run.events[-1]["found"]
    assert run.watch.why(3.04) == WORDS and run.watch.why(3.0 + 2 * TUNING.just) is None


def test_what_nobody_can_say_is_not_told() -> None:
    run = Watched()
    run.why = None
    run.until(3.0, stuck=True)
    assert run.events == [] and run.watch.why(run.now) is None


def test_out_of_reach_stands_in_health_once() -> None:
    run = Watched()
    run.why = Hindrance(HindranceKind.OUT_OF_REACH)
    run.until(3.0, stuck=True)
    assert run.events[0]["reason"] == "out_of_reach" and run.watch.health() == []


@pytest.mark.parametrize(
    ("goal", "why", "result"),
    [
        ({"reached": False, "error_mm": 646.1}, WORDS, {"reached": False, "error_mm": 646.1, "why": WORDS}),
        ({"reached": False, "error_mm": 646.1}, None, None),
        ({"reached": True, "error_mm": 0.1}, WORDS, None),
        ({"reached": False, "error_mm": None}, WORDS, None),
    ],
)
def test_a_goal_that_was_missed_is_explained(goal: Any, why: str | None, result: Any) -> None:
    assert explained({"goal": goal}, why) == ({} if result is None else {"goal": result})


def test_a_station_without_truth_tells_why_alone() -> None:
    assert explained({}, WORDS) == {"goal": {"why": WORDS}} and explained({}, None) == {}


def test_the_line_of_a_seed_ends_with_why() -> None:
    goal = {"reached": False, "error_mm": 646.1, "why": WORDS}
    summary = {
        "seed": 11, "objects": {}, "payload": {"mass_true": None, "mass_estimated": None}, "goal": goal,
        "clearance_min_mm": 9.0,
    }  # fmt: skip
    assert seed_line(summary, {"tracked": True, "reached": False}).endswith(f"  reached: {WORDS}")


@pytest.mark.parametrize(
    ("why", "after"), [(Why.TIME_LIMIT, True), (Why.NO_WAY, True), (Why.DROPPED, False), (Why.NONE, False)]
)
def test_a_step_that_ends_for_want_of_a_way_says_what_was_in_it(why: Why, after: bool) -> None:
    twin: Any = SimpleNamespace()
    watch = ObjectWatch(twin, lambda event: None, lambda time: WORDS if time == 3.0 else None)
    plain = SENTENCES[why]
    event = {"time": 3.0, "event": "step", "what": "failed"} | ({"why": plain} if plain else {})
    assert watch._explained(event).get("why", "") == (f"{plain}: {WORDS}" if after else plain)
    assert watch._explained(event | {"time": 1.0}) == event | {"time": 1.0}


@pytest.mark.long
@pytest.mark.parametrize("steps", [False, True])
def test_a_run_says_what_stands_at_its_goal(steps: bool, tmp_path: Path) -> None:
    plan = behind_a_wall(tmp_path)
    wall = plan.twin.fixtures[1]
    wall.X_WB = Pose([GOAL.translation[0], GOAL.translation[1], 0.175])
    plan.world.fixtures[1] = wall
    plan.duration = 2.4
    if steps:
        plan.twin.task.X_WG, plan.twin.task.steps = None, [TaskStep(kind="reach", goal=GOAL, time_limit=1.8)]
    lines: list[str] = []
    summary = run_scenario(plan, out=tmp_path / "out", pictures=False, quiet=True, say=lines.append)
    events = [json.loads(line) for line in (tmp_path / "out" / EVENTS).read_text().splitlines()]
    told = [event for event in events if event["event"].startswith("no_way")]
    assert told[0]["object"] == "wall" and told[0]["distance_mm"] < told[0]["kept_mm"] == 10.0
    if steps:
        assert [event["event"] for event in told] == ["no_way", "no_way_over"] and not told[1]["found"]
        assert summary["task"]["why"].startswith("not done within its time limit: at the goal the arm would ")
        assert summary["task"]["why"] == events[-1]["why"] if events[-1]["event"] == "step" else True
    else:
        assert len(told) == 1 and summary["goal"]["why"] == told[0]["why"]
        assert [lack["reason"] for lack in summary["health"]] == ["no_way"]
        assert any(line.endswith(f"mm off: {told[0]['why']}") for table in lines for line in table.splitlines())
