"""What a gripper meets: how far it can be pushed on, and what its pads touch when it closes.

All in the gripper's frame G (z along the approach, y along the closing axis), for many poses at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.grasps import closing_kernels
from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.slab import Flags, Slab
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants of this module; lengths in m."""

    gap: float = 0.003
    """Kept before whatever the gripper would touch when it is pushed on: what a calibrated arm may be off."""

    beside: float = 0.0015
    """The same beside open fingers, along the closing axis: half of it, because closing shifts the object anyway."""

    patch: float = 0.002
    """How deep a pad gives way: points that much behind the first one touch it, too. Pads are 6 mm of rubber."""

    against: float = 0.001
    """Where a pad touches is the middle of what is no more than this behind the first point, however thin the thing: a
    bowl's wall, 0.7 mm from flat along a pad, lies against all of it; a wall that leans touches the pads' ends."""

    round_share: float = 0.1
    """Of a thing's width, no more for normals: so deep a round one has its own within 37 degrees of the pad's."""

    patch_least: float = 0.0005
    """How deep a pad gives way at least: clouds of thin things are no finer."""

    held: float = 0.25
    """Share of the pads' length that an object shorter than the fingers is to have between them, or it is gone past."""

    hidden_room: float = 0.010
    """Room that a finger needs beyond the last seen point of a side that faces away from the camera."""


TUNING = Tuning()


@dataclass(frozen=True)
class Others:
    """What else there is: a table, and points that are not of the object.

    Attributes:
        table: normal and offset (4,): a place p is free where n·p >= offset, in the cloud's frame [m]; None: no table.
        first_other: points from this index on are of other things; None: all are the object's.
    """

    table: Array | None = None
    first_other: int | None = None

    def among(self, slab: Slab) -> Flags:
        """Return which entries (M,) of a slab are of other things."""
        if self.first_other is None:
            return np.zeros(len(slab.point), dtype=bool)
        return np.asarray(slab.point >= self.first_other)


def slab_half(gripper: Gripper, margin: float) -> float:
    """Return how far from the closing plane the fingers reach along x, with a margin [m]."""
    return max(gripper.finger_width, gripper.root_width) / 2 + margin


def finger_stop(slab: Slab, gripper: Gripper, margin: float, offset: Array, other: Flags) -> Array:
    """Return how far (K,) the open gripper can be pushed along z until a finger is a gap before a point [m].

    What a finger meets on a straight way from far off counts, so the approach is free as well as its end.

    Args:
        slab: points near the closing plane.
        gripper: with its fingers, opened all the way.
        margin: by which the fingers are taken wider along x [m].
        offset: (K,) of the gripper along y [m].
        other: (M,) entries that must not come between the fingers either.
    """
    inner = gripper.opening_most / 2
    x = gripper.finger_width / 2 + margin
    z = _before(slab, offset, other, inner, gripper.finger_thickness, x)
    stop = z - gripper.finger_front
    if gripper.root_thickness > 0:
        z = _before(slab, offset, other, inner, gripper.root_thickness, gripper.root_width / 2 + margin)
        stop = np.minimum(stop, z - gripper.root_front)
    return stop - TUNING.gap


def _before(slab: Slab, offset: Array, other: Flags, inner: float, thickness: float, half: float) -> Array:
    """Return the least z (K,) [m] of what meets something so thick on each finger's inside, to `half` along x."""
    most, least = inner + thickness + TUNING.beside, inner - TUNING.beside
    return closing_kernels.nearest_before(slab.pose, slab.q, offset, other, least, most, _single(half))


def drawn_back(slab: Slab, gripper: Gripper, offset: Array, depth: Array, other: Flags) -> Array:
    """Return depths (K,) [m] at which the pads have not gone past an object that is shorter than the fingers.

    Where they have, the pads' middle comes to the object's far end.

    Args:
        slab: points near the closing plane, of the whole object.
        gripper: with its pads.
        offset: (K,) along y [m].
        depth: (K,) along z [m].
        other: (M,) entries that are not of the object.
    """
    far = _between(slab, gripper, offset, other)[:, 1]
    least = gripper.pad_back + TUNING.held * (gripper.pad_front - gripper.pad_back)
    passed = np.isfinite(far) & (far < depth + least)
    return np.where(passed, far - (gripper.pad_back + gripper.pad_front) / 2, depth)


def rim_depth(slab: Slab, gripper: Gripper, offset: Array, depth: Array, other: Flags) -> Array:
    """Return depths (K,) [m] at which nothing of an object is between the fingers behind the pads; as `drawn_back`."""
    return np.minimum(depth, _between(slab, gripper, offset, other)[:, 0] - gripper.pad_back)


def _single(length: float) -> float:
    """Return a length [m] rounded as places in a slab are: what is right on it counts as before it."""
    return float(np.float32(length))


def _between(slab: Slab, gripper: Gripper, offset: Array, other: Flags) -> Array:
    """Return the least and largest z (K, 2) [m] of what of the object is between the fingers."""
    wide, half = gripper.opening_most / 2, _single(gripper.pad_width / 2)
    return closing_kernels.ends_between(slab.pose, slab.q, offset, other, wide, half)


def heights(gripper: Gripper, R: Array, p: Array, table: Array) -> Array:
    """Return how high (K,) the open gripper's lowest point is over a table (4,) [m]; poses R (K, 3, 3), p (K, 3)."""
    low, high = gripper.boxes()
    up = np.einsum("i,kij->kj", table[:3], R)
    lowest = up @ ((low + high) / 2).T - np.abs(up) @ ((high - low) / 2).T
    return np.asarray(lowest.min(axis=1) + p @ table[:3] - table[3])


def table_stop(gripper: Gripper, R: Array, p: Array, table: Array, retreat: float) -> Array:
    """Return how far (K,) the gripper can be pushed along z over a table [m]; minus infinity: nowhere.

    Args:
        gripper: opened all the way.
        R: (K, 3, 3) axes.
        p: (K, 3) origins [m].
        table: normal and offset (4,).
        retreat: length of the approach, which is free of the table, too [m].
    """
    room = heights(gripper, R, p, table) - TUNING.gap
    climb = R[:, :, 2] @ table[:3]
    with np.errstate(divide="ignore", invalid="ignore"):
        down = np.where(climb < -1e-9, room / -climb, np.where(room >= 0, np.inf, -np.inf))
    # From below: what counts is where the approach begins, and that is pushed along.
    return np.asarray(np.where((climb > 1e-9) & (room - retreat * climb < 0), -np.inf, down))


@dataclass(frozen=True)
class Closing:
    """What K poses hold when they close. Sides: 0 at positive y, 1 at negative.

    Attributes:
        count: (K,) points between the pads, of the object.
        width: (K,) between what the two pads touch first [m].
        middle: (K,) y of the middle between them [m].
        normal: (K, 2, 3) mean over each pad's patch of the outward normals, in G, by the area that the pad sees; a
            square contact's is ±y.
        contact: (K, 2, 3) the patches' centres in G [m].
        antipodal: (K,) mean over the points between the pads of (exp(n_y²) - 1) / (e - 1).
        roots_first: (K,) whether something meets the finger before the pads do.
    """

    count: Array
    width: Array
    middle: Array
    normal: Array
    contact: Array
    antipodal: Array
    roots_first: Flags

    @property
    def align(self) -> Array:
        """Part (K, 2) of the mean outward normal towards each pad; 1: square on."""
        return self.normal[:, :, 1] * np.array([1.0, -1.0])

    def or_else(self, others: Closing, there: Flags) -> Closing:
        """Return it with the rows of others where flags (K,) say so."""
        rows = {}
        for name, value in vars(self).items():
            rows[name] = value.copy()
            rows[name][there] = getattr(others, name)[there]
        return Closing(**rows)


def close(slab: Slab, normals: Array, R: Array, gripper: Gripper, offset: Array, depth: Array, other: Flags) -> Closing:
    """Close the gripper at K poses, each moved by `offset` along y and `depth` along z.

    The antipodal mean is that of the thesis's equations 4.1 and 4.2 (see `cost.antipodal_cost`).

    Args:
        slab: points near the closing plane, of the poses before they were moved.
        normals: (N, 3) of the cloud's points, outward.
        R: (K, 3, 3) the poses' axes.
        gripper: with its pads.
        offset: (K,) along y [m].
        depth: (K,) along z [m]; -inf: a pose that is none.
        other: (M,) entries that are not of the object.
    """
    entries, places = (slab.pose, slab.point, slab.q), np.empty((len(slab.pose), 3))
    along = (gripper.palm_front, gripper.finger_front, gripper.pad_back, gripper.pad_front)
    half, wide = _single(gripper.pad_width / 2), gripper.opening_most / 2
    facing = one_layout(R[:, :, 1].astype(np.float32)), one_layout(normals.astype(np.float32))
    furthest, beside, sums = closing_kernels.reached(*entries, other, *facing, offset, depth, half, wide, along, places)
    count, reach = sums[:, 0], furthest.sum(axis=1)
    patch = np.clip(TUNING.round_share * reach, TUNING.patch_least, TUNING.patch)
    against = np.maximum(patch, TUNING.against)
    contact, normal = closing_kernels.touched(*entries, one_layout(normals), places, furthest, against, patch)
    edge = np.where(count[:, None] > 0, furthest * np.array([1.0, -1.0]), 0.0)
    return Closing(
        count,
        edge[:, 0] - edge[:, 1],
        edge.sum(axis=1) / 2,
        np.einsum("kij,ksi->ksj", R, normal),
        contact,
        sums[:, 1] / np.maximum(count, 1.0),
        np.asarray((beside - gripper.root_setback > furthest).any(axis=1)),
    )
