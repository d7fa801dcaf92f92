"""Shapes go where the evidence is, working points to half of what is found; steps end when nothing changes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.made import ELBOW, LIFT, PAN, swinging, torque
from twin_diagram.gap.candidates import encoder_offset, stribeck_friction, torque_ripple
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search import shape_refinement
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.proposals import active
from twin_diagram.gap.search.shape_refinement import moved, recentred, refine, shapes


def bench_of(candidates: list[Candidate], truth: Candidate, c: list[float], noise: float = 0.02) -> Bench:
    terms = swinging()
    count = len(terms.records.residual)
    y = torque(terms, truth, np.array(c)) + noise * np.random.default_rng(1).normal(size=(count, 6))
    return Bench(y, Whitener(np.ones((6, 1)), np.full(6, noise), (count,)), candidates, [])


def ripple(count: float) -> Candidate:
    made = torque_ripple.ripple(swinging(), PAN, count)
    assert made is not None
    return made


def test_a_shape_is_moved_off_its_grid_to_where_it_explains_most() -> None:
    """Seven sections leave a thirtieth of the range."""
    terms = swinging()
    bench = bench_of([ripple(60.0)], ripple(61.3), [0.6, 0.8])
    start = bench.solve(frozenset({0}))
    found = moved(bench, terms, start, 0)
    (k,) = found.members
    width = min(0.3, torque_ripple.count_step(terms, PAN) / 60.0)
    best = max(
        (bench.solve(frozenset({bench.add(ripple(x), offered=False)})).evidence, x) for x in np.linspace(60, 62.6, 27)
    )
    assert bench.candidates[k].shape["cycles"] == pytest.approx(best[1], abs=2.0 * 60.0 * width / 30.0 + 0.1)
    assert found.evidence > 0.97 * best[0] and found.evidence > start.evidence + 20.0
    assert k not in bench.offered
    fresh = bench_of([ripple(60.0)], ripple(61.3), [0.6, 0.8])
    moved(fresh, terms, fresh.solve(frozenset({0})), 0)
    counts = [c.shape["cycles"] for c in fresh.candidates[1:]]
    assert len(counts) == 9 and min(counts) > 60.0 * (1.0 - width) and max(counts) < 60.0 * (1.0 + width)
    again = moved(fresh, terms, fresh.solve(frozenset({0})), 0)
    assert len(fresh.candidates) == 10 and again.evidence == pytest.approx(found.evidence, rel=1e-12)
    moved(fresh, terms, again, *again.members)
    assert len(fresh.candidates) == 19, "about another value others are tried"


def test_where_no_shape_is_better_the_fit_stays() -> None:
    terms = swinging()
    bench = bench_of([ripple(60.0)], ripple(60.0), [0.6, 0.8], 1e-4)
    fit = bench.solve(frozenset({0}))
    assert refine(bench, terms, fit).evidence >= fit.evidence


def test_what_bends_is_linearised_about_half_of_its_estimate() -> None:
    terms = swinging()
    plain = encoder_offset.encoder_offset(terms, LIFT)
    assert plain is not None
    truth = encoder_offset.encoder_offset(terms, LIFT, 0.3)
    assert truth is not None
    bench = bench_of([plain], truth, [0.3])
    fit = bench.solve(frozenset({0}))
    found = refine(bench, terms, fit)
    (k,) = found.members
    assert found.evidence > fit.evidence and bench.part(found, k)[0][0] == pytest.approx(0.3, abs=5e-3)
    assert recentred(terms, ripple(60.0), np.ones(2)) is None
    again = recentred(terms, plain, np.array([0.3]))
    assert again is not None
    np.testing.assert_allclose(again.columns, truth.columns)


def test_what_starts_within_a_log_keeps_its_time_price_and_variant() -> None:
    terms = swinging()
    plain = encoder_offset.encoder_offset(terms, LIFT)
    assert plain is not None
    onset = (0, 2.5)
    late = replace(plain.during(active(terms, onset, None), onset, None), cost=4.5, variant="starting")
    bench = bench_of([late], late, [0.3])
    found = moved(bench, terms, bench.solve(frozenset({0})), 0)
    (k,) = found.members
    made = bench.candidates[k]
    assert k != 0 and made.onset == onset and made.cost == 4.5 and made.variant == "starting"
    before = terms.records.times < 2.3
    assert np.max(np.abs(made.columns[before])) < 0.02 * np.max(np.abs(made.columns))
    held = replace(plain, variant="held")
    still = bench_of([held], plain, [0.3])
    assert moved(still, terms, still.solve(frozenset({0})), 0).members == {0}


def test_which_candidates_have_shapes() -> None:
    terms = swinging()
    dip = stribeck_friction.stribeck(terms, ELBOW, 0.1)
    assert dip is not None and shapes(terms, dip) == [("stribeck_velocity", 0.55, 1.8)]
    assert shapes(terms, replace(dip, onset=(0, 1.0))) == [] and shapes(terms, replace(dip, variant="held")) == []
    assert shapes(terms, replace(dip, name="viscous_friction")) == []


@pytest.mark.parametrize(
    ("changes", "rounds"),
    [([0.03, 0.019, 5.0], 2), ([0.03, -0.021, 5.0, 5.0], 3), ([0.0], 1), ([9.0, 9.0, 9.0, 9.0], 3)],
)
def test_rounds_end_when_evidence_settles(changes: list[float], rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """At a fiftieth of a nat, and after three."""
    asked: list[bool] = []

    def step(bench: Any, terms: Any, fit: Any, member: int, *, slow: bool) -> Any:
        asked.append(slow)
        return SimpleNamespace(evidence=fit.evidence + changes[len(asked) - 1], members=fit.members)

    monkeypatch.setattr(shape_refinement, "moved", step)
    fit: Any = SimpleNamespace(evidence=100.0, members=frozenset({3}))
    some: Any = None
    refine(some, some, fit, slow=False)
    assert asked == [False] * rounds


def test_shapes_that_take_long_may_wait() -> None:
    terms = swinging()
    bench = bench_of([replace(ripple(60.0), variant="swinging")], ripple(61.3), [0.6, 0.8])
    fit = bench.solve(frozenset({0}))
    assert moved(bench, terms, fit, 0, slow=False) is fit
    assert moved(bench, terms, fit, 0, slow=True) is not fit
