"""Which of the things in the bin is taken first: the highest of which a sure grasp with room about it is reached."""

from __future__ import annotations

from collections.abc import Sequence

from twin_diagram.runs.learning.beside_bin import lying
from twin_diagram.runs.learning.bin_view import SeenThing, narrowest
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.runs.learning.handling import Tools, grasp_of
from twin_diagram.runs.learning.in_the_way import TUNING as IN_THE_WAY
from twin_diagram.runs.learning.in_the_way import covered_share
from twin_diagram.runs.learning.picking import Reach


def which_first(tools: Tools, picture: Picture, things: Sequence[SeenThing]) -> tuple[SeenThing, Reach | None]:
    """Return what is to be taken first, and the grasp of it that was found.

    The highest thing as a rule. Where it can be had only by the pads' very tips, or with a side of which nothing is
    known, a lower one of which a sure grasp is reached goes before it, if nothing lies over that: tries that hold
    nothing push a heap together, and what is free now may no longer be so. For the same reason one for which the hand
    has room goes before one beside which it may touch others. Where nothing is sure, what is wider than the hand in
    every direction comes last: it could be had at a raised edge alone, from the side.

    Args:
        tools: of the cell; the hand is empty.
        picture: in which they were seen.
        things: at least one, the highest first.

    Returns:
        The thing, and its grasp; None: none was found, or is worth keeping.
    """
    first: Reach | None = None
    tight: tuple[SeenThing, Reach] | None = None
    unsure: tuple[SeenThing, Reach] | None = None
    around = lying(picture, tools.learning, tools.faces, tools.robot)
    for thing in things:
        others = [other for other in around if (other.middle != thing.middle).any()]
        if thing is not things[0] and covered_share(thing, others) >= IN_THE_WAY.covered:
            continue
        reach, _ = grasp_of(tools, thing, others)
        if reach is not None and reach.sure and reach.roomy:
            return thing, reach
        if reach is not None and reach.sure:
            tight = tight or (thing, reach)
        elif reach is not None and narrowest(thing) <= tools.gripper.opening_most:
            unsure = unsure or (thing, reach)
        first = reach if thing is things[0] else first
    return tight or unsure or (things[0], first)
