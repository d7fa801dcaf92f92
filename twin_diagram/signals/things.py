"""What goes over the wires about things that no library knows, and about further instances of those that it does.

Rows of vector-valued ports, as `layouts` has them for the library's objects. An identity is a number from 1 that stays
with one thing for as long as it holds its slot and is never given again; 0: the slot is free.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
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
THING_SIZE: Final = 1 + 1 + 1 + 1 + 3 + 3 + 1 + 3 + PIECES * PIECE_SIZE
"""A packed `Thing`."""
COAST: Final = 0.25
"""An unseen thing's velocity is trusted for so long, then it stays [s]: as `scene.object_filter` has it for objects."""

OWNER_SIZE: Final = 2
"""Before a further instance's measurement or track: its identity, and which of the library's objects it is like."""
FURTHER_MEASUREMENT_SIZE: Final = OWNER_SIZE + MEASUREMENT_SIZE
"""Identity, number in the library, `PoseMeasurement`."""
FURTHER_TRACK_SIZE: Final = OWNER_SIZE + TRACK_SIZE
"""Identity, number in the library, `Track`."""


_VELOCITY: Final = slice(7, 10)
"""Where `Thing.velocity` is in a packed one."""
_SHIFT: Final = slice(11, 14)
"""Where `Thing.shift` is."""


@dataclass(frozen=True)
class Thing:
    """An unknown thing as it is believed to be now.

    Attributes:
        identity: see the module; 0: there is none.
        status: see `ObjectStatus`; `UNSEEN` while it was seen in one image alone, and is no obstacle yet.
        first_seen, last_seen: capture times of the first and the last image that showed it [s].
        middle: (3,) of the points seen, in W [m].
        pieces: corners (V, 3) of convex pieces in W that together hold it [m].
        velocity: (3,) in W, zero where nothing shows that it moves [m/s].
        velocity_variance: of one coordinate of that [m²/s²].
        shift: (3,) how far it has gone since it was last seen, in W [m]: what is at `pieces + shift` now.
    """

    identity: int = 0
    status: ObjectStatus = ObjectStatus.UNSEEN
    first_seen: float = NEVER
    last_seen: float = NEVER
    middle: Array = field(default_factory=lambda: np.zeros(3))
    pieces: tuple[Array, ...] = ()
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    velocity_variance: float = 0.0
    shift: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def stands(self) -> bool:
        """Whether it is to be kept clear of."""
        return self.identity > 0 and self.status not in (ObjectStatus.UNSEEN, ObjectStatus.GONE)

    def pack(self) -> Array:
        """Return it as a vector of `THING_SIZE`."""
        vector = np.zeros(THING_SIZE)
        vector[:4] = self.identity, self.status, self.first_seen, self.last_seen
        vector[4:7] = self.middle
        vector[_VELOCITY], vector[10], vector[_SHIFT] = self.velocity, self.velocity_variance, self.shift
        rows = vector[14:].reshape(PIECES, PIECE_SIZE)
        for row, corners in zip(rows, self.pieces, strict=False):
            row[0] = len(corners)
            row[1 : 1 + corners.size] = corners.ravel()
        return vector

    @staticmethod
    def unpack(vector: Array) -> Thing:
        """Return the inverse of `pack`; copies."""
        rows = vector[14:THING_SIZE].reshape(PIECES, PIECE_SIZE)
        # Most slots are free, and those that are not have few pieces.
        some = rows[rows[:, 0] > 0]
        pieces = tuple(row[1 : 1 + 3 * int(row[0])].reshape(-1, 3).copy() for row in some)
        status = ObjectStatus(int(vector[1]))
        middle, velocity, shift = vector[4:7].copy(), vector[_VELOCITY].copy(), vector[_SHIFT].copy()
        times = float(vector[2]), float(vector[3])
        return Thing(int(vector[0]), status, *times, middle, pieces, velocity, float(vector[10]), shift)


def things_of(vector: Array) -> list[Thing]:
    """Return the things of a port (T · THING_SIZE), free slots included; these hold arrays that cannot be written."""
    rows = np.asarray(vector, dtype=float).reshape(-1, THING_SIZE)
    return [Thing.unpack(row) if row[0] > 0 else _free(row.tobytes()) for row in rows]


@lru_cache(maxsize=4)
def _free(row: bytes) -> Thing:
    """Return what a free slot holds: most are free and alike, and a planner asks for all of them at each tick."""
    thing = Thing.unpack(np.frombuffer(row))
    for array in (thing.middle, thing.velocity, thing.shift, *thing.pieces):
        array.setflags(write=False)
    return thing


def carried(vector: Array, now: float) -> Array:
    """Return the things of a port (T · THING_SIZE) as they are at a time: moved on from where they were last seen.

    A velocity is trusted for `COAST` seconds; then the thing stays where it has got to. Pieces and middles remain
    what was seen; `Thing.shift` says how far they have gone.
    """
    rows = np.array(vector, dtype=float).reshape(-1, THING_SIZE)
    age = np.maximum(now - rows[:, 3], 0.0)
    rows[:, _SHIFT] = rows[:, _VELOCITY] * np.minimum(age, COAST)[:, None]
    rows[age > COAST, _VELOCITY] = 0.0
    return rows.ravel()
