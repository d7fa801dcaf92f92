"""Grasps from above of an object whose convex pieces are known: the plainest that there are.

What cannot be taken so, `grasp_choice` takes as the object's shape offers. The tool frame lies between the finger tips:
z along the approach, y along the fingers' opening.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.planning.collision.hand_shape import Palm
from twin_diagram.planning.tasks.neighbours import Neighbours
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    turns: int = 8
    """Directions of closing that are tried over half a turn: every 22.5°."""

    spare: float = 0.008
    """The open fingers are wider than the object by this in all [m]: a few millimetres of error on each side."""

    depth: float = 0.03
    """The finger tips reach this far below the object's top [m] …"""

    palm: float = 0.005
    """The palm stays this far above the object's top [m]: what an estimated pose is off by at the most."""

    bottom: float = 0.02
    """… but stay this far above its bottom [m]."""

    tip: float = 0.012
    """The finger tips reach this far below the tool's origin [m]: 9 or 10 mm of those that come along, and some room.
    What is lower is not between them, however wide it is: the body of a bottle that is taken by its neck."""

    reach: float = 0.01
    """So far below the tool's origin the tips truly reach [m]. A hand that took a neck is by `tip` above the body: with
    the same bound for what the fingers closed on, a hair's breadth of error would say that it is the body."""

    hold: float = 0.018
    """What is between the fingers is at least this tall [m]: most of a pad."""

    lying: float = 0.1
    """An axis that is level by this much (its sine) tells how a round thing that lies or leans is turned."""

    finger: float = 0.025
    """Half of what an open finger with its pad takes up beyond the opening [m]: to tell who is in its way."""

    crowded: float = 100.0
    """What a grasp costs more for each [m] that others reach into where the hand comes to be: at 2 cm the planner finds
    no way at all, and at one it finds few, so that a grasp from the side that is free goes first."""

    room: float = 0.02
    """The palm stays so far from what stands beside [m]: 10 mm that planners keep, 8 by which their balls stand out."""

    shifts: tuple[float, ...] = (-0.01, 0.01, -0.02, 0.02)
    """Where something is in the way over the middle, it is taken so far along its sides as well [m]; what weighs 0.5 kg
    turns a hand that holds it 2 cm off by a degree …"""

    shifted: float = 5.0
    """… at this price [1/m]: two centimetres, a quarter of a turn and a half of the hand."""

    pad: float = 0.01
    """Half of a pad, along the sides that it meets [m]."""

    square: float = 0.1
    """Pads are met by sides that slant by no more than this [1]: a fifth of the least friction of what is taken."""


TUNING = Tuning()
NO_PALM: Final = Palm()
"""Of a hand of which nobody knows more than its fingers."""


def grasps_from_above(
    pieces_O: tuple[Array, ...],
    X_WO: Array,
    opening: float,
    near: Array,
    others: Neighbours,
    *,
    symmetric: bool = False,
    palm: Palm = NO_PALM,
) -> tuple[Array, Array]:
    """Return where the tool could take an object from above, the best first, and what each costs.

    Args:
        pieces_O: corners (m, 3) of the convex pieces that hold the object [m].
        X_WO: (7) where it is.
        opening: of the fingers at their widest [m].
        near: (4) quaternion of the tool's present turn: of grasps equally good the one that turns least is the best.
        others: what fingers and palm should not come near.
        symmetric: whether the object looks the same however it is turned about its own z axis.
        palm: of the hand.

    Returns:
        (G, 7) X_WG, none where it is too wide, whichever way it is taken; (G,) costs.
    """
    R_WO = rotations.matrix(X_WO[:4])
    pieces = [piece @ R_WO.T + X_WO[4:] for piece in pieces_O]
    heights = _heights(pieces, min(TUNING.depth, palm.free - TUNING.reach - TUNING.palm))
    heading = _heading(R_WO, symmetric=symmetric)
    found: list[tuple[float, Array]] = []
    for turn in heading + np.arange(TUNING.turns) * np.pi / TUNING.turns:
        closing, along = np.array([-np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), np.sin(turn)])
        for z in heights:
            between = np.concatenate([piece for piece in pieces if piece[:, 2].max() > z - TUNING.tip + 1e-9])
            across, length = between[:, :2] @ closing, between[:, :2] @ along
            width = float(np.ptp(across))
            if width <= opening - TUNING.spare:
                break
        else:
            continue
        middle = 0.5 * (across.max() + across.min()) * closing + 0.5 * (length.max() + length.min()) * along
        down = _pointing_down(turn)
        places = [(0.0, hindered(np.array([*down, *middle, z]), opening, palm, others))]
        if places[0][1] > 0.0:
            for shift in TUNING.shifts:
                if _square(across, length - along @ middle, shift):
                    X_WG = np.array([*down, *(middle + shift * along), z])
                    places.append((shift, hindered(X_WG, opening, palm, others)))
        for shift, crowded in places:
            for q in (down, _pointing_down(turn + np.pi)):
                angle = float(np.linalg.norm(rotations.difference(q, near)))
                # A narrow side first; a neighbour in the way weighs more than any turn of the hand.
                price = width / opening + 0.2 * angle + TUNING.crowded * crowded + TUNING.shifted * abs(shift)
                found.append((price, np.array([*q, *(middle + shift * along), z])))
    found.sort(key=lambda entry: entry[0])
    return np.array([X_WG for _, X_WG in found]).reshape(-1, 7), np.array([price for price, _ in found])


def _heading(R_WO: Array, *, symmetric: bool) -> float:
    """Return the direction of an object's sides from above [rad], up to quarter turns; of what is round, its axis'."""
    level = np.linalg.norm(R_WO[:2], axis=0)
    if symmetric:
        return float(np.arctan2(R_WO[1, 2], R_WO[0, 2])) if level[2] > TUNING.lying else 0.0
    # Of what lies on its side the x axis may stand upright, and says nothing.
    axis = 0 if level[0] > np.sqrt(0.5) else int(level.argmax())
    return float(np.arctan2(R_WO[1, axis], R_WO[0, axis]))


def _heights(pieces_W: list[Array], depth: float) -> list[float]:
    """Return the heights at which the tool may take an object [m], the lowest first.

    As deep as the fingers go, and just above each piece that lies lower than the top: where that is too wide for the
    open fingers, what stands above it may not be.

    Args:
        pieces_W: corners (m, 3) of its convex pieces in W [m].
        depth: of the tool below the object's top, at the most [m].
    """
    tops = np.array([piece[:, 2].max() for piece in pieces_W])
    low, high = min(float(piece[:, 2].min()) for piece in pieces_W), float(tops.max())
    deep = max(high - depth, min(low + TUNING.bottom, 0.5 * (low + high)))
    above = sorted(float(top) + TUNING.tip for top in tops if top <= high - TUNING.hold)
    return [deep, *(z for z in above if z > deep)]


def hindered(X_WG: Array, opening: float, palm: Palm, others: Neighbours) -> float:
    """Return how far others reach into where open fingers and palm come to be, at worst [m]; 0: they are in no way.

    Args:
        X_WG: (7) where the tool takes the object.
        opening: of the fingers at their widest [m].
        palm: of the hand.
        others: what stands beside the object.
    """
    R_WG, p_WG = rotations.matrix(X_WG[:4]), X_WG[4:]
    aside = (0.5 * opening + TUNING.finger) * R_WG[:2, 1]
    worst = others.discs(np.stack([p_WG[:2] - aside, p_WG[:2] + aside]), TUNING.finger)
    if not len(palm.corners):
        return worst
    return max(worst, others.body(palm.corners @ R_WG.T + p_WG, TUNING.room))


def _square(across: Array, along: Array, shift: float) -> bool:
    """Tell whether pads that are shifted along an object's sides meet them squarely.

    Args:
        across: (m,) its corners in the direction of closing [m].
        along: (m,) and along its sides [m], from the middle.
        shift: along them [m].
    """
    at = shift + TUNING.pad * np.array([-1.0, 0.0, 1.0])
    if at[0] < along.min() - 1e-9 or at[2] > along.max() + 1e-9:
        return False
    left, right = along[:, None, None], along[None, :, None]
    spans = (left <= at + 1e-9) & (right >= at - 1e-9)
    share = np.clip((at - left) / np.maximum(right - left, 1e-9), 0.0, 1.0)
    for side in (across, -across):
        edge = side[:, None, None] + share * (side[None, :, None] - side[:, None, None])
        reached_at = np.where(spans, edge, -np.inf).max(axis=(0, 1))
        if np.ptp(reached_at) > 2.0 * TUNING.pad * TUNING.square:
            return False
    return True


def _pointing_down(turn: float) -> Array:
    """Return the quaternion of a tool that points down, its x axis at an angle to W's [rad]."""
    c, s = np.cos(turn), np.sin(turn)
    return rotations.from_matrix(np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]]))


def reached(pieces_O: tuple[Array, ...], X_TO: Array) -> tuple[Array, ...]:
    """Return those pieces of an object at X_TO (7) that come up to the finger tips; all of them where none does.

    Args:
        pieces_O: corners (m, 3) of its convex pieces, in O [m].
        X_TO: its pose in the tool's frame.
    """
    z_O = rotations.matrix(X_TO[:4])[2]
    near = tuple(piece for piece in pieces_O if float((piece @ z_O).min()) + X_TO[6] < TUNING.reach)
    return near or pieces_O


def centred(X_TO: Array, covariance: Array, pieces_O: tuple[Array, ...], known: float) -> tuple[Array, Array]:
    """Return the pose of an object in the tool's frame once the fingers have closed on it, and its covariance.

    Fingers that move together put what is between them in the middle: along y it is known as well as they are.

    Args:
        X_TO: (7) before.
        covariance: (6, 6) of it, rotation then translation.
        pieces_O: corners (m, 3) of its convex pieces, or of what of it is between the fingers [m].
        known: standard deviation along y afterwards [m].
    """
    y = (np.concatenate(pieces_O) @ rotations.matrix(X_TO[:4]).T)[:, 1] + X_TO[5]
    off = 0.5 * float(y.max() + y.min())
    after = X_TO.copy()
    after[5] -= off
    # A measurement of y alone, as a filter takes one in.
    gain = covariance[:, 4] / (covariance[4, 4] + known**2)
    return after, covariance - np.outer(gain, covariance[4])
