"""What stands beside the library's objects and is none of them: further instances, and things that nobody knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus, Track
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, things_of


@dataclass(frozen=True)
class StandingBeside:
    """The ports that tell of them, as they are now; read where a grasp is chosen, which few ticks do.

    Attributes:
        further: (F · FURTHER_TRACK_SIZE) of further instances of the library's objects.
        things: (T · THING_SIZE) of unknown things.
        pieces: corners (V, 3) of the convex pieces of each kind of object that an instance may be of, in O [m].
    """

    further: Array = field(default_factory=lambda: np.zeros(0))
    things: Array = field(default_factory=lambda: np.zeros(0))
    pieces: Sequence[Sequence[Array]] = ()

    def corners(self) -> list[Array]:
        """Return the corners (m, 3) of each in W [m]."""
        found = []
        for row in self.further.reshape(-1, FURTHER_TRACK_SIZE):
            if not (np.isfinite(row).all() and row[0] > 0 and row[1] < len(self.pieces)):
                continue
            track = Track.unpack(row[OWNER_SIZE:])
            if track.status not in (ObjectStatus.UNSEEN, ObjectStatus.GONE):
                own = np.concatenate(list(self.pieces[int(row[1])]))
                found.append(own @ rotations.matrix(track.pose[:4]).T + track.pose[4:])
        if not np.isfinite(self.things).all():
            return found
        known = (thing for thing in things_of(self.things) if thing.stands and thing.pieces)
        return [*found, *(np.concatenate(thing.pieces) + thing.shift for thing in known)]
