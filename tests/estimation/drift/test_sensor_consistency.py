"""The cross-check of further sensors: silent while they agree, whatever their manner; loud when one parts ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi, chi2

from twin_diagram.estimation.drift.sensor_consistency import TUNING as SENSOR_CONSISTENCY
from twin_diagram.estimation.drift.sensor_consistency import CrossCheck, newest
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.estimation.filter.sensor_registry import note
from twin_diagram.signals.arrays import Array

LEARNING = 2.0
DT = 0.005


def check(*sizes: int) -> tuple[CrossCheck, Array]:
    cross = CrossCheck(sizes, 6.0, LEARNING)
    return cross, np.zeros(cross.size)


def feed(
    cross: CrossCheck, state: Array, white: Array, accepted: Array | None = None, start: float = DT, index: int = 0
) -> Array:
    """Statistics (N,) of readings (N, m)."""
    accepted = np.ones(len(white), dtype=bool) if accepted is None else accepted
    found = np.empty(len(white))
    loud = 0.0
    for k, row in enumerate(white):
        t = start + DT * k
        found[k] = cross.follow(state, index, row, bool(accepted[k]), t, t >= loud)
        if found[k] > 1.0:
            loud = t + 0.5
    return found


@pytest.fixture(scope="module")
def normal() -> tuple[CrossCheck, Array]:
    cross, state = check(6)
    feed(cross, state, np.random.default_rng(0).normal(size=(2000, 6)))
    return cross, state


@pytest.mark.long
def test_silent_while_a_sensor_agrees() -> None:
    cross, state = check(6)
    found = feed(cross, state, np.random.default_rng(1).normal(size=(20_000, 6)))
    assert np.all(found[: round((SENSOR_CONSISTENCY.settling + LEARNING) / DT)] == 0.0)
    assert 0.3 < found.max() < 1.0


def test_silent_where_a_sensor_is_always_a_little_wrong() -> None:
    """Coloured and too large: what is normal is learnt."""
    cross, state = check(3)
    rng = np.random.default_rng(2)
    white = np.zeros((12_000, 3))
    for k in range(1, len(white)):
        white[k] = 0.97 * white[k - 1] + rng.normal(size=3)
    assert np.std(white) > 3.5
    assert feed(cross, state, white).max() < 1.0


@pytest.mark.parametrize(("size", "within"), [(6.0, 3), (3.0, 12), (1.2, 160)])
def test_a_step_is_found_the_sooner_the_larger(normal, size: float, within: int) -> None:
    cross, state = normal[0], normal[1].copy()
    white = np.random.default_rng(3).normal(size=(400, 6))
    white[100:, 4] += size
    found = feed(cross, state, white, start=20.0)
    assert found[:100].max() < 1.0
    first = int(np.argmax(found > 1.0))
    assert 100 <= first < 100 + within


def test_a_slow_pull_is_found_before_a_reading_leaves_its_gate(normal) -> None:
    cross, state = normal[0], normal[1].copy()
    pull = np.linspace(0.0, 4.0, 1600)
    white = np.random.default_rng(4).normal(size=(1600, 6))
    white[:, 3] += pull
    found = feed(cross, state, white, start=20.0)
    first = int(np.argmax(found > 1.0))
    assert found[first] > 1.0 and pull[first] < 2.0


def test_a_pull_that_begins_before_much_was_seen_is_found_all_the_same() -> None:
    """A camera of 3 mm at 30 Hz, pulled by 5 mm/s after five seconds."""
    for seed in range(10):
        cross, state = check(6)
        t = np.arange(1, 301) / 30.0
        white = np.random.default_rng([seed, 8]).normal(size=(len(t), 6))
        white[:, 4] += np.maximum(t - 5.0, 0.0) * 5.0 / 3.0
        found = np.array([cross.follow(state, 0, row, True, at, True) for row, at in zip(white, t, strict=True)])
        assert found[t < 5.0].max() < 1.0
        assert t[np.argmax(found > 1.0)] < 7.6 and found.max() > 1.0, seed


@pytest.mark.long
def test_refusals_in_a_row_are_found_and_scattered_outliers_are_not() -> None:
    rng = np.random.default_rng(5)
    cross, state = check(6)
    white = rng.normal(size=(20_000, 6))
    wrong = rng.random(len(white)) < 0.1
    white[wrong] += 60.0
    assert feed(cross, state, white, ~wrong).max() < 1.0
    found = feed(cross, state, np.full((40, 6), 60.0), np.zeros(40, dtype=bool), start=200.0)
    assert 5 < int(np.argmax(found > 1.0)) < 15


def test_a_clock_that_was_set_back_leaves_it_deaf_no_longer_than_at_first() -> None:
    cross, state = check(3)
    feed(cross, state, np.random.default_rng(3).normal(size=(1000, 3)), start=1000.0)
    white, armed = np.random.default_rng(4).normal(size=(1000, 3)), round((SENSOR_CONSISTENCY.settling + LEARNING) / DT)
    white[armed:] += [8.0, 0.0, 0.0]
    found = feed(cross, state, white)
    assert np.all(found[:armed] == 0.0) and found.max() > 1.0


def test_sensors_do_not_disturb_each_other() -> None:
    both, state = check(6, 3)
    alone, other = check(3)
    rng = np.random.default_rng(6)
    first, second = rng.normal(size=(1500, 6)), rng.normal(size=(1500, 3))
    found = np.empty((2, 1500))
    for k in range(1500):
        both.follow(state, 0, first[k], True, DT * (k + 1), True)
        found[0, k] = both.follow(state, 1, second[k], True, DT * (k + 1), True)
        found[1, k] = alone.follow(other, 0, second[k], True, DT * (k + 1), True)
    np.testing.assert_array_equal(found[0], found[1])


def test_another_model_forgets_what_was_measured_and_keeps_what_is_normal(normal) -> None:
    cross, state = normal[0], normal[1].copy()
    feed(cross, state, np.full((20, 6), 5.0), start=20.0)
    kept = state[0]
    cross.begin(state)
    found = feed(cross, state, np.random.default_rng(7).normal(size=(200, 6)), start=21.0)
    assert found.max() < 1.0 and state[0] == kept


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([1e300, -1e300])), st.booleans()
        ),
        min_size=1,
        max_size=60,
    )
)
def test_whatever_comes_the_state_stays_finite(normal, readings: list[tuple[float, bool]]) -> None:
    cross, state = normal[0], normal[1].copy()
    with np.errstate(over="ignore"):
        for k, (number, accepted) in enumerate(readings):
            found = cross.follow(state, 0, np.array([number, 0, 0, 0, 0, 0.0]), accepted, 20.0 + DT * k, True)
            assert np.isfinite(found) and np.all(np.isfinite(state))


def test_a_reading_is_read_off_the_record_that_the_filter_keeps() -> None:
    before = np.zeros(len(SensorTrack) + 3)
    before[len(SensorTrack) :] = [0.1, -0.2, 0.3]
    white = np.array([1.0, -2.0, 0.5])
    for accepted in (True, False):
        after = before.copy()
        note(after, white, 5.0, 1.0, accepted)
        found = newest(before, after)
        assert found is not None and found[1] is accepted
        np.testing.assert_allclose(found[0], white)
    twice = after.copy()
    note(twice, white, 5.0, 1.005, True)
    assert newest(before, before) is None and newest(before, twice) is None


class Plain:
    """The cross-check of a sensor of five numbers: three, then two; each λ of its own."""

    forgetting, wider = (0.5, 0.8, 0.95, 0.99), (1.0, 1.0, 1.5, 2.0)

    def __init__(self, sigma: float) -> None:
        self.sigma, self.since = sigma, 0.0
        self.learnt = self.refused = self.row = 0.0
        self.sums, self.mean, self.square = np.zeros((4, 5)), np.zeros((4, 2)), np.zeros((4, 2))

    def take(self, white: Array, accepted: bool, t: float, quiet: bool) -> float:
        self.since = self.since or t
        if t < self.since + 2.0:
            return 0.0
        armed = t >= self.since + 2.0 + LEARNING
        if not accepted:
            self.row += 1.0
            self.refused = min(self.refused + quiet, 30_000.0)
            share = (self.refused - self.row * quiet + 2.0) / (self.learnt + self.refused + 40.0)
            needed = np.log(1e-9) / np.log(np.clip(share, 1e-3, 0.5))
            return self.row / needed if armed else 0.0
        self.row = 0.0
        length = float(np.linalg.norm(white))
        level, found = np.zeros((4, 2)), 0.0
        for i, forgetting in enumerate(self.forgetting):
            self.sums[i] = forgetting * self.sums[i] + white * (6.0 / length if length > 6.0 else 1.0)
            for j, (part, dof) in enumerate(((slice(0, 3), 3), (slice(3, 5), 2))):
                limit = float(CLAIMED[dof])
                level[i, j] = np.sqrt((1.0 - forgetting**2) * float(np.sum(self.sums[i, part] ** 2)) / limit)
                white_mean, white_square = MEANS[dof] / np.sqrt(limit), VARIANCES[dof] / limit
                seen = max(self.learnt, 1.0) * (1.0 - forgetting)
                share = seen / (seen + 3.0)
                beyond = self.mean[i, j] - white_mean
                spread = share * self.square[i, j] + (1.0 - share) * (white_square + share * beyond**2)
                usual = (1.0 - share) * white_mean + share * self.mean[i, j] + self.sigma * np.sqrt(spread)
                found = max(found, level[i, j] / max(usual, self.wider[i]))
        found *= armed
        if quiet and found < 0.5:
            self.learnt = min(self.learnt + 1.0, 60_000.0)
            one = 1.0 / self.learnt
            beyond = level - self.mean
            self.mean = self.mean + one * beyond
            self.square = (1.0 - one) * (self.square + one * beyond**2)
        return float(found)


CLAIMED = {dof: chi2.isf(1e-9, dof) for dof in (2, 3)}
MEANS = {dof: chi.mean(dof) for dof in (2, 3)}
VARIANCES = {dof: chi.var(dof) for dof in (2, 3)}


@pytest.mark.parametrize(("scale", "before"), [(1.0, 0.0), (4.0, 0.0), (1.0, 59_950.0)])
def test_is_what_plain_numbers_say(scale: float, before: float) -> None:
    """A sensor that agrees, one that is four times as noisy as it claims, and one that was watched for long."""
    rng, plain = np.random.default_rng(1306), Plain(6.0)
    cross, state = check(6, 5)
    at = 4 + 4 * (6 + 2 * 2)
    part = state[at:]
    if before:
        plain.learnt, plain.refused, plain.mean[:], plain.square[:] = before, 29_998.0, 0.25, 0.02
        part[1:3] = plain.learnt, plain.refused
        part[4 + 20 : 4 + 28], part[4 + 28 :] = 0.25, 0.02
    said, said_plain = [], []
    for k in range(1100):
        t = 1.0 + DT * k
        white = scale * rng.normal(size=5) * (3.0 if k % 40 == 0 else 1.0) + (1.5 * (k > 1000))
        accepted, quiet = bool(k % 90 < 85), k % 7 != 3
        said.append(cross.follow(state, 1, white, accepted, t, quiet))
        said_plain.append(plain.take(white, accepted, t, quiet))
    np.testing.assert_allclose(said, said_plain, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(part[1:4], [plain.learnt, plain.refused, plain.row])
    np.testing.assert_allclose(part[4:24].reshape(4, 5), plain.sums, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part[24:32].reshape(4, 2), plain.mean, rtol=1e-7)
    np.testing.assert_allclose(part[32:].reshape(4, 2), plain.square, rtol=1e-7)
    assert not state[:at].any() and max(said[1000:]) > 0.6
    cross.begin(state)
    assert part[3] == 0.0 and not part[4:24].any() and part[1] == plain.learnt


def test_a_reading_is_told_within_six_deviations_and_only_where_one_came() -> None:
    before = np.zeros(len(SensorTrack) + 2)
    for counts, used in (
        ((1, 0), True),
        ((0, 1), False),
        ((2, 0), None),
        ((1, 1), None),
        ((0, 0), None),
        ((-1, 0), None),
    ):
        after = before.copy()
        after[[SensorTrack.ACCEPTED, SensorTrack.REFUSED]] = counts
        after[len(SensorTrack) :] = [0.25, -0.125]
        found = newest(before, after)
        assert (found is None) == (used is None)
        if found is not None:
            assert found[1] is used
            np.testing.assert_allclose(found[0], [8.0, -4.0])
