"""Where a task goes after the goal that it has: what it says beforehand comes."""

from __future__ import annotations

import numpy as np

from tests.planning.tasks.small_world import COVARIANCE, DOWN, SmallWorld, pose, step
from twin_diagram.planning.tasks.goal_after import goal_after
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import Phase, TaskOutcome, TaskState
from twin_diagram.planning.tasks.step_view import StepView
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus, Track
from twin_diagram.signals.pose_vectors import errors

STEPS = (step("pick"), step("place", pose(0.4, -0.3, 0.05)), step("reach", pose(0.3, 0.0, 0.4, DOWN)))


def view(world: SmallWorld) -> StepView:
    track = Track(ObjectStatus.TRACKED, world.now, world.X_WO, np.zeros(6), COVARIANCE)
    return StepView(world.now, world.X_WT, 0.0, [track], [], world.opening, 0.0, 0.08, NEVER)


def test_the_goal_that_is_told_is_the_one_that_comes() -> None:
    world = SmallWorld(STEPS)
    states: list[TaskState] = []
    told: list[Array] = []
    while world.state.outcome is TaskOutcome.RUNNING:
        state = world.tick()
        if not states or state.phase is not states[-1].phase:
            states.append(state)
            told.append(goal_after(state, view(world), STEPS, world.library))
    phases = [state.phase for state, goal in zip(states, told, strict=True) if goal.any()]
    assert phases == [Phase.LIFT, Phase.RETREAT], "the last step has none after it"
    for k in (states.index(next(state for state in states if state.phase is phase)) for phase in phases):
        off, angle = errors(told[k], states[k + 1].goal)
        assert off < 2 * TUNING.drop_doubt and angle < 0.02
