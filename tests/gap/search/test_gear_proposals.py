"""Which springs and which play are offered to the search, against gears whose torque is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.residuals.test_regressors import log_with, terms_of
from twin_diagram.gap.candidates.gears import GearShape, gear, rattled
from twin_diagram.gap.naming import all_candidates
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.backlash_gaps import GAPS, Knocks
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.gear_proposals import propose
from twin_diagram.model.dynamics.elastic_gears import Untwisted

Array = npt.NDArray[np.float64]

NOISE = 0.02
PAN, LIFT = 0, 1


@pytest.fixture(scope="module")
def terms() -> Terms:
    """Their residual is made up, so that no encoder's noise is in it."""
    return shaken(terms_of(log_with()), 0.0)


def shaken(terms: Terms, share: float) -> Terms:
    records = tuple(replace(record, shaken=np.full(6, share)) for record in terms.records.records)
    return replace(terms, records=replace(terms.records, records=records))


def bench_of(terms: Terms, torque: Array, names: frozenset[str] = frozenset()) -> Bench:
    """White noise beside a torque (ΣD, 6), and the catalogue's candidates of some names."""
    rng = np.random.default_rng(7)
    lengths = terms.records.lengths
    noise = Whitener(np.ones((6, 1)), np.full(6, NOISE), lengths)
    candidates = [c for c in all_candidates(terms) if c.name in names]
    return Bench(torque + NOISE * rng.normal(size=torque.shape), noise, candidates, [])


def test_gears_tried_together_are_as_each_alone(terms: Terms) -> None:
    """Stiff ones at finer steps; play at the logs' own."""
    bare = {id(record): Untwisted() for record in terms.records.records}
    springs = [GearShape("joint_elasticity", LIFT, (("stiffness", k), ("loss", 3e-3))) for k in (500.0, 900.0, 4e4)]
    for shape in (*springs, *(GearShape("backlash", LIFT, (("gap", gap),)) for gap in (0.004, 0.025))):
        both = gear(terms, shape, bare), gear(terms, shape)
        assert both[0] is not None and both[1] is not None
        np.testing.assert_array_equal(both[0].columns, both[1].columns)


@pytest.mark.long
@pytest.mark.parametrize("stiffness", [1000.0, 5000.0])
def test_a_spring_is_offered_whatever_its_stiffness(terms: Terms, stiffness: float) -> None:
    true = gear(terms, GearShape("joint_elasticity", PAN, (("stiffness", stiffness), ("loss", 1e-3))))
    assert true is not None
    bench = bench_of(terms, true.columns[..., 0])
    offered = [bench.candidates[k] for k in propose(bench, terms, frozenset(), [PAN], Knocks(terms, bench))]
    springs = [c for c in offered if c.place[:2] == ("joint_elasticity", (PAN,))]
    assert min(abs(np.log(c.shape["stiffness"] / stiffness)) for c in springs) < 0.45


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("joint_elasticity", {"stiffness": 1e3, "loss": 0.2}),
        ("joint_elasticity", {"stiffness": 1e10}),
        ("backlash", {"gap": 0.6}),
    ],
)
def test_no_gear_is_beyond_what_its_effect_allows(terms: Terms, name: str, values: dict[str, float]) -> None:
    assert gear(terms, GearShape(name, PAN, tuple(values.items()))) is None


@pytest.mark.long
def test_play_takes_the_place_of_an_offset_and_a_rotor(terms: Terms) -> None:
    """A shoulder's load never turns: its play leans on one side, as an encoder that is off would."""
    assert np.all(np.abs(np.sign(terms.load[0][:, LIFT]).sum()) == len(terms.load[0]))
    true = gear(terms, GearShape("backlash", LIFT, (("gap", 0.003),)))
    assert true is not None
    rotor = 0.25
    bench = bench_of(
        terms, true.columns[..., 0] + rotor * true.columns[..., 1], frozenset({"encoder_offset", "reflected_inertia"})
    )
    instead = frozenset(
        next(k for k in bench.find(name) if bench.candidates[k].joints == (LIFT,))
        for name in ("encoder_offset", "reflected_inertia")
    )
    (k,) = (
        k
        for k in propose(bench, terms, instead, [LIFT], Knocks(terms, bench))
        if bench.candidates[k].name == "backlash"
    )
    found = bench.solve(frozenset({k}))
    assert found.evidence > bench.solve(instead).evidence
    share, inertia = bench.part(found, k)[0]
    assert share * bench.candidates[k].shape["gap"] == pytest.approx(0.003, rel=0.1)
    assert inertia == pytest.approx(rotor, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("gap", [0.0023, 0.0071, 0.0123, 0.029])
def test_play_that_knocks_is_offered_wherever_its_gap_lies(terms: Terms, gap: float) -> None:
    """On a joint that nothing suspects, and beside a hypothesis that took most of it."""
    true = gear(terms, GearShape("backlash", PAN, (("gap", gap),)))
    assert true is not None
    bench = bench_of(terms, true.columns[..., 0] + 0.1 * true.columns[..., 1], frozenset({"reflected_inertia"}))
    rotor = next(k for k in bench.find("reflected_inertia") if bench.candidates[k].joints == (PAN,))
    for members in (frozenset[int](), frozenset({rotor})):
        offered = propose(bench, terms, members, [], Knocks(terms, bench))
        near = [k for k in offered if abs(np.log(bench.candidates[k].shape["gap"] / gap)) < 0.06]
        assert near and all(bench.candidates[k].place[:2] == ("backlash", (PAN,)) for k in near)


def test_the_cheap_torque_of_play_is_nearly_the_true_one(terms: Terms) -> None:
    gap = float(GAPS[12])
    true = gear(terms, GearShape("backlash", PAN, (("gap", gap),)))
    assert true is not None
    bench = bench_of(terms, true.columns[..., 0])
    knocks = Knocks(terms, bench)
    assert any(found == pytest.approx(gap, rel=0.01) for found in knocks.gaps({PAN: [frozenset()]})[PAN])
    cheap, _ = knocks._tried[PAN][1 + 12]
    exact = true.columns[:, list(cheap.rows), 0]
    assert np.linalg.norm(cheap.columns[..., 0] - exact) < 0.1 * np.linalg.norm(exact)


def test_no_gap_is_worth_a_closer_look_where_there_is_noise_alone(terms: Terms) -> None:
    bench = bench_of(terms, np.zeros_like(terms.records.residual))
    knocks = Knocks(terms, bench)
    turning = [j for j in range(6) if knocks.turns(j)]
    assert PAN in turning and LIFT not in turning
    assert not any(knocks.gaps({j: [frozenset()] for j in turning}).values())
    assert propose(bench, terms, frozenset(), [], knocks) == []


def test_what_an_encoders_noise_alone_may_bring_a_gear_is_charged(terms: Terms) -> None:
    """Where the band keeps that noise small nothing is; else about half the samples times the noise's share."""
    costs = [rattled(shaken(terms, share), PAN) for share in (0.0, 0.3, 0.4, 0.6, 1.0, 100.0)]
    assert costs[1] == 0.0 and np.all(np.diff(costs[1:]) > 0.0)
    assert costs[-1] == pytest.approx(0.5 * len(terms.records.residual), rel=0.15)
