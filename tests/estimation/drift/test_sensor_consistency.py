"""The cross-check of further sensors: silent while they agree, whatever their manner; loud when one parts ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


def test_refusals_in_a_row_are_found_and_scattered_outliers_are_not() -> None:
    rng = np.random.default_rng(5)
    cross, state = check(6)
    white = rng.normal(size=(20_000, 6))
    wrong = rng.random(len(white)) < 0.1
    white[wrong] += 60.0
    assert feed(cross, state, white, ~wrong).max() < 1.0
    found = feed(cross, state, np.full((40, 6), 60.0), np.zeros(40, dtype=bool), start=200.0)
    assert 5 < int(np.argmax(found > 1.0)) < 15


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
