"""How what is held is put down: carry above its place, lower, open, retreat. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twin_diagram.planning.tasks.bearing import bears, place_now
from twin_diagram.planning.tasks.picking import before_grasp
from twin_diagram.planning.tasks.step_ends import TUNING, arrived, done, fail, passed
from twin_diagram.planning.tasks.step_state import Note, Phase, Step, TaskState, Why
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.planning.tasks.watching_hand import put_down
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import POSE_SIZE, ObjectStatus
from twin_diagram.signals.pose_vectors import compose, errors, inverse, moved

RAISED: Final = np.array([0.0, 0.0, TUNING.raised])
"""From where a thing is let go to above that [m]."""


def carrying(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Set off to above the place; where that is not known yet, rest until it is."""
    last = _last(state, seen, step, library, seen.X_WT)
    if last is None:
        return state.entering(Phase.CARRY, seen.now)
    if not _borne(state, seen, step, library):
        return fail(state, seen, Why.NO_STAND)
    state = replace(state, grasp=last)
    return state.entering(Phase.CARRY, seen.now, moved(last, RAISED))


def above_place(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> Array:
    """Return where what is held is carried to (7), above its place; zeros: that is not known."""
    last = _last(state, seen, step, library, seen.X_WT)
    return np.zeros(POSE_SIZE) if last is None else moved(last, RAISED)


def _last(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable], near: Array) -> Array | None:
    """Return where the tool is to let go (7), turned as at `near` (7) where the object looks the same all around.

    None where what is to bear it is not seen.
    """
    goal = place_now(state, seen, step, library)
    if goal is None:
        return None
    if library[step.target].symmetric:
        goal[:4] = rotations.fold_about_z(goal[:4], compose(near, state.hand.X_TO)[:4])
    last = compose(goal, inverse(state.hand.X_TO))
    up_T = rotations.matrix(last[:4])[2]
    variance = up_T @ state.hand.covariance[3:, 3:] @ up_T
    if step.support != NOTHING:
        variance += seen.tracks[step.support].covariance[5, 5]
    doubt = TUNING.drop_sigmas * float(np.sqrt(max(0.0, variance)))
    return moved(last, np.array([0.0, 0.0, TUNING.drop + min(doubt, TUNING.drop_doubt)]))


def _borne(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> bool:
    """Tell whether an object stands where it is to be put upon another, as that lies now."""
    X_WO = place_now(state, seen, step, library)
    if step.support == NOTHING or X_WO is None:
        return True
    above, below = library[step.target].pieces, library[step.support].pieces
    return bears(above, X_WO, below, seen.tracks[step.support].pose, step.position_tolerance)


def _as_it_lies(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable], above: Array) -> TaskState:
    """Return the state with the goal, `above` (3) where to let go, as the object, and what bears it, lie by now."""
    last = _last(state, seen, step, library, state.grasp)
    if last is None:
        return state
    off, angle = errors(state.grasp, last)
    if off < TUNING.told_step and angle < TUNING.told_turn:
        return state
    return replace(state, grasp=last, goal=moved(last, above))


def carry(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go to above the place; further down only where what is to bear the object rests, and does bear it."""
    if not state.goal.any():
        return carrying(state, seen, step, library)
    state = _as_it_lies(state, seen, step, library, RAISED)
    if not passed(state, seen, step) or not rests(seen, step):
        return state
    if not _borne(state, seen, step, library):
        return fail(state, seen, Why.NO_STAND)
    hand = replace(state.hand, on_support=True, X_TO=state.lies.X_TO, covariance=state.lies.pose_covariance)
    state = replace(state, hand=replace(hand, support=step.support))
    last = _last(state, seen, step, library, state.grasp)
    assert last is not None
    return replace(state, grasp=last).entering(Phase.LOWER, seen.now, last)


def rests(seen: StepView, step: Step) -> bool:
    """Tell whether what is to bear an object is known to stand still, well enough to put it there."""
    if step.support == NOTHING:
        return True
    track = seen.tracks[step.support]
    known = track.status in (ObjectStatus.TRACKED, ObjectStatus.STALE)
    return known and float(np.linalg.eigvalsh(track.covariance[3:, 3:])[-1]) < TUNING.vague**2


def lower(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go down to the place, and let go there."""
    state = _as_it_lies(state, seen, step, library, np.zeros(3))
    state, there = arrived(state, seen, step, TUNING.slow)
    if not there:
        return state
    hand = Hand(touched=step.target, around=True, since=state.hand.since)
    state = replace(state, hand=hand, opened=1.0, image=seen.now, elsewhere=0)
    state = state.noting(Note.RELEASED, seen.now)
    # Where it is: pushed aside by what comes near, it would go back to its place with the fingers half open.
    return state.entering(Phase.OPEN, seen.now)


def opened(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Wait until the fingers are open."""
    state = put_down(state, seen, step, library)
    if seen.now - state.since < TUNING.closing or seen.opening < 0.9 * seen.widest:
        return state
    return state.entering(Phase.RETREAT, seen.now, before_grasp(seen.X_WT))


def retreat(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go back up; from there on the object is an obstacle again, where it stands or where it has gone."""
    state = put_down(state, seen, step, library)
    if seen.X_WT[6] < state.grasp[6] + TUNING.away:
        return state
    if state.elsewhere >= TUNING.images:
        return fail(replace(state, hand=Hand()), seen, Why.NOT_WHERE_PUT)
    return done(replace(state, hand=Hand()), seen.now)
