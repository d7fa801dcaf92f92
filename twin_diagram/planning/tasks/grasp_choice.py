"""Which grasp a step takes: from above where that can be, else one of those that the object's shape offers.

From above nothing beside the object is in the way, and nothing must be known but its convex pieces; of what is too wide
so, a rim, a handle or a neck is taken, as `planning.grasps` has ranked them. Pure functions.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin_diagram.planning.tasks.grasp_from_above import TUNING as FROM_ABOVE
from twin_diagram.planning.tasks.grasp_from_above import crowding, grasps_from_above
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

    crowded: float = 30.0
    """Of how far others reach into the fingers' way, as from above [1/m]."""

    floor: float = 0.008
    """The open hand stays so far above what the object stands on [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class ShapeGrasps:
    """What `planning.grasps` has found for an object and a gripper.

    Attributes:
        poses: (G, 7) X_OG of the tool frame, the best first.
        score: (G,) cost.
        hand: (C, 3) corners of the open hand in G [m].
    """

    poses: Array = field(default_factory=lambda: np.zeros((0, 7)))
    score: Array = field(default_factory=lambda: np.zeros(0))
    hand: Array = field(default_factory=lambda: np.zeros((0, 3)))


def choices(
    pieces_O: tuple[Array, ...],
    X_WO: Array,
    opening: float,
    near: Array,
    others: Array,
    shape: ShapeGrasps,
    *,
    symmetric: bool = False,
) -> Array:
    """Return where the tool could take an object, the best first.

    Args:
        pieces_O: corners (m, 3) of the convex pieces that hold the object [m].
        X_WO: (7) where it is.
        opening: of the fingers at their widest [m].
        near: (4) quaternion of the tool's present turn.
        others: (M, 3) other objects' x, y [m] and radius [m].
        shape: grasps of the object's shape; those whose hand would meet what the object stands on are left out.
        symmetric: whether the object looks the same however it is turned about its own z axis.

    Returns:
        (G, 7) X_WG; none where nothing offers itself.
    """
    above, cost = grasps_from_above(pieces_O, X_WO, opening, near, others, symmetric=symmetric)
    if not len(shape.poses):
        return above
    R_WO = rotations.matrix(X_WO[:4])
    ground = float((np.concatenate(pieces_O) @ R_WO[2]).min() + X_WO[6])
    R = R_WO @ rotations.matrix(shape.poses[:, :4])
    p = shape.poses[:, 4:] @ R_WO.T + X_WO[4:]
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
        ends = [p[k, :2] + side * (0.5 * opening + FROM_ABOVE.finger) * R[k, :2, 1] for side in (-1.0, 1.0)]
        price = TUNING.known + float(shape.score[k] - shape.score.min()) + TUNING.slanted * (1.0 + R[k, 2, 2])
        price += TUNING.turn * angle + TUNING.crowded * crowding(ends, others)
        rows.append((price, np.array([*q, *p[k]])))
    every = [*zip(cost, above, strict=True), *rows]
    every.sort(key=lambda entry: entry[0])
    return np.array([X_WG for _, X_WG in every]).reshape(-1, 7)
