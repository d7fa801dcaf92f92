"""Which contacts a step asks for, and which are collisions; tasks drawn; what a run tells of its steps."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.small_loop import BLIND, small_scenario
from twin_diagram.cli import main
from twin_diagram.errors import ScenarioError
from twin_diagram.planning.tasks.step_state import Phase, TaskState
from twin_diagram.runs import run_scenario
from twin_diagram.runs.drawn_picks import TUNING, draw_picks
from twin_diagram.runs.task_score import Parts, asked_for
from twin_diagram.scenario import load_scenario
from twin_diagram.scenario.validation import check_twin
from twin_diagram.signals.hand import Hand

WORLD, TABLE, HAND, FINGER, CAN, MUG = range(6)
PARTS = Parts(frozenset([HAND, FINGER]), frozenset([FINGER]), {"can": CAN, "mug": MUG}, frozenset([WORLD, TABLE]))


def state(phase: Phase, *, held: bool = False, on_support: bool = False) -> TaskState:
    return replace(TaskState(), phase=phase, hand=Hand(held=0 if held else -1, on_support=on_support))


@pytest.mark.parametrize(
    ("a", "b", "at", "asked"),
    [
        (FINGER, CAN, state(Phase.CLOSE), True),
        (CAN, FINGER, state(Phase.CARRY, held=True), True),
        (FINGER, CAN, state(Phase.MOVE, held=True), True),
        (FINGER, CAN, state(Phase.DESCEND), False),
        (HAND, CAN, state(Phase.CLOSE), False),
        (FINGER, MUG, state(Phase.CLOSE), False),
        (FINGER, TABLE, state(Phase.DESCEND), False),
        (HAND, FINGER, state(Phase.MOVE), True),
        (CAN, TABLE, state(Phase.LIFT, held=True, on_support=True), True),
        (TABLE, CAN, state(Phase.CARRY, held=True), False),
        (CAN, MUG, state(Phase.LOWER, held=True, on_support=True), False),
        (CAN, TABLE, state(Phase.RETREAT), True),
        (MUG, TABLE, state(Phase.CARRY, held=True), True),
        (MUG, CAN, state(Phase.APPROACH), True),
    ],
)
def test_what_a_step_asks_for_is_no_collision(a: int, b: int, at: TaskState, asked: bool) -> None:
    assert asked_for(a, b, PARTS, "can", at) is asked
    assert asked_for(b, a, PARTS, "can", at) is asked


def test_what_bears_it_may_be_touched_while_it_is_put_down() -> None:
    lowering, carrying = state(Phase.LOWER, held=True, on_support=True), state(Phase.CARRY, held=True)
    assert asked_for(CAN, MUG, PARTS, "can", lowering, support=MUG)
    assert not asked_for(CAN, MUG, PARTS, "can", carrying, support=MUG)
    assert not asked_for(FINGER, MUG, PARTS, "can", lowering, support=MUG)


@pytest.mark.long
def test_a_table_on_which_room_is_rare_is_drawn_all_the_same() -> None:
    """The 228th draw of all places is the first good one there; a run over many seeds ended at it."""
    assert len(draw_picks(load_scenario("pick_and_place"), 700159).world.objects) == 4


def test_drawn_tables_are_tasks_of_their_own() -> None:
    base = load_scenario("pick_and_place")
    drawn = [draw_picks(base, seed) for seed in range(40)]
    for plan in drawn:
        check_twin(plan.twin)
        step = plan.twin.task.steps[1]
        item = plan.world.objects[step.object]
        assert step.goal is not None and item.mass is not None
        away = np.linalg.norm(np.subtract(step.goal.translation, item.X_WO.translation))
        assert away >= 0.6 and item.mass <= TUNING.heaviest
        places = [other.X_WO.translation[:2] for other in plan.world.objects.values()]
        apart = [np.linalg.norm(np.subtract(p, q)) for k, p in enumerate(places) for q in places[:k]]
        assert min(apart) > 0.05
    assert {plan.twin.task.steps[0].object for plan in drawn} == set(TUNING.targets)
    assert draw_picks(base, 3) == drawn[3] and drawn[3] != drawn[4]
    assert base == load_scenario("pick_and_place")
    with pytest.raises(ScenarioError, match=r"twin\.task\.steps"):
        draw_picks(load_scenario("tabletop"), 0)


def test_steps_are_told_in_events_and_summary(tmp_path: Path) -> None:
    """A short way, then a goal that nothing reaches within its time limit: the second step has failed, and says why."""
    far = "kind: reach, goal: {translation: [0.5, -0.4, 0.3]}"
    task = f"[{{kind: hold, seconds: 0.2}}, {{{far}, time_limit: 0.2}}, {{{far}}}]"
    plan = small_scenario(*BLIND, "duration=1.2", f"twin.task={task}", objects=())
    summary = run_scenario(plan, out=tmp_path, pictures=False, quiet=True, say=lambda text: None)
    lines = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    steps = [line for line in lines if line["event"] == "step"]
    assert [(line["step"], line["kind"], line["what"]) for line in steps] == [
        (0, "hold", "started"),
        (0, "hold", "done"),
        (1, "reach", "started"),
        (1, "reach", "failed"),
    ]
    assert "time limit" in steps[-1]["why"]
    task_told = json.loads((tmp_path / "summary.json").read_text())["task"]
    assert task_told == summary["task"]
    assert task_told["outcome"] == "failed" and task_told["done"] == 1 and task_told["steps"] == 3
    assert [event["what"] for event in task_told["events"]] == [line["what"] for line in steps]
    assert task_told["collisions"] == {"point": 0, "surface": 0}


def test_an_unknown_object_ends_before_anything_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    code = main(["run", "tabletop", "--out", str(out), "--set", "twin.task=[{kind: pick, object: teapot}]"])
    captured = capsys.readouterr()
    message = [line for line in captured.err.splitlines() if line]
    assert code == 2 and len(message) == 1 and "twin.task.steps.0.object" in message[0] and "teapot" in message[0]
    assert not out.exists()
