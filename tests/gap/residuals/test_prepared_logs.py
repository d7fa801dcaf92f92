"""Logs made ready: bands, strides and noise against closed forms; which logs are long enough and say something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, effect, record, swing, swinging
from twin_diagram.errors import LogError
from twin_diagram.gap.residuals.log_noise import mean_inertia, noise_above, roughness, shaken, trusted_band
from twin_diagram.gap.residuals.prepared_logs import (
    Record,
    Records,
    moves,
    prepare,
    round_stride,
    usable,
)
from twin_diagram.logs import Log, fingerprint
from twin_diagram.logs.dejittering import dejittered
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.model import Model

Array = npt.NDArray[np.float64]


def log_of(
    seconds: float = 4.0, rate: float = 250.0, torque_noise: float = 1.0, position_noise: float = 1e-7, seed: int = 0
) -> Log:
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    q = np.array([0.2, -1.2, 1.3, -0.9, -1.0, 0.3]) + 0.3 * np.sin(2.0 * time[:, None] + np.arange(6.0))
    return Log(
        time,
        ARM.joints,
        q + position_noise * rng.normal(size=q.shape),
        torque=5.0 + torque_noise * rng.normal(size=q.shape),
    )


@pytest.mark.parametrize(
    ("rate", "band", "stride"), [(250.0, 20.0, 5), (500.0, 20.0, 10), (125.0, 20.0, 2), (80.0, 16.0, 2)]
)
def test_band_and_thinning_go_with_the_logs_rate(rate: float, band: float, stride: int) -> None:
    """Twenty hertz or a fifth of the rate; two and a half samples kept per second for each of the band."""
    records = prepare(ARM, [log_of(3.0, rate)])
    record = records.records[0]
    assert record.band == pytest.approx(band) and record.rate == pytest.approx(rate)
    assert set(np.diff(record.kept)) == {stride} and records.rate == pytest.approx(rate / stride)
    assert record.times[0] >= 0.3 - 1e-9 and record.times[-1] <= record.time[-1] - 0.3 + 1e-9
    assert record.times[0] < 0.3 + 1.01 / rate
    assert record.period == pytest.approx(1.0 / rate) and record.index == 0


@pytest.mark.parametrize(
    ("rates", "thinned"), [((125.0, 1000.0), 62.5), ((1000.0, 125.0), 62.5), ((100.0, 500.0), 50.0)]
)
def test_logs_of_any_rates_are_thinned_to_the_same(rates: tuple[float, float], thinned: float) -> None:
    """One noise's colour is that of samples so far apart."""
    records = prepare(ARM, [log_of(3.0, rate) for rate in rates])
    each = [record.rate / (record.kept[1] - record.kept[0]) for record in records.records]
    np.testing.assert_allclose(each, thinned, rtol=1e-9)


def test_all_logs_share_the_band_that_the_poorest_of_them_allows() -> None:
    logs = [log_of(3.0, 250.0), log_of(3.0, 80.0), log_of(3.0, 250.0, torque_noise=0.02, position_noise=2e-5)]
    each = [prepare(ARM, [log]).records[0].band for log in logs]
    together = prepare(ARM, logs)
    assert each[2] < each[1] < each[0]
    assert {r.band for r in together.records} == {min(each)}
    assert [r.index for r in together.records] == [0, 1, 2]
    np.testing.assert_array_equal(np.bincount(together.owner), together.lengths)
    assert len(together.residual) == sum(together.lengths) == len(together.times)
    assert [r.mark for r in together.records[:1]] == [fingerprint(logs[0])]


@pytest.mark.parametrize(("torque_noise", "position_noise"), [(0.5, 1e-6), (0.1, 4e-7)])
def test_the_band_ends_where_position_noise_is_a_third_of_the_torques(
    torque_noise: float, position_noise: float
) -> None:
    """At f with I (2π f)² σ_q = 0.3 σ_τ, on the joint that allows least."""
    log = log_of(40.0, 250.0, torque_noise, position_noise)
    inertia = np.mean([np.diag(ARM.mass_matrix(q)) for q in log.position[::200]], axis=0)
    wanted = np.min(np.sqrt(0.3 * torque_noise / (inertia * position_noise))) / (2.0 * np.pi)
    assert 8.5 < wanted
    assert trusted_band(ARM, log) == pytest.approx(wanted, rel=0.03)
    np.testing.assert_allclose(mean_inertia(ARM, log), inertia, rtol=0.01)


def test_no_band_is_narrower_than_motion() -> None:
    noisy = log_of(4.0, 250.0, 1e-4, 1e-4)
    wrist = 1e-3 * np.outer(np.sin(30.0 * noisy.time), np.arange(6) == 5)
    assert trusted_band(ARM, replace(noisy, position=noisy.position + wrist)) == 8.0, "where one joint does"
    assert trusted_band(ARM, noisy) == 4.0, "where nothing moves faster, at whatever rate"
    for rate, known in ((63.0, False), (65.0, True)):
        log = log_of(4.0, rate)
        brisk = replace(log, position=log.position + 1e-3 * np.sin(30.0 * log.time)[:, None])
        assert np.isfinite(trusted_band(ARM, brisk)) == known, "eight samples per period"
    assert trusted_band(ARM, log_of(20.0, 50.0, 1e-4, 1e-4)) == 4.0
    still = log_of(4.0)
    assert trusted_band(ARM, replace(still, position=np.zeros_like(still.position))) == np.inf


@pytest.mark.parametrize("band", [4.0, 7.0, 10.0, 20.0])
@pytest.mark.parametrize("torque_noise", [0.4, 0.01])
def test_noise_above_the_band_is_what_the_residuals_low_pass_leaves_of_it(band: float, torque_noise: float) -> None:
    """White on torques, and on positions as it grows with the fourth power of the frequency: each of them the more."""
    log = log_of(40.0, 250.0, torque_noise, 2e-5)
    f = np.linspace(band, 10.0, 2001)
    inertial = mean_inertia(ARM, log)[:, None] * 2e-5 * (2.0 * np.pi * f) ** 2
    wanted = (
        np.sqrt(2.0 / 250.0 * np.trapezoid(torque_noise**2 + inertial**2, f, axis=1)) if band < 10.0 else np.zeros(6)
    )
    np.testing.assert_allclose(noise_above(ARM, log, band), wanted, rtol=0.1, atol=1e-12)


def test_a_torque_that_is_not_logged_narrows_no_band() -> None:
    log = log_of(8.0, 500.0, position_noise=5e-6)
    assert log.torque is not None
    dead = replace(log, torque=np.where(np.arange(6) == 5, 0.0, log.torque))
    assert 10.0 < trusted_band(ARM, log) == pytest.approx(trusted_band(ARM, dead))


def test_position_noise_as_inertial_torque_over_the_torques_own() -> None:
    log = log_of(40.0, 250.0, 0.4, 1e-5)
    inertia = mean_inertia(ARM, log)
    wanted = inertia * 1e-5 * (2.0 * np.pi * 12.0) ** 2 / 0.4
    np.testing.assert_allclose(shaken(ARM, log, 12.0), wanted, rtol=0.06)
    record = prepare(ARM, [log]).records[0]
    np.testing.assert_allclose(record.shaken, wanted * (record.band / 12.0) ** 2, rtol=0.06)


@pytest.mark.parametrize(("share", "within"), [(0.0, 0.01), (0.009, 0.05)])
def test_white_noise_is_known_beside_a_few_outliers(share: float, within: float) -> None:
    rng = np.random.default_rng(1)
    noise = 0.3 * rng.normal(size=(8000, 1))
    noise[rng.choice(8000, round(share * 8000 / 5), replace=False)] += 30.0
    assert roughness(noise, 0.004)[0] == pytest.approx(0.3, rel=within)


@pytest.mark.parametrize(("rest", "counts"), [(0.09, True), (0.11, False)])
def test_a_rest_of_a_tenth_of_a_second_says_nothing_of_noise(rest: float, counts: bool) -> None:
    """An encoder that says the same between two steps is quiet for as long as they are apart."""
    rate = 1000.0
    signal = np.zeros((8000, 1))
    rng = np.random.default_rng(2)
    every = round((rest + 0.02) * rate)
    for k in range(0, 8000 - every, every):
        signal[k : k + 20, 0] = rng.normal(size=20)
    rough = np.abs(np.diff(signal[:, 0], 4)) / np.sqrt(70.0)
    whole = np.sqrt(np.mean(np.sort(rough)[: int(0.99 * len(rough))] ** 2)) / 0.9617  # a Gauss without its last percent
    busy = roughness(signal, 1.0 / rate)[0]
    assert (busy == pytest.approx(whole, rel=0.02)) == counts


def test_white_noise_after_filter_and_thinning_has_this_colour() -> None:
    rng = np.random.default_rng(3)
    time, q, v, a = swing(5.0)
    one = record(ARM, time, q, v, a)
    expected = Records(ARM, (one,)).white(6)
    assert expected[0] == 1.0
    long = replace(one, kept=np.arange(100, 39_900, 5))
    y = long.reduce(rng.normal(size=(40_000, 6)))
    found = [np.mean(y[: len(y) - k] * y[k:]) / np.mean(y**2) for k in range(7)]
    np.testing.assert_allclose(expected, found, atol=0.015)
    more = Records(ARM, (one,)).white(200)
    assert len(more) == 201 and not np.any(more[40:])


def test_an_impulse_is_answered_by_the_low_pass() -> None:
    one = swinging().records.records[0]
    impulse = np.zeros(401)
    impulse[200] = 1.0
    wanted = lowpass(impulse, 200.0, 20.0)
    assert len(one.response) == 81
    np.testing.assert_allclose(one.response, wanted[160:241], atol=1e-6)


def test_reduced_signals_are_low_passed_and_thinned_whatever_their_shape() -> None:
    one = swinging().records.records[0]
    signal = np.random.default_rng(4).normal(size=(len(one.time), 2, 3))
    reduced = one.reduce(signal)
    assert reduced.shape == (len(one.kept), 2, 3)
    np.testing.assert_allclose(reduced[:, 1, 2], lowpass(signal[:, 1, 2], 200.0, 20.0)[one.kept])


def test_what_is_logged_beyond_the_given_model_is_the_residual() -> None:
    time, q, v, a = swing(3.0)
    first = record(ARM, time, q, v, a, extra=2.0)
    second = record(ARM, time + 50.0, q, v, a, extra=-1.0, index=1)
    records = Records(ARM, (first, second))
    half = len(first.kept)
    np.testing.assert_allclose(records.residual[:half], 2.0, atol=1e-6)
    np.testing.assert_allclose(records.residual[half:], -1.0, atol=1e-6)
    np.testing.assert_allclose(records.torque, records.reduce(lambda r: r.torque))
    assert records.n == 6 and records.lengths == (half, half)
    np.testing.assert_array_equal(records.times[half:], records.times[:half] + 50.0)
    np.testing.assert_array_equal(records.owner, np.repeat([0, 1], half))
    for found, signal in zip(records.motion, (q, v, a), strict=True):
        np.testing.assert_array_equal(found[:half], signal[first.kept])
    np.testing.assert_array_equal(records.full(lambda r: r.q), np.concatenate([q, q]))


def test_times_are_evened_out_where_that_makes_positions_smoother() -> None:
    rng = np.random.default_rng(5)
    even = log_of(2.0, 250.0)
    jitter = even.time + rng.uniform(-0.0012, 0.0012, len(even.time))
    stamped_late = replace(even, time=jitter)
    found = dejittered(stamped_late)
    assert found is not stamped_late
    np.testing.assert_allclose(found.time, even.time, atol=2e-4)
    moved = 0.2 + 0.3 * np.sin(2.0 * jitter[:, None] + np.arange(6.0))
    true_times = replace(even, time=jitter, position=moved)
    assert dejittered(true_times) is true_times
    assert dejittered(even) is even
    for count, evened in ((49, False), (50, True)):
        short = replace(
            stamped_late, time=jitter[:count], position=even.position[:count], torque=np.ones((count, 6)), velocity=None
        )
        assert (dejittered(short) is not short) == evened
    for late in (0.45, 0.56):  # none was lost, so also what is nearer to the next one's time is known by its number
        gap = jitter.copy()
        gap[250] = even.time[250] + late * 0.004
        off = dejittered(replace(stamped_late, time=gap))
        np.testing.assert_allclose(off.time, even.time, atol=2e-4)


@pytest.mark.parametrize(
    ("seconds", "shortest", "enough"), [(2.58, 2.0, False), (2.62, 2.0, True), (1.58, 1.0, False), (1.62, 1.0, True)]
)
def test_a_log_must_last_two_seconds_between_its_ends(seconds: float, shortest: float, enough: bool) -> None:
    log = log_of(seconds, 250.0)
    if enough:
        assert usable(log, shortest) == pytest.approx(seconds, abs=0.01)
    else:
        with pytest.raises(LogError, match=f"{shortest + 0.6:g} s are needed"):
            usable(log, shortest)
    if shortest == 2.0 and not enough:
        with pytest.raises(LogError, match=r"2\.6 s"):
            usable(log)


def test_a_log_without_torque_or_no_log_at_all_cannot_be_compared() -> None:
    silent = log_of()
    with pytest.raises(LogError, match="zero throughout"):
        usable(replace(silent, torque=np.zeros_like(silent.position)))
    with pytest.raises(LogError, match="no torque ever changes"):
        usable(replace(silent, torque=np.ones_like(silent.position)))
    with pytest.raises(LogError, match="at least one"):
        prepare(ARM, [])


@pytest.mark.parametrize(("rate", "stride"), [(4850.0, 97), (5000.0, 142), (1000.0, 20), (250.0, 5), (60.0, 1)])
def test_a_thinned_log_keeps_a_rate_between_its_own_and_the_thinned_one(rate: float, stride: int) -> None:
    rounded = round_stride(rate, stride)
    assert 0.8 * stride <= rounded <= stride
    between = [k for k in range(1, rounded + 1) if rounded % k == 0 and rate / k >= min(240.0, rate)]
    assert rate / max(between) <= 600.0


def test_what_gears_pass_on_is_without_dry_friction() -> None:
    dry = effect("coulomb_friction", [ARM.joints[ELBOW]], torque=4.0)
    log = log_of(3.0)
    with_it, slick = (prepare(ARM.with_effects(some), [log]).records[0] for some in ([dry], []))
    np.testing.assert_allclose(with_it.passed, slick.given, atol=1e-9)
    assert slick.passed is slick.given
    moving = np.abs(with_it.v[:, ELBOW]) > 0.1
    off = (with_it.given - with_it.passed)[:, ELBOW]
    np.testing.assert_allclose(off[moving], 4.0 * np.sign(with_it.v[moving, ELBOW]), atol=1e-6)
    made: Record = with_it
    assert made.torque.shape == made.q.shape


def test_friction_that_a_description_states_is_not_passed_on_either() -> None:
    stated = replace(ARM.arm.stated, friction=dict.fromkeys(ARM.joints, 4.0))
    less = effect("coulomb_friction", [ARM.joints[ELBOW]], torque=-1.0)
    model, log = Model(ARM.plant, replace(ARM.arm, stated=stated), [less]), log_of(3.0)
    made, bare = (prepare(one, [log]).records[0] for one in (model, ARM))
    np.testing.assert_allclose(made.passed, bare.given, atol=1e-9)
    assert np.max(np.abs(made.given - made.passed)) == pytest.approx(4.0, rel=1e-3)


def test_an_arm_at_rest_does_not_move_whatever_its_encoders_noise_and_a_slow_one_does() -> None:
    moving = log_of(position_noise=1e-4)
    noise = np.random.default_rng(1).normal(size=moving.position.shape)
    home = np.broadcast_to(moving.position[0], moving.position.shape)
    assert moves(moving)
    assert not moves(replace(moving, position=home.copy()))
    assert not moves(replace(moving, position=home + 1e-3 * noise))
    slow = home + 0.02 * (moving.position - home) + 1e-4 * noise
    assert moves(replace(moving, position=slow))
