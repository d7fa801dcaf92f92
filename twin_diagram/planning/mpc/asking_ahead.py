"""Ways to the goal after this one, which are searched for while the arm is still on its way to this one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from twin_diagram.planning.collision.collision_scene import Forecast
from twin_diagram.planning.mpc.planner_state import TUNING as PLANNER_STATE
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.paths.guide import Guide, Question
from twin_diagram.planning.paths.inverse_kinematics import IkTuning
from twin_diagram.planning.paths.situation import Aim, Route, Situation
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import POSE_SIZE
from twin_diagram.signals.pose_vectors import errors


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    same: tuple[float, float] = (0.02, 0.2)
    """A way found for a goal this near is one to the goal as well [m], [rad]: where it is put down is told anew as it
    lies in the hand, …"""

    end: float = 0.3
    """… with its end moved by no more than this in any joint [rad], or it would be another arm's way to stand."""


TUNING = Tuning()


@dataclass(frozen=True)
class Onward:
    """Where an arm goes after its goal.

    Attributes:
        goal: (7,) X_WG of the tool; zeros: it is not known.
        hand: what is held on the way there, a packed `Hand`; empty: nothing.
        pause: it rests so long before that, once it is where it is to be now [s].
    """

    goal: Array = field(default_factory=lambda: np.zeros(POSE_SIZE))
    hand: bytes = b""
    pause: float = 0.0


NOWHERE: Final = Onward()
"""Where an arm goes next of which that is not known."""


def foretold(memory: Memory, goal: Array) -> bool:
    """Tell whether a goal (7,) is the one that was looked ahead to."""
    if not memory.next_goal.any():
        return False
    off, angle = errors(memory.next_goal, goal)
    return off < TUNING.same[0] and angle < TUNING.same[1]


def question_ahead(guide: Guide, memory: Memory, question: Question, after: Array) -> Question | None:
    """Return what to ask for a way on to a goal (7,) after this one; None where a straight line leads there.

    Args:
        guide: of the arm as it is now.
        memory: with the way to the present goal.
        question: what is about, and what is held on the way there.
        after: the goal.
    """
    end = memory.route.points[-1]
    if len(guide.straight_way(end, after)):
        return None
    return replace(question, q=end, goal=after.copy(), goals=memory.goals[:0], more_goals=True)


def kept_ahead(before: Memory, memory: Memory, after: Array) -> Memory:
    """Return the memory of a goal that may be new with the way on that was found before, where that is still one.

    It is where it leads to what comes `after` (7,) the new goal: what fingers have closed on is lifted straight up, and
    the way from there to its place was sought before. It serves until one from the new goal is found.

    Args:
        before: the goal.
        memory: with it.
        after: the goal after it; zeros: it is not known.
    """
    if np.array_equal(before.goal, memory.goal) or not memory.goal.any():
        return memory
    if after.any() and len(memory.beyond) and foretold(memory, after) and not foretold(memory, memory.goal):
        return replace(memory, next_goal=np.zeros(POSE_SIZE))
    return replace(memory, next_goal=np.zeros(POSE_SIZE), beyond=memory.beyond[:0])


def revised(empty: Guide, memory: Memory, forecast: Forecast, hand: bytes) -> Memory:
    """Return the memory with the way on as it will be gone, without needless points; none where it is blocked by now.

    Args:
        empty: of the arm with an empty hand.
        memory: with the way to the goal, and the way on that was found.
        forecast: of the objects.
        hand: what is held on the way on, a packed `Hand`; empty: nothing.
    """
    end, beyond, guide = memory.route.points[-1], memory.beyond, empty.holding(hand)
    if not guide.router.follows(beyond, guide.situation(end, forecast, beyond[-1:])):
        return replace(memory, next_goal=np.zeros(POSE_SIZE), beyond=beyond[:0])
    up = beyond[: guide.router.rises and len(beyond) > 1]
    if len(up):  # what it lifts off its support it will have lifted there
        end, lifted = up[0], replace(Hand.unpack(np.frombuffer(hand)), on_support=False, support=NOTHING)
        guide = empty.holding(lifted.pack().tobytes())
    points = beyond[len(up) :]
    points = _shortened(guide, points, guide.situation(end, forecast, points[-1:]))
    return replace(memory, beyond=np.vstack([up, points]))


def _shortened(guide: Guide, points: Array, now: Situation) -> Array:
    """Return way points (W, n) without those that are needless from where the arm is."""
    router = guide.router
    spare, coarse = now.allowed(now.margins(0, router.tuning.spare)), now.allowed(now.margins(0), router.tuning.blocked)
    while True:
        kept = router.shortcut(Route(Aim.GOAL, points), now, spare, coarse).points
        if len(kept) == len(points):
            return points
        points = kept


def going_on(guide: Guide, memory: Memory, now: float, ahead: float, pause: float = 0.0) -> Array | None:
    """Return where an arm is (n,) [rad] that will have rested at its goal and go on from there by then.

    None where it is still on its way to the goal then, or no way on is known.

    Args:
        guide: whose limits count.
        memory: with the way to the goal, and the way on that was found.
        now: time [s].
        ahead: how much later [s].
        pause: how long it rests at its goal [s].
    """
    if not (len(memory.beyond) and memory.route.to_goal):
        return None
    q, v, _ = (part[0] for part in memory.trajectory.at(np.array([now])))
    left = ahead - pause - guide.router.travel(q - memory.offset, memory.route, v).duration
    if left <= 0.0:
        return None
    on = guide.router.travel(memory.route.points[-1], Route(Aim.GOAL, memory.beyond))
    return np.asarray(on.at(np.array([left]))[0])


def answered(memory: Memory, points: Array) -> Memory:
    """Return the memory with the way (W, n) that was found ahead, else the one before.

    W = 0: there is none; one too long to remember is none.
    """
    found = 0 < len(points) <= PLANNER_STATE.way_points
    return replace(memory, pending=None, beyond=points if found else memory.beyond)


def way_known(guide: Guide, memory: Memory, goal: Array, rng: np.random.Generator, tuning: IkTuning) -> Array:
    """Return the way (W, n) that was found ahead, its end moved to where the goal (7,) is now; W = 0: there is none."""
    none = np.zeros((0, guide.scene.chain.size))
    if not (len(memory.beyond) and foretold(memory, goal)):
        return none
    end = memory.beyond[-1]
    exact = guide.reaching(end, goal, rng, tuning)[:1]
    if not len(exact) or np.abs(exact[0] - end).max() > TUNING.end:
        return none
    return np.vstack([memory.beyond[:-1], exact])
