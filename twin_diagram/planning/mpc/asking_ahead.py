"""Ways to the goal after this one, which are searched for while the arm is still on its way to this one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.planning.mpc.planner_state import TUNING as PLANNER_STATE
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.paths.guide import Guide, Question
from twin_diagram.planning.paths.inverse_kinematics import IkTuning
from twin_diagram.planning.paths.route import Aim, Route
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
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
        question: what is about, and what is held.
        after: the goal.
    """
    end = memory.route.points[-1]
    if len(guide.straight_way(end, after)):
        return None
    hand = question.hand
    if hand:  # what it lifts off its support it will have lifted
        hand = replace(Hand.unpack(np.frombuffer(hand)), on_support=False, support=NOTHING).pack().tobytes()
    return replace(question, q=end, goal=after.copy(), goals=memory.goals[:0], more_goals=True, hand=hand)


def going_on(guide: Guide, memory: Memory, now: float, ahead: float) -> Array | None:
    """Return where an arm is (n,) [rad] that will have rested at its goal and go on from there by then.

    None where it is still on its way to the goal then, or no way on is known.

    Args:
        guide: whose limits count.
        memory: with the way to the goal, and the way on that was found.
        now: time [s].
        ahead: how much later [s].
    """
    if not (len(memory.beyond) and memory.route.to_goal):
        return None
    q, v, _ = (part[0] for part in memory.trajectory.at(np.array([now])))
    left = ahead - guide.router.travel(q - memory.offset, memory.route, v).duration
    if left <= 0.0:
        return None
    on = guide.router.travel(memory.route.points[-1], Route(Aim.GOAL, memory.beyond))
    return np.asarray(on.at(np.array([left]))[0])


def answered(memory: Memory, points: Array) -> Memory:
    """Return the memory with the way (W, n) that was found ahead, W = 0: none; one too long to remember is none."""
    return replace(memory, pending=None, beyond=points if len(points) <= PLANNER_STATE.way_points else points[:0])


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
