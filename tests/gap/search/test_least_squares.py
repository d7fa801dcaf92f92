"""Least squares with priors, against dense algebra on the whole stacked problem."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import LinAlgError

from tests.gap.made import ARM, BAND, RATE, record, swing, swinging
from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search import smooth_fit
from twin_diagram.gap.search.bench import Bench, likelihood_gain, noise_distance, noise_of
from twin_diagram.gap.search.inner_products import InnerProducts
from twin_diagram.gap.search.normal_equations import (
    coefficients,
    covariance_of,
    increment,
    increments,
    smaller,
    smaller_each,
    solutions,
    variances_of,
)
from twin_diagram.gap.search.offered_columns import OfferedColumns
from twin_diagram.gap.search.prior_costs import compatible
from twin_diagram.gap.search.scoring import basis, score_candidate, score_candidates
from twin_diagram.logs.differentiation import lowpass

Array = npt.NDArray[np.float64]

D, N = 60, 3


def made(name: str, rows: tuple[int, ...], size: int = 1, seed: int = 0, **more: Any) -> Candidate:
    rng = np.random.default_rng(seed)
    return Candidate(
        name=name,
        joints=more.pop("joints", rows[:1]),
        links=more.pop("links", ()),
        rows=rows,
        columns=rng.normal(size=(D, len(rows), size)),
        spread=np.linspace(1.0, 2.0, size) * 2.0,
        lower=np.full(size, -np.inf),
        upper=np.full(size, np.inf),
        parameters=linear("x"),
        **more,
    )


FOUR = [
    made("torque_bias", (0,), 1, 1),
    made("payload", (0, 2), 2, 2, joints=(), links=("hand",)),
    made("joint_spring", (1,), 3, 3),
    made("gravity_tilt", (0, 1, 2), 2, 4, joints=()),
    made("viscous_friction", (2,), 1, 5, cost=1.5),
    made("viscous_friction", (0,), 1, 6),
]
WHITENER = Whitener(np.array([[1.0, -0.5], [1.0, 0.3], [1.0, 0.0]]), np.array([0.5, 2.0, 1.0]), (25, 35))


def bench_of(candidates: list[Candidate] = FOUR, nuisances: tuple[Candidate, ...] = (), seed: int = 9) -> Bench:
    rng = np.random.default_rng(seed)
    weights = rng.uniform(size=(N, D - 2)) * (rng.uniform(size=(N, D - 2)) > 0.1)
    residual = rng.normal(size=(D, N)) + candidates[0].columns[:, [0], 0] * np.array([2.0, 0.0, 0.0])
    return Bench(residual, WHITENER, candidates, nuisances, weights)


def dense(bench: Bench, k: int) -> Array:
    """(n R, k) of a candidate's whitened columns over all joints."""
    candidate = bench.candidates[k]
    whole = np.zeros((D, N, candidate.size))
    whole[:, list(candidate.rows)] = candidate.columns
    white = bench.whitener.all(whole) * bench.weights[:, :, None]
    return white.reshape(-1, candidate.size)


def test_inner_products_are_those_of_the_whole_columns() -> None:
    bench = bench_of()
    for i in range(6):
        for k in range(6):
            np.testing.assert_allclose(bench.products.gram(i, k), dense(bench, i).T @ dense(bench, k), atol=1e-12)
            np.testing.assert_allclose(bench.products.gram(k, i), bench.products.gram(i, k).T)
        np.testing.assert_allclose(bench.right[i], dense(bench, i).T @ bench.y.ravel(), atol=1e-12)


def test_stacked_inner_products_are_those_of_each_joint() -> None:
    """Asked twice of what is remembered, and with nothing on a joint."""
    bench = bench_of()
    for order in ((3, 2, 1, 0), (2, 1), (3, 2, 1, 0), (2,), ()):
        square, right, between = bench.products.stacked(order)
        parts = [dense(bench, k).reshape(N, bench.rows, -1) for k in order]
        X = np.concatenate([np.zeros((N, bench.rows, 0)), *parts], axis=2)
        np.testing.assert_allclose(square, np.sum(bench.y**2, axis=1))
        np.testing.assert_allclose(right, np.einsum("jrk,jr->jk", X, bench.y), atol=1e-12)
        np.testing.assert_allclose(between, X.transpose(0, 2, 1) @ X, atol=1e-12)
    assert isinstance(bench.products, InnerProducts)


def test_generalised_least_squares_with_a_prior() -> None:
    bench = bench_of()
    order = (0, 1, 2, 3)
    spread = np.concatenate([bench.candidates[k].spread for k in order])
    variance = np.array([0.5, 2.0, 1.5])
    X = np.concatenate([dense(bench, k) for k in order], axis=1)
    W = np.repeat(1.0 / variance, bench.rows)
    S = X.T @ (W[:, None] * X) + np.diag(spread**-2.0)
    _, right, between = bench.products.stacked(order)
    c, factor, logdet = coefficients(right, between, variance, spread)
    np.testing.assert_allclose(covariance_of(factor), np.linalg.inv(S), rtol=1e-9)
    np.testing.assert_allclose(variances_of(factor), np.diag(np.linalg.inv(S)), rtol=1e-9)
    np.testing.assert_allclose(c, np.linalg.solve(S, X.T @ (W * bench.y.ravel())), rtol=1e-9)
    assert logdet == pytest.approx(np.linalg.slogdet(S @ np.diag(spread**2))[1])
    nothing, empty, none = coefficients(np.zeros((1, 0)), np.zeros((1, 0, 0)), np.ones(1), np.zeros(0))
    assert none == 0.0 and not len(nothing) and not len(covariance_of(empty)) and not len(variances_of(empty))
    with pytest.raises(LinAlgError):  # two columns that are one, and no prior
        coefficients(np.zeros((1, 2)), np.ones((1, 2, 2)), np.ones(1), np.full(2, np.inf))


def test_widths_side_by_side_are_those_of_each_effect() -> None:
    sizes = np.array([1, 3, 2, 1])
    rng = np.random.default_rng(5)
    c, variance, spread = 0.2 * rng.normal(size=7), 0.01 * rng.uniform(size=7), rng.uniform(1.0, 2.0, 7)
    ends = np.cumsum([0, *sizes])
    one_by_one = [smaller(c[a:b], variance[a:b], spread[a:b]) for a, b in pairwise(ends)]
    np.testing.assert_allclose(smaller_each(sizes, c, variance, spread), one_by_one)


def evidence(G: Array, b: Array, spread: Array) -> float:
    """Of unit noise: ½ bᵀ S⁻¹ b − ½ log det(S Λ⁻¹)."""
    S = G + np.diag(spread**-2.0)
    return 0.5 * float(b @ np.linalg.solve(S, b)) - 0.5 * float(np.linalg.slogdet(S @ np.diag(spread**2))[1])


@pytest.mark.parametrize(("size", "told"), [(5.0, False), (1.2, False), (0.4, True), (0.02, True)])
def test_how_much_smaller_than_its_prior_an_effect_is_may_be_said_for_a_price(size: float, told: bool) -> None:
    """A nat and a half; at the width that suits it, of one step of MacKay's."""
    spread, G = np.array([3.0, 3.0]), np.array([[4e4, 30.0], [30.0, 2e4]])
    b = G @ np.array([size, -0.5 * size])
    wide = evidence(G, b, spread)
    S = G + np.diag(spread**-2.0)
    c, variance = np.linalg.solve(S, b), np.diag(np.linalg.inv(S))
    scale = float(np.sqrt(np.mean((c**2 + variance) / spread**2)))
    scale = min(1.0, max(scale, 3e-3))
    narrow = evidence(G, b, scale * spread) - 1.5
    assert (narrow > wide) == told
    rise, found = solutions(G[None], b[None], spread[None])
    assert rise[0] == pytest.approx(max(wide, narrow))
    prior = spread * scale if told else spread
    np.testing.assert_allclose(found[0], np.linalg.solve(G + np.diag(prior**-2.0), b))
    assert increments(G[None], b[None], spread[None])[0] == rise[0]


def test_sizes_that_are_said_end_at_three_thousandths_and_at_two_coefficients() -> None:
    c, variance, spread = np.array([[1e-5], [4e-3], [2.0], [0.5]]), np.zeros((4, 1)), np.ones((4, 1))
    np.testing.assert_allclose(smaller(c, variance, spread), [3e-3, 4e-3, 1.0, 0.5])
    np.testing.assert_allclose(smaller(0.0 * c, 0.09 + variance, spread), 0.3)
    assert smaller(np.full((1, 2), 0.1), np.zeros((1, 2)), np.ones((1, 2))) == pytest.approx(0.1)
    assert smaller(np.full((1, 3), 0.1), np.zeros((1, 3)), np.ones((1, 3))) == 1.0
    assert smaller(np.array([[0.2, 0.0]]), np.zeros((1, 2)), np.full((1, 2), 2.0)) == pytest.approx(0.1 / np.sqrt(2.0))


def test_what_is_not_physical_has_no_evidence() -> None:
    bounded = replace(FOUR[0], lower=np.zeros(1))
    G, spread = np.full((2, 1, 1), 100.0), np.ones((2, 1))
    found = increment(G, np.array([[50.0], [-50.0]]), spread, [bounded, bounded])
    assert np.isfinite(found[0]) and found[1] == -np.inf
    assert found[0] == increments(G, np.array([[50.0], [-50.0]]), spread)[0]


@pytest.mark.parametrize("members", [frozenset(), frozenset({0}), frozenset({1, 2})])
@pytest.mark.parametrize("nuisances", [(), (made("", (0, 1), 2, 8),)])
def test_scores_are_the_rise_of_the_evidence_at_the_whiteners_noise(
    members: frozenset[int], nuisances: tuple[Candidate, ...]
) -> None:
    bench = bench_of(nuisances=nuisances)
    shift = len(nuisances)
    members = frozenset(k + shift for k in members)
    order = bench.solver.order(members)
    assert order == (*range(shift), *sorted(members))
    Q = basis(bench, members)
    assert Q.shape[:2] == (N, bench.rows)
    flat = Q.reshape(N * bench.rows, -1)
    V = np.eye(N * bench.rows)
    for k in order:
        X = dense(bench, k) * bench.candidates[k].spread
        V += X @ X.T
    inverse = np.linalg.inv(V)
    np.testing.assert_allclose(np.eye(len(V)) - flat @ flat.T, inverse, atol=1e-9)
    scores = score_candidates(bench, members)
    projected = np.einsum("jrk,jr->k", Q, bench.y)
    for k, candidate in enumerate(bench.candidates):
        X = dense(bench, k)
        G, b = X.T @ inverse @ X, X.T @ inverse @ bench.y.ravel()
        rise = float(increments(G[None], b[None], candidate.spread[None])[0])
        assert scores[k] == pytest.approx(rise - candidate.cost, abs=1e-8)
        for bounded in (True, False):
            assert score_candidate(bench, candidate, Q, projected, bounded) == pytest.approx(rise, abs=1e-8)


def test_scores_of_what_cannot_be_are_infinite_only_where_bounds_are_asked_for() -> None:
    wrong = replace(FOUR[0], upper=np.full(1, -1.0))
    wide = replace(FOUR[1], lower=np.full(2, 50.0))
    bench = bench_of([wrong, wide, *FOUR[2:]])
    scores = score_candidates(bench, frozenset())
    assert scores[0] == scores[1] == -np.inf and np.all(np.isfinite(scores[2:]))
    Q = basis(bench, frozenset())
    assert np.isfinite(score_candidate(bench, wrong, Q, np.zeros(0)))
    assert score_candidate(bench, wrong, Q, np.zeros(0), bounded=True) == -np.inf
    white = bench.whiten(FOUR[2])
    twice = score_candidate(bench, FOUR[2], Q, np.zeros(0), white=2.0 * white)
    assert twice != score_candidate(bench, FOUR[2], Q, np.zeros(0))


def test_only_offered_candidates_are_scored() -> None:
    bench = bench_of()
    before = score_candidates(bench, frozenset())
    k, wide = bench.add(FOUR[0], offered=False), bench.add(FOUR[3], offered=False)
    scores = score_candidates(bench, frozenset())
    assert scores[k] == scores[wide] == -np.inf and k not in bench.offered and 0 in bench.offered
    np.testing.assert_array_equal(scores[:6], before)
    bench.offered.offer(k)
    bench.offered.offer(wide)
    scores = score_candidates(bench, frozenset())
    assert scores[k] == pytest.approx(before[0]) and scores[wide] == pytest.approx(before[3]) and k in bench.offered


def test_offered_columns_stand_side_by_side() -> None:
    bench = bench_of()
    several, wide = bench.offered.wide()
    assert several == [1, 3] and wide.shape == (N * bench.rows, 4)
    np.testing.assert_allclose(wide, np.concatenate([dense(bench, 1), dense(bench, 3)], axis=1))
    groups = {(one.joint, one.spread.shape[1]): one for one in bench.offered.by_joint()}
    assert {key: list(one.indices) for key, one in groups.items()} == {(0, 1): [0, 5], (1, 3): [2], (2, 1): [4]}
    np.testing.assert_allclose(
        groups[0, 1].columns, np.column_stack([bench.columns[0][0, :, 0], bench.columns[5][0, :, 0]])
    )
    for (joint, size), one in groups.items():
        parts = one.columns.reshape(bench.rows, len(one.indices), size)
        np.testing.assert_allclose(one.own, np.einsum("rmi,rmk->mik", parts, parts))
        np.testing.assert_allclose(one.right, np.einsum("rmi,r->mi", parts, bench.y[joint]))
    assert isinstance(bench.offered, OfferedColumns)


def test_a_benchs_data_are_whitened_and_weighted() -> None:
    bench = bench_of()
    np.testing.assert_allclose(bench.y, WHITENER.all(bench.left(bench.solve(frozenset()))) * bench.weights)
    np.testing.assert_array_equal(bench.counts, np.sum(bench.weights > 0.0, axis=1))
    assert bench.rows == D - 2 and bench.n == N
    assert bench.find("viscous_friction") == [4, 5]
    own = np.array([10.0, 20.0, 0.0])
    sized = Bench(np.ones((D, N)), WHITENER, [], [], None, own)
    np.testing.assert_allclose(sized.finest, (5e-4 * own / WHITENER.sigma) ** 2 + 1e-12)
    unsized = Bench(np.full((D, N), 3.0), WHITENER, [], [], np.zeros((N, D - 2)))
    np.testing.assert_allclose(unsized.finest, (5e-4 * 3.0 / WHITENER.sigma) ** 2 + 1e-12)
    np.testing.assert_array_equal(unsized.counts, 1.0)


def test_a_fits_parts_and_what_it_leaves() -> None:
    bench = bench_of(nuisances=(made("", (1,), 2, 8),))
    fit = bench.solve(frozenset({1, 4}))
    assert fit.order == (0, 1, 4)
    c, covariance = bench.part(fit, 4)
    np.testing.assert_array_equal(c, fit.coefficients[3:6][: len(c)])
    np.testing.assert_array_equal(covariance, fit.covariance[3 : 3 + len(c), 3 : 3 + len(c)])
    with pytest.raises(KeyError):
        bench.part(fit, 2)
    left = bench.left(bench.solve(frozenset())) - bench.left(fit)
    both = np.zeros((D, N))
    for k in (1, 4):
        candidate = bench.candidates[k]
        both[:, list(candidate.rows)] += candidate.columns @ bench.part(fit, k)[0]
    nuisance = bench.candidates[0].columns @ (bench.part(fit, 0)[0] - bench.solve(frozenset()).coefficients)
    both[:, [1]] += nuisance
    np.testing.assert_allclose(left, both, atol=1e-12)


def test_a_hypothesis_is_solved_in_turn_with_the_noise_that_it_leaves() -> None:
    """Three times; its variance holds the finest, and its evidence the empty one's is taken off."""
    bench = bench_of()
    fit, empty = bench.solve(frozenset({0})), bench.solve(frozenset())
    assert empty.evidence == 0.0 and fit is bench.solve(frozenset({0}))
    X, y = bench.columns[0][0], bench.y[0]
    spread = float(bench.candidates[0].spread[0])
    variance = 1.0
    for _ in range(3):
        c = float(X[:, 0] @ y / variance) / float(X[:, 0] @ X[:, 0] / variance + spread**-2.0)
        variance = float(np.sum((y - c * X[:, 0]) ** 2)) / bench.counts[0] + bench.finest[0]
    assert fit.coefficients[0] == pytest.approx(c, rel=1e-4) and fit.variance[0] == pytest.approx(variance, rel=1e-6)
    np.testing.assert_allclose(empty.variance, np.sum(bench.y**2, axis=1) / bench.counts + bench.finest)
    np.testing.assert_allclose(fit.variance[1:], empty.variance[1:])
    assert likelihood_gain(bench, fit) == pytest.approx(bench.counts[0] * np.log(empty.variance[0] / fit.variance[0]))
    ratio = empty.variance[0] / fit.variance[0] - 1.0
    assert noise_distance(bench, fit, empty) == pytest.approx(np.sqrt(bench.counts[0] * ratio))
    assert noise_distance(bench, empty, fit) == 0.0
    noise = noise_of(bench, fit)
    np.testing.assert_allclose(noise.sigma, WHITENER.sigma * np.sqrt(fit.variance))
    spent = bench.solver.spent
    bench.solve(frozenset({1, 2, 3}))
    assert bench.solver.spent == spent + 3


def test_a_hypothesis_whose_coefficients_cannot_be_has_no_evidence() -> None:
    bench = bench_of([replace(FOUR[0], upper=np.zeros(1)), *FOUR[1:]])
    assert bench.solve(frozenset({0})).evidence == -np.inf and np.isfinite(bench.solve(frozenset({1})).evidence)
    free = bench_of(nuisances=(replace(FOUR[0], name="", upper=np.zeros(1)),))
    assert free.solve(frozenset()).evidence == 0.0, "nuisances have no bounds"


def place(name: str, joint: int, link: str = "", **more: Any) -> Candidate:
    links = (link,) if link else ()
    return made(name, (max(joint, 0),), joints=(joint,) if joint >= 0 else (), links=links, **more)


@pytest.mark.parametrize(
    ("old", "new", "both"),
    [
        (place("viscous_friction", 0), place("viscous_friction", 0), False),
        (place("viscous_friction", 0), place("viscous_friction", 1), True),
        (place("viscous_friction", 0), place("coulomb_friction", 0), True),
        (place("coulomb_friction", 0), place("stribeck_friction", 0), False),
        (place("coulomb_friction", 0), place("stribeck_friction", 1), True),
        (place("payload", -1, "hand"), place("payload", -1, "other"), False),
        (place("payload", -1, "hand"), place("inertial_parameters", -1, "hand"), False),
        (place("payload", -1, "hand"), place("inertial_parameters", -1, "arm"), True),
        (place("torque_bias", 0), place("joint_spring", 0), False),
        (place("external_force", -1, "hand"), place("external_force", -1, "arm"), False),
        (place("torque_ripple", 0, shape={"cycles": 4.0}), place("torque_ripple", 0, shape={"cycles": 9.0}), True),
        (place("torque_ripple", 0, shape={"cycles": 4.0}), place("torque_ripple", 0, shape={"cycles": 5.0}), False),
        (place("payload", -1, "hand", excludes=frozenset({"gravity_tilt"})), place("gravity_tilt", -1), False),
        (place("reflected_inertia", 0), place("backlash", 0), False),
        (place("joint_elasticity", 2), place("backlash", 2), False),
    ],
)
def test_which_names_go_together(old: Candidate, new: Candidate, both: bool) -> None:
    assert compatible([old], new) == compatible([new], old) == both
    assert compatible([], new)
    assert compatible([place("torque_constant", 5), old], new) == both


def test_a_smooth_fit_explains_each_joint_by_itself() -> None:
    time, q, v, a = swing(3.0)
    bump = np.zeros_like(q)
    bump[:, 0], bump[:, 1], bump[:, 2] = 3.0 * v[:, 0] + 1.0, 2.0, np.sin(40.0 * time)
    records = Records(ARM, (record(ARM, time, q, v, a, extra=bump),))
    speed = records.reduce(lambda r: r.v)

    def column(rows: tuple[int, ...], values: Array, spread: float) -> Candidate:
        one = np.full(1, spread)
        return Candidate("viscous_friction", rows, (), rows, values, one, -one, one, linear("damping"))

    candidates = [
        column((0,), speed[:, [0], None], 0.5),
        column((2, 4), np.stack([1e-12 * speed[:, [2]], speed[:, [4]]], axis=1), 4.0),
    ]
    explained, spent = smooth_fit.explain(records, candidates)
    np.testing.assert_array_equal(spent, [2, 1, 1, 1, 2, 1])
    np.testing.assert_allclose(explained[:, 0], records.residual[:, 0], atol=1e-9)
    np.testing.assert_allclose(explained[:, 1], 2.0, atol=1e-9)
    np.testing.assert_allclose(explained[:, 2], np.mean(records.residual[:, 2]), atol=1e-9)
    each = smooth_fit.columns(records, candidates)
    assert [x.shape[1] for x in each] == [2, 1, 2, 1, 2, 1]
    np.testing.assert_allclose(each[0][:, 0], 0.5 * speed[:, 0])
    np.testing.assert_allclose(each[4][:, 0], 4.0 * speed[:, 4])
    for j, x in enumerate(each):
        np.testing.assert_allclose(x[:, -1], np.sqrt(np.mean(records.torque[:, j] ** 2)))


@pytest.mark.parametrize(("faint", "kept"), [(0.9e-5, 1), (1.1e-5, 2)])
def test_directions_that_are_negligible_are_left_out(faint: float, kept: int) -> None:
    rng = np.random.default_rng(1)
    Q, _ = np.linalg.qr(rng.normal(size=(50, 2)))
    y = Q @ np.array([2.0, 3.0])
    found, count = smooth_fit.project(Q * np.array([1.0, faint]), y, 1e-5)
    assert count == kept
    np.testing.assert_allclose(found, y if kept == 2 else 2.0 * Q[:, 0], atol=1e-4)
    assert smooth_fit.project(Q * np.array([1.0, 0.9e-7]), y, 0.0)[1] == 1
    assert smooth_fit.project(Q * np.array([1.0, 1.2e-7]), y, 0.0)[1] == 2


def test_thinned_signals_come_back_at_the_full_rate() -> None:
    terms = swinging()
    one = terms.records.records[0]
    second = replace(one, index=1, time=one.time + 7.0)
    records = Records(ARM, (one, second))
    smooth = lowpass(np.random.default_rng(2).normal(size=one.q.shape), RATE, 0.3 * BAND)
    thinned = np.concatenate([smooth[one.kept], 2.0 * smooth[one.kept]])
    back = smooth_fit.at_full_rate(records, thinned)
    inside = slice(one.kept[0] + 20, one.kept[-1] - 20)
    np.testing.assert_allclose(back[0][inside], smooth[inside], atol=0.03 * np.std(smooth))
    np.testing.assert_allclose(back[1], 2.0 * back[0], atol=1e-12)
    np.testing.assert_allclose(back[0][: one.kept[0]], np.tile(smooth[one.kept[0]], (one.kept[0], 1)))
