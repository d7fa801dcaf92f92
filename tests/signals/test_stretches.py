"""Runs of samples for which a condition holds."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.stretches import stretches


def test_runs_are_those_of_their_condition() -> None:
    condition = np.array([True, True, False, True, False, False, True])
    np.testing.assert_array_equal(stretches(condition), [[0, 2], [3, 4], [6, 7]])
    assert stretches(np.zeros(3, dtype=bool)).shape == (0, 2)
