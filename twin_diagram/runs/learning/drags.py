"""How a thing beside which no finger goes down is dragged off the walls: which way, how far, and where it is pressed.

Shut fingers press on its top and go aside: pads hold more surely than a bin's smooth bottom, so that what is flat
slides with them, and what is round rolls, by half of their way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    beside: float = 0.025
    """Nearer to a wall than this a thing has no room for a finger there [m]: one of 15 mm, and 1 cm that pictures,
    guessed sides and the arm are off."""

    length: float = 0.06
    """Of the fingers' way [m]: what rolls comes by half of it off the wall."""

    top: float = 0.25
    """From its highest points on what share of its height is its top, on which it is pressed: of a lying cylinder three
    quarters of its width."""

    off: float = 0.008
    """Between the fingers and a wall behind them [m]: an arm that presses yields by as much."""

    level: float = 0.004
    """Below its highest points its top counts as level [m]: twice what depth and camera are off."""

    flat: float = 0.8
    """Share of its width from which that is flat: a lying can's is half."""


TUNING = Tuning()


@dataclass(frozen=True)
class Drag:
    """A way to drag a thing, in W.

    Attributes:
        along: (3,) of the way, level, off a wall.
        place: (3,) of the middle of the fingers' tips where they first press on it, the least behind its highest [m].
        length: of the way [m].
    """

    along: Array
    place: Array
    length: float = TUNING.length


def drags_of(
    thing: SeenThing, others: Array, bin_corners: tuple[Array, Array], deep: float, behind: float
) -> list[Drag]:
    """Return the ways to drag a thing off walls that it lies at, the best first.

    What lies along a wall is dragged off that before it is dragged along it: it rolls, or is grasped there. What has a
    flat top and is higher than it is wide along a way would rock over its far edge, and fall back: that comes last.

    Args:
        thing: as a picture shows it.
        others: (N, 3) points of all other things in W [m].
        bin_corners: lowest and highest corner (3,) of the bin's inside [m].
        deep: extent of the fingers' tips along the way [m].
        behind: how far the fingers reach back from their middle, where they are thickest [m].
    """
    low, high = bin_corners
    points, found = thing.points, list[tuple[bool, float, Drag]]()
    top = points[points[:, 2] > thing.top - TUNING.top * (thing.top - low[2])]
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        along = sign * np.eye(3)[axis]
        across = np.cross([0.0, 0.0, 1.0], along)
        wall = float(low[axis] if sign > 0.0 else -high[axis])
        near, far = (float(value) for value in np.quantile(points @ along, [0.01, 0.99]))
        if near - wall > TUNING.beside:
            continue
        left, right = (float(value) for value in np.quantile(points @ across, [0.01, 0.99]))
        ahead, beside = others @ along, others @ across
        if ((ahead > near) & (ahead < far + TUNING.length) & (beside > left) & (beside < right)).any():
            continue
        middle = float(np.median(top @ across))
        # The tips' leading edge begins at the middle of its top: what rolls stays below them the longest.
        at = max(float(np.median(top @ along)) - 0.5 * deep, wall + TUNING.off + behind)
        if at + 0.5 * deep > far:
            continue
        level = points[points[:, 2] > thing.top - TUNING.level] @ along
        rocks = float(np.ptp(level)) > TUNING.flat * (far - near) and far - near < thing.top - float(low[2])
        found.append((rocks, far - near, Drag(along, at * along + middle * across + np.array([0.0, 0.0, thing.top]))))
    return [drag for *_, drag in sorted(found, key=lambda one: one[:2])]
