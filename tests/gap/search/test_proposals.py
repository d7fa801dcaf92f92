"""Ripples, starts and pushes are proposed where they are, and only where they are worth it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, LIFT, PAN, RATE, WRIST, record, swing, terms_of
from twin_diagram.gap.candidates import external_force, torque_bias, torque_constant, torque_ripple
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.blocks_of_time import block_edges, block_sums, spans
from twin_diagram.gap.search.normal_equations import increments
from twin_diagram.gap.search.proposals import Proposer, active
from twin_diagram.gap.search.push_points import at_their_points
from twin_diagram.gap.search.scoring import basis, score_candidate, score_spans
from twin_diagram.logs.differentiation import lowpass

Array = npt.NDArray[np.float64]

NOISE = 0.1


@cache
def terms() -> Terms:
    return terms_of(Records(ARM, (record(ARM, *swing(14.0)),)))


def bench_of(torque: Array, candidates: list[Candidate], seed: int = 3, level: float = NOISE) -> Bench:
    """White noise beside a torque (ΣD, 6), and a nuisance that takes none of it."""
    count = len(terms().records.residual)
    one, none = np.ones(1), torque_bias.on_joints(terms())[WRIST][0]
    nuisance = replace(none, name="", columns=1e-9 * none.columns, spread=1e-9 * one)
    noise = Whitener(np.ones((6, 1)), np.full(6, level), (count,))
    return Bench(torque + level * np.random.default_rng(seed).normal(size=(count, 6)), noise, candidates, [nuisance])


def test_blocks_are_equal_and_their_sums_add_up() -> None:
    edges = block_edges(1000)
    assert len(edges) == 65 and edges[0] == 0 and edges[-1] == 1000 and set(np.diff(edges)) <= {15, 16}
    rng = np.random.default_rng(0)
    X, Q, y = rng.normal(size=(2, 50, 3)), rng.normal(size=(2, 50, 4)), rng.normal(size=(2, 50))
    G, C, b = block_sums(X, Q, y, [0, 7, 20, 50])
    assert G.shape == (3, 3, 3) and C.shape == (3, 4, 3) and b.shape == (3, 3)
    np.testing.assert_allclose(G[1], sum(X[j, 7:20].T @ X[j, 7:20] for j in range(2)))
    np.testing.assert_allclose(C[1], sum(Q[j, 7:20].T @ X[j, 7:20] for j in range(2)))
    np.testing.assert_allclose(b[2], sum(X[j, 20:].T @ y[j, 20:] for j in range(2)))


def test_a_push_lasts_two_blocks_at_least_and_half_a_log_at_most_unless_it_goes_on() -> None:
    found = {(int(i), int(k)) for i, k in spans()}
    wanted = {(i, k) for i in range(1, 64) for k in range(1, 65) if 2 <= k - i <= 32}
    wanted |= {(i, 64) for i in range(3, 32)}
    assert found == wanted


def test_what_is_switched_on_is_seen_low_passed() -> None:
    """At moments between samples, too; it stays on in later logs, and was off in earlier ones."""
    one = terms().records.records[0]
    both = terms_of(Records(ARM, (one, replace(one, index=1, time=one.time + 3.0))))
    half = len(one.kept)
    seen = active(both, (0, 5.0), None)
    step = (one.time >= 5.0).astype(float)
    step[np.isclose(one.time, 5.0)] = 0.5
    np.testing.assert_allclose(seen[:half], lowpass(step, RATE, 20.0)[one.kept], atol=1e-9)
    np.testing.assert_allclose(seen[half:], 1.0, atol=1e-9)
    between = active(both, (0, 5.0 + 0.25 / RATE), None)
    np.testing.assert_allclose(
        (seen - between)[:half], 0.25 * lowpass(np.isclose(one.time, 5.0) * 1.0, RATE, 20.0)[one.kept], atol=1e-9
    )
    late = active(both, (1, 9.0), None)
    assert np.max(np.abs(late[:half])) < 1e-9 and late[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(active(both, (0, 5.0), (0, 8.0)), seen - active(both, (0, 8.0), None), atol=1e-12)
    np.testing.assert_allclose(active(both, None, (0, 5.0)), 1.0 - seen, atol=1e-9)


def best_start(bench: Bench, k: int) -> tuple[float, float]:
    """Evidence of acting from the best block on, and of acting all the time, each less its price."""
    candidate, edges = bench.candidates[k], np.round(np.linspace(0, bench.rows, 65)).astype(int)
    X, y = bench.columns[k].reshape(-1, candidate.size), bench.y[list(candidate.rows)].ravel()
    whole = float(np.sum((X * candidate.spread) ** 2))
    scores = []
    for start in range(3, 61):
        on = slice(edges[start], None)
        before = float(np.sum((X[: edges[start + 1]] * candidate.spread) ** 2)) - float(
            np.sum((X[edges[start] : edges[start + 1]] * candidate.spread) ** 2)
        )
        rise = increments((X[on].T @ X[on])[None], (X[on].T @ y[on])[None], candidate.spread[None])[0]
        scores.append(rise if before >= 0.05 * whole else -np.inf)
    all_of_it = increments((X.T @ X)[None], (X.T @ y)[None], candidate.spread[None])[0]
    return max(scores) - np.log(64.0) - candidate.cost, float(all_of_it) - candidate.cost


def proposed(torque: Array, candidates: list[Candidate], what: str) -> tuple[Bench, list[int]]:
    bench = bench_of(torque, candidates)
    Q = basis(bench, frozenset())
    proposer = Proposer(terms())
    if what == "ripples":
        return bench, proposer.ripples(bench, frozenset(), Q, np.zeros(1))
    return bench, getattr(proposer, what)(bench, Q, np.zeros(1))


@pytest.mark.parametrize("onset", [4.0, 7.313, 10.0])
def test_a_start_is_found_to_a_fraction_of_a_sample(onset: float) -> None:
    bias = torque_bias.on_joints(terms())[ELBOW][0]
    torque = np.zeros_like(terms().records.residual)
    torque[:, ELBOW] = -2.0 * active(terms(), (0, onset), None)
    bench, made = proposed(torque, [bias], "starts")
    (k,) = made
    found = bench.candidates[k]
    assert found.variant == "starting" and found.onset is not None and found.end is None and k in bench.offered
    assert found.onset[0] == 0 and found.onset[1] == pytest.approx(onset, abs=0.35 / terms().records.rate)
    assert found.cost == pytest.approx(np.log(64.0)) and found.name == "torque_bias"
    np.testing.assert_allclose(found.columns[:, 0, 0], active(terms(), found.onset, None), atol=1e-9)


@pytest.mark.parametrize("moments", [[(0, 5.0), (0, 5.013), (0, 5.06)], [(1, 0.3), (1, 0.31)], [(0, 9.0), (1, 5.0)]])
def test_spans_that_are_alike_score_as_each_does_alone(moments: list[tuple[int, float]]) -> None:
    """In one log or several, near a begin or not, beside a hypothesis, with samples that do not count."""
    one = terms().records.records[0]
    both = terms_of(Records(ARM, (one, replace(one, index=1))))
    count, rng = len(one.kept), np.random.default_rng(1)
    noise = Whitener(np.column_stack([np.ones(6), 0.3 * rng.normal(size=(6, 3))]), np.full(6, 0.2), (count, count))
    force, *_, other = external_force.external_forces(both)[8:]
    weights = rng.uniform(0.0, 1.0, (6, 2 * count - 6))
    bench = Bench(rng.normal(size=(2 * count, 6)), noise, [other], [], weights=weights)
    Q = basis(bench, frozenset([0]))
    projected = np.einsum("jrk,jr->k", Q, bench.y)
    acts = [active(both, moment, None) for moment in moments]
    alone = [score_candidate(bench, force.during(act, None, None), Q, projected) for act in acts]
    found = score_spans(bench, force, acts, Q, projected)
    np.testing.assert_allclose(found, alone, rtol=1e-9)
    assert len(set(found.round(6))) == len(acts)


def test_a_torque_constant_that_starts_is_a_failing_motor() -> None:
    gain = torque_constant.on_joints(terms())[LIFT][0]
    torque = np.zeros_like(terms().records.residual)
    torque[:, LIFT] = 0.3 * gain.columns[:, 0, 0] * active(terms(), (0, 6.0), None)
    bench, (k,) = proposed(torque, [gain], "starts")
    assert bench.candidates[k].name == "actuator_fault"


@pytest.mark.parametrize(("beyond", "there"), [(-0.5, False), (0.5, True)])
@pytest.mark.parametrize("bound", ["name", "whole"])
def test_a_start_must_be_worth_its_name_and_more_than_acting_all_the_time(
    bound: str, beyond: float, there: bool
) -> None:
    """Sixteen nats beside none, and three beyond what the same brings from the begin."""
    bias = torque_bias.on_joints(terms())[ELBOW][0]
    step = active(terms(), (0, 4.0), None)

    def torque(size: float) -> Array:
        result = np.zeros_like(terms().records.residual)
        result[:, ELBOW] = size * step if bound == "name" else 2.0 - size * (1.0 - step)
        return result

    def excess(size: float) -> float:
        start, whole = best_start(bench_of(torque(size), [bias]), 1)
        return start - (16.0 if bound == "name" else whole + 3.0)

    low, high = 0.0, 1.0 if bound == "name" else 2.0
    for _ in range(16):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < beyond else (low, middle)
    assert excess(high) == pytest.approx(beyond, abs=0.45)
    assert bool(proposed(torque(high), [bias], "starts")[1]) == there


def test_nothing_starts_where_nothing_could_have_shown_before() -> None:
    """A twentieth of what it shows must lie before; variants and what starts already are not asked."""
    bias = torque_bias.on_joints(terms())[ELBOW][0]
    for still, there in ((7.2, False), (5.5, True)):
        shown = np.clip((terms().records.times - still) * 1e3, 0.0, 1.0)
        late = replace(bias, columns=bias.columns * shown[:, None, None])
        torque = np.zeros_like(terms().records.residual)
        torque[:, ELBOW] = 2.0 * active(terms(), (0, 6.2), None)
        assert bool(proposed(torque, [late], "starts")[1]) == there
    torque = np.zeros_like(terms().records.residual)
    torque[:, ELBOW] = 2.0 * active(terms(), (0, 6.2), None)
    for other in (
        replace(bias, variant="x"),
        replace(bias, onset=(0, 1.0)),
        replace(bias, name="time_delay"),
    ):
        assert not proposed(torque, [other], "starts")[1]


@pytest.mark.parametrize(("first", "last"), [(4.0, 6.5), (9.0, None)])
def test_a_push_is_found_with_its_link_and_its_time(first: float, last: float | None) -> None:
    torque = np.zeros_like(terms().records.residual)
    forces = external_force.external_forces(terms())
    end = None if last is None else (0, last)
    torque += forces[6].columns @ np.array([6.0, -4.0, 5.0]) * active(terms(), (0, first), end)[:, None]
    bench, made = proposed(torque, [], "forces")
    scores = {k: bench.solve(frozenset({k})).evidence for k in made}
    found = bench.candidates[max(made, key=lambda k: scores[k])]
    assert found.links == forces[6].links and found.variant == "spanned"
    assert found.onset is not None and found.onset[1] == pytest.approx(first, abs=0.02)
    assert (found.end is None) == (last is None)
    if found.end is not None and last is not None:
        assert found.end[1] == pytest.approx(last, abs=0.02)
    assert found.cost == pytest.approx(2.0 * np.log(64.0)) and len(made) <= 4
    assert not proposed(np.zeros_like(torque), [], "forces")[1]


def test_a_push_at_a_links_middle_is_told_there() -> None:
    """While the link turns, that is no constant wrench at its origin."""
    force = external_force.forces_at_centres(terms())[2]
    torque = force.columns @ np.array([60.0, -40.0, 50.0]) * active(terms(), (0, 4.0), (0, 6.5))[:, None]
    bench, made = proposed(torque, [], "forces")
    best = max(made, key=lambda k: bench.solve(frozenset({k})).evidence)
    told = bench.candidates[best].parameters(*bench.part(bench.solve(frozenset({best})), best))
    assert bench.candidates[best].links == force.links
    np.testing.assert_array_equal(told["point"][0], force.parameters(np.ones(3), np.eye(3))["point"][0])
    np.testing.assert_allclose(told["wrench"][0], [60.0, -40.0, 50.0, 0.0, 0.0, 0.0], rtol=0.02)


def test_a_push_at_another_point_of_a_link_is_told_there() -> None:
    """With the errors of its point; a neighbour's origin explained some of it."""
    body, point, force = 4, np.array([0.12, 0.08, -0.15]), np.array([12.0, -8.0, 10.0])
    wrench = external_force.external_forces(terms())[2 * body + 1]
    there = external_force.force_at(wrench, external_force.turned(terms(), body), point)
    torque = there.columns @ force * active(terms(), (0, 4.0), (0, 6.5))[:, None]
    bench, made = proposed(torque, [], "forces")
    best = max(made, key=lambda k: bench.solve(frozenset({k})).evidence)
    told = bench.candidates[best].parameters(*bench.part(bench.solve(frozenset({best})), best))
    assert bench.candidates[best].links == wrench.links
    assert np.all(np.abs(told["point"][0] - point) < 4.0 * told["point"][1]) and np.max(told["point"][1]) < 0.05
    assert np.all(np.abs(told["wrench"][0][:3] - force) < 4.0 * told["wrench"][1][:3])


@pytest.mark.parametrize("level", [1e-9, 1e-10, 1e-11])
def test_a_pushs_point_has_an_error_where_logs_are_all_but_exact(level: float) -> None:
    """Of what the motion does not tell, rounding left less than nothing: variances were below 0."""
    acts = active(terms(), (0, 5.0), (0, 8.0))
    wrenches = [force for force in external_force.external_forces(terms()) if force.size > 3]
    there = external_force.force_at(wrenches[4], external_force.turned(terms(), 4), np.array([0.05, -0.1, 0.1]))
    push = there.during(acts, (0, 5.0), (0, 8.0))
    bench = bench_of(push.columns @ np.array([20.0, -10.0, 5.0]), [], level=level)
    Q = basis(bench, frozenset())
    made = at_their_points(bench, terms(), Q, np.einsum("jrk,jr->k", Q, bench.y), wrenches, push, acts)
    told = [one.parameters(np.ones(3), 1e-30 * np.eye(3)) for one in made]
    errors = np.array([[*one["wrench"][1][:3], *one["point"][1]] for one in told])
    assert len(made) and np.all(errors > 0.0)


def test_a_push_must_be_worth_its_name_and_its_span() -> None:
    """Sixteen nats beside the choice among 64² spans, for the best of them."""
    forces = external_force.external_forces(terms())
    pushed = forces[6].columns @ np.array([0.6, -0.4, 0.5]) * active(terms(), (0, 4.0), (0, 6.5))[:, None]
    pairs = spans()

    def excess(size: float) -> float:
        bench = bench_of(size * pushed, [])
        edges = block_edges(bench.rows)
        best = -np.inf
        for force in forces[6:8]:
            G, _, b = block_sums(bench.whiten(force), np.zeros((6, bench.rows, 1)), bench.y, edges)
            G, b = (np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)]) for x in (G, b))
            dG, db = (x[pairs[:, 1]] - x[pairs[:, 0]] for x in (G, b))
            best = max(best, float(np.max(increments(dG, db, np.broadcast_to(force.spread, db.shape)))))
        return best - 2.0 * np.log(64.0) - 16.0

    low, high = 0.0, 4.0
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
    few = [proposed(size * pushed, [], "forces")[1] for size in (0.95 * low, 1.05 * high)]
    assert not few[0] and few[1]


def ripple_of(count: float, size: float) -> Array:
    torque = np.zeros_like(terms().records.residual)
    columns = torque_ripple.ripple_columns(terms(), PAN, np.array([count]))
    torque[:, PAN] = size * (0.6 * columns[:, 0] - 0.8 * columns[:, 1])
    return torque


def test_a_ripple_is_proposed_at_the_nearest_count_of_its_joint() -> None:
    step = torque_ripple.count_step(terms(), PAN)
    bench, made = proposed(ripple_of(60.0, 0.4), [], "ripples")
    (k,) = made
    assert bench.candidates[k].joints == (PAN,)
    assert bench.candidates[k].shape["cycles"] == pytest.approx(60.0, abs=0.75 * step)
    assert not proposed(ripple_of(60.0, 0.0), [], "ripples")[1]


@pytest.mark.parametrize(("rippled", "worth"), [(False, 16.0), (True, 8.0)])
def test_a_ripple_must_be_worth_its_name_or_a_further_joint(rippled: bool, worth: float) -> None:
    """Ten nats beyond a name's price; five beyond that of one more joint, where another has a ripple."""
    counts = torque_ripple.ripple_counts(terms(), PAN)
    other = torque_ripple.ripple(terms(), ELBOW, 50.0)
    assert other is not None
    elsewhere = other.columns[:, 0] @ np.array([2.0, 1.0])

    def asked(size: float) -> tuple[Bench, Any, Array]:
        torque = ripple_of(float(counts[20]), size)
        torque[:, ELBOW] += elsewhere if rippled else 0.0
        bench = bench_of(torque, [other])
        members: Any = frozenset({1} if rippled else ())
        Q = basis(bench, members)
        return bench, members, Q

    def excess(size: float) -> float:
        bench, _, Q = asked(size)
        told = np.einsum("jrk,jr->k", Q, bench.y)
        rises = []
        for count in counts[18:23]:
            made = torque_ripple.ripple(terms(), PAN, float(count))
            assert made is not None
            rises.append(score_candidate(bench, made, Q, told) - made.cost)
        return max(rises) - worth

    low, high = 0.0, 0.3
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
    for size, there in ((0.97 * low, False), (1.03 * high, True)):
        bench, members, Q = asked(size)
        made = Proposer(terms()).ripples(bench, members, Q, np.einsum("jrk,jr->k", Q, bench.y))
        assert any(bench.candidates[k].joints == (PAN,) for k in made) == there


def test_each_hypothesis_is_asked_once_and_crowded_ones_never(monkeypatch: pytest.MonkeyPatch) -> None:
    biases = [torque_bias.on_joints(terms())[j][0] for j in range(6)]
    more = [replace(biases[j], name="viscous_friction") for j in range(3)]
    again = replace(biases[0], shape={"other": 1.0})
    bench = bench_of(np.zeros_like(terms().records.residual), [*biases, *more, again])
    proposer = Proposer(terms())
    asked: list[int] = []
    for what in ("ripples", "starts", "forces"):
        monkeypatch.setattr(proposer, what, lambda *arguments: asked.append(1) or [])  # type: ignore[func-returns-value]
    for members, times in (({1}, 3), ({1}, 0), ({10}, 0), ({1, 2}, 3), (set(range(1, 9)), 3), (set(range(1, 10)), 0)):
        asked.clear()
        proposer(bench, frozenset(members))
        assert len(asked) == times
