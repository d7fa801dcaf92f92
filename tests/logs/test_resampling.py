"""Other sample times: what is exact, where it ends, what counts as regular."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram.errors import LogError
from twin_diagram.logs import Log, fingerprint, is_regular, resample, uniform
from twin_diagram.logs.dejittering import dejittered
from twin_diagram.logs.parting import parted
from twin_diagram.signals.arrays import Array


def log(time: Array, position: Array | None = None) -> Log:
    values = time**3 - time if position is None else position
    return Log(time, ("a",), values[:, None], torque=(1.0 + 2.0 * time)[:, None], velocity=np.abs(time - 0.5)[:, None])


@pytest.mark.parametrize("count", [4, 5, 9])
def test_a_cubic_position_is_exact_from_four_samples_on(count: int) -> None:
    times = np.linspace(0.0, 1.0, 23)
    found = resample(log(np.linspace(0.0, 1.0, count) ** 1.1), times)
    np.testing.assert_allclose(found.position[:, 0], times**3 - times, atol=1e-12)
    np.testing.assert_array_equal(found.time, times)


def test_few_samples_and_other_signals_are_joined_by_lines() -> None:
    knots, times = np.array([0.0, 0.5, 1.0]), np.linspace(0.0, 1.0, 21)
    short = resample(log(knots), times)
    np.testing.assert_allclose(short.position[:, 0], np.interp(times, knots, knots**3 - knots), atol=1e-12)
    knots = np.linspace(0.0, 1.0, 9)
    found = resample(log(knots), times)
    assert found.torque is not None and found.velocity is not None and found.torque_commanded is None
    np.testing.assert_allclose(found.torque[:, 0], 1.0 + 2.0 * times, atol=1e-12)
    np.testing.assert_allclose(found.velocity[:, 0], np.interp(times, knots, np.abs(knots - 0.5)), atol=1e-12)
    assert fingerprint(found) == fingerprint(log(knots))


@pytest.mark.parametrize("times", [[-0.001, 0.5], [0.5, 1.001], [-1.0, 2.0]])
def test_nothing_is_told_beyond_the_ends(times: list[float]) -> None:
    with pytest.raises(LogError, match=rf"{times[0]:g} to {times[1]:g} s is not within 0 to 1 s"):
        resample(log(np.linspace(0.0, 1.0, 9)), np.array(times))


def test_what_a_log_is_known_as_stays() -> None:
    """Currents do not become torques on the way, nor numbers names."""
    given = replace(log(np.linspace(0.0, 1.0, 9)), source="a.csv", notes=("odd",), numbered=True, currents=True)
    found = resample(given, np.linspace(0.0, 1.0, 5))
    assert (found.source, found.notes, found.numbered, found.currents) == ("a.csv", ("odd",), True, True)


@pytest.mark.parametrize("jump", [1e3, 1.7e9])
def test_a_clock_that_jumped_is_told_and_fills_no_memory(jump: float) -> None:
    time = np.arange(300) * 0.01
    time[200:] += jump
    broken = log(time, np.sin(time))
    assert dejittered(broken) is broken
    with pytest.raises(LogError, match=r"time: jumps from 1\.99 to .*cut the log there"):
        uniform(broken)
    assert [len(part) for part in parted(broken, 0.5)] == [200, 100]


def test_times_must_rise_everywhere() -> None:
    for times in ([0.0, 0.5, 0.5, 0.7], [0.0, 0.5, 0.4]):
        with pytest.raises(LogError, match="times must rise"):
            resample(log(np.linspace(0.0, 1.0, 9)), np.array(times))
    assert len(resample(log(np.linspace(0.0, 1.0, 9)), np.array([]))) == 0


@pytest.mark.parametrize("rate", [10.0, 30.0, 75.0, 77.0, 1e3])
@pytest.mark.parametrize("begin", [0.0, 12.7, 1e5])
def test_a_uniform_log_goes_to_the_end(rate: float, begin: float) -> None:
    """From the first sample on, as many as fit: where the end is a multiple of the period, that one, too."""
    time = begin + np.linspace(0.0, 3.0, 301)
    found = uniform(log(time, np.sin(time)), rate)
    assert len(found) == round(3.0 * rate) + 1
    np.testing.assert_allclose(found.time, begin + np.arange(len(found)) / rate, atol=1e-9)
    assert found.time[-1] <= time[-1]


def test_what_does_not_fit_whole_ends_before() -> None:
    found = uniform(log(np.linspace(0.0, 1.0, 101)), 30.5)
    assert len(found) == 31 and found.time[-1] == pytest.approx(30 / 30.5)


def test_an_irregular_log_gets_its_median_rate() -> None:
    time = np.r_[np.arange(0.0, 0.5, 0.01), np.arange(0.505, 1.0, 0.01)]
    found = uniform(log(time))
    assert found.period == pytest.approx(0.01) and is_regular(found.time)
    regular = log(np.arange(100) / 100.0)
    assert uniform(regular) is regular
    assert uniform(regular, 100.0) is not regular


@pytest.mark.parametrize(("share", "regular"), [(0.9e-3, True), (1.1e-3, False), (-0.9e-3, True), (-1.1e-3, False)])
def test_a_thousandth_of_a_step_is_regular(share: float, regular: bool) -> None:
    steps = np.full(50, 0.02)
    steps[20] *= 1.0 + share
    assert is_regular(np.r_[0.0, np.cumsum(steps)]) == regular
    assert is_regular(np.r_[0.0, np.cumsum(steps)], tolerance=0.01)


def test_no_tolerance_takes_equal_steps() -> None:
    assert is_regular(np.arange(9) / 8.0, tolerance=0.0)
    assert not is_regular(np.array([0.0, 0.125, 0.25, 0.5]), tolerance=0.0)
