"""Errors of what was fitted: no smaller than what kinds of motion differ by."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.whole_robot.estimates import widened


def test_what_kinds_of_motion_differ_by_widens_an_error_and_never_narrows_it() -> None:
    spread = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    fits = np.array([[0.0, 0.0, 7.0], [0.0, 2.0, 7.0], [0.0, 4.0, 7.0]])
    # Of the second: two thirds of 4 + 0 + 4.
    np.testing.assert_allclose(np.diag(widened(spread, fits)), [4.0, 16.0 / 3.0, 0.0])
    correlation = widened(spread, fits)[0, 1] / np.sqrt(4.0 * 16.0 / 3.0)
    np.testing.assert_allclose(correlation, 0.5)
