"""Margins: as many false alarms as were asked for, whatever the tail; and what grows slowly does not teach them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.drift.false_alarm_rate import TUNING as FALSE_ALARM_RATE
from twin_diagram.estimation.drift.false_alarm_rate import FalseRate
from twin_diagram.signals.arrays import Array


def fresh(tests: int = 1, rate: float = 0.5) -> tuple[FalseRate, Array]:
    margins = FalseRate(tests, rate)
    vector = np.zeros(margins.size)
    margins.begin(vector)
    return margins, vector


def feed(margins: FalseRate, vector: Array, peaks: Array, start: float = 0.0) -> int:
    """One peak for each block, of all tests alike; answers how many alarms there were."""
    alarms = 0
    for k, peak in enumerate(peaks):
        margins.turn_over(vector, start + k * FALSE_ALARM_RATE.block, True)
        alarms += sum(margins.take(vector, test, float(peak)) > 1.0 for test in range(margins.tests))
    return alarms


def test_what_stays_far_below_keeps_its_threshold() -> None:
    margins, vector = fresh(6)
    assert feed(margins, vector, np.random.default_rng(0).uniform(0.3, 0.65, 2000)) == 0
    assert margins.margin(vector, 3) == 1.0


@pytest.mark.parametrize("scale", [0.02, 0.05, 0.08])
def test_the_rate_is_what_was_asked_for(scale: float) -> None:
    """Exponential tails: an hour to learn from, then the rate over a thousand hours."""
    rate = 2.0
    margins, vector = fresh(1, rate)
    rng = np.random.default_rng(1)
    feed(margins, vector, FALSE_ALARM_RATE.high - 0.1 + rng.exponential(scale, 7200))
    u = margins.margin(vector, 0)
    expected = FALSE_ALARM_RATE.high - 0.1 + scale * np.log(3600.0 / rate)
    assert u == pytest.approx(max(expected, 1.0), rel=0.05)
    alarms = np.sum(FALSE_ALARM_RATE.high - 0.1 + rng.exponential(scale, 3_600_000) > u) / 1000.0
    assert alarms < 2.0 * rate


def test_the_more_tests_the_wider() -> None:
    found = []
    for tests in (1, 10):
        margins, vector = fresh(tests)
        feed(margins, vector, FALSE_ALARM_RATE.high + np.random.default_rng(2).exponential(0.05, 1000))
        found.append(margins.margin(vector, 0))
    assert found[1] - found[0] == pytest.approx(0.05 * np.log(10.0), rel=0.15)


def test_an_alarm_wipes_out_what_led_to_it() -> None:
    margins, vector = fresh()
    quiet = np.full(200, 0.4)
    feed(margins, vector, quiet)
    kept = vector.copy()
    alarms = feed(margins, vector, np.linspace(0.4, 0.99, FALSE_ALARM_RATE.delay), start=200.0)
    assert alarms == 0 and margins.margin(vector, 0) == margins.margin(kept, 0)
    margins.turn_over(vector, 300.0, False)
    feed(margins, vector, quiet, start=301.0)
    assert margins.margin(vector, 0) == 1.0


def test_tests_have_margins_of_their_own() -> None:
    margins, vector = fresh(2)
    for k in range(300):
        margins.turn_over(vector, k * FALSE_ALARM_RATE.block, True)
        margins.take(vector, 0, 0.9 + 0.05 * (k % 3))
        margins.take(vector, 1, 0.3)
    assert margins.margin(vector, 0) > 1.3 and margins.margin(vector, 1) == 1.0
    # The threshold over which a statistic counts is the one that is told.
    assert margins.take(vector, 0, 1.5) == 1.5 / margins.margin(vector, 0)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(ScenarioError, match=r"twin\.drift\.false_alarms"):
        FalseRate(3, rate)


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.0, 1e300), st.floats(-100.0, 100.0), st.booleans()), min_size=1, max_size=60),
    st.floats(1e-6, 1e6),
)
def test_whatever_comes_margins_stay_within_their_bounds(
    messages: list[tuple[float, float, bool]], rate: float
) -> None:
    margins, vector = fresh(2, rate)
    t = 0.0
    for statistic, ahead, calm in messages:
        t += ahead
        margins.turn_over(vector, t, calm)
        margins.take(vector, 1, statistic)
        assert np.all(np.isfinite(vector))
        assert all(1.0 <= margins.margin(vector, test) <= FALSE_ALARM_RATE.widest for test in (0, 1))
