"""How a thing that cannot be grasped is pushed off what it lies across: which way, how far, and where it is pressed.

As seen from above, a push is worth by how much more of the thing lies over bottom that is seen free then, and by how
much less of it stands out over the bin's rim. What is below it nobody sees, and counts as neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    cell: float = 0.006
    """Edge of the cells in which what is seen from above is compared [m]: some four pixels of a bin's camera."""

    farthest: float = 0.15
    """Of a push [m]: half of a bin's width; what is longer is pushed again once it was looked at."""

    step: float = 0.01
    """Between lengths that are compared [m], and the least one: what sticks yields by that much."""

    askew: float = 0.35
    """Between the push and the normal of a side that it may be pressed on [rad]: within friction of 0.4."""

    over: float = 0.03
    """What is higher than the thing's upper side less this bars its way [m]: it meets its side, not its bottom edge."""

    leaving: float = 0.02
    """Share of the thing that may come over the rim, or over what bars its way: cells at its outline are half its."""

    least: float = 0.1
    """Gain from which a push is worth its time."""

    dear: float = 0.5
    """What a metre of way costs of the gain: of two ways that free as much the shorter one disturbs less."""

    edge: float = 0.012
    """From its nearest points on how much of its upper side tells how high its near edge is [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Nudge:
    """A push of a thing, along which places are measured in W.

    Attributes:
        along: (3,) of the push, level.
        middle: to the left of the push, of where it is pressed: beside its middle it would turn [m].
        near: its nearest side there [m].
        edge: height of that side's upper edge [m].
        length: of the push from there on [m].
        gain: by what share of it more lies over free bottom, or less over the rim, then.
    """

    along: Array
    middle: float
    near: float
    edge: float
    length: float
    gain: float

    @property
    def across(self) -> Array:
        """(3,) to the left of the push."""
        return np.cross([0.0, 0.0, 1.0], self.along)


@dataclass(frozen=True)
class _FromAbove:
    """What lies where about a bin, in square cells from a corner (2,) on: whether bottom is seen, how high others are.

    Attributes:
        corner: lowest of the cells [m].
        free: (X, Y) whether the bottom is seen there, and nothing else.
        inside: (X, Y) whether that is over the bin.
        height: (X, Y) of what else lies there; -inf: nothing [m].
    """

    corner: Array
    free: npt.NDArray[np.bool_]
    inside: npt.NDArray[np.bool_]
    height: Array

    def index(self, places: Array) -> tuple[npt.NDArray[np.int64], ...]:
        """Return the cells of places (..., 2); those beyond the border are its."""
        at = np.floor((places - self.corner) / TUNING.cell).astype(np.int64)
        return tuple(np.moveaxis(np.clip(at, 0, np.array(self.free.shape) - 1), -1, 0))


def nudges_of(
    thing: SeenThing, others: Array, bottom: Array, bin_corners: tuple[Array, Array], half: float
) -> list[Nudge]:
    """Return the pushes of a thing that are worth it, the best first; one at the most along each direction.

    Args:
        thing: as a picture shows it.
        others: (N, 3) points of all other things in W [m].
        bottom: (K, 3) points where the bin's bottom is seen [m].
        bin_corners: lowest and highest corner (3,) of the bin's inside [m].
        half: of the width that presses on it [m].
    """
    seen = _from_above(thing, others, bottom, bin_corners)
    cells, tops = _cells_of(thing, seen)
    found = [_nudge(thing, along, cells, tops, seen, half) for along in _directions(thing)]
    worth = [one for one in found if one is not None and one.gain >= TUNING.least]
    return sorted(worth, key=lambda one: TUNING.dear * one.length - one.gain)


def _from_above(thing: SeenThing, others: Array, bottom: Array, bin_corners: tuple[Array, Array]) -> _FromAbove:
    """Return what lies where, wherever the thing may come to."""
    low, high = (corner[:2] for corner in bin_corners)
    about = thing.points[:, :2]
    corner = np.minimum(low, about.min(axis=0)) - TUNING.farthest
    size = np.ceil((np.maximum(high, about.max(axis=0)) + TUNING.farthest - corner) / TUNING.cell).astype(int)
    middles = corner + (np.moveaxis(np.indices(tuple(size)), 0, -1) + 0.5) * TUNING.cell
    seen = _FromAbove(
        corner,
        np.zeros(size, dtype=bool),
        ((middles > low) & (middles < high)).all(axis=-1),
        np.full(size, -np.inf),
    )
    seen.free[seen.index(bottom[:, :2])] = True
    np.maximum.at(seen.height, seen.index(others[:, :2]), others[:, 2])
    seen.free[np.isfinite(seen.height) | ~seen.inside] = False
    return seen


def _cells_of(thing: SeenThing, seen: _FromAbove) -> tuple[Array, Array]:
    """Return the middles (C, 2) of the cells that a thing fills, and how high it is there (C,) [m]."""
    top = np.full(seen.free.shape, -np.inf)
    np.maximum.at(top, seen.index(thing.points[:, :2]), thing.points[:, 2])
    own = ndimage.binary_closing(np.isfinite(top), np.ones((3, 3)))
    where = np.argwhere(own)
    highest = ndimage.maximum_filter(top, 3)[own]
    return seen.corner + (where + 0.5) * TUNING.cell, highest


def _directions(thing: SeenThing) -> list[Array]:
    """Return directions (3,) straight on a thing's sides, and along a bin's walls where these are not too askew."""
    _, _, degrees = cv2.minAreaRect(thing.points[:, :2].astype(np.float32))
    angle = np.radians(degrees)
    own = [np.array([np.cos(a), np.sin(a), 0.0]) for a in angle + 0.5 * np.pi * np.arange(4)]
    walls = [sign * axis for axis in np.eye(3)[:2] for sign in (1.0, -1.0)]
    turned = max(float(one @ walls[0]) for one in own)
    return own + (walls if np.cos(TUNING.askew) < turned < 0.999 else [])


def _nudge(thing: SeenThing, along: Array, cells: Array, tops: Array, seen: _FromAbove, half: float) -> Nudge | None:
    """Return the best push along a direction (3,); None: there is no way at all."""
    across = np.cross([0.0, 0.0, 1.0], along)
    middle = float((cells @ across[:2]).mean())
    beside = thing.points[np.abs(thing.points @ across - middle) <= half]
    if not len(beside):
        return None
    near = float(np.quantile(beside @ along, 0.01))
    edge = float(np.quantile(beside[beside @ along < near + TUNING.edge][:, 2], 0.9))

    lengths = np.arange(0.0, TUNING.farthest + 1e-9, TUNING.step)
    at = seen.index(cells + lengths[:, None, None] * along[:2])
    outside, over = (~seen.inside[at]).mean(axis=1), seen.free[at].mean(axis=1)
    met = (seen.height[at] > tops - TUNING.over).mean(axis=1)
    bars = (outside > np.minimum.accumulate(outside) + TUNING.leaving) | (met > met[0] + TUNING.leaving)
    count = int(np.argmax(bars)) if bars.any() else len(lengths)
    if count < 2:
        return None
    gains = (over - over[0] + outside[0] - outside)[:count]
    best = int(np.argmax(gains - TUNING.dear * lengths[:count]))
    return Nudge(along, middle, near, edge, float(lengths[best]), float(gains[best]))
