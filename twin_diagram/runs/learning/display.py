"""Shows what is held to the scanning camera: full turns of the last joint at several tilts of the tool's axis.

The masks of object and hand are taken from where the arm's own shapes are; where the object is within the hand they do
not say, `following` does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.errors import TwinError
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.runs.learning.cell import Cell, Picture
from twin_diagram.runs.learning.held_turns import TUNING as TURNS
from twin_diagram.runs.learning.held_turns import Weight, gentlest_first, gentlest_parts, parts_of
from twin_diagram.runs.learning.motion import Mover, NoWay, pointing, pose
from twin_diagram.runs.learning.picking import TUNING as PICKING
from twin_diagram.runs.learning.picking import go
from twin_diagram.runs.learning.steady_picture import refuse_blind
from twin_diagram.scenario import Learning
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    tilts: tuple[float, ...] = (0.87, 0.2, -0.45)
    """Of the tool's axis from straight down towards the camera [rad]: at the first the far end is seen, then the sides
    up to the fingers, then what faces the palm."""

    later_tilts: tuple[float, ...] = (0.5, -0.3)
    """The same in further grasps, which show what the fingers of the first one hid."""

    other_tilts: tuple[float, ...] = (0.87, 0.2, -0.45)
    """Taken in place of these where they show more of what is missing: those of the first grasp, which are reached."""

    nearer: float = 0.12
    """By which it is shown nearer to the arm where the axis leads away from the camera [m]: there the arm reaches."""

    more_tilts: tuple[float, ...] = (0.7, 0.52, 0.35, 0.0)
    """Tried in their place where the arm does not reach one."""

    turn: float = 2.95
    """Of the last joint to both sides [rad]: nearly all of its range, 340° in all; less where its limits are nearer."""

    reach: float = 0.24
    """Farther from the finger tips than this is no part of the object [m]."""

    palm: float = -0.070
    """z in the tool's frame behind which is the hand [m]: the palm's front."""

    beside: float = 0.004
    """Distance from the hand's shapes within which a point is the hand's [m]."""

    least: int = 60
    """Pixels of an object in a picture; fewer show nothing."""

    upright: tuple[float, ...] = (0.0, 0.1, 0.2)
    """Tilts between parts of a turn, of which the first that is reached is gone through [rad]."""

    few: int = 4
    """Pictures of a part of a turn at the least."""


TUNING = Tuning()


@dataclass(frozen=True)
class Allowed:
    """What may be asked of the grip.

    Attributes:
        weight: of what is held.
        limit: share of what may be asked of it, as `Weight.asked` tells it: no less than as it hangs.
        first: whether nothing was shown yet.
    """

    weight: Weight
    limit: float
    first: bool


class NothingHeld(TwinError):
    """The hand is empty where something should be in it."""


@dataclass(frozen=True)
class HeldPicture:
    """One picture of what the hand holds.

    Attributes:
        picture: as taken.
        X_WT: (4, 4) of the tool then, by the joints as measured.
        mask: (H, W) where the object shows.
        hand: (H, W) where the hand does.
        grasp: number of the grasp in which it is held.
    """

    picture: Picture
    X_WT: Array
    mask: Mask
    hand: Mask
    grasp: int

    def points_T(self, stride: int = 1) -> Array:
        """Return the object's points (N, 3) in the tool's frame by the joints alone [m]."""
        rows = self.mask.copy()
        if stride > 1:
            thin = np.zeros_like(rows)
            thin[::stride, ::stride] = True
            rows &= thin
        return (self.picture.points()[rows] - self.X_WT[:3, 3]) @ self.X_WT[:3, :3]


def shown(picture: Picture, X_WT: Array, robot: RobotShape, grasp: int) -> HeldPicture:
    """Return a picture with the masks of object and hand."""
    points = picture.points()
    points_T = (points - X_WT[:3, 3]) @ X_WT[:3, :3]
    near = (np.linalg.norm(points_T, axis=-1) < TUNING.reach) & (picture.depth > 0)
    hand = np.zeros(near.shape, dtype=bool)
    hand[near] = robot.near(points[near], picture.q, TUNING.beside, picture.fingers)
    mask = near & ~hand & (points_T[..., 2] > TUNING.palm)
    mask = _largest(mask)
    return HeldPicture(picture, X_WT, mask, hand | (near & (points_T[..., 2] <= TUNING.palm)), grasp)


def _largest(mask: Mask) -> Mask:
    """Return a mask without specks: parts that are much smaller than its largest."""
    count, label, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    if count < 2:
        return mask
    size = stats[1:, cv2.CC_STAT_AREA]
    kept = 1 + np.flatnonzero(size >= max(TUNING.least, 0.02 * size.max()))
    return np.asarray(np.isin(label, kept))


def display(
    mover: Mover,
    cell: Cell,
    learning: Learning,
    robot: RobotShape,
    grasp: int,
    tilts: tuple[float, ...] = TUNING.tilts,
    during: Callable[[float], None] | None = None,
    weight: Weight | None = None,
) -> list[HeldPicture]:
    """Show what is held, a full turn of the last joint at each tilt, and return the pictures.

    Where the weight would turn it between the fingers, a turn is gone along in parts that hold it, and what leans least
    is shown first. Where nobody felt it yet, it has turned as it was lifted, or may: then it is first turned as it
    hangs, which asks nothing of the pads, and pictures tell how it hangs.

    Args:
        mover: plans; it knows what is held.
        cell: whose arm holds something.
        learning: where, how fast, how many pictures.
        robot: the arm's own shapes.
        grasp: number of this one.
        tilts: of the tool's axis towards the camera [rad].
        during: is told each tick's time since the begin of its turn [s]: for who feels what is held, or meddles.
        weight: of what is held; None: nobody knows, and all of each turn is gone along.

    Raises:
        NoWay: the arm cannot show it at any tilt.
        NothingHeld: it fell before the first turn, or no picture shows anything in the hand.
        StationError: the camera measured nothing.
    """
    taken: list[HeldPicture] = []
    ways = 0
    hanging, asked = mover.tool(cell.commanded)[None, :3, :3], None
    order = tilts if weight is None else gentlest_first(tilts)
    if weight is not None and not weight.held_all_round(tool_at(learning, order[0])[:3, :3]):
        order = (0.0, *order[1:])
    for tilt in order:
        if weight is not None and (ways or tilt != 0.0):
            weight = weight.seen(np.concatenate([np.zeros((0, 3)), *(one.points_T(4) for one in taken)]))
            # As it hangs it is held, which tells no more than what is known of where it pulls.
            asked = Allowed(weight, max(1.0, float(weight.asked(hanging)[0])), first=not ways)
        tries = (tilt, *TUNING.more_tilts) if tilt == tilts[0] else (tilt,)
        for part in _reached(mover, cell, learning, TUNING.upright if tilt == 0.0 else tries, asked):
            ways += 1
            if not taken and cell.opening < PICKING.empty:
                raise NothingHeld("it fell on its way to the camera")
            taken += _turn(mover, cell, learning, robot, grasp, part, during)
    if not ways:
        raise NoWay("cannot be shown to the camera: no posture is reached")
    refuse_blind(learning.scan_camera, *(one.picture.depth for one in taken))
    good = [one for one in taken if int(one.mask.sum()) >= TUNING.least]
    if not good:
        raise NothingHeld("no picture shows anything in the hand")
    return good


def tool_at(learning: Learning, tilt: float) -> Array:
    """Return the pose X_WT (4, 4) of the tool in the middle of a turn before the camera, its axis tilted [rad]."""
    approach = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    place = np.array(learning.display) - [TUNING.nearer if tilt < -0.1 else 0.0, 0.0, 0.0]
    return pose(pointing(approach, np.array([0.0, 1.0, 0.0])), place)


def _reached(
    mover: Mover,
    cell: Cell,
    learning: Learning,
    tilts: tuple[float, ...],
    asked: Allowed | None,
) -> Iterator[tuple[float, float]]:
    """Go to where each part of a turn at the first tilt that is reached begins, and yield it; nothing: none is reached.

    Args:
        mover: plans.
        cell: whose arm holds something.
        learning: where it is shown.
        tilts: of which the first that is reached is taken [rad].
        asked: of the grip; None: nobody knows.
    """
    ends = _ends(mover)
    for tilt in tilts:
        begun = False
        for goals, parts in _turns_at(mover, cell, learning, tilt, ends, asked):
            for part in parts:
                # It begins at the end that is nearer; the last joint hardly changes what the arm is near to.
                begin = part if cell.commanded[-1] < np.mean(part) else part[::-1]
                goals[:, -1] = begin[0]
                try:
                    if part != ends:
                        _upright(mover, cell, learning, begin[0])
                    go(cell, mover.timed(mover.path(cell.commanded, goals)))
                except NoWay:
                    continue
                begun = True
                yield begin
                if part != ends:
                    _upright(mover, cell, learning, begin[1])
            if begun:
                return


def _turns_at(
    mover: Mover,
    cell: Cell,
    learning: Learning,
    tilt: float,
    ends: tuple[float, float],
    asked: Allowed | None,
) -> Iterator[tuple[Array, list[tuple[float, float]]]]:
    """Yield joint angles (G, n) at a tilt [rad], and parts of the last joint's turn there that hold; whole ones first.

    Arguments as of `_reached`; `ends`: between which it turns.
    """
    goals = _clear(mover, cell, learning, tilt, ends)
    if asked is None:
        yield goals, [ends]
        return
    parts = [_held_parts(mover, q, ends, asked) for q in goals]
    whole = np.array([few == [ends] for few in parts], dtype=bool)
    if whole.any():
        yield goals[whole], [ends]
    for q, few in zip(goals[~whole], [few for few in parts if few != [ends]], strict=True):
        yield q[None].copy(), few


def _clear(mover: Mover, cell: Cell, learning: Learning, tilt: float, ends: tuple[float, float]) -> Array:
    """Return joint angles (G, n) at a tilt [rad] about which the last joint turns freely, the nearest first."""
    goals = mover.goals(tool_at(learning, tilt), cell.commanded)
    if not len(goals):
        return goals
    turned = np.repeat(goals[:, None], 9, axis=1)
    turned[:, :, -1] = np.linspace(*ends, 9)
    clear = mover.free(turned.reshape(-1, goals.shape[1]), 0.005).reshape(len(goals), 9).all(axis=1)
    return np.asarray(goals[clear])


def _held_parts(mover: Mover, q: Array, ends: tuple[float, float], asked: Allowed) -> list[tuple[float, float]]:
    """Return from where to where the last joint may turn at joint angles (n,) [rad]; see `parts_of`.

    Where no part is held short ones are gone along that ask little more, and at first the gentlest, whatever they ask:
    what nobody sees cannot be taken in another grasp.
    """
    angles = np.linspace(*ends, 120)
    turned = np.repeat(q[None], len(angles), axis=0)
    turned[:, -1] = angles
    chain = mover.scene.chain
    share = asked.weight.asked(chain.tool(chain.place(turned))[:, :3, :3])
    if (share <= asked.limit).all():
        return [ends]
    most = np.inf if asked.first else asked.limit + TURNS.more
    return parts_of(share <= asked.limit, angles) or gentlest_parts(share, angles, most)


def _upright(mover: Mover, cell: Cell, learning: Learning, last: float) -> None:
    """Have the tool hang down where things are shown, at first with its last joint as it is, then at an angle [rad].

    Raises:
        NoWay: there is none.
    """
    for tilt in TUNING.upright:
        goals = mover.goals(tool_at(learning, tilt), cell.commanded)
        if not len(goals):
            continue
        for angle in (float(cell.commanded[-1]), last):
            goals[:, -1] = angle
            go(cell, mover.timed(mover.path(cell.commanded, goals)))
        return
    raise NoWay("the tool does not hang down where things are shown")


def _ends(mover: Mover) -> tuple[float, float]:
    """Return from where to where the last joint turns [rad]: within its limits, both sides of 0 as a rule."""
    return max(-TUNING.turn, float(mover.lower[-1])), min(TUNING.turn, float(mover.upper[-1]))


def _turn(
    mover: Mover,
    cell: Cell,
    learning: Learning,
    robot: RobotShape,
    grasp: int,
    part: tuple[float, float],
    during: Callable[[float], None] | None,
) -> list[HeldPicture]:
    """Turn the last joint from one end of a part of its turn to the other [rad], and take pictures on the way."""
    q, ends = cell.commanded, _ends(mover)
    end = q.copy()
    end[-1] = part[1]
    took = float(abs(end[-1] - q[-1])) / learning.turn_speed
    count = max(2, int(np.ceil(took / 0.02)))
    s = np.arange(count + 1) / count
    # Even speed but for both ends: a blend of 10 % of the way each.
    ramp = np.interp(s, [0.0, 0.1, 0.9, 1.0], [0.0, 1.0, 1.0, 0.0])
    blend = np.concatenate([[0.0], np.cumsum(0.5 * (ramp[1:] + ramp[:-1]))])
    blend /= blend[-1]
    share = abs(part[1] - part[0]) / (ends[1] - ends[0])
    due = list(np.linspace(0.0, took, max(round(share * learning.frames), min(TUNING.few, learning.frames))))
    pictures: list[HeldPicture] = []

    def look(now: float) -> None:
        if during is not None:
            during(now)
        if due and now >= due[0] - 1e-9:
            due.pop(0)
            picture = cell.look(learning.scan_camera)
            pictures.append(shown(picture, mover.tool(picture.q), robot, grasp))

    cell.follow(took * s, q + blend[:, None] * (end - q), look)
    return pictures
