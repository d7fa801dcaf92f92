"""Errors of what was fitted: no smaller than what kinds of motion differ by."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from twin_diagram.gap.whole_robot.estimates import by_evidence, covariance, widened


def test_what_kinds_of_motion_differ_by_widens_an_error_and_never_narrows_it() -> None:
    spread = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    fits = np.array([[0.0, 0.0, 7.0], [0.0, 2.0, 7.0], [0.0, 4.0, 7.0]])
    # Of the second: two thirds of 4 + 0 + 4.
    np.testing.assert_allclose(np.diag(widened(spread, fits)), [4.0, 16.0 / 3.0, 0.0])
    correlation = widened(spread, fits)[0, 1] / np.sqrt(4.0 * 16.0 / 3.0)
    np.testing.assert_allclose(correlation, 0.5)


def test_a_drives_error_is_no_larger_than_what_left_out_motion_loses_without_it_says() -> None:
    one_joint = 14
    wide, least = 4.0 * np.eye(one_joint), 0.25 * np.eye(one_joint)
    brought = np.zeros((1, 4))
    brought[0] = 8.0, 1e6, 8.0, 8.0  # damping, dry friction, offset, rotor [nats]
    size = np.full(one_joint, 4.0)
    error = np.sqrt(np.diag(by_evidence(wide, least, size, brought)))
    # Damping and a rotor of four standard errors; dry friction of more, but no error is less than its own.
    np.testing.assert_allclose(error, [*np.full(10, 2.0), 1.0, 0.5, 2.0, 1.0])
    nothing = by_evidence(wide, least, size, np.full((1, 4), -3.0))
    np.testing.assert_allclose(nothing, wide)


def test_stretches_that_pull_apart_widen_what_torques_say_and_the_prior_stays_what_it_is() -> None:
    """One coordinate known as well by torques as beforehand, and stretches pull twice as hard as noise would."""
    problem: Any = SimpleNamespace(
        system=lambda z, sums: (np.array([[2.0]]), None),
        pulls=lambda z: np.array([[2.0], [0.0]]),
        sums=SimpleNamespace(whole=None),
        free=np.array([True]),
        precision=np.array([[1.0]]),
    )
    np.testing.assert_allclose(covariance(problem, np.zeros(1)), [[(4.0 + 1.0) / 2.0**2]])
