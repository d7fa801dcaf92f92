"""What happens to objects and unknown things, as events: read off two statuses of each, before and after."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus

EVENT_FIELDS: Final = 5
"""Of an event: time [s] (`NEVER` where empty), `EventKind`, row, identity, number in the library (-1: unknown)."""
RING: Final = 64
"""So many of the newest events are kept."""


class EventKind(IntEnum):
    """What happened."""

    NEW = 1
    MOVED = 2
    STALE = 3
    LOST = 4
    HELD = 5
    GONE = 6
    REMOVED = 7


_BECOMES: Final = {
    ObjectStatus.MOVING: EventKind.MOVED,
    ObjectStatus.STALE: EventKind.STALE,
    ObjectStatus.LOST: EventKind.LOST,
    ObjectStatus.HELD: EventKind.HELD,
    ObjectStatus.GONE: EventKind.GONE,
}
"""Which event it is to come to have a status."""


Event = tuple[EventKind, int, int, int]
"""Kind, row, identity, number in the library."""


def changes(before: Array, after: Array) -> list[Event]:
    """Return what happened between two looks, in the order of the rows.

    Args:
        before: (R, 3) identity (0: none), `ObjectStatus` and number in the library (-1: unknown) of each row.
        after: (R, 3) the same, later.
    """
    found: list[Event] = []
    for row, ((was, old, what), (is_, now, kind)) in enumerate(zip(before.tolist(), after.tolist(), strict=True)):
        was, is_ = (int(who) if status != ObjectStatus.UNSEEN else 0 for who, status in ((was, old), (is_, now)))
        if was and was != is_:
            if old != ObjectStatus.GONE:
                found.append((EventKind.GONE, row, was, int(what)))
            found.append((EventKind.REMOVED, row, was, int(what)))
        if is_ and was != is_:
            found.append((EventKind.NEW, row, is_, int(kind)))
        if not is_ or (was == is_ and old == now):
            continue
        status = ObjectStatus(int(now))
        if status in _BECOMES:
            found.append((_BECOMES[status], row, is_, int(kind)))
        elif was == is_ and old == ObjectStatus.GONE:
            found.append((EventKind.MOVED, row, is_, int(kind)))  # it is back, elsewhere
    return found


def empty_ring() -> Array:
    """Return (RING · EVENT_FIELDS) without an event."""
    ring = np.zeros((RING, EVENT_FIELDS))
    ring[:, 0] = NEVER
    return ring.ravel()


def noted(ring: Array, time: float, happened: Sequence[Event]) -> Array:
    """Return the ring with events added at its end; the oldest go."""
    if not happened:
        return ring
    rows = np.array([[time, *(float(x) for x in event)] for event in happened])
    return np.concatenate([ring.reshape(-1, EVENT_FIELDS), rows])[-RING:].ravel()


@dataclass(frozen=True)
class Names:
    """What to call the holders of rows.

    Attributes:
        library: of the library's objects, a row each.
        added: of assets that came later, whose numbers follow the library's.
        own: identities of the first instance of each of those.
    """

    library: Sequence[str]
    added: Sequence[str] = ()
    own: Collection[int] = ()

    def of(self, row: int, identity: int, what: int) -> str:
        """Return the name of a row's holder: the first instance of an object by its name, others by numbers."""
        if row < len(self.library):
            return self.library[row]
        if what < 0:
            return f"unknown#{identity}"
        name = [*self.library, *self.added][what]
        return name if identity in self.own and what >= len(self.library) else f"{name}#{identity + 1}"


def told(ring: Array, names: Names) -> list[dict[str, Any]]:
    """Return the events, oldest first: time [s], event, object.

    Args:
        ring: as of the port `object_events`.
        names: of rows' holders.
    """
    rows = ring.reshape(-1, EVENT_FIELDS)
    return [
        {
            "time": round(float(time), 4),
            "event": EventKind(int(kind)).name.lower(),
            "object": names.of(int(row), int(who), int(what)),
        }
        for time, kind, row, who, what in rows
        if time >= 0.0
    ]
