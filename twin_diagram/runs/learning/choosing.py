"""Chooses how a thing in the bin is taken, and how far fingers open for it: what is open wide touches neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from twin_diagram.planning.grasps import Gripper
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.cell import Cell
from twin_diagram.runs.learning.in_the_way import in_the_way, yielding_away
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.picking import Reach, reach_of, unlike
from twin_diagram.runs.learning.thing_grasps import Lean, by_tips, downward, grasps_of_thing, leaning, why_not
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    opened: tuple[float, ...] = (1.0, 0.7, 0.45)
    """Shares of their way by which fingers are open, as they are tried: 11.5, 8 and 5.5 cm of a WSG-50."""

    upright: float = 0.95
    """Least share of an approach that goes downwards where they are not opened all the way: wrist and arm, which may
    come as near to walls as fingers then (`reach_of`), are above them."""

    spare: float = 0.01
    """Between open fingers and the thing that they go down beside, on each side [m]: what the grasps' search leaves
    beside a side that is not seen; the arm sags by two millimetres, and pictures are off by one or two."""


TUNING = Tuning()
ROOMY: Final = "roomy"
"""A grasp whose contacts are seen or guessed, away from the pads' tips, with room about the hand."""
TIGHT: Final = "tight"
"""The same without that room."""
LEANING: Final = "leaning"
"""One across the sides of what leans, guessed along the normal of the face that is seen: of three tries two held."""
ONE_SIDED: Final = "one-sided"
"""One with a side of which nothing is known."""
ASIDE: Final = "aside"
"""One whose fingers push aside what lies beside the thing; walls and what stays leave the hand room."""
PUSHING: Final = "pushing"
"""The same without that room: the palm has met a bin's rim."""
TIPS: Final = "tips"
"""One by the very tips of the pads."""
SURE: Final = (ROOMY, TIGHT)
"""Kinds of grasps that hold as a rule, the best first."""
UNSURE: Final = (LEANING, ONE_SIDED, ASIDE, PUSHING, TIPS)
"""Kinds that may hold nothing, or touch what they should not, the best first."""


@dataclass
class Choice:
    """Looks for a grasp of one thing, kind by kind: each search takes a second or two, and is made once if at all.

    One whose contacts are both seen or guessed goes before one with a side of which nothing is known, and that before
    one by the very tips of the pads, with which more room is bought too dearly; one with room beside the hand before
    one without; then one that is had with fingers opened all the way before others. Where its sides are known they are
    opened no farther than it asks for. Where none is sure, sides of what leans are guessed along its face's normal.
    Before tips of pads are tried, fingers may push aside what lies beside it, at first where the palm has room over
    walls.

    Attributes:
        mover: plans.
        cell: where the arm is.
        gripper: that takes it.
        thing: that is to be taken.
        bin_corners: lowest and highest corner (3,) of the bin's inside.
        floor: height that the fingers stay above [m].
        rest: points (N, 3) of each thing beside it.
        attempt: number of the try, from 0.
        failed: (4, 4) poses of the tool at which it held nothing.
        why: why there is none, as far as was looked.
    """

    mover: Mover
    cell: Cell
    gripper: Gripper
    thing: SeenThing
    bin_corners: tuple[Array, Array]
    floor: float
    rest: Sequence[Array]
    attempt: int = 0
    failed: Sequence[Array] = ()
    why: str = ""
    _spares: dict[str, Reach] = field(default_factory=dict)
    _looked: dict[str, Reach | None] = field(default_factory=dict)

    def best(self) -> Reach | None:
        """Return the best grasp that is reached; None: there is none, see `why`."""
        return next((reach for kind in (*SURE, *UNSURE) if (reach := self.one(kind)) is not None), None)

    def one(self, kind: str) -> Reach | None:
        """Return a grasp of a kind, of `SURE` or `UNSURE`; what is looked for in earlier ones comes on the way."""
        if kind in (ONE_SIDED, TIPS):
            for before in SURE:
                self.one(before)
            # Where the picture cuts it off nobody knows how far off its other side is.
            return None if kind == ONE_SIDED and len(self.thing.beyond) else self._spares.get(kind)
        if kind not in self._looked:
            pushed, lean = kind in (ASIDE, PUSHING), leaning(self.thing) if kind == LEANING else None
            if kind == LEANING and lean is None:
                return None
            beside = self._yielding if pushed else self._free
            self._looked[kind] = self._look(beside[kind in (TIGHT, PUSHING)], kind, lean) if beside else None
        return self._looked[kind]

    @cached_property
    def _free(self) -> list[Array]:
        return in_the_way(*self.bin_corners, self.rest)

    @cached_property
    def _yielding(self) -> list[Array]:
        return in_the_way(*self.bin_corners, yielding_away(self.thing, self.rest)) if self.rest else []

    def _look(self, beside: Array, kind: str, lean: Lean | None = None) -> Reach | None:
        """Return a grasp of a kind beside points (N, 3), and note one-sided ones and those by tips."""
        for opened in TUNING.opened:
            most = self.gripper.opening_least + opened * (self.gripper.opening_most - self.gripper.opening_least)
            gripper = replace(self.gripper, opening_most=most)
            grasps = grasps_of_thing(self.thing, gripper, self.floor, beside, self.attempt, lean=lean)
            order = downward(grasps)
            if opened < 1.0:
                order = order[grasps.approach[order, 2] <= -TUNING.upright]
            elif self.why != "out of reach" and kind in SURE:
                self.why = "out of reach" if len(order) else why_not(self.thing, self.gripper, grasps)
            reach = reach_of(self.mover, self.cell, grasps, unlike(grasps.poses, order, self.failed), opened=opened)
            if reach is None:
                continue
            reach, tips = replace(reach, roomy=kind == ROOMY), bool(by_tips(grasps)[reach.grasp])
            if grasps.seen[reach.grasp].all() and not tips:
                enough = min(reach.opened, needed(self.thing, reach.X_WT, self.gripper))
                return replace(reach, opened=enough, sure=kind in SURE)
            if kind in SURE:
                self._spares.setdefault(TIPS if tips else ONE_SIDED, replace(reach, sure=False))
        return None


def needed(thing: SeenThing, X_WT: Array, gripper: Gripper) -> float:
    """Return by which share fingers are to be open on the straight way to a grasp of a thing, beside all of it.

    Args:
        thing: that they are to go down on both sides of.
        X_WT: (4, 4) of the tool at the grasp.
        gripper: whose fingers they are.
    """
    p_T = (thing.points - X_WT[:3, 3]) @ X_WT[:3, :3]
    aside = np.abs(p_T[:, 1])
    # What is beyond the fingers, as a ring's other wall, is not between them.
    between = (np.abs(p_T[:, 0]) <= 0.5 * gripper.finger_width + TUNING.spare) & (p_T[:, 2] <= gripper.finger_front)
    between &= aside <= 0.5 * gripper.opening_most
    opening = 2.0 * (float(aside[between].max(initial=0.0)) + TUNING.spare)
    share = (opening - gripper.opening_least) / (gripper.opening_most - gripper.opening_least)
    return float(np.clip(share, 0.0, 1.0))
