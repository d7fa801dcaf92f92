"""A trial in which nothing is found leaves the figures of its cell to all others."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
sys.path[:0] = [str(BENCHMARKS)]

from registration_peers import told  # noqa: E402

BOUND = (0.002, np.radians(2.0))


def test_one_that_is_not_found_holds_no_truth_and_claims_nothing() -> None:
    found = [[0.001, 0.01, 0.005, 1.2, 1.0]] * 3
    missed = [[0.02, 0.17, 0.005, np.nan, np.nan]]
    text = told(np.array(found + missed), BOUND)
    assert text.startswith(" 75.0%") and "NEES   1.20" in text and "held  75.0%, 1 not found" in text
    assert "found" not in told(np.array(found), BOUND)
    assert "NEES" not in told(np.array(missed * 4), BOUND), "a peer claims nothing"
