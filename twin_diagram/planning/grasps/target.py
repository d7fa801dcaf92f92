"""What is to be grasped, as all steps of the search see it: a cloud, and what is known beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from twin_diagram.errors import TwinError
from twin_diagram.planning.grasps.closing import Others
from twin_diagram.planning.grasps.slab import Flags
from twin_diagram.signals.arrays import Array

LARGE: Final = 0.08
"""Of things this large [m] the fingers' plane holds a fifth of the points …"""
FEWEST: Final = 0.25
"""… and of no thing fewer than this share is looked at: a cube of 1 cm has 25 points on a side then."""
NEIGHBOURS: Final = 8
"""Of a place, among which one is looked for that faces as it does: over an edge half of them do."""


class GraspError(TwinError):
    """Something that grasps cannot be proposed for; an object that cannot be held is none: its list is empty."""


@dataclass(frozen=True)
class GraspTarget:
    """An object's cloud in its frame O, and what else is known; lengths in m.

    Attributes:
        points: (N, 3); with those of other things behind the object's own.
        normals: (N, 3) unit, outward.
        own: how many are the object's.
        viewpoint: (3,) where the camera was, if the cloud is what one camera saw; None: it shows all sides.
        table: normal and offset (4,): a place p is free where n·p >= offset; None: no table.
        mass: [kg]; None: not known.
        centre: (3,) centre of mass; None: not known.
        up: (3,) unit, against gravity; None: any direction may be.
        share: of the points that the search would look at.
        guessed: (N,) points that no camera saw; see `hidden_sides`. None: there are none.
    """

    points: Array
    normals: Array
    own: int
    viewpoint: Array | None = None
    table: Array | None = None
    mass: float | None = None
    centre: Array | None = None
    up: Array | None = None
    share: float = 1.0
    guessed: Flags | None = None

    @property
    def others(self) -> Others:
        """What is in the way beside the object."""
        return Others(self.table, self.own if self.own < len(self.points) else None)

    def thinned(self, count: int) -> GraspTarget:
        """Return it with `count` of the object's points at the most, and as large a share of the other ones.

        The points are taken to be in random order, as an asset's are.
        """
        count = self.enough(count)
        if self.own <= count:
            return self
        every = self.own / count
        rest = np.arange(self.own, len(self.points))[:: max(int(every), 1)]
        kept = np.concatenate([np.arange(count), rest])
        guessed = None if self.guessed is None else self.guessed[kept]
        return replace(self, points=self.points[kept], normals=self.normals[kept], own=count, guessed=guessed)

    def shown(self, places: Array, outward: Array, within: float, least: float) -> Flags:
        """Return on which places (M, 3) of the object a camera saw some of the side that faces outward there.

        Args:
            places: on the object, in O [m].
            outward: (M, 3) unit.
            within: so far from each a seen point may be [m], …
            least: … whose normal has this part, or more, along `outward`.
        """
        if self.guessed is None:
            return np.ones(len(places), dtype=bool)
        tree, normals = self._seen
        off, nearest = tree.query(places, k=min(NEIGHBOURS, tree.n), distance_upper_bound=within)
        near = np.isfinite(off)
        along = np.einsum("mki,mi->mk", normals[np.where(near, nearest, 0)], outward)
        return np.asarray((near & (along >= least)).any(axis=1))

    @cached_property
    def _seen(self) -> tuple[cKDTree, Array]:
        assert self.guessed is not None
        seen = np.flatnonzero(~self.guessed[: self.own])
        return cKDTree(self.points[seen]), self.normals[seen]

    def enough(self, count: int) -> int:
        """Return how many points are looked at where `count` of a large thing would be."""
        return int(count * self.share)

    def sparser(self) -> GraspTarget:
        """Return it with fewer points to look at where it is seen whole and small beside the fingers.

        Nearly all of them lie between the pads then, pose by pose.
        """
        size = float(np.ptp(self.points[: self.own], axis=0).max())
        share = 1.0 if self.viewpoint is not None else float(np.clip(size / LARGE, FEWEST, 1.0))
        return replace(self, share=share)

    @property
    def spacing(self) -> float:
        """Typical distance from a point to the next [m], by the area that the box about the object has."""
        x, y, z = np.ptp(self.points[: self.own], axis=0)
        return float(np.sqrt(2 * (x * y + y * z + z * x) / self.own))


def target_of(
    points: Array,
    normals: Array,
    *,
    viewpoint: Array | None = None,
    table: Array | None = None,
    surroundings: Array | None = None,
    mass: float | None = None,
    centre: Array | None = None,
    up: Array | None = None,
) -> GraspTarget:
    """Check what is told of an object and put it together; arguments as `GraspTarget`'s.

    Args:
        points: (N, 3) in O [m].
        normals: (N, 3) outward, of any length but zero.
        viewpoint: (3,) [m].
        table: (4,).
        surroundings: (S, 3) points of other things, which the gripper keeps clear of [m].
        mass: [kg].
        centre: (3,) [m].
        up: (3,); None: the table's normal, if there is a table.

    Raises:
        GraspError: shapes that do not fit, too few points, values that are not finite or not possible.
    """
    points, normals = _rows("points", points), _rows("normals", normals)
    if points.shape != normals.shape:
        raise GraspError(f"points {points.shape} and normals {normals.shape}: there must be one normal to each point")
    if len(points) < 10:
        raise GraspError(f"points: {len(points)} of them are no surface; ten are the least")
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not (length > 1e-9).all():
        raise GraspError(f"normals: {int((length <= 1e-9).sum())} of {len(normals)} have no length")
    if mass is not None and not (np.isfinite(mass) and mass > 0):
        raise GraspError(f"mass {mass:g}: must be positive [kg]")
    if table is not None:
        table = _vector("table", table, 4)
        table = table / np.linalg.norm(table[:3])
        up = table[:3] if up is None else up
    own, others = len(points), np.empty((0, 3)) if surroundings is None else _rows("surroundings", surroundings)
    return GraspTarget(
        np.concatenate([points, others]),
        np.concatenate([normals / length, np.zeros_like(others)]),
        own,
        None if viewpoint is None else _vector("viewpoint", viewpoint, 3),
        table,
        mass,
        None if centre is None else _vector("centre", centre, 3),
        None if up is None else _vector("up", up, 3) / np.linalg.norm(up),
    )


def _rows(name: str, array: Array) -> Array:
    array = np.asarray(array, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3:
        raise GraspError(f"{name}: must be an array (N, 3), not {array.shape}")
    if not np.isfinite(array).all():
        raise GraspError(f"{name}: {int((~np.isfinite(array)).any(axis=1).sum())} of {len(array)} are not finite")
    return array


def _vector(name: str, array: Array, size: int) -> Array:
    array = np.asarray(array, dtype=float)
    if array.shape != (size,) or not np.isfinite(array).all() or not np.linalg.norm(array[:3]) > 0:
        if name in ("viewpoint", "centre") and array.shape == (size,) and np.isfinite(array).all():
            return array
        raise GraspError(f"{name}: must be {size} finite numbers, not {array.tolist()}")
    return array
