"""Where nothing is found, where several turns are likely, and where no picture tells one, the benchmark says so."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
sys.path[:0] = [str(BENCHMARKS)]

from pose_truth import things, trials  # noqa: E402
from pose_truth.methods import ALLOWED, ours  # noqa: E402
from registration_peers import told  # noqa: E402

BOUND = (0.002, np.radians(2.0))


def test_one_that_is_not_found_holds_no_truth_and_claims_nothing() -> None:
    found = [[0.001, 0.01, 0.005, 1.2, 1.0, 1.0]] * 3
    missed = [[0.02, 0.17, 0.005, np.nan, np.nan, 1.0]]
    text = told(np.array(found + missed), BOUND)
    assert text.startswith(" 75.0%") and "NEES   1.20" in text and "held  75.0%, 1 not found" in text
    assert "found" not in told(np.array(found), BOUND)
    assert "NEES" not in told(np.array(missed * 4), BOUND), "a peer claims nothing"


def test_a_half_hidden_grey_mug_is_shown_as_it_is_likeliest_and_not_half_way() -> None:
    trial = trials.draw(things.thing("grey_mug"), "d415", 0.4, 541)
    R, p, covariance = ours(trial)
    metres, angle = trials.miss(trial, R, p)
    assert metres < 0.002 and np.degrees(angle) < 2.0, "the mean of all turns is 46 degrees off"
    share = [one.probability for one in ALLOWED]
    assert share == sorted(share, reverse=True) and abs(sum(share) - 1.0) < 1e-9
    np.testing.assert_array_equal(ALLOWED[0].R, R)
    # One eighth or so is still elsewhere: nobody is told that the turn is certain.
    assert covariance is not None and np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]) > np.radians(10.0)


@pytest.mark.long
def test_pictures_that_hide_a_handle_are_counted_apart() -> None:
    hides, shows = (trials.draw(things.thing("grey_mug"), "d435", 0.4, number) for number in (506, 513))
    assert hides.telling < trials.FEW < 100 < shows.telling
    assert trials.draw(things.thing("mug"), "d435", 0.4, 506).telling > 100, "its picture tells"
    turned = [[0.001, 0.6, 0.005, 1.2, 1.0, 0.0]]
    inside = [[0.001, 0.01, 0.005, 1.2, 1.0, 1.0]]
    text = told(np.array(turned + inside * 3), BOUND)
    assert text.startswith(" 75.0%") and "(1 of 4 tell no turn, of the others 100.0%)" in text
    assert "(1 of 1 tell no turn)" in told(np.array(turned), BOUND)
