"""How what is held is put down: carry above its place, lower, open, retreat. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin_diagram.planning.tasks.picking import before_grasp
from twin_diagram.planning.tasks.step_ends import TUNING, arrived, done, passed
from twin_diagram.planning.tasks.step_state import Note, Phase, Step, TaskState
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.signals import rotations
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.pose_vectors import compose, inverse, moved


def carrying(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Set off to above the place; what looks the same whichever way it is turned is not turned."""
    goal = moved(step.goal, np.array([0.0, 0.0, TUNING.drop]))
    if library[step.target].symmetric:
        goal[:4] = rotations.fold_about_z(goal[:4], compose(seen.X_WT, state.hand.X_TO)[:4])
    last = compose(goal, inverse(state.hand.X_TO))
    state = replace(state, grasp=last)
    return state.entering(Phase.CARRY, seen.now, moved(last, np.array([0.0, 0.0, TUNING.raised])))


def carry(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go to above the place."""
    if not passed(state, seen, step):
        return state
    hand = replace(state.hand, on_support=True)
    return replace(state, hand=hand).entering(Phase.LOWER, seen.now, state.grasp)


def lower(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go down to the place, and let go there."""
    state, there = arrived(state, seen, step)
    if not there:
        return state
    state = replace(state, hand=Hand(touched=step.target), opened=1.0).noting(Note.RELEASED, seen.now)
    return state.entering(Phase.OPEN, seen.now, state.goal)


def opened(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Wait until the fingers are open."""
    if seen.now - state.since < TUNING.closing or seen.opening < 0.9 * seen.widest:
        return state
    return state.entering(Phase.RETREAT, seen.now, before_grasp(state.grasp))


def retreat(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go back up; from there on the object is an obstacle again."""
    if seen.X_WT[6] < state.grasp[6] + TUNING.away:
        return state
    return done(replace(state, hand=Hand()), seen.now)
