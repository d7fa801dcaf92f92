"""How an object went while it was an unknown thing: pure functions.

What comes into view is a thing that nobody knows before it is recognised. It does not stop for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.things import COAST, Thing


class LinearMotion(NamedTuple):
    """A velocity in W.

    Attributes:
        velocity: (3,) [m/s].
        variance: of a coordinate of that [m²/s²].
    """

    velocity: Array
    variance: float


def motion_before(things: Sequence[Thing], place: Array, radius: float, time: float) -> LinearMotion | None:
    """Return how the unknown thing went that an object is, first found at a place; None: it is none that goes.

    Args:
        things: as images showed them.
        place: (3,) of the object, in W [m].
        radius: of a ball about it [m].
        time: when it was found [s].
    """
    own: tuple[float, Thing] | None = None
    for thing in things:
        age = time - thing.last_seen
        if not (thing.identity > 0 and thing.velocity.any() and -1e-9 <= age <= COAST):
            continue
        off = float(np.linalg.norm(thing.middle + age * thing.velocity - place))
        if off < radius and (own is None or off < own[0]):
            own = off, thing
    return None if own is None else LinearMotion(own[1].velocity, own[1].velocity_variance)
