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


class Plain:
    """One test's tail: 30 blocks with 3 peaks beforehand, peaks beyond 0.7, learnt from 16 blocks later."""

    def __init__(self, tests: int, rate: float) -> None:
        self.wanted = rate / tests / 3600.0
        self.prior = 3.0 * 0.3 / np.log(max(3.0 / 30.0 / self.wanted, np.e))
        self.blocks = self.peaks = self.sum = 0.0
        self.waiting: list[float] = []
        self.began, self.largest = 0.0, 0.0

    @property
    def margin(self) -> float:
        blocks, peaks, beyond = self.blocks + 30.0, self.peaks + 3.0, self.sum + self.prior
        return float(np.clip(0.7 + beyond / peaks * np.log(max(peaks / blocks / self.wanted, 1.0)), 1.0, 2.0))

    def turn_over(self, t: float, calm: bool) -> None:
        if not calm:
            self.waiting, self.largest, self.began = [], 0.0, t
        elif not 0.0 <= t - self.began < 1.0:
            self.began = t
            self.waiting.append(self.largest)
            self.largest = 0.0
            if len(self.waiting) > 16:
                if self.blocks >= 20_000.0:
                    self.blocks, self.peaks, self.sum = (
                        x * 19_999 / 20_000 for x in (self.blocks, self.peaks, self.sum)
                    )
                peak = self.waiting.pop(0)
                self.blocks += 1.0
                self.peaks += peak > 0.7
                self.sum += max(peak - 0.7, 0.0)

    def take(self, statistic: float) -> float:
        self.largest = max(self.largest, min(statistic, 2.0))
        return statistic / self.margin


@pytest.mark.parametrize(("scale", "rate", "before"), [(0.05, 0.5, 0.0), (0.3, 1e4, 0.0), (0.1, 2.0, 19_995.0)])
def test_is_what_peaks_over_threshold_say(scale: float, rate: float, before: float) -> None:
    rng = np.random.default_rng(1304)
    margins, vector = fresh(2, rate)
    plain = Plain(2, rate)
    assert margins.margin(vector, 1) == pytest.approx(plain.margin)
    if before:
        plain.blocks, plain.peaks, plain.sum = before, 0.1 * before, 0.01 * before
        vector.reshape(-1)[1 + 21 + 1 : 1 + 21 + 4] = plain.blocks, plain.peaks, plain.sum
        vector[1 + 21 + 4] = plain.margin
    t, found = 0.0, []
    for k in range(600):
        t += float(rng.choice([0.25, 0.5, 1.0])) - 2.0 * (k % 97 == 96)
        calm = k % 149 != 148
        margins.turn_over(vector, t, calm)
        plain.turn_over(t, calm)
        for _ in range(2):
            statistic = float(rng.choice([0.7, 0.6 + rng.exponential(scale), 3.0 * (k % 61 == 0)]))
            found.append((margins.take(vector, 1, statistic), plain.take(statistic)))
        found.append((margins.margin(vector, 1), plain.margin))
    np.testing.assert_allclose(*np.transpose(found), rtol=1e-9)
    assert plain.blocks > 100.0


def test_what_is_known_beforehand_gives_no_margin() -> None:
    """Three peaks in half a minute, as large on average as makes their share of the rate one at the threshold."""
    for tests, rate in ((1, 0.5), (10, 0.1), (4, 2.0)):
        margins, vector = fresh(tests, rate)
        assert margins.margin(vector, 0) == pytest.approx(1.0, abs=1e-9)
        beyond = 0.3 / np.log(0.1 * 3600.0 * tests / rate)
        feed(margins, vector, np.full(16 + 30, 0.7 + 2.0 * beyond))
        assert margins.margin(vector, 0) > 1.2
