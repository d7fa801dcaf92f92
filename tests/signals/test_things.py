"""Things on a port: what free slots hold, and what is taken out of those that are not."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.things import THING_SIZE, Thing, things_of


def test_slots_are_read_as_one_by_one() -> None:
    cube = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0]), axis=-1).reshape(-1, 3)
    things = [
        Thing(),
        Thing(3, ObjectStatus.TRACKED, 0.5, 1.5, np.arange(3.0), (cube, 2.0 * cube[:5]), np.ones(3), 0.1, -np.ones(3)),
        Thing(),
    ]
    row = np.concatenate([*(thing.pack() for thing in things), np.zeros(THING_SIZE)])  # of the last nothing was told
    for found, part in zip(things_of(row), row.reshape(-1, THING_SIZE), strict=True):
        alone = Thing.unpack(part)
        assert (found.identity, found.status, found.first_seen, found.last_seen) == (
            alone.identity,
            alone.status,
            alone.first_seen,
            alone.last_seen,
        )
        np.testing.assert_array_equal(found.pack(), part)


def test_what_free_slots_share_cannot_be_changed() -> None:
    row = np.tile(Thing().pack(), 2)
    first, second = things_of(row)
    assert first is second and not first.stands
    with pytest.raises(ValueError):
        first.middle[0] = 1.0
    row[4] = 7.0  # the port goes on to hold something else
    assert things_of(row)[0].middle[0] == 7.0 and second.middle[0] == 0.0
