"""Ends a run on a signal: what is held is set down where it was taken if the way is free and short, else it is held."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np

from twin_diagram.runs.learning.cell import RELEASE
from twin_diagram.runs.learning.handling import Tools
from twin_diagram.runs.learning.motion import Mover, NoWay, TimedPath
from twin_diagram.runs.learning.picking import TUNING as PICKING
from twin_diagram.runs.learning.picking import go
from twin_diagram.runtime import stopping
from twin_diagram.runtime.stopping import Stopped
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    within: float = 8.5
    """Wall time that setting down may take after a signal [s]: the command ends within 10 s, files included."""

    spare: float = 1.5
    """Of that, what is left for the fingers and a busy machine when the way is begun [s]."""

    gap: float = 0.004
    """Left under the object where the fingers open [m]: what it sank in the hand, and the arm's sag."""

    above: float = 0.05
    """Height from which it goes straight down [m]."""

    beside: float = 0.01
    """Within this of the vertical over that place it goes down at once [m]."""

    speed: float = 0.12
    """Of the way down [m/s]."""

    opening: float = 0.5
    """Until the fingers have let go [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Ending:
    """How a run was ended: in words, and whether nothing is in the hand now that was not at the begin."""

    told: str
    empty: bool


def end_early(tools: Tools, within: float = TUNING.within) -> Ending:
    """Bring the arm to rest, set down what it holds where its fingers last shut, or keep holding it.

    Args:
        tools: of the cell; its arm may have been stopped in the middle of a motion.
        within: wall time that this may take [s]; a second signal ends the process at once.
    """
    cell, begun = tools.cell, time.monotonic()
    try:
        with stopping.closing(within):
            with _where_taken(tools):
                cell.brake()
            if not cell.shut or cell.opening < PICKING.empty or cell.shut_at is None:
                return Ending("the hand is empty", True)
            way, line = _way_down(tools.mover, cell.commanded, tools.mover.tool(cell.shut_at))
            took = sum(float(part.times[-1]) for part in (way, line) if part is not None) + TUNING.opening
            left = within - TUNING.spare - (time.monotonic() - begun)
            if took * cell.pace > left:
                return Ending(
                    f"it is held: to set it down takes {took * cell.pace:.0f} s, {left:.0f} s are left", False
                )
            if way is not None:
                go(cell, way)
            with cell.about(RELEASE, tools.mover.tool(line.q[-1])[:3, 3]):
                go(cell, line)
                cell.grip(1.0, TUNING.opening)
            tools.mover.hold(None)
            return Ending("it was set down where it was taken", True)
    except NoWay as why:
        return Ending(f"it is held: {why}", False)
    except Stopped:
        return Ending("it is held: there was no time to set it down", False)


def _where_taken(tools: Tools) -> AbstractContextManager[None]:
    """Have the observer know that the hand is still where its fingers shut: what it holds may touch what it lay on."""
    cell, mover = tools.cell, tools.mover
    if cell.shut_at is None:
        return nullcontext()
    place, taken = mover.tool(cell.commanded)[:3, 3], mover.tool(cell.shut_at)[:3, 3]
    near = float(np.linalg.norm(place - taken)) < TUNING.above
    return cell.about(RELEASE, place) if near else nullcontext()


def _way_down(mover: Mover, q: Array, X_WT: Array) -> tuple[TimedPath | None, TimedPath]:
    """Return the way to over a place, None where the tool is there, and the line down to it.

    Raises:
        NoWay: there is none.
    """
    goal = X_WT.copy()
    goal[2, 3] += TUNING.gap
    now = mover.tool(q)
    upright = float(np.trace(now[:3, :3].T @ goal[:3, :3])) > 2.999
    if upright and float(np.hypot(*(now - goal)[:2, 3])) < TUNING.beside:
        return None, mover.timed_line(_down(mover, q, goal), TUNING.speed)
    above = goal.copy()
    above[2, 3] += TUNING.above
    last = NoWay("no way to where it was taken")
    for q_above in mover.goals(above, q)[:2]:
        try:
            line = _down(mover, q_above, goal)
            return mover.timed(mover.path(q, line[:1])), mover.timed_line(line, TUNING.speed)
        except NoWay as why:
            last = why
    raise last


def _down(mover: Mover, q: Array, goal: Array) -> Array:
    """Return the line (W, n) down to a pose; what is held may come as near to its support as it was.

    Raises:
        NoWay: there is none.
    """
    line = mover.line(q, goal)
    if not mover.bare_free(line, PICKING.grazing):
        raise NoWay("something is in the way down to where it was taken")
    return line
