"""How what is held is put down: carry above its place, lower, open, retreat. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twin_diagram.planning.tasks.picking import before_grasp
from twin_diagram.planning.tasks.step_ends import TUNING, arrived, done, fail, passed
from twin_diagram.planning.tasks.step_state import Note, Phase, Step, TaskState, Why
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.planning.tasks.watching_hand import put_down
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.pose_vectors import compose, errors, inverse, moved

RAISED: Final = np.array([0.0, 0.0, TUNING.raised])
"""From where a thing is let go to above that [m]."""


def carrying(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Set off to above the place."""
    last = _last(state, step, library, seen.X_WT)
    state = replace(state, grasp=last)
    return state.entering(Phase.CARRY, seen.now, moved(last, RAISED))


def above_place(state: TaskState, step: Step, library: Sequence[Takeable], near: Array) -> Array:
    """Return where what is held is carried to (7), above its place, turned as at `near` (7) where that is free."""
    return moved(_last(state, step, library, near), RAISED)


def _last(state: TaskState, step: Step, library: Sequence[Takeable], near: Array) -> Array:
    """Return where the tool is to let go (7), turned as at `near` (7) where the object looks the same all around."""
    goal = step.goal.copy()
    if library[step.target].symmetric:
        goal[:4] = rotations.fold_about_z(goal[:4], compose(near, state.hand.X_TO)[:4])
    last = compose(goal, inverse(state.hand.X_TO))
    up_T = rotations.matrix(last[:4])[2]
    doubt = TUNING.drop_sigmas * float(np.sqrt(max(0.0, up_T @ state.hand.covariance[3:, 3:] @ up_T)))
    return moved(last, np.array([0.0, 0.0, TUNING.drop + min(doubt, TUNING.drop_doubt)]))


def _as_it_lies(state: TaskState, step: Step, library: Sequence[Takeable], above: Array) -> TaskState:
    """Return the state with the goal, `above` (3) where to let go, as the object lies in the hand by now."""
    last = _last(state, step, library, state.grasp)
    off, angle = errors(state.grasp, last)
    if off < TUNING.told_step and angle < TUNING.told_turn:
        return state
    return replace(state, grasp=last, goal=moved(last, above))


def carry(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go to above the place."""
    state = _as_it_lies(state, step, library, RAISED)
    if not passed(state, seen, step):
        return state
    hand = replace(state.hand, on_support=True, X_TO=state.lies.X_TO, covariance=state.lies.pose_covariance)
    state = replace(state, hand=hand)
    last = _last(state, step, library, state.grasp)
    return replace(state, grasp=last).entering(Phase.LOWER, seen.now, last)


def lower(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go down to the place, and let go there."""
    state = _as_it_lies(state, step, library, np.zeros(3))
    state, there = arrived(state, seen, step, TUNING.slow)
    if not there:
        return state
    state = replace(state, hand=Hand(touched=step.target, around=True), opened=1.0, image=seen.now, elsewhere=0)
    state = state.noting(Note.RELEASED, seen.now)
    # Where it is: pushed aside by what comes near, it would go back to its place with the fingers half open.
    return state.entering(Phase.OPEN, seen.now)


def opened(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Wait until the fingers are open."""
    state = put_down(state, seen, step)
    if seen.now - state.since < TUNING.closing or seen.opening < 0.9 * seen.widest:
        return state
    return state.entering(Phase.RETREAT, seen.now, before_grasp(seen.X_WT))


def retreat(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go back up; from there on the object is an obstacle again, where it stands or where it has gone."""
    state = put_down(state, seen, step)
    if seen.X_WT[6] < state.grasp[6] + TUNING.away:
        return state
    if state.elsewhere >= TUNING.images:
        return fail(replace(state, hand=Hand()), seen, Why.NOT_WHERE_PUT)
    return done(replace(state, hand=Hand()), seen.now)
