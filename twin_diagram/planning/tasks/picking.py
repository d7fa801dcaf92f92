"""How an object is picked up: look, approach from above, descend, close, lift. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin_diagram.planning.collision.held_shape import TUNING as HELD_SHAPE
from twin_diagram.planning.tasks.bearing import bearer
from twin_diagram.planning.tasks.grasp_choice import TUNING as GRASP_CHOICE
from twin_diagram.planning.tasks.grasp_choice import between_fingers, choices
from twin_diagram.planning.tasks.grasp_from_above import TUNING as FROM_ABOVE
from twin_diagram.planning.tasks.grasp_from_above import centred, reached
from twin_diagram.planning.tasks.neighbours import Neighbours
from twin_diagram.planning.tasks.step_ends import TUNING, arrived, done, fail, passed, steady, stuck
from twin_diagram.planning.tasks.step_state import Note, Phase, Step, TaskState, Why
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.planning.tasks.tool_past import no_past
from twin_diagram.planning.tasks.watching_hand import closing_on
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import POSE_SIZE, ObjectStatus, Track
from twin_diagram.signals.pose_vectors import compose, errors, inverse, moved


def looking(state: TaskState, now: float, step: Step) -> TaskState:
    """Return the state at the begin of a try: at rest, fingers opening."""
    return replace(state, opened=1.0, force=step.force).entering(Phase.LOOK, now)


def again(state: TaskState, seen: StepView, step: Step, why: Why) -> TaskState:
    """Try a pick once more, or give up."""
    state = replace(state, attempt=state.attempt + 1, others=0, hand=Hand(), why=why)
    if state.attempt >= step.tries:
        return fail(state, seen, why)
    return looking(state.noting(Note.TRIED_AGAIN, seen.now, why), seen.now, step)


def _grasp(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable], near: Array) -> Array | None:
    """Return where to take the object (7): as told, or the best that is left; None where nothing offers itself."""
    if step.goal.any():
        return compose(seen.tracks[step.target].pose, step.goal)
    found = _offered(seen, step, library, near)
    return found[min(state.attempt, len(found) - 1)] if len(found) else None


def another_grasp(
    state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable], why: Why
) -> TaskState | None:
    """Go for the next grasp, after one to which no way leads; None where there is none.

    Nothing was touched, so it is no further try. After the last comes the first again, for what was in the way may go;
    of those out of reach only a few are gone through.
    """
    most = TUNING.out_of_reach if why is Why.OUT_OF_REACH else np.inf
    if step.goal.any() or state.others + 1 >= most:
        return None
    apart: list[Array] = []
    for each in _offered(seen, step, library, seen.X_WT[:4]):
        if not any(_same(each, other) for other in apart):
            apart.append(each)
    if not apart:  # it has been turned meanwhile, or stands elsewhere
        return None
    grasp = apart[(state.attempt + state.others + 1) % len(apart)]
    if _same(grasp, state.grasp):
        return None
    state = replace(state, others=state.others + 1, grasp=grasp).noting(Note.OTHER_GRASP, seen.now, why)
    return state.entering(Phase.APPROACH, seen.now, before_grasp(grasp))


def _same(X_WG: Array, other: Array) -> bool:
    """Tell whether two grasps (7) are much the same."""
    off, angle = errors(X_WG, other)
    return bool(off < GRASP_CHOICE.same[0] and angle < GRASP_CHOICE.same[1])


def _offered(seen: StepView, step: Step, library: Sequence[Takeable], near: Array) -> Array:
    """Return where the object could be taken (G, 7), the best first."""
    track, known = seen.tracks[step.target], library[step.target]
    # Lower than this no finger comes: what bears it is in none's way.
    tips = _standing(_corners(known, track.pose))[1] + FROM_ABOVE.bottom - FROM_ABOVE.tip
    others = Neighbours.of([points for points in _beside(seen, step, library) if points[:, 2].max() > tips])
    pose, wide = track.pose, seen.widest
    return choices(known.pieces, pose, wide, near, others, known.shape, symmetric=known.symmetric, palm=seen.palm)


def _nearest(X_WG: Array, seen: StepView, step: Step, library: Sequence[Takeable]) -> Array | None:
    """Return the grasp (7) of those offered now that is nearest to one (7) chosen before; as told, where one was."""
    if step.goal.any():
        return compose(seen.tracks[step.target].pose, step.goal)
    found = _offered(seen, step, library, X_WG[:4])
    near, turn = GRASP_CHOICE.same
    return min(found, key=lambda X: sum(np.divide(errors(X, X_WG), (near, turn))), default=None)


def look(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Wait until the object lies still in sight; then choose a grasp."""
    track = seen.tracks[step.target]
    if not _lies_still(track) or track.last_seen < min(state.since, seen.now - TUNING.settled):
        return state
    grasp = _grasp(state, seen, step, library, seen.X_WT[:4])
    if grasp is None:
        return fail(state, seen, Why.TOO_WIDE)
    return replace(state, grasp=grasp).entering(Phase.APPROACH, seen.now, before_grasp(grasp))


def _lies_still(track: Track) -> bool:
    """Tell whether an object is known to lie still, well enough to be taken."""
    vague = np.sqrt(max(0.0, np.linalg.eigvalsh(track.covariance[3:, 3:])[-1])) > TUNING.vague
    return track.status == ObjectStatus.TRACKED and not vague


def first_goal(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> Array:
    """Return from where the object would be taken (7), began the pick now; zeros: that is not known."""
    known = _lies_still(seen.tracks[step.target])
    grasp = _grasp(state, seen, step, library, seen.X_WT[:4]) if known else None
    return np.zeros(POSE_SIZE) if grasp is None else before_grasp(grasp)


def before_grasp(X_WG: Array) -> Array:
    """Return the pose (7) from which a grasp is approached."""
    return moved(X_WG, -TUNING.above * rotations.matrix(X_WG[:4])[:, 2])


def approach(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go to above the grasp, opening; an object that moves is followed, one lost on the way is looked for again."""
    track = seen.tracks[step.target]
    if track.status in (ObjectStatus.UNSEEN, ObjectStatus.GONE, ObjectStatus.LOST):
        return again(state, seen, step, Why.TARGET_LOST)
    if not passed(state, seen, step):
        far = seen.reach == 0.0
        state, stands = steady(state, seen, seen.speed < TUNING.still, TUNING.no_reach if far else TUNING.no_way)
        why = Why.OUT_OF_REACH if far else Why.NO_WAY
        return (another_grasp(state, seen, step, library, why) if stands else None) or state
    if seen.opening < 0.9 * seen.widest:
        return state
    # The object is taken where it is now, with the hand turned as it is.
    fresh = _nearest(state.grasp, seen, step, library)
    if fresh is not None and errors(fresh, state.grasp)[1] < 4 * TUNING.follow_turn:
        state = replace(state, grasp=fresh)
    state = replace(state, hand=Hand(touched=step.target, since=seen.now))
    return state.entering(Phase.DESCEND, seen.now, state.grasp)


def descend(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go down to the grasp, and close there; from no other side, since the hand no longer keeps clear of the object."""
    astray = errors(seen.X_WT, state.grasp)[0] > TUNING.astray
    if astray or stuck(state, seen, step):
        last = state.attempt + 1 >= step.tries
        free = replace(state, hand=Hand())
        other = another_grasp(free, seen, step, library, Why.NO_WAY_DOWN) if last or not astray else None
        return other or again(state, seen, step, Why.NO_WAY_DOWN)
    state, there = arrived(state, seen, step, TUNING.slow)
    if not there:
        return state
    state = replace(state, hand=replace(state.hand, around=True), opened=0.0)
    return state.entering(Phase.CLOSE, seen.now, state.goal)


def close(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Close; what stops the fingers is held, where perception saw it and the fingers put it."""
    state, still = steady(state, seen, seen.finger_speed < TUNING.fingers_still)
    if not still or seen.now - state.since < TUNING.closing:
        return state
    if seen.opening < TUNING.empty:
        return again(state, seen, step, Why.MISSED)
    track = seen.tracks[step.target]
    hand, doubt = closed_on(seen.X_WT, seen, step, library, state.hand.since)
    state = replace(state, hand=hand, elsewhere=0, image=track.last_seen, past=no_past()).noting(Note.GRASPED, seen.now)
    state = replace(state, lies=closing_on(hand.X_TO, doubt, seen), stood=track.pose[:4].copy())
    return state.entering(Phase.LIFT, seen.now, moved(state.grasp, np.array([0.0, 0.0, _rise(seen, step, library)])))


def closed_on(X_WG: Array, seen: StepView, step: Step, library: Sequence[Takeable], since: float) -> tuple[Hand, Array]:
    """Return the hand once it has closed at X_WG (7): what it holds, where perception saw it and the fingers put it.

    It has been about it `since` then [s]. Beside it the covariance (6, 6) of where it lies in the hand as perception
    alone knows it.
    """
    track, known = seen.tracks[step.target], library[step.target]
    R_TW = np.kron(np.eye(2), rotations.matrix(X_WG[:4]).T)
    X_TO = compose(inverse(X_WG), track.pose)
    held = between_fingers(known.shape, X_TO)
    pieces = reached(known.pieces, X_TO) if held is None else (held,)
    doubt = R_TW @ track.covariance @ R_TW.T
    X_TO, covariance = centred(X_TO, doubt, pieces, TUNING.finger_error)
    bears = bearer(seen, step, library)
    return Hand(step.target, NOTHING, True, X_TO, covariance, support=bears, since=since), doubt


def lift(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Go up; off its support the object may not touch it any more."""
    if state.hand.on_support and seen.X_WT[6] > state.grasp[6] + TUNING.clear:
        state = replace(state, hand=replace(state.hand, on_support=False, support=NOTHING))
    # Once it is up, where it goes sideways is no matter of this step.
    up = seen.X_WT[6] > state.goal[6] - TUNING.passing
    return done(state, seen.now) if up else state


def _rise(seen: StepView, step: Step, library: Sequence[Takeable]) -> float:
    """Return how far to lift an object straight up [m]: over all that stands close beside it."""
    own, low, _ = _standing(_corners(library[step.target], seen.tracks[step.target].pose))
    rise = TUNING.raised
    for points in _beside(seen, step, library):
        other, _, high = _standing(points)
        if np.linalg.norm(own[:2] - other[:2]) < own[2] + other[2] + TUNING.beside:
            rise = max(rise, high - low + TUNING.over)
    return rise


def _beside(seen: StepView, step: Step, library: Sequence[Takeable]) -> list[Array]:
    """Return the corners (m, 3) in W of all that stands beside the object [m], in the library or not."""
    there = (ObjectStatus.UNSEEN, ObjectStatus.GONE)
    known = [
        _corners(library[k], track.pose)
        for k, track in enumerate(seen.tracks)
        if k != step.target and track.status not in there
    ]
    own, X_OW = np.concatenate(library[step.target].pieces), inverse(seen.tracks[step.target].pose)
    low, high = own.min(axis=0) - HELD_SHAPE.own, own.max(axis=0) + HELD_SHAPE.own
    for points in seen.beside.corners():
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        p_O = rotations.matrix(X_OW[:4]) @ middle + X_OW[4:]
        # What is seen in its very place is a part of it.
        if not ((low < p_O) & (p_O < high)).all():
            known.append(points)
    return known


def _standing(points: Array) -> tuple[Array, float, float]:
    """Return middle and radius (3,) of the circle about points (m, 3) from above, their lowest and highest z [m]."""
    middle = 0.5 * (points[:, :2].min(axis=0) + points[:, :2].max(axis=0))
    radius = float(np.linalg.norm(points[:, :2] - middle, axis=1).max())
    return np.array([*middle, radius]), float(points[:, 2].min()), float(points[:, 2].max())


def _corners(thing: Takeable, X_WO: Array) -> Array:
    """Return the corners (m, 3) of a thing's pieces in W [m]."""
    corners: Array = np.concatenate(thing.pieces) @ rotations.matrix(X_WO[:4]).T + X_WO[4:]
    return corners
