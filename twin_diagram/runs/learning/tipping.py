"""Tips up what lies flat and is wider than the hand opens: shut fingers push it to a wall and raise its near side.

Pressed against one of its sides, as hard as the arm's torques tell, the fingers lift that side by friction; see
`flat_things` for the way.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.planning.grasps import Gripper
from twin_diagram.runs.learning.beside_bin import things_in_bin
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.cell import GRASP, Picture
from twin_diagram.runs.learning.flat_things import TUNING as FLAT
from twin_diagram.runs.learning.flat_things import FlatThing, may_be_tipped, pushes_of, way_of
from twin_diagram.runs.learning.handling import Tools
from twin_diagram.runs.learning.in_the_way import in_the_way
from twin_diagram.runs.learning.motion import NoWay, pointing, pose
from twin_diagram.runs.learning.picking import TUNING as PICKING
from twin_diagram.runs.learning.picking import go, lift
from twin_diagram.runs.learning.pressing import TUNING as PRESSING
from twin_diagram.runs.learning.pressing import begun_at, pressed
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    force: float = 40.0
    """With which its side is pressed [N]: of 1.2 kg half hang on friction there, and the wall presses it down again."""

    yielding: float = 1.3e-4
    """By which fingers are told to go farther, a newton that is missing and a step [m]: a fifth of what an iiwa's
    impedance yields."""

    deepest: float = 0.06
    """By which at the most they are told to go into it [m]."""

    after: float = 0.02
    """By which it is pushed on then [m]."""

    away: tuple[float, float] = (0.05, 0.05)
    """By which the fingers leave it, back and up [m]."""


TUNING = Tuning()


def tool_poses(flat: FlatThing, way: Array, gripper: Gripper) -> Array:
    """Return poses (M, 4, 4) of a tool that points down, its leading edge on a way (M, 2), flat on the near side."""
    R = pointing(np.array([0.0, 0.0, -1.0]), flat.across)
    places = [
        (s - 0.5 * gripper.finger_width) * flat.along
        + flat.middle * flat.across
        + np.array([0.0, 0.0, z + gripper.finger_front])
        for s, z in way
    ]
    return np.array([pose(R, place) for place in places])


@dataclass(frozen=True)
class Tipping:
    """How something flat is tipped up, as planned.

    Attributes:
        flat: as it lies.
        places: (K, 3) of it in W, all over what is seen of it [m].
        turn: 1 or -1: of both turns of the fingers, which are alike, the one that is reached.
        way: (W, n) joint angles to above where the push begins [rad].
        down: (M, n) from there to it.
        there, raised: see `way_of`.
    """

    flat: FlatThing
    places: Array
    turn: float
    way: Array
    down: Array
    there: Array
    raised: Array


def plan_tipping(tools: Tools, thing: SeenThing, picture: Picture) -> Tipping | None:
    """Return how a flat thing is pushed to a wall and tipped up there; None: it is not flat, or has no wall or room.

    Args:
        tools: of the cell; the hand is empty.
        thing: as it lies.
        picture: in which it was seen; all else in it is in the way.
    """
    if thing.beside:
        return None
    low, high = (np.array(corner) for corner in tools.learning.from_bin)
    rest = [
        one.points for one in things_in_bin(picture, tools.learning, tools.robot) if (one.middle != thing.middle).any()
    ]
    tools.mover.stand("bin", [thing.points, *rest], float(low[2]))
    pushes = [one for one in pushes_of(thing, low, high) if may_be_tipped(one, tools.gripper, float(high[2]))]
    barred = in_the_way(low, high, rest)[0]
    others = np.concatenate([np.zeros((0, 3)), *rest])
    # A wall holds a far edge more surely than a corner does.
    for flat in sorted(pushes, key=lambda one: (not one.to_wall, one.wall - one.far - one.tilt)):
        there, raised = way_of(flat)
        poses = tool_poses(flat, np.vstack([there, raised[:, :2]]), tools.gripper)
        if not is_clear(flat, poses, tools.gripper, barred, others):
            continue
        for turn in (1.0, -1.0):
            begun = begun_at(tools, poses * np.array([turn, turn, 1.0, 1.0]))
            if begun is not None:
                return Tipping(flat, thing.some, turn, *begun, there, raised)
    return None


def tip_up(tools: Tools, plan: Tipping) -> None:
    """Push something flat to a wall and tip it up there, as far as it goes.

    Args:
        tools: of the cell; the hand is empty.
        plan: how.
    """
    mover, cell = tools.mover, tools.cell
    cell.grip(0.0)
    go(cell, mover.timed(plan.way))
    with cell.about(GRASP, plan.places):
        go(cell, mover.timed_line(plan.down, PICKING.slow * 2.0))
        with contextlib.suppress(NoWay):
            _Push(tools, plan.flat, plan.turn).raise_side(plan.there, plan.raised)
        lift(mover, cell)
    cell.grip(1.0)


@dataclass
class _Push:
    """Shut fingers beside a flat thing: goes from place to place and feels how hard they press by torques."""

    tools: Tools
    flat: FlatThing
    turn: float

    def raise_side(self, there: Array, raised: Array) -> None:
        """Go to its side until it presses back, and raise that, pressing evenly; see `way_of`.

        Raises:
            NoWay: where the fingers would have to go farther than the arm reaches; it is at rest.
        """
        free = self._pressed(there[0])
        ahead = np.array([[k * FLAT.step, 0.0] for k in range(1 + int(TUNING.deepest / FLAT.step))])
        for place in np.vstack([there[1:], there[-1] + ahead]):
            at = place
            if (self._pressed(at) - free) @ self.flat.along >= TUNING.force:
                break
        deep = 0.0
        for s, z, tilt in raised - [*(raised[0, :2] - at), 0.0]:
            inwards = np.array([np.cos(tilt), -np.sin(tilt)])
            force = self._pressed(np.array([s, z]) + deep * inwards) - free
            lacks = TUNING.force - float(force @ (inwards[0] * self.flat.along + [0.0, 0.0, inwards[1]]))
            deep = float(np.clip(deep + TUNING.yielding * lacks, -TUNING.deepest, TUNING.deepest))
        self._pressed(np.array([s + TUNING.after, z]))
        self._pressed(np.array([s - TUNING.away[0], z + TUNING.away[1]]), 10.0)

    def _pressed(self, place: Array, longer: float = 1.0) -> Array:
        """Go to a place (2,), see `way_of`, and return the force (3,) with which the fingers press in W [N]."""
        turn = np.array([self.turn, self.turn, 1.0, 1.0])
        return pressed(self.tools, tool_poses(self.flat, place[None], self.tools.gripper)[0] * turn, longer)


def is_clear(flat: FlatThing, poses: Array, gripper: Gripper, barred: Array, others: Array) -> bool:
    """Return whether nothing else is in the hand's way, nor between a flat thing and its wall.

    Args:
        flat: that is pushed.
        poses: (M, 4, 4) of the tool on its way.
        gripper: whose fingers are shut.
        barred: (N, 3) points that the hand keeps clear of [m].
        others: (K, 3) points of other things [m].
    """
    s, left = others @ flat.along, others @ flat.across
    if ((s > flat.far) & (np.abs(left - flat.middle) < 0.5 * flat.length)).any():
        return False
    shut = gripper.boxes(gripper.opening_least)
    drawn_out = gripper.boxes(gripper.opening_least, PRESSING.above)
    return not (
        Boxes(poses[0], *drawn_out).hold(barred).any() or any(Boxes(X, *shut).hold(barred).any() for X in poses)
    )
