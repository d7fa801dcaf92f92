"""Where the arm is once it has come to its goal and gone on to those after it: for a preview, no command."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_diagram.planning.mpc.asking_ahead import foretold
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.paths.route import Aim, Route
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.signals.next_goals import NextGoal


def going_on(
    planner: MotionPlanner, memory: Memory, now: float, ahead: float, after: Sequence[NextGoal]
) -> Array | None:
    """Return where the arm is so much later (n,), by commands [rad]; None: it has not set out for more by then.

    It goes straight in space to what is near, else by a way that was found: where none was it may wait, or go around.

    Args:
        planner: its ways and speeds.
        memory: the plan of now.
        now: [s].
        ahead: [s].
        after: goals after the present one, in their order.
    """
    route = memory.route
    if not after or memory.trajectory.start == NEVER or not (route.to_goal and len(route.points)):
        return None
    q, v, _ = (part[0] for part in memory.trajectory.at(np.array([now])))
    way = planner.router.travel(q - memory.offset, route, v)
    comes, end, found = now + way.duration, route.points[-1], None
    for each in after:
        leaves = max(comes + each.pause, each.earliest, now)
        if leaves >= now + ahead:
            break
        beyond = _way(planner, memory, end, each.X_WG)
        if beyond is None:
            break
        way = planner.router.travel(end, beyond)
        found = way.at(np.array([now + ahead - leaves]))[0] + memory.offset
        comes, end = leaves + way.duration, beyond.points[-1]
    return found


def _way(planner: MotionPlanner, memory: Memory, q: Array, goal: Array) -> Route | None:
    """Return the way to a goal (7,) from joint angles (n,): found ahead, or straight; None: it is not known."""
    if len(memory.beyond) and foretold(memory, goal):
        return Route(Aim.GOAL, memory.beyond)
    line = planner.guide.straight_way(q, goal)
    return Route(Aim.LINE, line) if len(line) else None
