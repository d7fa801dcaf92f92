"""Drags a thing that lies too near to walls for any grasp off them, with shut fingers that press on its top.

Pressed down as hard as the arm's torques tell, and drawn aside level, it slides or rolls along; then the bin is looked
at once more. See `drags` for which way.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.planning.grasps import Gripper
from twin_diagram.runs.learning.beside_bin import lying, whole_of
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.cell import GRASP, Picture
from twin_diagram.runs.learning.drags import Drag, drags_of
from twin_diagram.runs.learning.flat_things import evenly
from twin_diagram.runs.learning.handling import Tools
from twin_diagram.runs.learning.in_the_way import TUNING as IN_THE_WAY
from twin_diagram.runs.learning.in_the_way import covered_share, in_the_way
from twin_diagram.runs.learning.motion import NoWay, pointing, pose
from twin_diagram.runs.learning.picking import TUNING as PICKING
from twin_diagram.runs.learning.picking import go, lift
from twin_diagram.runs.learning.pressing import begun_at, pressed
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    force: float = 40.0
    """With which it is pressed [N]: pads of friction 0.9 then draw 1.5 kg over a bottom of 0.4, whatever its own is."""

    before: float = 0.012
    """Over its top the fingers come down [m]."""

    deepest: float = 0.03
    """Below where its top was seen they are told to go at the most [m]: an iiwa yields by 17 mm to that force."""

    seen: float = 0.004
    """Below it they may come [m]: what pictures and arm are off."""

    down: float = 0.001
    """Between points of the way down [m]: 10 N more each."""

    step: float = 0.004
    """Between points of the way aside [m]: with `pressing`'s ticks 7 cm/s."""


TUNING = Tuning()


@dataclass(frozen=True)
class Dragging:
    """A way to drag a thing, as planned.

    Attributes:
        drag: which way.
        R_WT: (3, 3) axes of the tool, which points down; its fingers shut along the way, or across it.
        way: (W, n) joint angles to above where it begins [rad].
        line: (M, n) from there to it.
        places: (K, 3) of the thing, all over what is seen of it [m].
    """

    drag: Drag
    R_WT: Array
    way: Array
    line: Array
    places: Array


def plan_drag(tools: Tools, thing: SeenThing, picture: Picture, attempt: int = 0) -> Dragging | None:
    """Return how a thing is dragged off walls that it lies at; None: it lies at none, or no way is free and reached.

    Args:
        tools: of the cell; the hand is empty.
        thing: as it lies.
        picture: in which it was seen; all else in it is in the way.
        attempt: number of the try, from 0: in a corner each way comes first in turn, for one may not have moved it.
    """
    if thing.beside or len(thing.beyond):
        return None
    low, high = (np.array(corner) for corner in tools.learning.from_bin)
    around = lying(picture, tools.learning, tools.faces, tools.robot)
    others = [one for one in around if (one.middle != thing.middle).any()]
    if covered_share(thing, others) >= IN_THE_WAY.covered:
        return None
    rest, gripper = [whole_of(one) for one in others], tools.gripper
    tools.mover.stand("bin", [thing.points, *rest], float(low[2]))
    barred, flat = in_the_way(low, high, rest)[-1], np.vstack([np.zeros((0, 3)), *rest])
    shut, bare = gripper.opening_least + 2.0 * gripper.finger_thickness, PICKING.grazing - 0.5 * tools.cell.widest
    fingers = -gripper.boxes(gripper.opening_least)[0][:-1].min(axis=0)
    for along_way, deep, behind in ((True, shut, fingers[1]), (False, gripper.finger_width, fingers[0])):
        found = drags_of(thing, flat, (low, high), deep, float(behind))
        turned = attempt % len(found) if found else 0
        for drag in found[turned:] + found[:turned]:
            across = np.cross([0.0, 0.0, 1.0], drag.along)
            for sign in (1.0, -1.0):
                R_WT = pointing(np.array([0.0, 0.0, -1.0]), sign * (drag.along if along_way else across))
                if not is_clear(tool_poses(drag, R_WT, gripper, TUNING.seen), gripper, barred):
                    continue
                poses = tool_poses(drag, R_WT, gripper, TUNING.deepest)
                if (begun := begun_at(tools, poses, bare)) is not None:
                    return Dragging(drag, R_WT, *begun, thing.some)
    return None


def tool_poses(drag: Drag, R_WT: Array, gripper: Gripper, deeper: float) -> Array:
    """Return poses (M, 4, 4) of a tool that comes down on a thing, its tips below its top by so much [m], and aside."""
    at = drag.place + np.array([0.0, 0.0, gripper.finger_front])
    over, low = at + [0.0, 0.0, TUNING.before], at - [0.0, 0.0, deeper]
    ways = (np.array([over, low]), np.array([low, low + drag.length * drag.along]))
    return np.array([pose(R_WT, place) for way in ways for place in evenly(way, TUNING.step)])


def is_clear(poses: Array, gripper: Gripper, barred: Array) -> bool:
    """Return whether nothing but what is dragged is in the hand's way: points (N, 3) that it keeps clear of [m]."""
    shut = gripper.boxes(gripper.opening_least)
    return not any(Boxes(X, *shut).hold(barred).any() for X in poses)


def drag_off(tools: Tools, plan: Dragging) -> str:
    """Press on a thing and drag it as was planned, and leave it upwards; return what came of it, in words.

    Args:
        tools: of the cell; the hand is empty.
        plan: how.
    """
    mover, cell, drag = tools.mover, tools.cell, plan.drag
    cell.grip(0.0)
    go(cell, mover.timed(plan.way))
    told = "it was not felt"
    with cell.about(GRASP, plan.places):
        go(cell, mover.timed_line(plan.line, PICKING.slow * 2.0))
        with contextlib.suppress(NoWay):
            X_WT = mover.tool(cell.commanded)
            free, force = pressed(tools, X_WT), 0.0
            for _ in range(int((TUNING.before + TUNING.deepest) / TUNING.down)):
                X_WT[2, 3] -= TUNING.down
                force = float((free - pressed(tools, X_WT))[2])
                if force >= TUNING.force:
                    break
            if force >= TUNING.force:
                told = f"dragged by {100 * drag.length:.0f} cm"
                for at in np.arange(TUNING.step, drag.length + 1e-9, TUNING.step):
                    aside = X_WT.copy()
                    aside[:3, 3] += at * drag.along
                    pressed(tools, aside)
        lift(mover, cell)
    cell.grip(1.0)
    return told
