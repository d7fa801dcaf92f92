"""How sure a name is: probabilities, rivals and places of hypotheses whose evidence is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.candidates.test_records import at
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.findings import Rest
from twin_diagram.gap.search import shape_refinement
from twin_diagram.gap.verdict import posterior as module
from twin_diagram.gap.verdict import rivals
from twin_diagram.gap.verdict.posterior import (
    claim,
    claims,
    findings_of,
    groups,
    most_probable,
    parameters_of,
    posterior,
    separations_of,
    together,
)

RECORDS: Any = SimpleNamespace(n=3, model=SimpleNamespace(joints=("a", "b", "c"), prismatic=frozenset({"c"})))


class Solved:
    """A bench of hypotheses with evidence and variances, all of which were solved."""

    def __init__(self, candidates: list[Candidate], evidence: dict[tuple[int, ...], float]) -> None:
        self.candidates, self.counts = candidates, np.full(3, 100.0)
        fits = {frozenset(k): self._fit(frozenset(k), e) for k, e in evidence.items()}
        self.solver = SimpleNamespace(fits=fits)

    def _fit(self, members: frozenset[int], evidence: float) -> Any:
        variance = np.array([1.0 + 0.01 * (200.0 - evidence if np.isfinite(evidence) else 0.0), 1.0, 1.0])
        return SimpleNamespace(members=members, evidence=evidence, variance=variance, order=tuple(sorted(members)))

    def solve(self, members: frozenset[int]) -> Any:
        return self.solver.fits[members]

    def part(self, fit: Any, k: int) -> Any:
        return np.array([1.0 + k]), np.array([[0.25]])


CANDIDATES = [
    at("torque_constant", 0),
    at("torque_constant", 1),
    at("gravity_tilt", 0),
    at("torque_constant", 0, shape={"other": 1.0}),
    at("time_delay", 2),
]
EVIDENCE = {(): 0.0, (0, 1): 200.0, (1, 3): 196.0, (1, 2): 198.0, (0, 4): 192.0, (0,): -np.inf, (1,): 150.0}


def bench(evidence: dict[tuple[int, ...], float] = EVIDENCE, candidates: list[Candidate] = CANDIDATES) -> Any:
    return Solved(candidates, evidence)


def weights(*less: float) -> list[float]:
    """Evidence counts half."""
    raw = np.exp(-0.5 * np.array(less))
    return list(raw / np.sum(raw))


def test_probabilities_are_of_claims_whose_best_shapes_count() -> None:
    some = bench()
    found = posterior(some, some.solve(frozenset({0, 1})))
    gain, tilt = ("torque_constant", (0, 1), ()), ("gravity_tilt", (0,), ())
    wanted = weights(0.0, 2.0, 8.0, 50.0, 200.0)
    assert found[frozenset({gain})] == pytest.approx(wanted[0])
    assert found[frozenset({("torque_constant", (1,), ()), tilt})] == pytest.approx(wanted[1])
    assert sum(found.values()) == pytest.approx(1.0) and len(found) == 5
    better = bench({**EVIDENCE, (0, 4): 230.0})
    top = posterior(better, better.solve(frozenset({0, 1})))
    late = frozenset({("torque_constant", (0,), ()), ("time_delay", (2,), ())})
    best, chosen, *_ = weights(0.0, 30.0, 32.0, 80.0, 230.0)
    assert top[late] == pytest.approx(best), "what is solved and better counts as such"
    assert top[frozenset({gain})] == pytest.approx(chosen)


@pytest.mark.parametrize(("name", "charge"), [("torque_constant", 6.0), ("viscous_friction", 3.0)])
def test_a_larger_set_is_charged_what_its_further_members_must_bring(name: str, charge: float) -> None:
    """Six nats a member, three the third joint of a usual name; a smaller one is given nothing for its size."""
    candidates = [at(name, joint) for joint in range(3)]
    for more in (charge - 1.0, charge + 1.0):
        some = bench({(): 0.0, (0,): 199.0, (0, 1): 200.0, (0, 1, 2): 200.0 + more}, candidates)
        fit = some.solve(frozenset({0, 1}))
        found = posterior(some, fit)
        best = max(more - charge, 0.0)
        wanted = weights(best, best + 1.0, best + charge - more, best + 200.0)
        for joints, p in zip([(0, 1), (0,), (0, 1, 2)], wanted, strict=False):
            assert found[frozenset({(name, joints, ())})] == pytest.approx(p)
        larger = more > charge
        assert most_probable(some, fit) is (some.solve(frozenset({0, 1, 2})) if larger else fit)
        assert (max(found.values()) == found[frozenset({(name, (0, 1, 2), ())})]) == larger


def test_a_finer_law_is_held_to_what_it_must_bring() -> None:
    candidates = [at("coulomb_friction"), at("stribeck_friction")]
    some = bench({(): 0.0, (0,): 1000.0, (1,): 1001.0}, candidates)
    found = posterior(some, some.solve(frozenset({0})))
    finer = frozenset({("stribeck_friction", (0,), ())})
    wanted = np.exp(-0.5 * 0.5) / (1.0 + np.exp(-0.25) + np.exp(-500.0))
    assert found[finer] == pytest.approx(wanted), "a nat more, less one and a half per mille of a thousand"


@pytest.mark.parametrize(("rival", "further"), [((0, 2, 3), 1), ((0, 1, 4), 1), ((0, 2, 4), 2), ((2, 3, 5), 0)])
def test_a_finer_law_is_held_to_it_on_each_further_joint(rival: tuple[int, ...], further: int) -> None:
    """As `plainer` asks it joint by joint: what that took away would else be more probable than what it left."""
    laws = ["stribeck_friction", "coulomb_friction", "stribeck_friction", "coulomb_friction", "stribeck_friction"]
    candidates = [
        *(at(law, joint) for law, joint in zip(laws, (0, 1, 1, 2, 2), strict=True)),
        at("coulomb_friction", 0),
    ]
    charge = 1.5 * further
    for more in (charge - 0.2, charge + 0.2):
        some = bench({(): 0.0, (0, 1, 3): 1000.0, rival: 1000.0 + more}, candidates)
        fit = some.solve(frozenset({0, 1, 3}))
        found = posterior(some, fit)
        odds = found[claims(some, frozenset(rival))] / found[claims(some, fit.members)]
        assert odds == pytest.approx(np.exp(0.5 * (more - charge)))
        assert (most_probable(some, fit) is fit) == (more < charge)


def test_findings_tell_confidence_rivals_and_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hypothesis counts for the one claim of it that takes the finding's place, that of its name first."""
    asked: list[Any] = []
    monkeypatch.setattr(module, "additions", lambda bench, members, count: asked.append((members, count)))
    monkeypatch.setattr(module, "everywhere", lambda bench, fit: asked.append(fit.members))
    some = bench({**EVIDENCE, (): 191.0, (1,): 194.0, (2,): 195.0})
    both = frozenset({0, 1})
    (found,) = findings_of(RECORDS, some, some.solve(both))
    wanted = weights(0.0, 2.0, 8.0, 6.0, 5.0, 9.0)
    assert found.name == "torque_constant" and found.joints == ("a", "b")
    assert found.confidence == pytest.approx(wanted[0])
    alternatives = [(a.name, a.joints, a.probability) for a in found.alternatives]
    assert alternatives == [
        ("torque_constant", ("b",), pytest.approx(wanted[1] + wanted[3])),
        ("gravity_tilt", ("a",), pytest.approx(wanted[4])),
        ("torque_constant", ("a",), pytest.approx(wanted[2])),
    ]
    assert found.rest == Rest(nothing=pytest.approx(wanted[5]))
    assert found.significance == pytest.approx(np.sqrt(100.0 * 0.09)), "without both, variance is 9 % more"
    around = [(both, 12), both, (frozenset(), 12), (frozenset({1}), 12), (frozenset({0}), 12)]
    assert asked == around, "beside all, on every joint, in the place of a name, in that of a member"
    assert set(found.parameters) == {"x"}


@pytest.fixture(autouse=True)
def unit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "unit_of", lambda name, key, prismatic=False: "N" if prismatic else "N·m")


def test_findings_come_strongest_first_and_know_what_may_be_unseen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "additions", lambda *arguments: None)
    candidates = [at("joint_elasticity", 0), at("payload", 1)]
    some = bench({(): -999.0, (0,): 150.0, (1,): 50.0, (0, 1): 200.0}, candidates)
    found = findings_of(RECORDS, some, some.solve(frozenset({0, 1})))
    assert [f.name for f in found] == ["joint_elasticity", "payload"]
    assert found[0].confidence == pytest.approx(0.97**2, abs=1e-6) and found[1].confidence == pytest.approx(
        1.0, abs=1e-6
    )


def test_members_that_start_at_other_times_are_findings_of_their_own() -> None:
    times = [None, (0, 3.0), (0, 3.99), (0, 4.01), (1, 3.0)]
    candidates = [at("torque_bias", j, onset=when) for j, when in enumerate(times)]
    some = bench({(): 0.0}, candidates)
    assert together(some, [0, 1, 2, 3, 4]) == [[0], [1, 2], [3], [4]]
    ended = bench({(): 0.0}, [at("torque_bias", j, onset=(0, 1.0), end=when) for j, when in enumerate(times)])
    assert together(ended, [0, 1, 2, 3, 4]) == [[0], [1, 2], [3], [4]]


def test_parameters_are_told_per_joint_with_their_units() -> None:
    candidates = [at("torque_bias", 0), at("torque_bias", 2), at("gravity_tilt", 0)]
    some = bench({(): 0.0, (0, 1, 2): 10.0}, candidates)
    fit = some.solve(frozenset({0, 1, 2}))
    told = parameters_of(RECORDS, some, fit, [0, 1])["x"]
    assert isinstance(told, dict) and {k: (e.value, e.std, e.unit) for k, e in told.items()} == {
        "a": (1.0, 0.5, "N·m"),
        "c": (2.0, 0.5, "N"),
    }
    whole = parameters_of(RECORDS, some, fit, [2])["x"]
    assert not isinstance(whole, dict) and whole.value == 3.0


def test_of_ripples_on_one_joint_the_largest_is_told() -> None:
    def sized(value: float) -> Candidate:
        return replace(at("torque_ripple"), parameters=lambda c, covariance: {"amplitude": (value * c, 0.1 * c)})

    some = bench({(): 0.0, (0, 1): 1.0}, [sized(8.0), sized(0.5)])
    told = parameters_of(RECORDS, some, some.solve(frozenset({0, 1})), [0, 1])["amplitude"]
    assert isinstance(told, dict) and told["a"].value == 8.0


def test_near_rivals_are_told_with_their_distance() -> None:
    candidates = [at("torque_constant", 0), at("torque_bias", 0), at("time_delay", 1), at("gravity_tilt", 2)]
    evidence = {(): 0.0, (0,): 200.0, (1,): 150.0, (2,): 199.0, (3,): -800.0, (1, 2): 199.9}
    some = bench(evidence, candidates)
    found = separations_of(RECORDS, some, some.solve(frozenset({0})))
    assert [(s.a, s.b) for s in found] == [
        ("torque_constant on a", "time_delay on b"),
        ("torque_constant on a", "torque_bias on a"),
    ]
    assert found[0].distance == pytest.approx(np.sqrt(100.0 * 0.01)) and found[1].distance == pytest.approx(
        np.sqrt(50.0)
    )
    for value, told in ((-698.0, True), (-702.0, False)):
        far = bench({(0,): 200.0, (3,): value}, candidates)
        assert bool(separations_of(RECORDS, far, far.solve(frozenset({0})))) == told, "thirty deviations"


def test_what_a_hypothesis_says() -> None:
    candidates = [at("torque_bias", 2), at("torque_bias", 0), replace(at("payload", 1), joints=(), links=("hand",))]
    some = bench({(): 0.0}, candidates)
    assert groups(some, frozenset({0, 1, 2})) == {"payload": [2], "torque_bias": [1, 0]}
    assert claim([candidates[0], candidates[1]]) == ("torque_bias", (0, 2), ())
    assert claims(some, frozenset({0, 1, 2})) == {("torque_bias", (0, 2), ()), ("payload", (), ("hand",))}


def test_rivals_within_forty_nats_are_given_the_same_care(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best of each place that has shapes; of gears that swing, two."""
    own = [at("coulomb_friction", 0), at("viscous_friction", 1)]
    others = [at("stribeck_friction", 0), at("stribeck_friction", 0), at("stribeck_friction", 2), at("payload", 0)]
    others += [at("backlash", j, variant="swinging") for j in (0, 1, 2)]
    some = bench({(): 0.0, (0, 1): 200.0}, [*own, *others])
    fit = some.solve(frozenset({0, 1}))

    def additions(bench: Any, members: frozenset[int], count: int) -> list[Any]:
        assert count == 12
        evidence = {2: 190.0, 3: 189.0, 4: 159.0, 5: 195.0, 6: 161.0, 7: 161.0, 8: 161.0}
        return [SimpleNamespace(members=members | {k}, evidence=e) for k, e in evidence.items()]

    monkeypatch.setattr(rivals, "additions", additions)
    shaped = {"stribeck_friction": [("x", 0.5, 2.0)], "backlash": [("gap", 0.5, 2.0)]}
    monkeypatch.setattr(shape_refinement, "shapes", lambda terms, candidate: shaped.get(candidate.name, []))
    terms: Any = None
    found = rivals.rivals_of(some, terms, fit, frozenset({0}))
    assert [new for _, new in found] == [2, 6, 7, 8]
    moved: list[int] = []

    def improve(bench: Any, terms: Any, rival: Any, new: int) -> Any:
        moved.append(new)
        return SimpleNamespace(evidence=201.0 if new == 7 else 150.0, new=new)

    monkeypatch.setattr(shape_refinement, "moved", improve)
    best: Any = rivals.refined(some, terms, fit)
    assert best.new == 7 and moved == [2, 6, 7, 2]
    monkeypatch.setattr(shape_refinement, "moved", lambda *arguments: SimpleNamespace(evidence=199.0))
    assert rivals.refined(some, terms, fit) is fit
