"""Where a task goes after the goal that it has, as far as it is known: for who looks a second ahead. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from twin_diagram.planning.tasks.picking import before_grasp, grasp_now, lies_still, risen
from twin_diagram.planning.tasks.placing import above_place
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import Phase, Step, TaskState
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import NEVER
from twin_diagram.signals.next_goals import NextGoal
from twin_diagram.signals.pose_vectors import compose, inverse

FINGERS_TAKE: Final = TUNING.settled + TUNING.closing
"""From when the tool has come to where its fingers close or open until it leaves [s]."""
SOONER: Final = 0.15
"""Points on the way are left about so long before a way that ended there would end [s]."""


def goals_after(
    state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable], start: float = NEVER
) -> list[NextGoal]:
    """Return the goals that follow the present one, in their order; what depends on what is yet to be seen ends them.

    Args:
        state: after a tick.
        seen: then.
        steps: of the task.
        library: the known objects, in the order of the tracks.
        start: when the task begins [s].
    """
    if state.step >= len(steps):
        return []
    step, phase, soon = steps[state.step], state.phase, state.since + TUNING.closing
    if phase is Phase.START:
        return _first(state, seen, step, library, start)
    if phase is Phase.APPROACH:
        return [NextGoal(state.grasp, -SOONER)]
    if phase is Phase.DESCEND:
        return [NextGoal(risen(state, seen, step, library), FINGERS_TAKE), *_next_step(state, seen, steps, library)]
    if phase is Phase.CLOSE:
        up = NextGoal(risen(state, seen, step, library), 0.0, soon)
        return [up, *_next_step(state, seen, steps, library)]
    if phase is Phase.CARRY:
        return [NextGoal(state.grasp, -SOONER)]
    if phase is Phase.LOWER:
        up = NextGoal(before_grasp(state.grasp), FINGERS_TAKE)
        return [up, *_next_step(state, seen, steps, library)]
    if phase is Phase.OPEN:
        up = NextGoal(before_grasp(seen.X_WT), 0.0, soon)
        return [up, *_next_step(state, seen, steps, library)]
    if phase in (Phase.LIFT, Phase.RETREAT, Phase.MOVE):
        return _next_step(state, seen, steps, library)
    return []


def _first(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable], start: float) -> list[NextGoal]:
    """Return where a task that is yet to begin goes first, by what is seen now."""
    if step.kind == "reach":
        return [NextGoal(step.goal, 0.0, start)]
    if step.kind != "pick" or not lies_still(seen, step, NEVER):
        return []
    grasp = grasp_now(state, seen, step, library)
    return [] if grasp is None else [NextGoal(before_grasp(grasp), 0.0, start)]


def _next_step(state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable]) -> list[NextGoal]:
    """Return where the step after this one goes first, where that is known: to a place, or to a goal of its own."""
    if state.step + 1 >= len(steps):
        return []
    step = steps[state.step + 1]
    pause = TUNING.settled if state.phase is Phase.MOVE else -SOONER
    if step.kind == "reach":
        return [NextGoal(step.goal, pause)]
    if step.kind != "place":
        return []
    if state.hand.held == NOTHING:
        X_TO: Array = compose(inverse(state.grasp), seen.tracks[step.target].pose)
        state = replace(state, hand=Hand(step.target, X_TO=X_TO))
    return [NextGoal(above_place(state, step, library, seen.X_WT), pause)]
