"""Takes one thing: grasps of what a picture shows, a way there, a straight approach, fingers shut, and up again."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.grasps import Grasps
from twin_diagram.runs.learning.cell import GRASP, Cell
from twin_diagram.runs.learning.motion import Mover, NoWay, TimedPath
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.pose_vectors import as_matrix


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    retreats: tuple[float, ...] = (0.10, 0.16)
    """Length of the straight approach [m]: the longer one begins with the hand over the bin's walls, where beside them
    there is no room to come to the shorter one's begin; in corners there is none."""

    lift: float = 0.20
    """By which what is held is lifted straight up [m]: out of a bin, over its walls."""

    least_lift: float = 0.06
    """By which at least, where the arm does not reach farther [m]; where it does not, it is let go again."""

    over: float = 0.05
    """Between a bin's walls and what may hang from the pads, before it is brought away [m]: of a bottle 4.5 cm more
    hung there than was seen of it, its neck lay lower and counted as another thing."""

    empty: float = 0.004
    """Fingers closer than this hold nothing [m]."""

    slow: float = 0.08
    """Speed of the last centimetres down, and of the first up [m/s]."""

    grazing: float = -0.015
    """Clearance that is kept at a grasp [m]: the balls that stand for hand and wrist overlap walls by as much, and the
    search for grasps has held the hand's own shape against them."""

    like: tuple[float, float] = (0.02, 0.94)
    """Grasps nearer than this, whose closing axes have at least this cosine between them, are alike [m]: what failed
    pushes a thing by a centimetre or two."""

    settle: float = 0.2
    """Rest before the fingers shut [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Reach:
    """A grasp that the arm can go to: way and line (W, n) [rad], and the tool's pose there (4, 4).

    `opened`: by which share the fingers are open on the way to it; `sure`: whether both of its contacts are seen or
    guessed, and neither is at the pads' very tips; `roomy`: whether hand and fingers keep off all else by more than
    pictures and arm are off.
    """

    grasp: int
    X_WT: Array
    way: Array
    line: Array
    opened: float = 1.0
    sure: bool = True
    roomy: bool = True


@dataclass(frozen=True)
class Taken:
    """What the hand holds after a pick.

    Attributes:
        X_WT: (4, 4) of the tool when the fingers shut: what was at points of W is in its frame since then.
        opening: between the pads [m].
        grasp: which of the grasps it was.
    """

    X_WT: Array
    opening: float
    grasp: int


def reach_of(
    mover: Mover, cell: Cell, grasps: Grasps, order: Sequence[int], most: int = 8, opened: float = 1.0
) -> Reach | None:
    """Return the first of some grasps, in order, that the arm can go to straight and has a way to; None: none.

    Both turns of the fingers, which are alike, are tried.

    Args:
        mover: plans.
        cell: where the arm is.
        grasps: in W.
        order: numbers of those that may be.
        most: path searches at the most.
        opened: by which share the fingers are open.
    """
    q, searched, spare = cell.commanded, 0, None
    # The balls stand for fingers at all their openings.
    grazing = TUNING.grazing - 0.5 * (1.0 - opened) * cell.widest
    for k in order:
        X_WT = as_matrix(grasps.poses[int(k)])
        for turn in (1.0, -1.0):
            X = X_WT.copy()
            X[:3, :2] *= turn
            for q_before in before_grasp(mover, X, q):
                try:
                    line = mover.line(q_before, X, grazing)
                    searched += 1
                    way = mover.path(q, line[:1])
                except NoWay:
                    if searched >= most:
                        return spare
                    continue
                reach = Reach(int(k), X, way, line, opened)
                if lift_line(mover, line[-1]) is not None:
                    return reach
                spare = spare or reach
    return spare


def before_grasp(mover: Mover, X_WT: Array, q: Array) -> Array:
    """Return joint angles (G, n) from which it is straight on to a grasp (4, 4), the nearest to some (n,) first."""
    goals = np.zeros((0, len(q)))
    for retreat in TUNING.retreats:
        before = X_WT.copy()
        before[:3, 3] -= retreat * X_WT[:3, 2]
        goals = mover.goals(before, q)[:3]
        if len(goals):
            break
    return goals


def unlike(poses: Array, order: Array, failed: Sequence[Array]) -> list[int]:
    """Return the numbers of grasps in order, those last that are like one that held nothing.

    Args:
        poses: (N, 7) of the tool, in W.
        order: (M,) numbers of those that may be.
        failed: (4, 4) poses of the tool; its two turns about its approach are alike.
    """

    def is_like(number: int) -> bool:
        X = as_matrix(poses[number])
        return any(
            float(np.linalg.norm(X[:3, 3] - other[:3, 3])) < TUNING.like[0]
            and abs(float(X[:3, 1] @ other[:3, 1])) > TUNING.like[1]
            for other in failed
        )

    return sorted((int(number) for number in order), key=is_like)


def take(mover: Mover, cell: Cell, reach: Reach) -> Taken | None:
    """Go to a grasp, shut the fingers and lift; None where they hold nothing."""
    there = abs(cell.opening - reach.opened * cell.widest) < 0.01
    cell.grip(reach.opened, 0.0 if there else 0.5)
    go(cell, mover.timed(reach.way))
    with cell.about(GRASP, reach.X_WT[:3, 3]):
        return _taken(mover, cell, reach)


def _taken(mover: Mover, cell: Cell, reach: Reach) -> Taken | None:
    """Take what is before the fingers, from where the straight way to it begins."""
    go(cell, mover.timed_line(reach.line, TUNING.slow * 2.0))
    cell.wait(TUNING.settle)
    X_WT = mover.tool(cell.q)
    if cell.grip(0.0) < TUNING.empty:
        back_out(mover, cell, reach)
        return None
    if not lift(mover, cell):
        back_out(mover, cell, reach)
        return None
    if cell.opening < TUNING.empty:
        cell.grip(reach.opened)
        return None
    return Taken(X_WT, cell.apart, reach.grasp)


def lift(mover: Mover, cell: Cell, most: float = TUNING.lift, least: float = TUNING.least_lift) -> bool:
    """Go straight up by that much [m], or as far as the arm reaches; whether it did, by the least at least."""
    line = lift_line(mover, cell.commanded, most, least)
    if line is None:
        return False
    go(cell, mover.timed_line(line, TUNING.slow * 1.5))
    return True


def lift_line(mover: Mover, q: Array, most: float = TUNING.lift, least: float = TUNING.least_lift) -> Array | None:
    """Return joint angles (W, n) straight up from some (n,), as far as the arm reaches; None: hardly at all."""
    start = mover.tool(q)
    for height in np.arange(most, least - 1e-9, -0.02):
        above = start.copy()
        above[2, 3] += height
        with contextlib.suppress(NoWay):
            return mover.line(q, above)
    return None


def lift_over(mover: Mover, cell: Cell, taken: Taken, points: Array, walls: float) -> None:
    """Lift what was taken until it is over a bin's walls, should it turn between the pads and hang from them, too.

    Args:
        mover: plans.
        cell: whose fingers hold it.
        taken: where they shut.
        points: (N, 3) of it in W, as it lay then [m].
        walls: height of their upper edges [m].
    """
    hangs = float(np.linalg.norm(points - taken.X_WT[:3, 3], axis=1).max())
    lacks = walls + TUNING.over + hangs - float(mover.tool(cell.commanded)[2, 3])
    if lacks > 0.0:
        lift(mover, cell, lacks, min(lacks, 0.02))


def back_out(mover: Mover, cell: Cell, reach: Reach) -> None:
    """Open the fingers, go back the way that was come, and up: what was pushed may lean where nothing was before."""
    cell.grip(reach.opened)
    go(cell, mover.timed_line(reach.line[::-1], TUNING.slow * 2.0))
    lift(mover, cell)


def go(cell: Cell, motion: TimedPath) -> None:
    """Go along a motion and come to rest."""
    cell.follow(motion.times, motion.q)
    cell.wait(0.05)
