"""What to do next: from what is remembered and what is seen to what is remembered then. Pure functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from twin_diagram.planning.tasks import picking, placing
from twin_diagram.planning.tasks.step_ends import TUNING, arrived, done, fail, in_sight
from twin_diagram.planning.tasks.step_state import Note, Phase, Step, TaskOutcome, TaskState, Why
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.planning.tasks.watching_hand import watched
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.pose_vectors import compose, errors


def advance(state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable]) -> TaskState:
    """Return the state after a tick.

    Args:
        state: before.
        seen: now.
        steps: of the task.
        library: the known objects, in the order of the tracks.
    """
    if state.phase is Phase.REST:
        return state
    if state.phase is Phase.START:
        return _begin(state, seen, steps, library)
    step = steps[state.step]
    lost = Why.NONE
    if state.hand.held != NOTHING:
        state, lost = watched(state, seen, library[state.hand.held])
    if lost is not Why.NONE:
        if state.phase is Phase.LIFT:
            return picking.again(state, seen, step, lost)
        return fail(state, seen, lost)
    if seen.now - state.begun > step.time_limit:
        return fail(state, seen, _late(state, seen, step))
    if state.goal.any() and seen.reach == 0.0 and seen.now - state.since > TUNING.patience:
        if state.phase is Phase.APPROACH:
            other = picking.another_grasp(state, seen, step, library, Why.OUT_OF_REACH)
            return other or picking.again(state, seen, step, Why.OUT_OF_REACH)
        return fail(state, seen, Why.OUT_OF_REACH)
    after = _PHASES[state.phase](state, seen, step, library)
    return _begin(after, seen, steps, library) if after.phase is Phase.START else after


def _begin(state: TaskState, seen: StepView, steps: Sequence[Step], library: Sequence[Takeable]) -> TaskState:
    """Begin the present step, or come to rest where there is none."""
    if state.step >= len(steps):
        return replace(state.entering(Phase.REST, seen.now), outcome=TaskOutcome.DONE)
    step, now = steps[state.step], seen.now
    state = replace(state, begun=now, attempt=0, others=0).noting(Note.STARTED, now)
    if step.kind == "reach":
        return state.entering(Phase.MOVE, now, step.goal)
    if step.kind == "follow":
        return state.entering(Phase.WAIT, now)
    if step.kind == "hold":
        return state.entering(Phase.HOLD, now)
    if step.kind == "pick":
        return picking.looking(state, now, step)
    return placing.carrying(state, seen, step, library)


def _late(state: TaskState, seen: StepView, step: Step) -> Why:
    """Say why a step came to its time limit."""
    if state.phase is Phase.LOOK:
        return Why.NOT_SEEN if seen.tracks[step.target].status == ObjectStatus.UNSEEN else Why.TARGET_LOST
    if state.phase is Phase.CARRY and not placing.rests(seen, step):
        return Why.NO_SUPPORT
    return Why.TARGET_LOST if state.phase is Phase.WAIT else Why.TIME_LIMIT


def _move(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    state, there = arrived(state, seen, step)
    return done(state, seen.now) if there else state


def _hold(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    return done(state, seen.now) if seen.now - state.begun >= step.seconds - 1e-9 else state


def _wait(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Rest until what is to be followed is seen, but not for ever once it was."""
    track = seen.tracks[step.target]
    if in_sight(track):
        if state.why is Why.TARGET_LOST:
            state = replace(state.noting(Note.RESUMED, seen.now), why=Why.NONE)
        return state.entering(Phase.FOLLOW, seen.now, compose(track.pose, step.goal))
    if state.why is Why.TARGET_LOST and seen.now - state.since > TUNING.lost:
        return fail(state, seen, Why.TARGET_LOST)
    return state


def _follow(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    track = seen.tracks[step.target]
    if not in_sight(track):
        return replace(state.noting(Note.WAITS, seen.now, Why.TARGET_LOST), why=Why.TARGET_LOST).entering(
            Phase.WAIT, seen.now
        )
    if seen.now - state.begun >= step.seconds - 1e-9:
        return done(state, seen.now)
    goal = compose(track.pose, step.goal)
    off, angle = errors(state.goal, goal)
    return replace(state, goal=goal) if off > TUNING.follow_step or angle > TUNING.follow_turn else state


_PHASES: Final[dict[Phase, Callable[[TaskState, StepView, Step, Sequence[Takeable]], TaskState]]] = {
    Phase.MOVE: _move,
    Phase.FOLLOW: _follow,
    Phase.WAIT: _wait,
    Phase.HOLD: _hold,
    Phase.LOOK: picking.look,
    Phase.APPROACH: picking.approach,
    Phase.DESCEND: picking.descend,
    Phase.CLOSE: picking.close,
    Phase.LIFT: picking.lift,
    Phase.CARRY: placing.carry,
    Phase.LOWER: placing.lower,
    Phase.OPEN: placing.opened,
    Phase.RETREAT: placing.retreat,
}
"""What each phase does in a tick."""
