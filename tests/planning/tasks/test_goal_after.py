"""Where a task goes after the goal that it has: what it says beforehand comes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.planning.tasks.small_world import COVARIANCE, DOWN, SmallWorld, pose, step
from twin_diagram.planning.tasks.goal_after import before_task, goal_after
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import AFTER_SIZE, After, Phase, TaskOutcome, TaskState
from twin_diagram.planning.tasks.step_view import StepView
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import NEVER, ObjectStatus, Track
from twin_diagram.signals.pose_vectors import errors

STEPS = (step("pick"), step("place", pose(0.4, -0.3, 0.05)), step("reach", pose(0.3, 0.0, 0.4, DOWN)))


def view(world: SmallWorld) -> StepView:
    track = Track(ObjectStatus.TRACKED, world.now, world.X_WO, np.zeros(6), COVARIANCE)
    return StepView(world.now, world.X_WT, 0.0, [track], [], world.opening, 0.0, 0.08, NEVER)


def test_the_goal_that_is_told_is_the_one_that_comes() -> None:
    world = SmallWorld(STEPS)
    states: list[TaskState] = []
    told: list[After] = []
    while world.state.outcome is TaskOutcome.RUNNING:
        state = world.tick()
        if not states or state.phase is not states[-1].phase:
            states.append(state)
            told.append(goal_after(state, view(world), STEPS, world.library))
    phases = [state.phase for state, after in zip(states, told, strict=True) if after.goal.any()]
    assert phases == [Phase.DESCEND, Phase.CLOSE, Phase.LIFT, Phase.RETREAT], "the last step has none after it"
    then = {Phase.DESCEND: Phase.CARRY, Phase.CLOSE: Phase.CARRY, Phase.LIFT: Phase.CARRY, Phase.RETREAT: Phase.MOVE}
    for phase, comes in then.items():
        at, later = (next(k for k, state in enumerate(states) if state.phase is each) for each in (phase, comes))
        off, angle = errors(told[at].goal, states[later].goal)
        assert off < 2 * TUNING.drop_doubt and angle < 0.02, phase
        held = states[later].hand.held
        assert told[at].hand.held == held
        if held != NOTHING:
            off, angle = errors(told[at].hand.X_TO, states[later].hand.X_TO)
            assert off < 1e-3 and angle < 1e-3, "before the fingers close it is known where they will hold it"


def test_fingers_that_close_take_their_time_before_the_arm_goes_on() -> None:
    world = SmallWorld(STEPS)
    state = world.until(Phase.CLOSE)
    state = replace(state, after=goal_after(state, view(world), STEPS, world.library))
    assert state.after.pause == pytest.approx(TUNING.closing, abs=0.04)
    world.now = state.since + 0.6 * TUNING.closing
    assert goal_after(state, view(world), STEPS, world.library).pause == pytest.approx(0.4 * TUNING.closing)
    world.now = state.since + 2.0
    assert goal_after(state, view(world), STEPS, world.library).pause == 0.0
    assert goal_after(state, view(world), STEPS[:1], world.library).goal.tolist() == [0.0] * 7
    held = (STEPS[0], step("hold"))
    assert not goal_after(replace(state, after=After()), view(world), held, world.library).goal.any()


def test_a_task_tells_where_it_goes_first_before_it_begins() -> None:
    world = SmallWorld(STEPS)
    told = before_task(world.state, view(world), STEPS, world.library, 0.8).after
    assert told.pause == 0.8 and told.hand.held == NOTHING
    assert errors(told.goal, world.until(Phase.APPROACH).goal) == pytest.approx((0.0, 0.0), abs=1e-6)
    unseen = replace(view(world), tracks=[Track(ObjectStatus.LOST, 0.0, world.X_WO, np.zeros(6), COVARIANCE)])
    assert not before_task(TaskState(), unseen, STEPS, world.library, 0.8).after.goal.any()
    reach = before_task(TaskState(), view(world), STEPS[2:], world.library, 0.4).after
    np.testing.assert_array_equal(reach.goal, STEPS[2].goal)
    assert not before_task(TaskState(), view(world), (step("hold"),), world.library, 0.4).after.goal.any()


def test_what_it_takes_first_is_looked_at_once_an_image() -> None:
    world = SmallWorld(STEPS)
    first = before_task(world.state, view(world), STEPS, world.library, 0.8)
    there = view(world)
    track = replace(there.tracks[0], pose=there.tracks[0].pose + np.array([0, 0, 0, 0, 0.01, 0, 0]))
    same = before_task(first, replace(there, tracks=[track]), STEPS, world.library, 0.7)
    np.testing.assert_array_equal(same.after.goal, first.after.goal)
    assert same.after.pause == 0.7
    newer = replace(track, last_seen=there.tracks[0].last_seen + 0.05)
    moved = before_task(same, replace(there, tracks=[newer]), STEPS, world.library, 0.65)
    assert moved.after.goal[4] == pytest.approx(first.after.goal[4] + 0.01, abs=1e-3)


def test_what_comes_after_is_the_same_from_its_vector() -> None:
    after = After(pose(0.4, -0.3, 0.05), Hand(0, on_support=True), 0.25)
    again = TaskState.unpack(TaskState(after=after).pack()).after
    np.testing.assert_array_equal(again.pack(), after.pack())
    assert len(after.pack()) == AFTER_SIZE
