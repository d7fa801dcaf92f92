"""Where a task goes after the goal that it has, where there may be something in the way. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin_diagram.planning.tasks import picking
from twin_diagram.planning.tasks.placing import above_place
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import After, Phase, Step, TaskState
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.signals.hand import NOTHING


def before_task(
    state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable], begins: float
) -> TaskState:
    """Return the state with where a task goes first that has not begun, as the newest image shows it.

    Args:
        state: before.
        seen: now.
        steps: of the task.
        library: the known objects, in the order of the tracks.
        begins: in how long the task does [s].
    """
    step = steps[state.step]
    if step.kind == "reach":
        return replace(state, after=After(step.goal, pause=begins))
    if step.kind != "pick":
        return state
    image = seen.tracks[step.target].last_seen
    if image <= state.image:
        return replace(state, after=replace(state.after, pause=begins))
    return replace(state, image=image, after=After(picking.first_goal(state, seen, step, library), pause=begins))


def goal_after(state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable]) -> After:
    """Return where the step after this one goes first: to a place, or to a goal of its own.

    Within a step the arm goes straight, so nobody asks beforehand: once its fingers have closed on what it takes, it
    goes to the place with it.

    Args:
        state: after a tick.
        seen: then.
        steps: of the task.
        library: the known objects, in the order of the tracks.
    """
    if state.step + 1 >= len(steps):
        return After()
    step = steps[state.step + 1]
    if state.phase in (Phase.DESCEND, Phase.CLOSE):
        waits = TUNING.closing + (state.since - seen.now if state.phase is Phase.CLOSE else TUNING.settled)
        once = state.after if state.after.goal.any() else _with_what_is_taken(state, seen, steps, library)
        return replace(once, pause=max(waits, 0.0))
    if state.phase in (Phase.LIFT, Phase.RETREAT, Phase.MOVE):
        # What it lifts off its support it will have lifted.
        hand = replace(state.hand, on_support=False, touched=NOTHING, support=NOTHING, around=False)
        if step.kind == "reach":
            return After(step.goal, hand)
        if step.kind == "place" and state.hand.held != NOTHING:
            return After(above_place(state, seen, step, library), hand)
    return After()


def _with_what_is_taken(state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable]) -> After:
    """Return where the next step goes first with what the present one is about to take."""
    step = steps[state.step + 1]
    if step.kind != "place":
        return After()
    hand, _ = picking.closed_on(state.grasp, seen, steps[state.step], library, state.hand.since)
    then = replace(state, hand=hand, stood=seen.tracks[step.target].pose[:4].copy())
    return After(above_place(then, replace(seen, X_WT=state.grasp), step, library), hand)
