"""Which springs and which play are offered to the search, against gears whose torque is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from test_gap_terms import log_with, terms_of

from twin_diagram.gap.evidence import Bench
from twin_diagram.gap.gears import Shape, gear, propose, rattled
from twin_diagram.gap.naming import all_candidates
from twin_diagram.gap.terms import Terms
from twin_diagram.gap.whitening import Whitener

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


@pytest.mark.parametrize("stiffness", [1000.0, 5000.0])
def test_a_spring_is_offered_whatever_its_stiffness(terms: Terms, stiffness: float) -> None:
    true = gear(terms, Shape("joint_elasticity", PAN, (("stiffness", stiffness), ("loss", 1e-3))))
    assert true is not None
    bench = bench_of(terms, true.columns[..., 0])
    offered = [bench.candidates[k] for k in propose(bench, terms, frozenset(), [PAN])]
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
    assert gear(terms, Shape(name, PAN, tuple(values.items()))) is None


def test_play_takes_the_place_of_an_offset_and_a_rotor(terms: Terms) -> None:
    """A shoulder's load never turns: its play leans on one side, as an encoder that is off would."""
    assert np.all(np.abs(np.sign(terms.load[0][:, LIFT]).sum()) == len(terms.load[0]))
    true = gear(terms, Shape("backlash", LIFT, (("gap", 0.003),)))
    assert true is not None
    rotor = 0.25
    bench = bench_of(
        terms, true.columns[..., 0] + rotor * true.columns[..., 1], frozenset({"encoder_offset", "reflected_inertia"})
    )
    instead = frozenset(
        next(k for k in bench.find(name) if bench.candidates[k].joints == (LIFT,))
        for name in ("encoder_offset", "reflected_inertia")
    )
    (k,) = (k for k in propose(bench, terms, instead, [LIFT]) if bench.candidates[k].name == "backlash")
    found = bench.solve(frozenset({k}))
    assert found.evidence > bench.solve(instead).evidence
    share, inertia = bench.part(found, k)[0]
    assert share * bench.candidates[k].shape["gap"] == pytest.approx(0.003, rel=0.1)
    assert inertia == pytest.approx(rotor, rel=0.1)


def test_what_an_encoders_noise_alone_may_bring_a_gear_is_charged(terms: Terms) -> None:
    """Where the band keeps that noise small nothing is; else about half the samples times the noise's share."""
    costs = [rattled(shaken(terms, share), PAN) for share in (0.0, 0.3, 0.4, 0.6, 1.0, 100.0)]
    assert costs[1] == 0.0 and np.all(np.diff(costs[1:]) > 0.0)
    assert costs[-1] == pytest.approx(0.5 * len(terms.records.residual), rel=0.15)
