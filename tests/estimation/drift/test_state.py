"""A monitor's state as one vector: every view has a place of its own in it, and begins as nothing."""

from __future__ import annotations

import numpy as np

from twin_diagram.estimation.drift.state import DriftEntry, DriftState, Evidence
from twin_diagram.signals.layouts import NEVER


def test_views_fill_the_vector_and_do_not_overlap() -> None:
    n, p, changes, rows, sensors, motors, margins = 3, 5, 2, 7, 11, 13, 17
    state = DriftState(n, p, changes, rows, sensors, motors, margins)
    views = [state.header, state.log, state.evidence, state.checked, state.roll_mean, state.roll_squares]
    views += [state.from_state, state.from_theta, state.torques, state.sums, state.change, state.tenths]
    views += [state.sensors, state.motors, state.margins]
    shapes = [(32,), (32, 3), (32, 10 + n), (p,), (n + 1,), (n + 1,), (2 * n,), (p,), (rows, n + 1), (changes, n)]
    shapes += [(2, changes), (30,), (sensors,), (motors,), (margins,)]
    assert [view.shape for view in views] == shapes
    assert len(state.vector) == sum(view.size for view in views)
    for k, view in enumerate(views):
        view[...] = k + 1.0
    counted = [int(np.sum(state.vector == k + 1.0)) for k in range(len(views))]
    assert counted == [view.size for view in views]


def test_nothing_has_happened_at_first() -> None:
    state = DriftState(2, 1, 3, 4, 0, 0, 0)
    never = [DriftEntry.TIME, DriftEntry.SINCE, DriftEntry.STARTED, DriftEntry.RAISED, DriftEntry.QUIET]
    np.testing.assert_array_equal(state.header[never], NEVER)
    assert state.header[DriftEntry.SENSOR] == -1.0
    np.testing.assert_array_equal(state.log[:, 0], NEVER)
    state.header[[*never, DriftEntry.SENSOR]], state.log[:, 0] = 0.0, 0.0
    assert not state.vector.any()
    assert len(Evidence) == 10 and len(DriftEntry) == 32
