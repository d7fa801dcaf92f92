"""Figures of the change test, and when an alarm has grown."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from twin_diagram.estimation.drift import likelihood_ratio

LAMBDA = (0.5, 0.8, 0.95)


@pytest.mark.parametrize("n", [1, 6, 7])
def test_white_innovations_exceed_their_threshold_once_in_a_billion(n: int) -> None:
    assert chi2.sf(likelihood_ratio.threshold(n), n) == pytest.approx(1e-9, rel=1e-3)


def test_statistics_are_those_of_sums_with_forgetting() -> None:
    white, sums = np.random.default_rng(1302).normal(size=(40, 5)), np.zeros((3, 5))
    white[30] *= 20.0  # counts as six deviations in its direction
    for row in white:
        found = likelihood_ratio.add_message(sums, row)
    lengths = np.linalg.norm(white, axis=1)
    white *= np.minimum(6.0 / lengths, 1.0)[:, None]
    for index, forgetting in enumerate(LAMBDA):
        total = sum(forgetting ** (39 - k) * row for k, row in enumerate(white))
        np.testing.assert_allclose(sums[index], total, rtol=1e-12)
        assert found[index] == pytest.approx((1.0 - forgetting**2) * float(total @ total), rel=1e-12)


@pytest.mark.parametrize("length", [5.9, 6.0, 6.1, 600.0])
def test_a_message_counts_as_six_deviations_at_most(length: float) -> None:
    sums = np.zeros((3, 4))
    likelihood_ratio.add_message(sums, np.array([0.0, -length, 0.0, 0.0]))
    np.testing.assert_allclose(np.linalg.norm(sums, axis=1), min(length, 6.0), rtol=1e-12)


@pytest.mark.parametrize(
    ("before", "grown"),
    [
        ([0.1, 0.2, 0.3, 0.41, 0.42, 0.43], True),
        ([0.2, 0.3, 0.41, 0.42, 0.43], False),  # too short a time tells nothing
        ([0.1, 0.1, 0.1, 0.5, 0.5, 0.39], False),  # it had come down again
        ([0.1, 0.1, 0.1, 0.5, 0.5, 0.4], False),
        ([0.1, 0.1, 0.1, 0.3, 0.3, 0.59], False),  # it jumped in the last tenth
        ([0.1, 0.1, 0.1, 0.35, 0.35, 0.53], True),
        ([0.6, 0.6, 0.6, 0.5, 0.5, 0.5], False),  # it fell
        ([0.5, 0.5, 0.5, 0.5, 0.5, 0.5], False),
        ([0.9, 0.9, 0.9, 0.1, 0.1, 0.1, 0.5, 0.5, 0.5], True),  # what was long before counts for nothing
        ([0.0, 0.0, 0.0, 0.9, 0.9, 0.9, 0.5, 0.5, 0.5], False),
    ],
)
def test_what_grows(before: list[float], grown: bool) -> None:
    assert likelihood_ratio.grows(np.array(before)) == grown
