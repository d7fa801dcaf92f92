"""Curves that follow anything find what a fit leaves, and in noise no more than noise has."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, PAN, RATE, record, swing, terms_of
from twin_diagram.gap.candidates import torque_bias, viscous_friction
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.verdict import leftover_structure
from twin_diagram.gap.verdict.leftover_structure import features, hat, left_over, profiled, regression, scaled

Array = npt.NDArray[np.float64]


@cache
def terms() -> Terms:
    return terms_of(Records(ARM, (record(ARM, *swing(30.0)),)))


def bench_of(torque: Array | float, seed: int, named: bool = True, weights: Array | None = None) -> Bench:
    count = len(terms().records.residual)
    noise = Whitener(np.array([[1.0, -0.4]] * 6), np.full(6, 0.1), (count,))
    rng = np.random.default_rng(seed)
    y = np.zeros((count + 1, 6))
    for t in range(count):
        y[t + 1] = 0.4 * y[t] + 0.1 * rng.normal(size=6)
    candidates = [viscous_friction.on_joints(terms())[PAN][0], torque_bias.on_joints(terms())[ELBOW][0]]
    if not named:
        candidates = [replace(c, name="") for c in candidates]
    return Bench(y[1:] + torque, noise, candidates, [], weights)


@pytest.fixture(autouse=True)
def once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Curves of the same terms are worked out once."""
    monkeypatch.setattr(leftover_structure, "features", lambda records, terms, j: curves_of(j))


@cache
def curves_of(j: int) -> Array:
    return features(terms().records, terms(), j)


def test_noise_alone_has_the_statistic_of_noise() -> None:
    """A mean of nought and a deviation of one, joint by joint, beside what is named, too."""
    found = np.array(
        [
            left_over(terms().records, terms(), b, b.solve(frozenset({0, 1}))).joints
            for b in (bench_of(0.0, s) for s in range(8))
        ]
    )
    assert abs(np.mean(found)) < 0.4 and np.std(found) == pytest.approx(1.0, abs=0.3)


def test_structure_is_found_on_its_joint_with_what_it_gains() -> None:
    records = terms().records
    torque = np.zeros_like(records.residual)
    curve = records.reduce(lambda r: np.abs(np.sin(3.0 * r.q)))[:, ELBOW]
    torque[:, ELBOW] = 0.4 * (curve - np.mean(curve))
    bench = bench_of(torque, 1)
    fit, empty = bench.solve(frozenset({0, 1})), bench_of(0.0, 1)
    found = left_over(records, terms(), bench, fit)
    assert int(np.argmax(found.joints)) == ELBOW and found.statistic == np.max(found.joints) > 20.0
    assert np.max(np.delete(found.joints, ELBOW)) < 5.0
    gained = float(bench.counts[ELBOW] * np.log(fit.variance[ELBOW] / empty.solve(frozenset({0, 1})).variance[ELBOW]))
    assert found.gain == pytest.approx(gained, rel=0.12)


@pytest.mark.parametrize(("size", "noise", "there"), [(5e-4, 1e-3, False), (4e-3, 1e-3, True), (0.0, 1e-3, False)])
def test_what_is_a_trifle_beside_the_torque_is_no_structure(size: float, noise: float, there: bool) -> None:
    """However sure it is: of a simulator's millisecond steps as much is left."""
    records = terms().records
    level = float(terms().torque_size[ELBOW])
    curve = records.reduce(lambda r: np.abs(np.sin(3.0 * r.q)))[:, ELBOW]
    torque = np.zeros_like(records.residual)
    torque[:, ELBOW] = size * level * (curve - np.mean(curve)) / np.std(curve)
    white = Whitener(np.ones((6, 1)), noise * terms().torque_size, (len(torque),))
    drawn = noise * terms().torque_size * np.random.default_rng(6).normal(size=torque.shape)
    bench = Bench(drawn + torque, white, [], [], size=terms().torque_size)
    found = left_over(records, terms(), bench, bench.solve(frozenset()))
    assert (found.joints[ELBOW] > 8.0) == (size > 0.0)
    assert (found.beyond(1e-3) > 8.0) == there and found.beyond(0.0) == pytest.approx(found.statistic)
    if size > 0.0:
        assert found.shares[ELBOW] == pytest.approx(size, rel=0.25)


def test_the_statistic_is_what_curves_explain_beyond_what_noise_lets_them() -> None:
    """Recomputed by plain least squares: k regressors take N log(free/(free − k)) of pure noise, by √(2k)."""
    weights = np.ones((6, len(terms().records.residual) - 1))
    weights[:, ::3] = 0.0
    bench = bench_of(0.05 * terms().records.reduce(lambda r: r.q), 2, weights=weights)
    fit = bench.solve(frozenset({0, 1}))
    found = left_over(terms().records, terms(), bench, fit)
    gain = 0.0
    for j in range(6):
        known = [bench.candidates[k].columns[:, 0, 0] for k in (0, 1) if bench.candidates[k].joints == (j,)]
        curves = curves_of(j)
        y = bench.whitener.joint(j, bench.left(fit)[:, j]) * weights[j] / np.sqrt(fit.variance[j])
        sides = []
        for some in (known, [*known, *curves.T]):
            X = np.zeros((len(y), 0))
            if some:
                X = bench.whitener.joint(j, np.column_stack(some)) * weights[j][:, None]
                X = X / np.sqrt(np.mean(X**2, axis=0))
            c, _, rank, _ = np.linalg.lstsq(X, y, rcond=1e-4) if some else (np.zeros(0), 0, 0, 0)
            sides.append((float(np.sum((y - X @ c) ** 2)), int(rank)))
        (before, spent), (after, more) = sides
        count, k, free = bench.counts[j], more - spent, bench.counts[j] - spent
        ratio, expected = count * np.log(before / after), count * np.log(free / (free - k))
        assert found.joints[j] == pytest.approx(
            (ratio - expected) / (np.sqrt(2.0 * k) * count / (free - k)), rel=1e-3, abs=1e-3
        )
        gain += max(0.0, ratio - expected)
    assert found.gain == pytest.approx(gain, rel=1e-3)


def test_a_nuisance_does_not_count_as_known() -> None:
    torque = np.zeros_like(terms().records.residual)
    torque[:, PAN] = 0.5 * terms().records.reduce(lambda r: r.v)[:, PAN]
    named, nameless = bench_of(torque, 3), bench_of(torque, 3, named=False)
    none = frozenset[int]()
    at_all = [left_over(terms().records, terms(), b, b.solve(none)).joints[PAN] for b in (named, nameless)]
    assert at_all[0] == pytest.approx(at_all[1]) and at_all[0] > 20.0
    left = left_over(terms().records, terms(), named, named.solve(frozenset({0})))
    assert left.joints[PAN] < 5.0
    fits = [left_over(terms().records, terms(), b, b.solve(frozenset({0}))).joints[PAN] for b in (named, nameless)]
    assert fits[0] != pytest.approx(fits[1], rel=1e-6)


def test_a_joint_of_which_little_counts_tells_nothing() -> None:
    """Two samples per curve at least."""
    rows = len(terms().records.residual) - 1
    curves = curves_of(PAN)
    torque = 9.0 * np.random.default_rng(4).normal(size=(rows + 1, 1)) * np.ones(6)
    told = []
    for most in range(2 * curves.shape[1] - 24, 2 * curves.shape[1], 3):
        weights = np.zeros((6, rows))
        weights[:, np.linspace(0, rows - 1, most).astype(int)] = 1.0
        bench = bench_of(torque, 5, weights=weights)
        fit = bench.solve(frozenset())
        noise = replace(bench.whitener, sigma=bench.whitener.sigma * np.sqrt(fit.variance))
        _, rank = profiled(bench.left(fit)[:, PAN], curves, noise, PAN, weights[PAN])
        told.append((most < 2.0 * rank, left_over(terms().records, terms(), bench, fit).joints[PAN] == 0.0))
    assert all(few == silent for few, silent in told) and len(set(told)) == 2


def test_hats_add_up_to_one_and_interpolate() -> None:
    x = np.linspace(0.0, 1.0, 33)
    made = hat(x, 8)
    assert made.shape == (33, 9)
    np.testing.assert_allclose(np.sum(made, axis=1), 1.0)
    np.testing.assert_allclose(made @ np.linspace(0.0, 1.0, 9), x)
    np.testing.assert_array_equal(hat(np.linspace(0.0, 1.0, 9), 8), np.eye(9))


def test_signals_are_scaled_by_their_central_98_per_cent() -> None:
    whole = np.linspace(0.0, 100.0, 10_001)
    np.testing.assert_allclose(
        scaled(np.array([-5.0, 1.0, 50.0, 99.0, 200.0]), whole), [0.0, 0.0, 0.5, 1.0, 1.0], atol=1e-12
    )
    np.testing.assert_array_equal(scaled(np.array([3.0]), np.full(5, 3.0)), 0.0)


@pytest.mark.parametrize(("faint", "kept"), [(0.9e-4, 1), (1.1e-4, 2)])
def test_faint_directions_are_left_out(faint: float, kept: int) -> None:
    Q, _ = np.linalg.qr(np.random.default_rng(6).normal(size=(50, 2)))
    c, rank = regression(Q * np.array([1.0, faint]), Q @ np.array([2.0, 3.0]), 1e-4)
    assert rank == kept
    np.testing.assert_allclose(c[0], 2.0)
    assert regression(Q * np.array([1.0, 0.9e-7]), Q[:, 0], 0.0)[1] == 1
    assert regression(Q * np.array([1.0, 1.2e-7]), Q[:, 0], 0.0)[1] == 2
    nothing, none = regression(np.zeros((5, 0)), np.ones(5), 1e-4)
    assert not len(nothing) and none == 0


def test_what_is_left_of_a_torque_does_not_depend_on_the_regressors_scale() -> None:
    rng = np.random.default_rng(7)
    X, y = rng.normal(size=(200, 3)), rng.normal(size=200)
    noise = Whitener(np.array([[1.0, -0.5]]), np.array([2.0]), (200,))
    weights = np.linspace(0.0, 1.0, 199)
    left, rank = profiled(y, X * np.array([1.0, 1e6, 1e-6]), noise, 0, weights)
    W, z = ((x[1:] - 0.5 * x[:-1]) / 2.0 * (weights if x.ndim == 1 else weights[:, None]) for x in (X, y))
    assert rank == 3 and left == pytest.approx(np.linalg.lstsq(W, z, rcond=None)[1][0])


@pytest.mark.parametrize(
    "law",
    [
        lambda r: np.sign(r.v) * r.q,
        lambda r: r.time[:, None] / r.time[-1] * r.v,
        lambda r: (r.time[:, None] - 3.0) * r.q,
        lambda r: np.sign(r.v) * r.time[:, None],
        lambda r: np.maximum(0.0, np.abs(r.v) - 0.3),
        lambda r: np.abs(r.given - np.mean(r.given, axis=0)),
        lambda r: np.gradient(r.given, 1.0 / RATE, axis=0),
    ],
)
def test_curves_follow_all_that_laws_may_do(law: object) -> None:
    records = terms().records
    y = records.reduce(law)[:, ELBOW]  # type: ignore[arg-type]
    X = curves_of(ELBOW)
    c, *_ = np.linalg.lstsq(X, y, rcond=None)
    assert np.linalg.norm(y - X @ c) < 0.12 * np.linalg.norm(y - np.mean(y))
