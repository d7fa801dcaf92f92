"""Pushes a thing that cannot be grasped off what it lies across, with shut fingers beside its upper edge.

Pushed straight and level, no harder than `Tuning.force`, it slides into the bin, or free of what it lay on; then the
bin is looked at once more. See `nudges` for which way.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from itertools import product

import numpy as np

from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.planning.grasps import Gripper
from twin_diagram.runs.learning.beside_bin import lying, whole_of
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.cell import GRASP, Picture
from twin_diagram.runs.learning.flat_things import evenly
from twin_diagram.runs.learning.handling import TUNING as HANDLING
from twin_diagram.runs.learning.handling import Tools
from twin_diagram.runs.learning.in_the_way import TUNING as IN_THE_WAY
from twin_diagram.runs.learning.in_the_way import covered_share, in_the_way
from twin_diagram.runs.learning.motion import NoWay, pointing, pose
from twin_diagram.runs.learning.nudges import Nudge, nudges_of
from twin_diagram.runs.learning.picking import TUNING as PICKING
from twin_diagram.runs.learning.picking import go, lift
from twin_diagram.runs.learning.pressing import TUNING as PRESSING
from twin_diagram.runs.learning.pressing import begun_at, pressed
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    force: float = 40.0
    """From which it counts as stuck [N]: 1.5 kg slide at a friction of 0.9 with 13; what is tipped up is pressed so."""

    depths: tuple[float, ...] = (0.03, 0.02, 0.012)
    """Of the tips below its upper edge, as they are tried [m]: the deepest grips best, and turns it over least."""

    before: float = 0.02
    """Of its side, the fingers come down [m]."""

    leans: tuple[float, ...] = (0.0, 0.35)
    """By how much the hand leans over the thing, the way it pushes, as they are tried [rad]: beyond a far rim, 82 cm
    from an iiwa 7's axis, a hand that hangs straight down is out of reach. Shut fingers meet its upper edge then, half
    as far ahead of the tips as they come down before its side."""

    step: float = 0.004
    """Between points of the way [m]: with `pressing`'s ticks 7 cm/s."""

    bottom: float = 0.008
    """Within which of the bottom's height a point is the bottom's [m]: twice what things stand out by at the least."""


TUNING = Tuning()


@dataclass(frozen=True)
class Nudging:
    """A push as planned.

    Attributes:
        nudge: which way.
        tip: height of the finger tips [m].
        lean: of the hand over the thing [rad].
        turn: 1 or -1: of both turns of the fingers, which are alike, the one that is reached.
        way: (W, n) joint angles to above where it begins [rad].
        down: (M, n) from there to it.
        places: (K, 3) of the thing, all over what is seen of it [m].
    """

    nudge: Nudge
    tip: float
    lean: float
    turn: float
    way: Array
    down: Array
    places: Array


def tool_poses(nudge: Nudge, tip: float, gripper: Gripper, lean: float = 0.0) -> Array:
    """Return poses (M, 4, 4) of a tool on the way of a push, its tips' leading edge at a height [m].

    Args:
        nudge: which way.
        tip: that height.
        gripper: whose fingers are shut.
        lean: of the hand from straight up, the way it pushes [rad].
    """
    c, s, up = np.cos(lean), np.sin(lean), np.array([0.0, 0.0, 1.0])
    approach, ahead = -c * up - s * nudge.along, c * nudge.along - s * up
    to_edge = gripper.finger_front * approach + 0.5 * gripper.finger_width * ahead
    ends = np.array([[nudge.near - TUNING.before, tip], [nudge.near + nudge.length, tip]])
    places = [at * nudge.along + nudge.middle * nudge.across + z * up for at, z in evenly(ends, TUNING.step)]
    return np.array([pose(pointing(approach, nudge.across), place - to_edge) for place in places])


def plan_nudge(tools: Tools, thing: SeenThing, picture: Picture) -> Nudging | None:
    """Return how a thing is pushed into free room; None: no way of it is worth it, free and reached.

    Args:
        tools: of the cell; the hand is empty.
        thing: as it lies.
        picture: in which it was seen; all else in it is in the way.
    """
    if thing.beside or len(thing.beyond):
        return None
    low, high = (np.array(corner) for corner in tools.learning.from_bin)
    around = lying(picture, tools.learning, tools.faces, tools.robot)
    others = [one for one in around if (one.middle != thing.middle).any()]
    if covered_share(thing, others) >= IN_THE_WAY.covered:
        return None
    rest = [whole_of(one) for one in others]
    tools.mover.stand("bin", [thing.points, *rest], float(low[2]))
    gripper, half = tools.gripper, 0.5 * tools.gripper.opening_least + tools.gripper.finger_thickness
    found = nudges_of(thing, np.vstack([np.zeros((0, 3)), *rest]), _bottom(picture, low, high), (low, high), half)
    barred = in_the_way(low, high, rest)[0]
    for nudge, lean in product(found, TUNING.leans):
        for tip in sorted({max(nudge.edge - depth, low[2] + HANDLING.floor) for depth in TUNING.depths}):
            poses = tool_poses(nudge, tip, gripper, lean)
            if not is_clear(poses, gripper, barred, thing.points):
                continue
            for turn in (1.0, -1.0):
                begun = begun_at(tools, poses * np.array([turn, turn, 1.0, 1.0]), PICKING.grazing)
                if begun is not None:
                    return Nudging(nudge, tip, lean, turn, *begun, thing.some)
    return None


def _bottom(picture: Picture, low: Array, high: Array) -> Array:
    """Return points (K, 3) of the bin's bottom, where it is seen [m]."""
    points = picture.points()
    there = (points[..., :2] > low[:2]).all(-1) & (points[..., :2] < high[:2]).all(-1) & (picture.depth > 0)
    return np.asarray(points[there & (np.abs(points[..., 2] - low[2]) < TUNING.bottom)])


def is_clear(poses: Array, gripper: Gripper, barred: Array, own: Array) -> bool:
    """Return whether nothing but the thing's own side is in the hand's way.

    Args:
        poses: (M, 4, 4) of the tool on its way; it comes down to the first.
        gripper: whose fingers are shut.
        barred: (N, 3) points that the hand keeps clear of [m].
        own: (K, 3) of the thing, which fingers come down beside and the palm stays above [m].
    """
    shut, drawn_out = gripper.boxes(gripper.opening_least), gripper.boxes(gripper.opening_least, PRESSING.above)
    first, pressing = Boxes(poses[0], *drawn_out), poses[0].copy()
    pressing[:3, 3] += (poses[-1] - poses[0])[:3, 3] * (TUNING.before / np.linalg.norm((poses[-1] - poses[0])[:3, 3]))
    palm = shut[0][-1:], shut[1][-1:]
    return not (
        first.hold(np.vstack([barred, own])).any()
        or Boxes(pressing, *palm).hold(own).any()
        or any(Boxes(X, *shut).hold(barred).any() for X in poses)
    )


def nudge_off(tools: Tools, plan: Nudging) -> str:
    """Push a thing as was planned, and leave it upwards; return how far it went, in words.

    Args:
        tools: of the cell; the hand is empty.
        plan: how.
    """
    mover, cell, nudge = tools.mover, tools.cell, plan.nudge
    poses = tool_poses(nudge, plan.tip, tools.gripper, plan.lean) * np.array([plan.turn, plan.turn, 1.0, 1.0])
    cell.grip(0.0)
    go(cell, mover.timed(plan.way))
    told = f"pushed by {100 * nudge.length:.0f} cm"
    with cell.about(GRASP, plan.places):
        go(cell, mover.timed_line(plan.down, PICKING.slow * 2.0))
        with contextlib.suppress(NoWay):
            free, gone = pressed(tools, poses[0]), list[Array]()
            for X_WT in poses:
                if (pressed(tools, X_WT) - free) @ nudge.along >= TUNING.force:
                    way = float((X_WT - poses[0])[:3, 3] @ nudge.along) - TUNING.before
                    told = f"stuck after {100 * max(way, 0.0):.0f} cm"
                    break
                gone.append(X_WT)
            for X_WT in gone[: -round(TUNING.before / TUNING.step) - 1 : -1]:
                pressed(tools, X_WT)
        lift(mover, cell)
    cell.grip(1.0)
    return told
