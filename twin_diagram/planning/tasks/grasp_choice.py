"""Which grasp a step takes: from above where that can be, else one of those that the object's shape offers.

From above nothing beside the object is in the way, and nothing must be known but its convex pieces; of what is too wide
so, a rim, a handle or a neck is taken, as `planning.grasps` has ranked them. Pure functions.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin_diagram.planning.collision.hand_shape import Palm
from twin_diagram.planning.tasks.grasp_from_above import NO_PALM, grasps_from_above, hindered
from twin_diagram.planning.tasks.grasp_from_above import TUNING as FROM_ABOVE
from twin_diagram.planning.tasks.neighbours import Neighbours
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    known: float = 1.0
    """What a grasp of the shape costs more than one from above: as much as a hand's whole opening."""

    slanted: float = 1.0
    """What one costs more that comes from the side, in proportion to how far it is from coming straight down."""

    turn: float = 0.2
    """Of the angle that the hand must turn, as from above [1/rad]."""

    stand_off: float = 0.006
    """A hand pushed as far as it goes stands back by this [m]: an object a few millimetres off meets no palm."""

    same: tuple[float, float] = (0.03, 0.4)
    """A hand this near to a grasp of the shape has taken that one [m], [rad]."""

    floor: float = 0.008
    """The open hand stays so far above what the object stands on [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class ShapeGrasps:
    """What `planning.grasps` has found for an object and a gripper.

    Attributes:
        poses: (G, 7) X_OG of the tool frame, the best first.
        score: (G,) cost.
        contacts: (G, 2, 3) where the pads meet the object, in O [m]; NaN where that is not known.
        hand: (C, 3) corners of the open hand in G [m].
    """

    poses: Array = field(default_factory=lambda: np.zeros((0, 7)))
    score: Array = field(default_factory=lambda: np.zeros(0))
    contacts: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))
    hand: Array = field(default_factory=lambda: np.zeros((0, 3)))


def choices(
    pieces_O: tuple[Array, ...],
    X_WO: Array,
    opening: float,
    near: Array,
    others: Neighbours,
    shape: ShapeGrasps,
    *,
    symmetric: bool = False,
    palm: Palm = NO_PALM,
) -> Array:
    """Return where the tool could take an object, the best first.

    Args:
        pieces_O: corners (m, 3) of the convex pieces that hold the object [m].
        X_WO: (7) where it is.
        opening: of the fingers at their widest [m].
        near: (4) quaternion of the tool's present turn.
        others: what stands beside it.
        shape: grasps of the object's shape; those whose hand would meet what the object stands on are left out.
        symmetric: whether the object looks the same however it is turned about its own z axis.
        palm: of the hand.

    Returns:
        (G, 7) X_WG; none where nothing offers itself.
    """
    above, cost = grasps_from_above(pieces_O, X_WO, opening, near, others, symmetric=symmetric, palm=palm)
    if not len(shape.poses):
        return above
    R_WO = rotations.matrix(X_WO[:4])
    ground = float((np.concatenate(pieces_O) @ R_WO[2]).min() + X_WO[6])
    R = R_WO @ rotations.matrix(shape.poses[:, :4])
    p = shape.poses[:, 4:] @ R_WO.T + X_WO[4:] - TUNING.stand_off * R[:, :, 2]
    low = (shape.hand @ R.transpose(0, 2, 1))[:, :, 2].min(axis=1) + p[:, 2]
    fine = np.flatnonzero(low > ground + TUNING.floor)
    rows = []
    for k in fine:
        q = rotations.from_matrix(R[k])
        # A hand with two fingers holds the same turned by half a turn about its approach.
        flipped = rotations.from_matrix(R[k] @ np.diag([-1.0, -1.0, 1.0]))
        angle, q = min(
            ((float(np.linalg.norm(rotations.difference(one, near))), one) for one in (q, flipped)), key=lambda e: e[0]
        )
        crowded = hindered(np.array([*q, *p[k]]), opening, palm, others)
        price = TUNING.known + float(shape.score[k] - shape.score.min()) + TUNING.slanted * (1.0 + R[k, 2, 2])
        price += TUNING.turn * angle + FROM_ABOVE.crowded * crowded
        rows.append((price, np.array([*q, *p[k]])))
    every = [*zip(cost, above, strict=True), *rows]
    every.sort(key=lambda entry: entry[0])
    return np.array([X_WG for _, X_WG in every]).reshape(-1, 7)


def between_fingers(shape: ShapeGrasps, X_TO: Array) -> Array | None:
    """Return the points (2, 3) of an object, in O, that the pads meet where a hand at X_TO (7) closes on its shape.

    None where the hand is at none of the shape's grasps, or where it is not known what the pads meet.
    """
    R_TO = rotations.matrix(X_TO[:4])
    if not len(shape.poses):
        return None
    R_OG, p_OG = R_TO.T, -R_TO.T @ X_TO[4:]
    R = rotations.matrix(shape.poses[:, :4])
    off = np.linalg.norm(shape.poses[:, 4:] - TUNING.stand_off * R[:, :, 2] - p_OG, axis=1)
    # Half a turn about the approach is the same grasp.
    cosines = [np.einsum("kij,ij->k", R, R_OG @ flip) for flip in (np.eye(3), np.diag([-1.0, -1.0, 1.0]))]
    angle = np.arccos(np.clip((np.maximum(*cosines) - 1.0) / 2.0, -1.0, 1.0))
    price = off / TUNING.same[0] + angle / TUNING.same[1]
    price[(off > TUNING.same[0]) | (angle > TUNING.same[1])] = np.inf
    price[~np.isfinite(shape.contacts).all(axis=(1, 2))] = np.inf
    best = int(np.argmin(price))
    return shape.contacts[best] if np.isfinite(price[best]) else None
