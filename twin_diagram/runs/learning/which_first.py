"""Which of the things in the bin is taken first: the highest of which a sure grasp with room about it is reached."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, product

from twin_diagram.runs.learning.beside_bin import lying
from twin_diagram.runs.learning.bin_view import SeenThing, narrowest
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.runs.learning.choosing import SURE, UNSURE, Choice
from twin_diagram.runs.learning.handling import Tools, choice_of
from twin_diagram.runs.learning.in_the_way import TUNING as IN_THE_WAY
from twin_diagram.runs.learning.in_the_way import covered_share


def which_first(tools: Tools, picture: Picture, things: Sequence[SeenThing]) -> tuple[SeenThing, Choice]:
    """Return what is to be taken first, and what was found when a grasp of it was looked for.

    The highest thing as a rule. Where it can be had only by the pads' very tips, or with a side of which nothing is
    known, a lower one of which a sure grasp is reached goes before it, if nothing lies over that: tries that hold
    nothing push a heap together, and what is free now may no longer be so. For the same reason one for which the hand
    has room goes before one beside which it may touch others. Where nothing is sure, what touches least and is
    likeliest to hold goes first, whichever thing it is of; what is wider than the hand in every direction comes last:
    it could be had at a raised edge alone, from the side.

    Args:
        tools: of the cell; the hand is empty.
        picture: in which they were seen.
        things: at least one, the highest first.

    Returns:
        The thing, and the choice of its grasp, which knows what was looked for.
    """
    around = lying(picture, tools.learning, tools.faces, tools.robot)
    choices: list[tuple[SeenThing, Choice]] = []
    for thing in things:
        others = [other for other in around if (other.middle != thing.middle).any()]
        if thing is things[0] or covered_share(thing, others) < IN_THE_WAY.covered:
            choices.append((thing, choice_of(tools, thing, others)))
    # What is sure of a low thing is found before all that may be of a high one was looked for.
    narrow = [(thing, choice) for thing, choice in choices if narrowest(thing) <= tools.gripper.opening_most]
    for kind, (thing, choice) in chain(product(SURE, choices), product(UNSURE, narrow)):
        if choice.one(kind) is not None:
            return thing, choice
    return choices[0]
