"""Motion out of logs: gains of filters, exactness on polynomials, and how a drive's velocity is weighed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import below_cutoff, differentiate, inner, lowpass, motion, smooth
from twin_diagram.signals.arrays import Array

RATE = 500.0


def gain(frequency: float, cutoff: float, rate: float = RATE) -> float:
    """Of a Butterworth filter of 4th order, forward and backward, by the bilinear transform."""
    return float(1.0 / (1.0 + (np.tan(np.pi * frequency / rate) / np.tan(np.pi * cutoff / rate)) ** 8))


def middle(signal: Array) -> Array:
    return signal[len(signal) // 3 : -len(signal) // 3]


@pytest.mark.parametrize(
    ("frequency", "cutoff"), [(10.0, None), (8.0, None), (12.0, None), (40.0, 40.0), (60.0, 40.0), (2.0, 40.0)]
)
def test_the_filters_gain_and_phase(frequency: float, cutoff: float | None) -> None:
    """Residuals are looked at below 10 Hz: there half of an amplitude is left."""
    time = np.arange(3000) / RATE
    wave = np.sin(2 * np.pi * frequency * time)
    given = {} if cutoff is None else {"cutoff": cutoff}
    expected = gain(frequency, cutoff or 10.0) * wave
    for filter_ in (lowpass, smooth) if cutoff else (lowpass,):
        np.testing.assert_allclose(middle(filter_(wave, RATE, **given)), middle(expected), atol=1e-6)


def test_motion_is_smoothed_at_25_hertz() -> None:
    time = np.arange(3000) / RATE
    wave = np.sin(2 * np.pi * 25.0 * time)
    np.testing.assert_allclose(middle(smooth(wave, RATE)), 0.5 * middle(wave), atol=1e-6)
    found = motion(Log(time, ("a",), wave[:, None]))
    np.testing.assert_allclose(middle(found.position[:, 0]), 0.5 * middle(wave), atol=1e-6)


def test_a_slow_signal_is_answered_as_it_is() -> None:
    signal = np.random.default_rng(0).normal(size=(50, 2))
    for filter_ in (lowpass, smooth):
        for rate in (20.0, 15.0):
            found = filter_(signal, rate, 10.0)
            np.testing.assert_array_equal(found, signal)
            assert found is not signal
        assert np.std(filter_(signal, 21.0, 10.0) - signal) > 1e-3


@pytest.mark.parametrize("count", [2, 5, 20, 49, 50, 51, 52, 200])
def test_a_signal_of_any_length_is_filtered_with_one_period_of_padding(count: int) -> None:
    signal = np.cumsum(np.random.default_rng(1).normal(size=(count, 2)), axis=0)
    sos = butter(4, 10.0, fs=RATE, output="sos")
    expected = sosfiltfilt(sos, signal, axis=0, padlen=min(count - 1, 50))
    np.testing.assert_allclose(lowpass(signal, RATE), expected, atol=1e-12)
    np.testing.assert_allclose(lowpass(np.full(count, 3.0), RATE), 3.0, atol=1e-9)


def continued(signal: Array, window: int, beyond: int) -> tuple[Array, Array]:
    """Cubics fitted to both ends, continued."""
    k = np.arange(window)
    before = np.polynomial.Polynomial.fit(k, signal[:window], 3)(np.arange(-beyond, 0))
    after = np.polynomial.Polynomial.fit(k, signal[-window:], 3)(np.arange(window, window + beyond))
    return before, after


def test_ends_go_on_along_cubics_of_one_and_a_half_periods() -> None:
    signal = np.cumsum(np.random.default_rng(2).normal(size=400))
    before, after = continued(signal, 31, 41)  # 30.6 and 40.8 samples at 24.5 Hz
    expected = lowpass(np.r_[before, signal, after], RATE, 24.5)[41:-41]
    np.testing.assert_allclose(smooth(signal, RATE, 24.5), expected, atol=1e-9)


@pytest.mark.parametrize("count", [30, 31, 60, 400])
def test_a_cubic_is_kept_to_its_ends(count: int) -> None:
    time = np.arange(count) / count
    cubic = np.stack([1.0 + 2.0 * time - 3.0 * time**2 + 5.0 * time**3, -time], axis=1)
    np.testing.assert_allclose(smooth(cubic, RATE), cubic, atol=4e-3)


def test_what_is_shorter_than_a_window_is_filtered_plainly() -> None:
    signal = np.cumsum(np.random.default_rng(3).normal(size=40))
    np.testing.assert_array_equal(smooth(signal[:29], RATE, 25.0), lowpass(signal[:29], RATE, 25.0))
    assert np.abs(smooth(signal[:30], RATE, 25.0) - lowpass(signal[:30], RATE, 25.0)).max() > 1e-3


@pytest.mark.parametrize(("count", "degree"), [(3, 2), (4, 3), (5, 4), (6, 5), (20, 5)])
def test_derivatives_of_polynomials_are_exact(count: int, degree: int) -> None:
    time = np.sort(np.random.default_rng(4).uniform(0.0, 2.0, count))
    polynomial = np.polynomial.Polynomial(np.arange(1.0, degree + 2))
    for order in (1, 2):
        np.testing.assert_allclose(
            differentiate(polynomial(time), time, order), polynomial.deriv(order)(time), rtol=1e-5, atol=1e-5
        )


# A drive's velocity.


def moving(
    rate: float, encoder: float, drive: float, scale: float = 1.0, late: float = 0.0, vibration: float = 0.0
) -> tuple[Log, Array, Array]:
    """A log of one joint with noise on both, and its true velocity and acceleration.

    Args:
        rate: [1/s].
        encoder: standard deviation of positions [rad].
        drive: the same of velocities [rad/s].
        scale: of the logged velocity.
        late: samples by which it lags.
        vibration: amplitude in the logged velocity at a quarter of the rate [rad/s].
    """
    rng = np.random.default_rng(6)
    time = np.arange(round(8.0 * rate)) / rate
    w = 2 * np.pi * 0.7
    lagged = time - late / rate
    logged = scale * w * np.cos(w * lagged) + drive * rng.normal(size=len(time))
    logged += vibration * np.sin(2 * np.pi * 0.25 * rate * time)
    position = np.sin(w * time) + encoder * rng.normal(size=len(time))
    still = np.zeros_like(time)
    log = Log(time, ("a", "rest"), np.stack([position, still], 1), velocity=np.stack([logged, still], 1))
    return log, w * np.cos(w * time), -(w**2) * np.sin(w * time)


def weight_of_drive(log: Log) -> float:
    """How far the velocity that comes out lies towards the drive's, from the encoder's."""
    assert log.velocity is not None
    alone = motion(Log(log.time, log.joints, log.position))
    drive = smooth(log.velocity, 1.0 / log.period)[:, 0]
    away = drive - alone.velocity[:, 0]
    found = motion(log)
    weight = float(away @ (found.velocity[:, 0] - alone.velocity[:, 0]) / (away @ away))
    slope = differentiate(drive, log.time, 1)
    blend = weight * drive + (1 - weight) * alone.velocity[:, 0]
    np.testing.assert_allclose(found.velocity[:, 0], blend, atol=1e-9)
    blend = weight * slope + (1 - weight) * alone.acceleration[:, 0]
    np.testing.assert_allclose(found.acceleration[:, 0], blend, atol=1e-7)
    np.testing.assert_array_equal(found.velocity[:, 1], 0.0)
    return weight


@pytest.mark.parametrize(("encoder", "drive"), [(1e-4, 5e-3), (1e-4, 2e-3), (1e-4, 1e-2)])
def test_a_drives_velocity_is_weighed_by_its_noise(encoder: float, drive: float) -> None:
    """ω σ_q at 10 Hz against σ_v."""
    log, velocity, acceleration = moving(RATE, encoder, drive)
    of_encoder = (2 * np.pi * 10.0 * encoder) ** 2
    assert weight_of_drive(log) == pytest.approx(of_encoder / (of_encoder + drive**2), rel=0.1)
    found = motion(log)
    np.testing.assert_allclose(middle(found.velocity[:, 0]), middle(velocity), atol=6 * (6.3 * 10 * encoder + drive))
    assert np.std(middle(found.acceleration[:, 0] - acceleration)) < 100 * (6.3 * 10 * encoder + drive)


@pytest.mark.parametrize(
    ("fault", "used"),
    [
        ({"scale": 1.004}, True),
        ({"scale": 0.996}, True),
        ({"scale": 1.006}, False),
        ({"scale": 0.994}, False),
        ({"late": 0.22}, True),
        ({"late": -0.22}, True),
        ({"late": 0.28}, False),
        ({"late": -0.28}, False),
    ],
)
def test_a_drives_velocity_that_lags_or_is_scaled_is_left_out(fault: dict[str, float], used: bool) -> None:
    """Half a per cent, and a quarter of a sample."""
    weight = weight_of_drive(moving(RATE, 1e-5, 1e-4, **fault)[0])
    assert weight == pytest.approx(0.98 if used else 0.0, abs=0.02)


@pytest.mark.parametrize(("rate", "used"), [(80.5, True), (79.5, False)])
def test_noise_is_told_from_motion_from_80_samples_a_second_on(rate: float, used: bool) -> None:
    assert (weight_of_drive(moving(rate, 1e-4, 1e-3)[0]) > 0.5) == used


def test_what_moves_below_a_third_of_the_rate_is_no_noise() -> None:
    plain, shaking = (weight_of_drive(moving(RATE, 1e-4, 5e-3, vibration=size)[0]) for size in (0.0, 0.1))
    assert shaking == pytest.approx(plain, rel=0.05)


# What residuals are compared by.


def test_residuals_are_compared_below_10_hertz_without_the_ends() -> None:
    time = 12.7 + np.arange(1000) / 250.0
    signal = np.sin(2 * np.pi * 10.0 * time)[:, None] * [1.0, -2.0]
    log = Log(time, ("a", "b"), signal)
    kept = below_cutoff(signal, log)
    assert len(kept) == 1000 - 2 * 75  # three tenths of a second at each end
    np.testing.assert_allclose(kept[200:-200], 0.5 * signal[275:-275], atol=1e-3)
    np.testing.assert_allclose(kept, lowpass(signal, 1.0 / log.period)[75:-75], atol=1e-12)


@pytest.mark.parametrize("begin", [0.0, 0.1, 12.7, 4321.1])
def test_samples_on_the_cut_are_kept(begin: float) -> None:
    for rate, cut in ((250.0, 0.3), (100.0, 0.07), (1000.0, 0.021)):
        time = begin + np.arange(400) / rate
        edge = round(cut * rate)
        np.testing.assert_array_equal(np.flatnonzero(inner(time, cut)), np.arange(edge, 400 - edge))
