"""Where a task goes after the goal that it has: what it says beforehand comes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.planning.tasks.small_world import COVARIANCE, DOWN, SmallWorld, pose, step
from twin_diagram.planning.tasks.goals_after import FINGERS_TAKE, goals_after
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import Phase, TaskOutcome, TaskState
from twin_diagram.planning.tasks.step_view import StepView
from twin_diagram.signals import next_goals
from twin_diagram.signals.layouts import NEVER, ObjectStatus, Track
from twin_diagram.signals.next_goals import NEXT_GOALS_SIZE, NextGoal
from twin_diagram.signals.pose_vectors import errors

STEPS = (step("pick"), step("place", pose(0.4, -0.3, 0.05)), step("reach", pose(0.3, 0.0, 0.4, DOWN)))


def view(world: SmallWorld) -> StepView:
    track = Track(ObjectStatus.TRACKED, world.now, world.X_WO, np.zeros(6), COVARIANCE)
    return StepView(world.now, world.X_WT, 0.0, [track], [], world.opening, 0.0, 0.08, NEVER)


def told_by_phase() -> tuple[list[TaskState], list[list[NextGoal]]]:
    """The state at the begin of each phase, and what is said then to come after its goal."""
    world = SmallWorld(STEPS)
    states: list[TaskState] = []
    told: list[list[NextGoal]] = []
    while world.state.outcome is TaskOutcome.RUNNING:
        state = world.tick()
        if not states or state.phase is not states[-1].phase:
            states.append(state)
            told.append(goals_after(state, view(world), STEPS, world.library))
    return states, told


def test_the_goals_that_are_told_are_those_that_come() -> None:
    states, told = told_by_phase()
    counts = {state.phase.name: len(each) for state, each in zip(states, told, strict=True)}
    assert counts == {
        "LOOK": 0, "APPROACH": 1, "DESCEND": 2, "CLOSE": 2, "LIFT": 1, "CARRY": 1, "LOWER": 2, "OPEN": 2, "RETREAT": 1,
        "MOVE": 0, "REST": 0,
    }  # fmt: skip
    goals = [state.goal for state in states]
    for i, each in enumerate(told):
        came: list[np.ndarray] = []
        for goal in goals[i + 1 :]:
            if goal.any() and not any(np.array_equal(goal, other) for other in [goals[i], *came]):
                came.append(goal)
        for foreseen, goal in zip(each, came, strict=False):
            off, angle = errors(foreseen.X_WG, goal)
            assert off < 2 * TUNING.drop_doubt and angle < 0.02, states[i].phase


def test_it_is_told_when_they_are_left_for() -> None:
    states, told = told_by_phase()
    by_phase = {state.phase: (state, each) for state, each in zip(states, told, strict=True)}
    for phase in (Phase.DESCEND, Phase.LOWER):
        assert by_phase[phase][1][0].pause == FINGERS_TAKE
    for phase in (Phase.CLOSE, Phase.OPEN):
        state, each = by_phase[phase]
        assert each[0].earliest == state.since + TUNING.closing
    for phase in (Phase.APPROACH, Phase.CARRY, Phase.LIFT):
        assert by_phase[phase][1][0].pause < 0.0, "passed"


def test_before_it_begins_a_task_is_foreseen_to_go_to_what_it_sees() -> None:
    world = SmallWorld(STEPS)
    state = world.until(Phase.APPROACH)
    seen = view(world)
    (first,) = goals_after(TaskState(), seen, STEPS, world.library, 2.5)
    assert first.earliest == 2.5
    np.testing.assert_allclose(first.X_WG, state.goal, atol=1e-9)
    unseen = replace(seen, tracks=[replace(seen.tracks[0], status=ObjectStatus.STALE)])
    assert goals_after(TaskState(), unseen, STEPS, world.library, 2.5) == []
    (first,) = goals_after(TaskState(), unseen, STEPS[2:], world.library, 2.5)
    np.testing.assert_array_equal(first.X_WG, STEPS[2].goal)


def test_goals_go_over_the_wire_and_back_up_to_the_first_that_is_none() -> None:
    one, other = NextGoal(pose(0.1, 0.2, 0.3), -0.1), NextGoal(pose(0.4, 0.5, 0.6), 0.2, 3.0)
    for goals in ([], [one], [one, other]):
        vector = next_goals.pack(goals)
        assert len(vector) == NEXT_GOALS_SIZE
        back = next_goals.unpack(vector)
        assert [(*g.X_WG, g.pause, g.earliest) for g in back] == [(*g.X_WG, g.pause, g.earliest) for g in goals]
    assert len(next_goals.unpack(next_goals.pack([one, other, one]))) == 2
    assert next_goals.unpack(np.full(NEXT_GOALS_SIZE, np.nan)) == []
