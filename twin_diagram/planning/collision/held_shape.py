"""What the hand holds, for the planner: part of the arm's shape, and no obstacle. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.planning.collision.ball_cover import TUNING as BALL_COVER
from twin_diagram.planning.collision.ball_cover import Balls, box_cover
from twin_diagram.planning.collision.collision_scene import Forecast, Scene
from twin_diagram.planning.collision.convex_solids import bounding_box
from twin_diagram.planning.collision.unsure_pose import Unsure
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus
from twin_diagram.signals.pose_vectors import as_matrix, from_matrix
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, THING_SIZE, things_of


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    links_apart: int = 2
    """Links of the arm so many joints or more before the last can meet what the hand holds; nearer ones cannot."""

    misnamed: float = 0.03
    """What is seen within an object's radius and this of where the hand is about it is that object [m]: half covered
    by the fingers it may look like something else."""

    own: float = 0.01
    """An unknown thing that was there before the fingers came is a part of the object only where its middle lies within
    the object's box and this [m]: as far as an estimated pose and a part's middle are off."""

    at_fingers: float = 0.07
    """What comes nearer than this to the tool is at the fingers [m]: open they reach so far to either side, and what is
    5 cm beside the flat of the hand is farther."""


TUNING = Tuning()


@dataclass(frozen=True)
class ObjectBox:
    """The box about an object where it is: X_WO (7), and half its edges (3,) [m]."""

    X_WO: Array
    half: Array

    def to(self, p_W: Array) -> float:
        """Return how far a point (3,) of W is from the box [m]; 0: inside."""
        p_O = rotations.matrix(self.X_WO[:4]).T @ (p_W - self.X_WO[4:])
        return float(np.linalg.norm(np.maximum(np.abs(p_O) - self.half, 0.0)))

    def ball_to(self, p_W: Array) -> float:
        """Return how far a point (3,) of W is from the ball about the box [m]; negative: inside."""
        return float(np.linalg.norm(p_W - self.X_WO[4:]) - np.linalg.norm(self.half))


def holding(scene: Scene, pieces_O: Sequence[Array], hand: Hand) -> Scene:
    """Return the scene of an arm that holds an object: the object's cover moves with its last link.

    What is not known of its place and its turn in the hand makes it larger, as it does where things stand.

    Args:
        scene: with an empty hand.
        pieces_O: corners (m, 3) of the object's convex pieces [m].
        hand: what is held, and whether that may touch what stands still, and what bears it.
    """
    n = scene.chain.size
    X_TO = as_matrix(hand.X_TO)
    X_LO = scene.chain.X_LT @ X_TO
    shape = scene.clearance.bodies[scene.fixture_count + hand.held]
    grown = Unsure.of(hand.covariance, X_TO[:3, :3], shape, moving=False).now
    centres, radii = [], []
    for piece in pieces_O:
        box = bounding_box(np.asarray(piece))
        for centre, radius, _ in box_cover(2 * box.half, BALL_COVER.overhang):
            centres.append(X_LO[:3, :3] @ (centre + box.p_GB) + X_LO[:3, 3])
            radii.append(radius + grown)
    count = len(radii)
    cover = Balls(np.array(centres), np.array(radii), np.full(count, n), np.zeros(count, int), np.zeros((0, 2), int))
    unseen = list(range(scene.fixture_count)) if hand.on_support else []
    if hand.on_support and hand.support != NOTHING:
        unseen.append(scene.fixture_count + hand.support)
    return replace(scene, clearance=scene.clearance.carrying(cover, n - TUNING.links_apart, unseen))


def obstacles_beside(
    hand: Hand, X_WT: Array, sizes: Array, tracks: Array, further: Array | None, things: Array | None
) -> tuple[Array, Array | None, Array | None]:
    """Return tracks and things without what the hand holds or may touch.

    What an image shows at its place under another name goes with it; what stands beside it stays. Two instances part
    where neither can be within the other; an unknown thing is told by when it was seen first.

    Args:
        hand: what it is about.
        X_WT: (4, 4) the tool.
        sizes: (K, 3) edges of boxes about the library's objects, in their own axes [m].
        tracks: (K · TRACK_SIZE,)
        further: (F · FURTHER_TRACK_SIZE,) or None.
        things: (T · THING_SIZE,) or None.
    """
    about = [k for k in (hand.held, hand.touched) if k != NOTHING]
    if not about:
        return tracks, further, things
    rows = tracks.reshape(-1, TRACK_SIZE).copy()
    # What the fingers are around is there, also when an image that shows it as something unknown calls it gone.
    lost = hand.around & np.isin(rows[:, 0], [float(ObjectStatus.UNSEEN), float(ObjectStatus.GONE)])
    X_WH = from_matrix(X_WT @ as_matrix(hand.X_TO))
    boxes = [ObjectBox(X_WH if k == hand.held or lost[k] else rows[k, 2:9].copy(), 0.5 * sizes[k]) for k in about]
    rows[about, 0] = float(ObjectStatus.GONE)

    def misnamed(p_W: Array, beyond: float) -> bool:
        """Tell whether what has its middle there is what the hand is about: no farther than so from its box."""
        return any(box.ball_to(p_W) < TUNING.misnamed and box.to(p_W) < beyond for box in boxes)

    if further is not None and len(further):
        more = further.reshape(-1, FURTHER_TRACK_SIZE).copy()
        for row in more:
            half = 0.5 * float(sizes[int(row[1])].min()) if row[1] < len(sizes) else np.inf
            if row[0] > 0 and misnamed(row[OWNER_SIZE + 6 : OWNER_SIZE + 9], half):
                row[0] = 0.0
        further = more.ravel()
    if things is not None and np.isfinite(things).all():
        seen = things.reshape(-1, THING_SIZE).copy()
        for row, thing in zip(seen, things_of(things), strict=True):
            beyond = TUNING.own if thing.first_seen < hand.since else np.inf
            if thing.stands and misnamed(thing.middle + thing.shift, beyond):
                row[:] = 0.0
        things = seen.ravel()
    return rows.ravel(), further, things


def at_rest(
    p_WT: Array, tracks: Array, further: Array | None, things: Array | None
) -> tuple[Array, Array | None, Array | None]:
    """Return tracks and things without those that move, for a hand at `p_WT` (3) that gives way to none.

    An unknown thing at the fingers themselves stays: mostly a part of what they let go, and to be backed out of. Other
    arguments as of `obstacles_beside`.
    """
    rows = tracks.reshape(-1, TRACK_SIZE).copy()
    rows[Forecast.of_tracks(rows).moving, 0] = float(ObjectStatus.GONE)
    if further is not None and len(further):
        more = further.reshape(-1, FURTHER_TRACK_SIZE).copy()
        more[Forecast.of_tracks(more[:, OWNER_SIZE:]).moving, 0] = 0.0
        further = more.ravel()
    if things is not None and np.isfinite(things).all():
        seen = things.reshape(-1, THING_SIZE).copy()
        for row, thing in zip(seen, things_of(things), strict=True):
            if not thing.velocity.any():
                continue
            corners = np.concatenate([thing.middle[None], *thing.pieces]) + thing.shift
            if np.linalg.norm(corners - p_WT, axis=1).min() > TUNING.at_fingers:
                row[:] = 0.0
        things = seen.ravel()
    return rows.ravel(), further, things
