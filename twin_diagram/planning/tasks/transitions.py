"""What to do next: from what is remembered and what is seen to what is remembered then. Pure functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twin_diagram.planning.tasks.grasp_from_above import centred, grasps_from_above
from twin_diagram.planning.tasks.step_state import Note, Outcome, Phase, Step, TaskState, Why
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import NEVER, ObjectStatus, PoseMeasurement, Track
from twin_diagram.signals.pose_vectors import compose, errors, inverse, moved


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    above: float = 0.10
    """The tool comes to above a grasp, lifts, lowers and retreats by this much [m]: the length of the fingers and
    some room."""

    passing: float = 0.015
    """Points on the way count as reached within this [m] …"""

    passing_speed: float = 0.08
    """… at less than this [m/s]."""

    still: float = 0.01
    """A tool slower than this is at rest [m/s]."""

    settled: float = 0.10
    """So long must the end of a phase last [s]."""

    late: float = 1.0
    """A tool that rests within twice its tolerances for so long has arrived as well as it can [s]."""

    fingers_still: float = 0.002
    """Fingers slower than this are at rest [m/s]."""

    closing: float = 0.4
    """Fingers are given at least so long to close or open [s]."""

    empty: float = 0.003
    """Fingers that are open by less than this hold nothing [m]."""

    finger_error: float = 0.001
    """How well closed fingers tell where the middle of what they hold is [m]."""

    clear: float = 0.03
    """Lifted by this much an object touches its support no more [m]."""

    drop: float = 0.002
    """What is put down is let go this far above its place [m]: it is not pressed into the table."""

    patience: float = 3.5
    """A goal that no joint positions reach is given up after this [s]: joint goals are drawn anew every 2 s."""

    lost: float = 2.0
    """What is followed may be out of sight for so long [s]."""

    vague: float = 0.02
    """An object whose place is known no better than this is not taken [m]."""

    elsewhere: float = 0.06
    """What is seen so far from where the hand should hold it is not in the hand [m] …"""

    images: int = 4
    """… when so many images running say so."""

    follow_step: float = 0.002
    """A followed goal moves when it is off by more than this [m]: each move costs a search for joint goals …"""

    follow_turn: float = 0.02
    """… or this [rad]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Known:
    """An object of the library, as far as taking it goes."""

    pieces: tuple[Array, ...]
    symmetric: bool

    @property
    def radius(self) -> float:
        """Of the upright cylinder about the object's z axis that holds it [m]."""
        return float(np.linalg.norm(np.concatenate(self.pieces)[:, :2], axis=1).max())


@dataclass(frozen=True)
class Seen:
    """What is known now.

    Attributes:
        now: [s].
        X_WT: (7) the tool.
        speed: of its origin [m/s].
        tracks: of the library's objects.
        measured: of the newest image, one for each of the library's objects.
        opening: between the fingers [m].
        finger_speed: of the fastest finger [m/s].
        widest: the fingers' greatest opening [m].
        reach: number of joint positions that reach the goal; `NEVER` where the planner has none.
    """

    now: float
    X_WT: Array
    speed: float
    tracks: Sequence[Track]
    measured: Sequence[PoseMeasurement]
    opening: float
    finger_speed: float
    widest: float
    reach: float


def advance(state: TaskState, seen: Seen, steps: Sequence[Step], library: Sequence[Known]) -> TaskState:
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
    state, lost = _watch_hand(state, seen)
    if lost is not Why.NONE:
        if state.phase is Phase.LIFT:
            return _again(state, seen, step, lost)
        return _fail(state, seen, lost)
    if seen.now - state.begun > step.time_limit:
        return _fail(state, seen, _late(state, seen, step))
    if state.goal.any() and seen.reach == 0.0 and seen.now - state.since > TUNING.patience:
        if state.phase is Phase.APPROACH:
            return _again(state, seen, step, Why.OUT_OF_REACH)
        return _fail(state, seen, Why.OUT_OF_REACH)
    after = _PHASES[state.phase](state, seen, step, library)
    return _begin(after, seen, steps, library) if after.phase is Phase.START else after


def _begin(state: TaskState, seen: Seen, steps: Sequence[Step], library: Sequence[Known]) -> TaskState:
    """Begin the present step, or come to rest where there is none."""
    if state.step >= len(steps):
        return replace(state.entering(Phase.REST, seen.now), outcome=Outcome.DONE)
    step, now = steps[state.step], seen.now
    state = replace(state, begun=now, attempt=0).noting(Note.STARTED, now)
    if step.kind == "reach":
        return state.entering(Phase.MOVE, now, step.goal)
    if step.kind == "follow":
        return state.entering(Phase.WAIT, now)
    if step.kind == "hold":
        return state.entering(Phase.HOLD, now)
    if step.kind == "pick":
        return _looking(state, now, step)
    return _carrying(state, seen, step, library)


def _done(state: TaskState, now: float) -> TaskState:
    """Go on to the next step; what called this begins it."""
    state = state.noting(Note.DONE, now)
    return replace(state, step=state.step + 1, phase=Phase.START, why=Why.NONE)


def _fail(state: TaskState, seen: Seen, why: Why) -> TaskState:
    """Come to rest for good; what is held stays held, unless that is what was lost."""
    hand = Hand() if why in (Why.DROPPED, Why.SEEN_ELSEWHERE) else replace(state.hand, touched=NOTHING)
    state = state.noting(Note.FAILED, seen.now, why).entering(Phase.REST, seen.now)
    return replace(state, outcome=Outcome.FAILED, why=why, hand=hand)


def _again(state: TaskState, seen: Seen, step: Step, why: Why) -> TaskState:
    """Try a pick once more, or give up."""
    state = replace(state, attempt=state.attempt + 1, hand=Hand(), why=why)
    if state.attempt >= step.tries:
        return _fail(state, seen, why)
    return _looking(state.noting(Note.TRIED_AGAIN, seen.now, why), seen.now, step)


def _late(state: TaskState, seen: Seen, step: Step) -> Why:
    """Say why a step came to its time limit."""
    if state.phase is Phase.LOOK:
        return Why.NOT_SEEN if seen.tracks[step.target].status == ObjectStatus.UNSEEN else Why.TARGET_LOST
    return Why.TARGET_LOST if state.phase is Phase.WAIT else Why.TIME_LIMIT


def _watch_hand(state: TaskState, seen: Seen) -> tuple[TaskState, Why]:
    """Look whether what is held is still there."""
    k = state.hand.held
    if k == NOTHING:
        return state, Why.NONE
    if seen.opening < TUNING.empty:
        return state, Why.DROPPED
    measurement = seen.measured[k]
    if not (measurement.quality > 0.0 and measurement.time > state.image):
        return state, Why.NONE
    off = float(np.linalg.norm(measurement.pose[4:] - compose(seen.X_WT, state.hand.X_TO)[4:]))
    doubt = 3.0 * float(np.sqrt(max(0.0, np.linalg.eigvalsh(measurement.covariance[3:, 3:])[-1])))
    count = state.elsewhere + 1 if off > TUNING.elsewhere + doubt else 0
    why = Why.SEEN_ELSEWHERE if count >= TUNING.images else Why.NONE
    return replace(state, elsewhere=count, image=measurement.time), why


def _steady(state: TaskState, seen: Seen, good: bool, lasting: float = TUNING.settled) -> tuple[TaskState, bool]:
    """Return the state with `steady` kept, and whether something good has lasted for so long [s]."""
    if not good:
        return replace(state, steady=NEVER), False
    since = state.steady if state.steady >= 0.0 else seen.now
    return replace(state, steady=since), seen.now - since >= lasting - 1e-9


def _arrived(state: TaskState, seen: Seen, step: Step) -> tuple[TaskState, bool]:
    """Tell whether the tool rests at its goal, or near it for long."""
    off, angle = errors(seen.X_WT, state.goal)
    times = max(off / step.position_tolerance, angle / step.rotation_tolerance)
    state, steady = _steady(state, seen, seen.speed < TUNING.still and times < 2.0)
    return state, steady and (times < 1.0 or seen.now - state.steady >= TUNING.late)


def _passed(state: TaskState, seen: Seen, step: Step) -> bool:
    """Tell whether the tool is near enough to a goal that is a point on its way."""
    off, angle = errors(seen.X_WT, state.goal)
    near = max(TUNING.passing, step.position_tolerance), max(2.0 * step.rotation_tolerance, 0.1)
    return off < near[0] and angle < near[1] and seen.speed < TUNING.passing_speed


def _move(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    state, there = _arrived(state, seen, step)
    return _done(state, seen.now) if there else state


def _hold(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    return _done(state, seen.now) if seen.now - state.begun >= step.seconds - 1e-9 else state


def _in_sight(track: Track) -> bool:
    return track.status in (ObjectStatus.TRACKED, ObjectStatus.MOVING)


def _wait(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    """Rest until what is to be followed is seen, but not for ever once it was."""
    track = seen.tracks[step.target]
    if _in_sight(track):
        if state.why is Why.TARGET_LOST:
            state = replace(state.noting(Note.RESUMED, seen.now), why=Why.NONE)
        return state.entering(Phase.FOLLOW, seen.now, compose(track.pose, step.goal))
    if state.why is Why.TARGET_LOST and seen.now - state.since > TUNING.lost:
        return _fail(state, seen, Why.TARGET_LOST)
    return state


def _follow(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    track = seen.tracks[step.target]
    if not _in_sight(track):
        return replace(state.noting(Note.WAITS, seen.now, Why.TARGET_LOST), why=Why.TARGET_LOST).entering(
            Phase.WAIT, seen.now
        )
    if seen.now - state.begun >= step.seconds - 1e-9:
        return _done(state, seen.now)
    goal = compose(track.pose, step.goal)
    off, angle = errors(state.goal, goal)
    return replace(state, goal=goal) if off > TUNING.follow_step or angle > TUNING.follow_turn else state


# Pick.


def _looking(state: TaskState, now: float, step: Step) -> TaskState:
    return replace(state, opened=1.0, force=step.force).entering(Phase.LOOK, now)


def _grasp(state: TaskState, seen: Seen, step: Step, library: Sequence[Known], near: Array) -> Array | None:
    """Return where to take the object (7): as told, or from above; None where it is too wide."""
    track, known = seen.tracks[step.target], library[step.target]
    if step.goal.any():
        return compose(track.pose, step.goal)
    there = (ObjectStatus.UNSEEN, ObjectStatus.GONE)
    others = [
        [*other.pose[4:6], library[k].radius]
        for k, other in enumerate(seen.tracks)
        if k != step.target and other.status not in there
    ]
    rows = np.array(others).reshape(-1, 3)
    found = grasps_from_above(known.pieces, track.pose, seen.widest, near, rows, symmetric=known.symmetric)
    return found[min(state.attempt, len(found) - 1)] if len(found) else None


def _look(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    track = seen.tracks[step.target]
    vague = np.sqrt(max(0.0, np.linalg.eigvalsh(track.covariance[3:, 3:])[-1])) > TUNING.vague
    if track.status != ObjectStatus.TRACKED or vague or track.last_seen < min(state.since, seen.now - TUNING.settled):
        return state
    if seen.opening < 0.9 * seen.widest:
        return state  # the fingers have to open first
    grasp = _grasp(state, seen, step, library, seen.X_WT[:4])
    if grasp is None:
        return _fail(state, seen, Why.TOO_WIDE)
    return replace(state, grasp=grasp).entering(Phase.APPROACH, seen.now, _before(grasp))


def _before(X_WG: Array) -> Array:
    """Return the pose (7) from which a grasp is approached."""
    return moved(X_WG, -TUNING.above * rotations.matrix(X_WG[:4])[:, 2])


def _approach(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    track = seen.tracks[step.target]
    if track.status in (ObjectStatus.UNSEEN, ObjectStatus.GONE, ObjectStatus.LOST):
        return _again(state, seen, step, Why.TARGET_LOST)
    if not _passed(state, seen, step):
        return state
    # The object is taken where it is now, with the hand turned as it is.
    fresh = _grasp(replace(state, attempt=0), seen, step, library, state.grasp[:4])
    if fresh is not None and errors(fresh, state.grasp)[1] < 4 * TUNING.follow_turn:
        state = replace(state, grasp=fresh)
    state = replace(state, hand=Hand(touched=step.target))
    return state.entering(Phase.DESCEND, seen.now, state.grasp)


def _descend(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    state, there = _arrived(state, seen, step)
    if not there:
        return state
    return replace(state, opened=0.0).entering(Phase.CLOSE, seen.now, state.goal)


def _close(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    """Close; what stops the fingers is held, where perception saw it and the fingers put it."""
    state, still = _steady(state, seen, seen.finger_speed < TUNING.fingers_still)
    if not still or seen.now - state.since < TUNING.closing:
        return state
    if seen.opening < TUNING.empty:
        return _again(state, seen, step, Why.MISSED)
    track = seen.tracks[step.target]
    R_TW = np.kron(np.eye(2), rotations.matrix(seen.X_WT[:4]).T)
    X_TO, covariance = centred(
        compose(inverse(seen.X_WT), track.pose),
        R_TW @ track.covariance @ R_TW.T,
        library[step.target].pieces,
        TUNING.finger_error,
    )
    hand = Hand(step.target, NOTHING, True, X_TO, covariance)
    state = replace(state, hand=hand, elsewhere=0, image=track.last_seen).noting(Note.GRASPED, seen.now)
    return state.entering(Phase.LIFT, seen.now, moved(state.grasp, np.array([0.0, 0.0, TUNING.above])))


def _lift(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    if state.hand.on_support and seen.X_WT[6] > state.grasp[6] + TUNING.clear:
        state = replace(state, hand=replace(state.hand, on_support=False))
    # Once it is up, where it goes sideways is no matter of this step.
    up = seen.X_WT[6] > state.grasp[6] + TUNING.above - TUNING.passing
    return _done(state, seen.now) if up else state


# Place.


def _carrying(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    """Set off to above the place; what looks the same whichever way it is turned is not turned."""
    goal = moved(step.goal, np.array([0.0, 0.0, TUNING.drop]))
    if library[step.target].symmetric:
        goal[:4] = rotations.fold_about_z(goal[:4], compose(seen.X_WT, state.hand.X_TO)[:4])
    last = compose(goal, inverse(state.hand.X_TO))
    state = replace(state, grasp=last)
    return state.entering(Phase.CARRY, seen.now, moved(last, np.array([0.0, 0.0, TUNING.above])))


def _carry(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    if not _passed(state, seen, step):
        return state
    hand = replace(state.hand, on_support=True)
    return replace(state, hand=hand).entering(Phase.LOWER, seen.now, state.grasp)


def _lower(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    state, there = _arrived(state, seen, step)
    if not there:
        return state
    state = replace(state, hand=Hand(touched=step.target), opened=1.0).noting(Note.RELEASED, seen.now)
    return state.entering(Phase.OPEN, seen.now, state.goal)


def _open(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    if seen.now - state.since < TUNING.closing or seen.opening < 0.9 * seen.widest:
        return state
    return state.entering(Phase.RETREAT, seen.now, _before(state.grasp))


def _retreat(state: TaskState, seen: Seen, step: Step, library: Sequence[Known]) -> TaskState:
    if not _passed(state, seen, step):
        return state
    return _done(replace(state, hand=Hand()), seen.now)


_PHASES: Final[dict[Phase, Callable[[TaskState, Seen, Step, Sequence[Known]], TaskState]]] = {
    Phase.MOVE: _move,
    Phase.FOLLOW: _follow,
    Phase.WAIT: _wait,
    Phase.HOLD: _hold,
    Phase.LOOK: _look,
    Phase.APPROACH: _approach,
    Phase.DESCEND: _descend,
    Phase.CLOSE: _close,
    Phase.LIFT: _lift,
    Phase.CARRY: _carry,
    Phase.LOWER: _lower,
    Phase.OPEN: _open,
    Phase.RETREAT: _retreat,
}
"""What each phase does in a tick."""
