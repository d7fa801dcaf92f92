"""Where a task goes after the goal that it has, where there may be something in the way. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_diagram.planning.tasks.placing import above_place
from twin_diagram.planning.tasks.step_state import Phase, Step, TaskState
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.layouts import POSE_SIZE


def goal_after(state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable]) -> Array:
    """Return where the step after this one goes first (7): to a place, or to a goal of its own; zeros: not known.

    Within a step the arm goes straight, so nobody asks beforehand.

    Args:
        state: after a tick.
        seen: then.
        steps: of the task.
        library: the known objects, in the order of the tracks.
    """
    ends = state.phase in (Phase.LIFT, Phase.RETREAT, Phase.MOVE)
    if ends and state.step + 1 < len(steps):
        step = steps[state.step + 1]
        if step.kind == "reach":
            return step.goal
        if step.kind == "place" and state.hand.held != NOTHING:
            return above_place(state, seen, step, library)
    return np.zeros(POSE_SIZE)
