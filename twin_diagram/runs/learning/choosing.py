"""Chooses how a thing in the bin is taken: fingers open all the way, or less where walls and things leave no room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from twin_diagram.planning.grasps import Gripper
from twin_diagram.runs.learning.bin_view import SeenThing, by_tips, downward, grasps_of_thing, why_not
from twin_diagram.runs.learning.cell import Cell
from twin_diagram.runs.learning.in_the_way import in_the_way
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.picking import Reach, reach_of, unlike
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    opened: tuple[float, ...] = (1.0, 0.7, 0.45)
    """Shares of their way by which fingers are open, as they are tried: 11.5, 8 and 5.5 cm of a WSG-50."""

    upright: float = 0.95
    """Least share of an approach that goes downwards where they are not opened all the way: wrist and arm, which may
    come as near to walls as fingers then (`reach_of`), are above them."""


TUNING = Tuning()


def choose(
    mover: Mover,
    cell: Cell,
    gripper: Gripper,
    thing: SeenThing,
    bin_corners: tuple[Array, Array],
    floor: float,
    rest: Sequence[Array],
    attempt: int,
    failed: Sequence[Array],
) -> tuple[Reach | None, str]:
    """Return a grasp of a thing that is reached, or why there is none.

    One whose contacts are both seen or guessed goes before one with a side of which nothing is known, and that before
    one by the very tips of the pads, with which more room is bought too dearly; fingers that are opened all the way
    before others.

    Args:
        mover: plans.
        cell: where the arm is.
        gripper: that takes it.
        thing: that is to be taken.
        bin_corners: lowest and highest corner (3,) of the bin's inside.
        floor: height that the fingers stay above [m].
        rest: points (N, 3) of each thing beside it.
        attempt: number of the try, from 0.
        failed: (4, 4) poses of the tool at which it held nothing.
    """
    spares, why = dict[bool, Reach](), ""
    for opened in TUNING.opened:
        most = gripper.opening_least + opened * (gripper.opening_most - gripper.opening_least)
        for beside in in_the_way(*bin_corners, rest):
            grasps = grasps_of_thing(thing, replace(gripper, opening_most=most), floor, beside, attempt)
            order = downward(grasps)
            if opened < 1.0:
                order = order[grasps.approach[order, 2] <= -TUNING.upright]
            elif why != "out of reach":
                why = "out of reach" if len(order) else why_not(thing, gripper, grasps)
            reach = reach_of(mover, cell, grasps, unlike(grasps.poses, order, failed), opened=opened)
            if reach is None:
                continue
            tips = bool(by_tips(grasps)[reach.grasp])
            if grasps.seen[reach.grasp].all() and not tips:
                return reach, ""
            spares.setdefault(tips, replace(reach, sure=False))
    return spares.get(False, spares.get(True)), why
