"""Late stamps go back to even times, also where samples were lost; real times stay."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.logs import Log
from twin_diagram.logs.dejittering import dejittered, even_times


@pytest.mark.parametrize("seconds", [2.0, 90.0])
def test_even_times_are_found_where_samples_were_lost(seconds: float) -> None:
    rng = np.random.default_rng(3)
    whole = 7.0 + 0.004 * np.arange(round(seconds * 250.0))
    kept = rng.random(len(whole)) > 0.05
    kept[200:240] = False
    even = whole[kept]
    found = even_times(even + rng.uniform(-0.0012, 0.0012, len(even)))
    assert found is not None
    np.testing.assert_allclose(found - found.mean(), even - even.mean(), atol=1.5e-4)


def test_a_clock_of_no_period_has_no_even_times() -> None:
    rng = np.random.default_rng(4)
    assert even_times(np.cumsum(rng.uniform(0.0007, 0.0015, 3000))) is None


def test_positions_say_whether_stamps_are_late() -> None:
    rng = np.random.default_rng(5)
    even = (0.004 * np.arange(1500))[rng.random(1500) > 0.05]
    late = even + rng.uniform(-0.001, 0.001, len(even))
    for true, straight in ((even, True), (late, False)):
        position = np.sin(2.0 * true)[:, None]
        log = Log(late, ("a",), position, torque=position)
        assert (dejittered(log) is not log) == straight


def test_stamps_that_are_later_than_the_next_ones_time_are_counted() -> None:
    """No sample is lost, so their number tells which is which."""
    rng = np.random.default_rng(6)
    even = 0.008 * np.arange(1500)
    late = np.sort(even + 0.0025 * rng.normal(size=1500))
    position = np.sin(2.0 * even)[:, None]
    found = dejittered(Log(late, ("a",), position, torque=position))
    np.testing.assert_allclose(found.time, even, atol=5e-4)


def test_a_pause_of_the_log_is_not_spread_over_all_its_stamps() -> None:
    """Nothing was sent while the joint rested: the stamps are late on even times with a gap, and not on a line."""
    rng = np.random.default_rng(7)
    even = np.concatenate([0.004 * np.arange(750), 4.0 + 0.004 * np.arange(750)])
    late = even + rng.uniform(-0.001, 0.001, len(even))
    position = np.sin(2.0 * np.minimum(even, 3.0) + 2.0 * np.maximum(even - 4.0, 0.0))[:, None]
    found = dejittered(Log(late, ("a",), position, torque=position))
    np.testing.assert_allclose(found.time, even, atol=5e-4)
