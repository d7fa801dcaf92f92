"""What goes over the wires about things that no library knows, and about further instances of those that it does.

Rows of vector-valued ports, as `layouts` has them for the library's objects. An identity is a number from 1 that stays
with one thing for as long as it holds its slot and is never given again; 0: the slot is free.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, TRACK_SIZE, ObjectStatus

PIECES: Final = 8
"""Convex pieces of an unknown thing at most."""
CORNERS: Final = 24
"""Corners of a piece at most."""
PIECE_SIZE: Final = 1 + 3 * CORNERS
"""A packed piece: how many corners, and those."""
THING_SIZE: Final = 1 + 1 + 1 + 1 + 3 + PIECES * PIECE_SIZE
"""A packed `Thing`."""

OWNER_SIZE: Final = 2
"""Before a further instance's measurement or track: its identity, and which of the library's objects it is like."""
FURTHER_MEASUREMENT_SIZE: Final = OWNER_SIZE + MEASUREMENT_SIZE
"""Identity, number in the library, `PoseMeasurement`."""
FURTHER_TRACK_SIZE: Final = OWNER_SIZE + TRACK_SIZE
"""Identity, number in the library, `Track`."""


@dataclass(frozen=True)
class Thing:
    """An unknown thing as it is believed to be now.

    Attributes:
        identity: see the module; 0: there is none.
        status: see `ObjectStatus`; `UNSEEN` while it was seen in one image alone, and is no obstacle yet.
        first_seen, last_seen: capture times of the first and the last image that showed it [s].
        middle: (3,) of the points seen, in W [m].
        pieces: corners (V, 3) of convex pieces in W that together hold it [m].
    """

    identity: int = 0
    status: ObjectStatus = ObjectStatus.UNSEEN
    first_seen: float = NEVER
    last_seen: float = NEVER
    middle: Array = field(default_factory=lambda: np.zeros(3))
    pieces: tuple[Array, ...] = ()

    @property
    def stands(self) -> bool:
        """Whether it is to be kept clear of."""
        return self.identity > 0 and self.status not in (ObjectStatus.UNSEEN, ObjectStatus.GONE)

    def pack(self) -> Array:
        """Return it as a vector of `THING_SIZE`."""
        vector = np.zeros(THING_SIZE)
        vector[:4] = self.identity, self.status, self.first_seen, self.last_seen
        vector[4:7] = self.middle
        rows = vector[7:].reshape(PIECES, PIECE_SIZE)
        for row, corners in zip(rows, self.pieces, strict=False):
            row[0] = len(corners)
            row[1 : 1 + corners.size] = corners.ravel()
        return vector

    @staticmethod
    def unpack(vector: Array) -> Thing:
        """Return the inverse of `pack`; copies."""
        rows = vector[7:THING_SIZE].reshape(PIECES, PIECE_SIZE)
        pieces = tuple(row[1 : 1 + 3 * int(row[0])].reshape(-1, 3).copy() for row in rows if row[0] > 0)
        status = ObjectStatus(int(vector[1]))
        return Thing(int(vector[0]), status, float(vector[2]), float(vector[3]), vector[4:7].copy(), pieces)


def things_of(vector: Array) -> list[Thing]:
    """Return the things of a port (T · THING_SIZE), free slots included."""
    return [Thing.unpack(row) for row in np.asarray(vector, dtype=float).reshape(-1, THING_SIZE)]
