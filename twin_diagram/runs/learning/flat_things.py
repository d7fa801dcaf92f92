"""What lies flat in a bin, as a picture shows it, and how its near side is raised while its far side is at a wall.

The far side slides down the wall and out from under it, like a ladder. In the end it stands on what was its far side,
and is as wide as it was thick. With thickness h and length L along the push, tilted by θ, its far lower edge is h sin θ
off the wall, and what is z high at its near side while it lies flat is (z sin θ − L cos θ, L sin θ + z cos θ) from that
edge, along the push and up.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from twin_diagram.planning.grasps import Gripper
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    plane: float = 0.006
    """Points within this of its upper face are that face's [m]."""

    face: float = 0.6
    """Share of a thing's points on one plane from which it is flat."""

    tilts: tuple[float, float] = (-0.1, 0.6)
    """Of its upper face before it is tipped, the near side up [rad]; what is steeper leans as a ladder does."""

    across: float = 0.3
    """Slope of its upper face across the push at the most."""

    thinnest: float = 0.025
    """What is thinner has no side to press on [m]."""

    spare: float = 0.02
    """By which the hand opens wider than it is thick, and by which it then stands out over the walls [m]."""

    at_wall: float = 0.015
    """What is as near to a wall in a picture touches it [m]: the strip beside a wall counts as the wall's."""

    turned: float = 0.35
    """What lies turned by more than this against the walls may also be pushed along its own edges, into a corner [rad]:
    at 20° pushes towards a wall were tried, at 45° one into a corner."""

    before: float = 0.02
    """Of its side, the fingers come down [m]."""

    height: float = 0.7
    """Of the finger tips along its side, over its thickness: the wall presses on its upper edge, and what is pressed
    below that is pressed down."""

    upright: float = 1.4
    """Tilt up to which the near side is raised [rad]; from there it falls to the wall by itself."""

    step: float = 0.004
    """Between points of the way [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class FlatThing:
    """Something flat as it lies before a push towards a wall, along which places are measured in W.

    Attributes:
        along: (3,) of the push.
        middle: of its near side, to the left of the push [m].
        near: edge of its upper face where the push begins [m].
        far: the opposite one, the wall's where it touches that.
        wall: where the wall is, or where a corner's walls hold its far edge.
        floor: height of what it lies on [m].
        length: of its upper face along the push [m].
        thickness: over the floor, at the far side [m].
        tilt: of its upper face, the near side up [rad].
    """

    along: Array
    middle: float
    near: float
    far: float
    wall: float
    floor: float
    length: float
    thickness: float
    tilt: float

    @property
    def across(self) -> Array:
        """(3,) to the left of the push."""
        return np.cross([0.0, 0.0, 1.0], self.along)

    @property
    def to_wall(self) -> bool:
        """Whether it is pushed straight to one wall, not into a corner."""
        return bool(np.abs(self.along[:2]).min() < 1e-6)

    def pressed(self, tilt: float) -> Array:
        """Return where (2,) along the push and up in W its near side is pressed at a tilt, once it is at the wall."""
        z, c, s = TUNING.height * self.thickness, np.cos(tilt), np.sin(tilt)
        edge = np.array([self.wall - self.thickness * s, self.floor])
        return np.asarray(edge + [z * s - self.length * c, self.length * s + z * c])


def upper_face(thing: SeenThing) -> tuple[Array, Array] | None:
    """Return a flat thing's upper face, z = plane · (x, y, 1), as plane (3,) and points (N, 3) [m]; None: it has none.

    Args:
        thing: as a picture shows it.
    """
    columns = np.column_stack([thing.points[:, :2], np.ones(len(thing.points))])
    slopes = -np.median(thing.normals[:, :2] / np.maximum(thing.normals[:, 2:], 0.1), axis=0)
    plane = np.append(slopes, np.median(thing.points[:, 2] - thing.points[:, :2] @ slopes))
    upper = np.ones(len(columns), dtype=bool)
    for _ in range(3):
        upper = np.abs(thing.points[:, 2] - columns @ plane) < TUNING.plane
        if upper.mean() < TUNING.face:
            return None
        plane = np.linalg.lstsq(columns[upper], thing.points[upper, 2], rcond=None)[0]
    return plane, thing.points[upper]


def pushes_of(thing: SeenThing, low: Array, high: Array) -> list[FlatThing]:
    """Return a flat thing before a push towards each of a bin's walls, then into its corners; none: it is not flat.

    Args:
        thing: as a picture shows it.
        low: (3,) lowest corner of the bin's inside [m].
        high: (3,) its highest.
    """
    face = upper_face(thing)
    if face is None:
        return []
    plane, points = face
    _, edges, angle = cv2.minAreaRect(points[:, :2].astype(np.float32))
    first = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])  # along the first of the edges
    ways = [sign * axis for axis in np.eye(3)[:2] for sign in (1.0, -1.0)]
    if np.abs(first).min() > np.sin(TUNING.turned):
        own = np.array([*first, 0.0])
        ways += [sign * axis for axis in (own, np.cross([0.0, 0.0, 1.0], own)) for sign in (1.0, -1.0)]
    found = list[FlatThing]()
    for along in ways:
        across = np.cross([0.0, 0.0, 1.0], along)
        slope = -float(plane[:2] @ along[:2])
        if abs(plane[:2] @ across[:2]) > TUNING.across:
            continue
        near, far = np.quantile(points @ along, [0.01, 0.99]).tolist()
        middle = float(np.mean(np.quantile(points @ across, [0.01, 0.99])))
        height = float(plane @ [*(far * along + middle * across)[:2], 1.0] - low[2])  # at the far edge
        tilt = float(np.arctan(slope))
        length, width = edges if abs(first @ along[:2]) > np.sqrt(0.5) else edges[::-1]
        ends = far * along + 0.5 * width * np.array([[-1.0], [1.0]]) * across + middle * across
        wall = far + _room(ends, along, low, high)
        far, length = wall if wall - far < TUNING.at_wall else far, float(length) / np.cos(tilt)
        found.append(FlatThing(along, middle, near, far, wall, float(low[2]), length, height / np.cos(tilt), tilt))
    return found


def _room(places: Array, along: Array, low: Array, high: Array) -> float:
    """Return how far places (N, 3) go along a direction (3,) until the first of them is at a wall [m]."""
    moved = np.abs(along[:2]) > 1e-6
    walls = np.where(along > 0.0, high, low)[:2]
    return float(((walls - places[:, :2])[:, moved] / along[:2][moved]).min())


def may_be_tipped(flat: FlatThing, gripper: Gripper, rim: float) -> bool:
    """Return whether a flat thing can be tipped towards its wall, and taken then.

    Args:
        flat: as it lies.
        gripper: that is to take it then.
        rim: height of the walls [m].
    """
    return (
        TUNING.thinnest <= flat.thickness <= gripper.opening_most - TUNING.spare
        and TUNING.tilts[0] <= flat.tilt <= TUNING.tilts[1]
        and flat.length >= 1.5 * flat.thickness
        and flat.floor + flat.length >= rim + TUNING.spare
    )


def way_of(flat: FlatThing) -> tuple[Array, Array]:
    """Return the way of the finger tips' leading edge: to its side at the wall, then as that is raised.

    Returns:
        Places (M, 2) along the push and up in W [m] from before its near side on, and (K, 3) on from there: of its
        side, and how far it is tilted [rad].
    """
    tilts = np.linspace(max(flat.tilt, 0.0), TUNING.upright, int(np.ceil(1.5 * flat.length / TUNING.step)))
    raised = np.array([[*flat.pressed(float(tilt)), tilt] for tilt in tilts])
    begin = np.array([flat.near - TUNING.before, raised[0, 1]])
    return evenly(np.array([begin, raised[0, :2]]), TUNING.step), raised


def evenly(corners: Array, step: float) -> Array:
    """Return points (M, 2) about a step [m] apart along straight pieces between some (K, 2), these among them."""
    pieces = [corners[:1]]
    for a, b in pairwise(corners):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(pieces)
