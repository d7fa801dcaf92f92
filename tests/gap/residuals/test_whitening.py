"""Level and colour of noise: what is claimed of means and coefficients, against their scatter over seeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from tests.gap.search.test_evidence import candidate
from twin_diagram.gap.residuals.whitening import (
    Whitener,
    estimate,
    noise_below,
    ordinary,
    restricted,
)
from twin_diagram.gap.search.bench import Bench
from twin_diagram.logs.differentiation import lowpass

Array = npt.NDArray[np.float64]

FILTERS = {"white": [1.0], "red": [1.0, -0.8], "blue": [1.0, 0.6], "swinging": [1.0, -1.2, 0.7]}


def noise(filters: list[float], shape: tuple[int, ...], sigma: float, seed: int) -> Array:
    """Stationary, along the first axis."""
    white = sigma * np.random.default_rng(seed).normal(size=(shape[0] + 300, *shape[1:]))
    return np.asarray(lfilter([1.0], filters, white, axis=0)[300:])


@pytest.mark.parametrize("colour", FILTERS)
def test_claimed_errors_of_a_constant_in_coloured_noise_are_its_scatter(colour: str) -> None:
    """With level and colour found in the same log."""
    f, off = FILTERS[colour], []
    each = [replace(candidate("torque_bias", j, np.ones(600)), spread=np.array([30.0])) for j in range(3)]
    for seed in range(50):
        y = noise(f, (600, 3), 0.5, seed)
        bench = Bench(y, estimate(y - np.mean(y, axis=0), (600,), 1.0), each, [])
        fit = bench.solve(frozenset({0, 1, 2}))
        off += list(fit.coefficients / np.sqrt(np.diag(fit.covariance)))
    assert np.std(off) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("colour", FILTERS)
def test_level_and_colour_are_found(colour: str) -> None:
    f = np.zeros(9)
    f[: len(FILTERS[colour])] = FILTERS[colour]
    y = np.stack([noise(FILTERS[colour], (20_000,), s, 3) for s in (0.2, 3.0)], axis=1)
    found = estimate(y, (12_000, 8_000))
    np.testing.assert_allclose(found.filters, np.stack([f, f]), atol=0.04)
    np.testing.assert_allclose(found.sigma, [0.2, 3.0], rtol=0.03)
    assert found.order == 8 and found.lengths == (12_000, 8_000)


def test_estimates_are_yules_and_walkers_over_the_pairs_that_count() -> None:
    """Pair by pair within each record, tapered, and the share of fitted parameters added again."""
    rng = np.random.default_rng(4)
    lengths, order, freedom = (30, 25), 3, 7.0
    y = rng.normal(size=(55, 2))
    weights = (rng.uniform(size=(55, 2)) > 0.2).astype(float)
    found = estimate(y, lengths, freedom, weights, order)
    for j in range(2):
        total, pairs = np.zeros(order + 1), np.zeros(order + 1)
        for lag in range(order + 1):
            for first, last in ((0, 30), (30, 55)):
                for t in range(first, last - lag):
                    if weights[t, j] and weights[t + lag, j]:
                        total[lag] += y[t, j] * y[t + lag, j]
                        pairs[lag] += 1.0
        r = total / pairs * (1.0 - np.arange(4) / 55.0) * pairs[0] / (pairs[0] - freedom)
        r[0] *= 1.0001
        a = np.linalg.solve(toeplitz(r[:-1]), r[1:])
        np.testing.assert_allclose(found.filters[j], [1.0, *-a], atol=1e-12)
        assert found.sigma[j] == pytest.approx(np.sqrt(r[0] - a @ r[1:]))


def test_silence_has_a_level_and_no_colour() -> None:
    silent = estimate(np.zeros((50, 1)), (50,))
    assert 0.0 < silent.sigma[0] < 1e-11 and np.all(np.isfinite(silent.filters))
    assert np.all(np.isfinite(estimate(np.ones((5, 1)), (5,), 99.0, order=1).sigma)), "more parameters than samples"


def test_fitted_parameters_take_no_noise_away() -> None:
    rng = np.random.default_rng(5)
    X = rng.normal(size=(200, 60))
    levels = []
    for _ in range(60):
        y = rng.normal(size=200)
        left = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
        levels.append(estimate(left[:, None], (200,), 60.0, order=1).sigma[0])
    assert np.mean(levels) == pytest.approx(1.0, abs=0.03)


def test_whitened_samples_are_innovations_within_each_record() -> None:
    rng = np.random.default_rng(6)
    whitener = Whitener(np.array([[1.0, -0.5, 0.25], [1.0, 0.3, 0.0]]), np.array([2.0, 0.5]), (4, 6))
    signal = rng.normal(size=(10, 2, 3))
    rows = [2, 3, 6, 7, 8, 9]
    np.testing.assert_array_equal(whitener.rows, rows)
    white = whitener.all(signal)
    assert white.shape == (2, 6, 3)
    for j in range(2):
        for place, t in enumerate(rows):
            wanted = sum(whitener.filters[j, k] * signal[t - k, j] for k in range(3)) / whitener.sigma[j]
            np.testing.assert_allclose(white[j, place], wanted)
    np.testing.assert_array_equal(whitener.joint(1, signal[:, 1]), white[1])


def test_pushes_are_means_over_a_second_five_deviations_off() -> None:
    rng = np.random.default_rng(7)
    rate, lengths = 20.0, (300, 200)
    y = rng.normal(size=(500, 3))
    y[100:118, 1] += 2.2
    y[400:415, 2] -= 1.6
    slow = np.zeros_like(y)
    for first, last in ((0, 300), (300, 500)):
        for j in range(3):
            around = np.pad(y[first:last, j], (10, 9), mode="symmetric")
            slow[first:last, j] = np.convolve(around, np.ones(20) / 20.0, "valid")
    off = np.abs(slow - np.median(slow, axis=0))
    far = off > 5.0 * 1.4826 * np.median(off, axis=0)
    wanted = np.ones_like(y)
    for first, last in ((0, 300), (300, 500)):
        for t, j in zip(*np.nonzero(far[first:last]), strict=True):
            wanted[first + max(0, t - 9) : first + min(last - first, t + 11), j] = 0.0
    found = ordinary(y, lengths, rate)
    assert 10 < np.sum(far) and 0.85 < np.mean(wanted) < 0.98
    assert np.mean(found != wanted) < 0.006, "but for a sample at the ends of each"
    np.testing.assert_array_equal(ordinary(np.zeros((50, 1)), (50,), rate), 1.0)


def test_a_spell_is_three_samples_at_least() -> None:
    y = np.random.default_rng(8).normal(size=(400, 1))
    np.testing.assert_array_equal(ordinary(y, (400,), 0.5), ordinary(y, (400,), 3.0))


@pytest.mark.parametrize("colour", ["white", "red", "swinging"])
def test_many_regressors_make_no_hole_in_the_noise(colour: str) -> None:
    """A third as many as samples: level and colour are still those of the noise."""
    f = np.zeros(4)
    f[: len(FILTERS[colour])] = FILTERS[colour]
    answer = lfilter([1.0], f, np.eye(1, 200)[0])
    expected = np.array([answer[k:] @ answer[: 200 - k] for k in range(4)]) / (answer @ answer)
    levels, filters = [], []
    for seed in range(6):
        X = 30.0 * noise([1.0, -0.5], (300, 100), 1.0, seed + 50)
        y = noise(FILTERS[colour], (300, 1), 0.7, seed) + (X @ np.random.default_rng(seed).normal(size=100))[:, None]
        start = Whitener(np.eye(1, 4), np.ones(1), (300,))
        weights = np.ones((1, 297))
        found = restricted(y, [X], start, weights, expected)
        levels.append(found.sigma[0])
        filters.append(found.filters[0])
    assert np.mean(levels) == pytest.approx(0.7, rel=0.08)
    np.testing.assert_allclose(np.mean(filters, axis=0), f, atol=0.15)


@pytest.mark.parametrize(("regressors", "kept"), [(5, 5), (80, 50)])
def test_restricted_noise_explains_itself(regressors: int, kept: int) -> None:
    """One more expectation and maximisation, by plain inverses, changes nothing; half the freedom is the noise's."""
    rng = np.random.default_rng(9)
    order, count = 2, 100
    X = rng.normal(size=(130, regressors)) * np.geomspace(30.0, 3.0, regressors)
    y = rng.normal(size=(130, 1)) + X @ rng.normal(size=(regressors, 1))
    weights = np.zeros((1, 128))
    weights[0, 20 : 20 + count] = 1.0
    white = np.array([1.0, 0.5, 0.2])
    found = restricted(y, [X], Whitener(np.eye(1, 3), np.ones(1), (130,)), weights, white, rounds=3000)
    _, _, Vt = np.linalg.svd(X, full_matrices=False)
    Q = X @ Vt[:kept].T
    rows = np.arange(22, 22 + count)
    lags = [np.column_stack([y[rows - k, 0], Q[rows - k]]) for k in range(order + 1)]
    whole = np.tensordot(found.filters[0], lags, 1) / found.sigma[0]
    P = np.linalg.inv(whole[:, 1:].T @ whole[:, 1:] + np.eye(kept))
    c = P @ whole[:, 1:].T @ whole[:, 0]
    R = np.array([[float((a[:, 0] - a[:, 1:] @ c) @ (b[:, 0] - b[:, 1:] @ c)) for b in lags] for a in lags])
    R += [[float(np.trace(a[:, 1:] @ P @ b[:, 1:].T)) for b in lags] for a in lags]
    believed = R + 0.2 * R[0, 0] * toeplitz(white)
    f = np.array([1.0, *-np.linalg.solve(believed[1:, 1:], believed[1:, 0])])
    rel = 0.02 if kept == 50 else 2e-3
    np.testing.assert_allclose(f, found.filters[0], atol=rel)
    assert np.sqrt(f @ R @ f / count) == pytest.approx(found.sigma[0], rel=rel)


def test_regressors_below_the_noise_take_none_of_it() -> None:
    rng = np.random.default_rng(10)
    y = rng.normal(size=(200, 1))
    start, weights, white = Whitener(np.eye(1, 2), np.ones(1), (200,)), np.ones((1, 199)), np.eye(1, 2)[0]
    X = rng.normal(size=(200, 1))
    X /= np.linalg.norm(X)
    without = restricted(y, [np.zeros((200, 0))], start, weights, white)
    assert restricted(y, [0.99 * X], start, weights, white).sigma == without.sigma
    assert restricted(y, [1.01 * X], start, weights, white).sigma != without.sigma
    lagged = np.column_stack([y[1:, 0], y[:-1, 0]])
    R = lagged.T @ lagged
    f = -R[1, 0] / (R[1, 1] + 0.2 * R[0, 0])
    assert without.filters[0, 1] == pytest.approx(f, rel=1e-3)
    assert without.sigma[0] == pytest.approx(np.sqrt((R[0, 0] + 2.0 * f * R[0, 1] + f**2 * R[1, 1]) / 199.0), rel=1e-3)


@pytest.mark.parametrize("colour", FILTERS)
def test_noise_below_a_cutoff_is_what_a_filter_leaves(colour: str) -> None:
    """Of a fourth-order low-pass, forward and backward."""
    rate = 50.0
    y = noise(FILTERS[colour], (60_000,), 1.3, 11)
    known = Whitener(np.array([FILTERS[colour]] * 2), np.array([1.3, 2.6]), (60_000,))
    for cutoff in (10.0, 4.0):
        claimed = noise_below(known, rate, cutoff)
        assert np.std(lowpass(y, rate, cutoff)) == pytest.approx(claimed[0], rel=0.05)
        assert claimed[1] == pytest.approx(2.0 * claimed[0])
    assert noise_below(known, rate)[0] == pytest.approx(noise_below(known, rate, 10.0)[0])
