"""When a phase is at its end, and how a step ends: what all kinds of steps share. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass, replace

from twin_diagram.planning.tasks.step_state import Note, Phase, Step, TaskOutcome, TaskState, Why
from twin_diagram.planning.tasks.step_view import StepView
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import NEVER, ObjectStatus, Track
from twin_diagram.signals.pose_vectors import errors


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    above: float = 0.08
    """The tool comes to above a grasp by this much [m]: the fingers' depth and some room."""

    raised: float = 0.06
    """What is held is lifted and lowered by this much [m]: the planner's clearance, and some room …"""

    beside: float = 0.02
    """… and lifted over what stands nearer to it than this [m]: what the planner keeps of two unsure poses …"""

    over: float = 0.03
    """… by this much [m]: what the planner keeps, and some room."""

    astray: float = 0.14
    """A tool that is this far from the grasp that it goes down to goes some other way [m]: it set out from `above`, and
    what it is to take may have moved a little meanwhile."""

    no_way_down: float = 3.0
    """A hand that rests short of a grasp so long after it set out down to it found no way [s]: it takes one."""

    passing: float = 0.02
    """Points on the way count as reached within this [m] …"""

    passing_speed: float = 0.2
    """… at less than this [m/s]."""

    still: float = 0.02
    """A tool slower than this is at rest [m/s]: fingers that close in 0.1 s then move by less than its tolerance."""

    slow: float = 0.05
    """A tool slower than this may close or open its fingers [m/s]: in the 0.1 s that it takes it moves by half a
    tolerance."""

    settled: float = 0.10
    """So long must the end of a phase last [s]."""

    late: float = 1.0
    """A tool that rests within twice its tolerances for so long has arrived as well as it can [s]."""

    fingers_still: float = 0.002
    """Fingers slower than this are at rest [m/s]."""

    closing: float = 0.25
    """Fingers are given at least so long to close or open [s]: a command takes some 0.05 s to move them."""

    empty: float = 0.0012
    """Fingers that are open by less than this hold nothing [m]: around a mug's wall soft pads leave 2.5 mm."""

    finger_error: float = 0.001
    """How well closed fingers tell where the middle of what they hold is [m]."""

    clear: float = 0.03
    """Lifted by this much an object touches its support no more [m]."""

    away: float = 0.05
    """Risen by this much after release the fingers are off the object [m]: they reach down 0.03 m."""

    drop: float = 0.002
    """What is put down is let go this far above its place [m]: it is not pressed into the table …"""

    drop_sigmas: float = 2.0
    """… and by so many standard deviations of its height in the hand …"""

    drop_doubt: float = 0.003
    """… but for no more than this [m]."""

    patience: float = 3.5
    """A goal that no joint positions reach is given up after this [s]: joint goals are drawn anew every 2 s."""

    no_way: float = 1.5
    """A hand that rests for so long on its way to a grasp has found none, and goes for another grasp [s]: a search is
    answered in a fifth of a second, and made anew after another."""

    no_reach: float = 0.5
    """… or for so long, where a search found no joint positions at it [s]."""

    out_of_reach: int = 8
    """So many grasps that no joint positions reach are gone through before the object counts as out of reach."""

    lost: float = 2.0
    """What is followed may be out of sight for so long [s]."""

    vague: float = 0.02
    """An object whose place is known no better than this is not taken [m]."""

    elsewhere: float = 0.06
    """What is seen so far from where the hand should hold it is not in the hand [m] …"""

    images: int = 4
    """… when so many images running say so."""

    misplaced: float = 0.03
    """What was let go and is seen so far from its place, in as many images, does not stand there [m]: thrice the usual
    tolerance; what topples goes farther."""

    grip: float = 0.015
    """The point between the fingertips is inside what they hold, or so near it [m]: pads are 20 mm wide."""

    fits: float = 0.55
    """An image that fits less of what it should show says nothing of where a thing lies in the hand [1]: before a D435
    a can that was taken for the hand itself fitted by 0.25 to 0.45, what was found right by 0.59 and more."""

    told_step: float = 0.003
    """On the way planner, monitor and goal are told anew where a thing lies in the hand when that is off by more than
    this [m]: each time shapes are made and a way is sought anew …"""

    told_turn: float = 0.035
    """… or this [rad]."""

    follow_step: float = 0.002
    """A followed goal moves when it is off by more than this [m]: each move costs a search for joint goals …"""

    follow_turn: float = 0.02
    """… or this [rad]."""


TUNING = Tuning()


def done(state: TaskState, now: float) -> TaskState:
    """Go on to the next step; what called this begins it."""
    state = state.noting(Note.DONE, now)
    return replace(state, step=state.step + 1, phase=Phase.START, why=Why.NONE)


def fail(state: TaskState, seen: StepView, why: Why) -> TaskState:
    """Come to rest for good; what is held stays held, unless that is what was lost."""
    hand = Hand() if why in (Why.DROPPED, Why.SEEN_ELSEWHERE) else replace(state.hand, touched=NOTHING, around=False)
    state = state.noting(Note.FAILED, seen.now, why).entering(Phase.REST, seen.now)
    return replace(state, outcome=TaskOutcome.FAILED, why=why, hand=hand)


def steady(state: TaskState, seen: StepView, good: bool, lasting: float = TUNING.settled) -> tuple[TaskState, bool]:
    """Return the state with `steady` kept, and whether something good has lasted for so long [s]."""
    if not good:
        return replace(state, steady=NEVER), False
    since = state.steady if state.steady >= 0.0 else seen.now
    return replace(state, steady=since), seen.now - since >= lasting - 1e-9


def arrived(state: TaskState, seen: StepView, step: Step, still: float = TUNING.still) -> tuple[TaskState, bool]:
    """Tell whether the tool rests, slower than `still` [m/s], at its goal, or near it for long."""
    off, angle = errors(seen.X_WT, state.goal)
    times = max(off / step.position_tolerance, angle / step.rotation_tolerance)
    state, rests = steady(state, seen, seen.speed < still and times < 2.0)
    return state, rests and (times < 1.0 or seen.now - state.steady >= TUNING.late)


def stuck(state: TaskState, seen: StepView, step: Step) -> bool:
    """Tell whether the tool rests far from a goal, though it set out long ago."""
    off, angle = errors(seen.X_WT, state.goal)
    far = off > 2.0 * step.position_tolerance or angle > 2.0 * step.rotation_tolerance
    return far and seen.speed < TUNING.still and seen.now - state.since > TUNING.no_way_down


def passed(state: TaskState, seen: StepView, step: Step) -> bool:
    """Tell whether the tool is near enough to a goal that is a point on its way."""
    off, angle = errors(seen.X_WT, state.goal)
    near = max(TUNING.passing, step.position_tolerance), max(2.0 * step.rotation_tolerance, 0.1)
    return off < near[0] and angle < near[1] and seen.speed < TUNING.passing_speed


def in_sight(track: Track) -> bool:
    """Tell whether the newest images show an object."""
    return track.status in (ObjectStatus.TRACKED, ObjectStatus.MOVING)
