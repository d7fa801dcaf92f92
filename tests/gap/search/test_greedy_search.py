"""The search ends where no single step helps, whatever evidence hypotheses have; what its steps ask for."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.candidates.test_records import at
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.search import greedy_search
from twin_diagram.gap.search.greedy_search import additions, climb, everywhere, one_kind, plainer, search
from twin_diagram.gap.search.prior_costs import compatible

NAMES = ("torque_bias", "viscous_friction", "coulomb_friction", "torque_constant", "reflected_inertia", "time_delay")


class Table:
    """A bench whose hypotheses have any evidence; what a further member would bring is scored without its price."""

    def __init__(self, candidates: list[Candidate], evidence: Any, physical: Any = None, rows: int = 10) -> None:
        self.candidates, self.evidence, self.rows = candidates, evidence, rows
        self.offered = set(range(len(candidates)))
        self.solver = SimpleNamespace(spent=0)
        self.asked: list[frozenset[int]] = []
        self.physical = physical or (lambda k, members: True)

    def solve(self, members: frozenset[int]) -> Any:
        self.asked.append(members)
        self.solver.spent += len(members)
        return SimpleNamespace(members=members, evidence=float(self.evidence(members)))

    def compatible(self, members: frozenset[int], k: int) -> bool:
        return compatible([self.candidates[m] for m in members], self.candidates[k])

    def find(self, name: str) -> list[int]:
        return [k for k, candidate in enumerate(self.candidates) if candidate.name == name]

    def part(self, fit: Any, k: int) -> tuple[Any, None]:
        return np.array([1.0 if self.physical(k, fit.members) else 100.0]), None


def scored(monkeypatch: pytest.MonkeyPatch, scores: Any) -> None:
    monkeypatch.setattr(greedy_search, "score_candidates", lambda bench, members: np.array(scores(bench, members)))


def rises(bench: Table, members: frozenset[int]) -> list[float]:
    """What each further member brings, before its name's price."""
    names = {bench.candidates[k].name for k in members}
    return [
        bench.evidence(members | {k}) - bench.evidence(members) + (3.0 if c.name in names else 6.0)
        for k, c in enumerate(bench.candidates)
    ]


@pytest.mark.parametrize("seed", range(12))
def test_no_single_step_helps_where_a_search_ends(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Brute force, with members that bring more, or less, beside others."""
    rng = np.random.default_rng(seed)
    candidates = [at(name, j) for name in NAMES[:5] for j in range(2)][: 8 + seed % 2]
    n = len(candidates)
    alone, pairs = 12.0 * rng.normal(size=n), np.triu(8.0 * rng.normal(size=(n, n)), 1)

    def evidence(members: frozenset[int]) -> float:
        some = sorted(members)
        return float(np.sum(alone[some]) + np.sum(pairs[np.ix_(some, some)]))

    bench: Any = Table(candidates, evidence)
    scored(monkeypatch, rises)
    fit = search(bench, least=2.0)
    for k in fit.members:
        assert evidence(fit.members - {k}) < fit.evidence
        for i in set(range(n)) - fit.members:
            assert evidence(fit.members - {k} | {i}) <= fit.evidence + 1e-6
    for i in set(range(n)) - fit.members:
        if bench.compatible(fit.members, i):
            assert evidence(fit.members | {i}) <= fit.evidence + 2.0
    best_one = max(evidence(frozenset({k})) for k in range(n))
    assert fit.evidence >= min(best_one, max(0.0, best_one))


@pytest.mark.parametrize(("brings", "taken"), [(2.9, False), (3.1, True)])
def test_a_further_member_must_bring_its_least(brings: float, taken: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    bench: Any = Table([at("torque_bias")], lambda members: brings * len(members))
    scored(monkeypatch, rises)
    assert bool(climb(bench, frozenset(), 3.0, 9).members) == taken


def test_no_more_members_are_added_than_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    bench: Any = Table([at(name) for name in NAMES], lambda members: 20.0 * len(members))
    scored(monkeypatch, rises)
    for most in (1, 2, 4):
        assert len(climb(bench, frozenset(), 3.0, most).members) == most
    assert len(search(bench).members) == len(NAMES)


def test_a_search_gives_up_when_it_has_cost_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """After four million members times samples."""
    scored(monkeypatch, rises)
    for spent, went_on in ((399_000, True), (401_000, False)):
        bench: Any = Table([at("torque_bias")], lambda members: 50.0 * len(members))
        bench.solver.spent = spent
        assert bool(climb(bench, frozenset(), 3.0, 5).members) == went_on


def test_what_cannot_be_is_left_and_what_can_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    values = {frozenset({0}): -np.inf, frozenset({1}): -5.0, frozenset({0, 1}): -np.inf, frozenset(): -9.0}
    bench: Any = Table([at("torque_bias"), at("viscous_friction")], lambda members: values[members])
    scored(monkeypatch, lambda bench, members: [8.0, 9.0])
    assert climb(bench, frozenset({0}), 3.0, 5).members == {1}


def test_additions_are_the_best_by_score_less_the_price_of_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six nats a new name, three a further joint; eight of them are solved."""
    candidates = [at("viscous_friction", j) for j in range(6)] + [at("torque_bias", j) for j in range(6)] + [at("", 0)]
    scores = np.array([99.0, 20.0, 19.0, 18.0, 17.0, -np.inf, 22.9, 21.9, 20.9, 19.9, 18.9, 17.9, 99.0])
    bench: Any = Table(candidates, lambda members: -float(sum(members)))
    scored(monkeypatch, lambda bench, members: scores.copy())
    found = additions(bench, frozenset({0}))
    chosen = [next(iter(fit.members - {0})) for fit in found]
    assert sorted(chosen) == [1, 2, 3, 4, 6, 7, 8, 9] and chosen == sorted(chosen), "most evidence first"
    order = [next(iter(m - {0})) for m in bench.asked]
    assert order == [1, 6, 2, 7, 3, 8, 4, 9]
    assert len(additions(bench, frozenset({0}), 2)) == 2


def test_a_search_starts_from_what_is_promising_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """From five names at most, each worth its price and three tenths of the best."""
    candidates = [*(at(name) for name in NAMES), at("torque_bias", 1), at("", 0)]

    def starts(*scores: float) -> list[int]:
        scored(monkeypatch, lambda bench, members: list(scores))
        bench: Any = Table(candidates, lambda members: 0.0)
        return greedy_search._starts(bench)

    assert starts(100.0, 90.0, 80.0, 70.0, 60.0, 50.0, 95.0, 99.0) == [0, 1, 2, 3, 4]
    assert starts(100.0, 29.0, 31.0, 0.0, 0.0, 0.0, 0.0, 0.0) == [0, 2]
    assert starts(10.0, 5.9, 6.1, -np.inf, 0.0, 0.0, 9.0, 0.0) == [0, 2]
    assert starts(8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.0, 0.0) == [6]


def test_a_usual_name_is_tried_on_every_joint_but_where_it_cannot_be() -> None:
    """Joint by joint nothing of it would have been worth its price."""
    candidates = [at("coulomb_friction", j) for j in range(4)] + [at("torque_bias", j) for j in range(4)]
    candidates += [at("coulomb_friction", 3, variant="two-sided"), at("coulomb_friction", 3, onset=(0, 1.0))]
    bench: Any = Table(candidates, lambda members: 10.0 * len(members & {0, 1, 2, 3}), lambda k, members: k != 1)
    empty = bench.solve(frozenset())
    found = everywhere(bench, empty)
    assert found is not None and found.members == {0, 2, 3}
    bench.offered -= {2}
    found = everywhere(bench, empty)
    assert found is not None and found.members == {0, 3}
    alone: Any = Table(candidates[:1], lambda members: 10.0 * len(members))
    assert everywhere(alone, alone.solve(frozenset())) is None, "one joint is no everywhere"
    never: Any = Table(candidates[:4], lambda members: -np.inf if members else 0.0)
    assert everywhere(never, never.solve(frozenset())) is None


def test_joints_are_left_out_of_everywhere_three_times() -> None:
    """Each time those that cannot be; then the rest must do."""
    asked: list[frozenset[int]] = []

    def physical(k: int, members: frozenset[int]) -> bool:
        return k != max(members)

    bench: Any = Table([at("coulomb_friction", j) for j in range(6)], lambda members: float(len(members)), physical)
    everywhere(bench, bench.solve(frozenset()))
    asked = [m for m in bench.asked if m]
    assert [len(m) for m in asked if len(m) > 1][:3] == [6, 5, 4]


def test_dry_friction_is_of_one_kind_where_that_is_better() -> None:
    candidates = [at("stribeck_friction", 0), at("coulomb_friction", 1), at("coulomb_friction", 2)]
    candidates += [at("stribeck_friction", j) for j in (1, 1, 2)]
    good = frozenset({0, 4, 5})

    def evidence(members: frozenset[int]) -> float:
        return 100.0 + 10.0 * len(members & good) - (25.0 if members & {1, 2} and members != {0, 1, 2} else 0.0)

    bench: Any = Table(candidates, evidence)
    mixed = bench.solve(frozenset({0, 1, 2}))
    found = one_kind(bench, mixed)
    assert found is not None and found.members == good
    assert one_kind(bench, found) is None
    assert one_kind(bench, bench.solve(frozenset({1, 2}))) is None, "no dip was named"
    bench.offered -= {5}
    assert one_kind(bench, mixed) is None, "a joint that is not offered a dip keeps all as they are"
    worse: Any = Table(candidates, lambda members: -float(len(members & {3, 4, 5})))
    assert one_kind(worse, worse.solve(frozenset({0, 1, 2}))) is None


@pytest.mark.parametrize(
    ("finer", "plain", "whole", "rest", "allowed"),
    [
        ("stribeck_friction", "coulomb_friction", 1000.0, 200.0, 1.5),
        ("joint_elasticity", "reflected_inertia", 1000.0, 200.0, 0.025 * 800.0),
        ("backlash", "reflected_inertia", 1000.0, -50.0, 0.025 * 1000.0),
    ],
)
def test_a_finer_law_is_named_where_it_brings_its_share(
    finer: str, plain: str, whole: float, rest: float, allowed: float
) -> None:
    """Of all evidence, or of what the plainer law brings at all."""
    for share, named in ((0.97, plain), (1.03, finer)):
        brings = allowed * share
        values = {
            frozenset({0}): whole + (brings if finer != "stribeck_friction" else 0.0),
            frozenset({1}): whole if finer != "stribeck_friction" else whole - brings,
            frozenset(): rest,
        }
        bench: Any = Table([at(finer), at(plain), at(plain, variant="x")], values.__getitem__)
        chosen = plainer(bench, bench.solve(frozenset({0})))
        assert [bench.candidates[k].name for k in chosen.members] == [named]


def test_finer_laws_go_together_or_one_by_one() -> None:
    finer, plain = [at("stribeck_friction", j) for j in range(3)], [at("coulomb_friction", j) for j in range(2)]
    values = {0: 500.0, 1: 500.0, 2: 500.0, 3: 400.0, 4: 499.9}
    bench: Any = Table([*finer, *plain], lambda members: sum(values[k] for k in members))
    assert plainer(bench, bench.solve(frozenset({0, 1, 2}))).members == {0, 2, 4}
    late: Any = Table([at("stribeck_friction", 0, onset=(0, 1.0)), plain[0]], lambda members: 500.0)
    assert plainer(late, late.solve(frozenset({0}))).members == {0}


def test_what_is_proposed_is_asked_for_beside_each_hypothesis(monkeypatch: pytest.MonkeyPatch) -> None:
    bench: Any = Table([at("torque_bias"), at("viscous_friction")], lambda members: 20.0 * len(members))
    scored(monkeypatch, rises)
    asked: list[frozenset[int]] = []

    def propose(bench: Any, members: frozenset[int]) -> list[int]:
        asked.append(members)
        return []

    polished: list[int] = []

    def polish(bench: Any, fit: Any) -> Any:
        polished.append(len(fit.members))
        return fit

    fit = climb(bench, frozenset(), 3.0, 5, propose, polish)
    assert fit.members == {0, 1} and polished == [0, 1, 2]
    assert set(asked) == {frozenset(some) for size in range(3) for some in combinations((0, 1), size)}


@pytest.mark.parametrize(("members", "asks"), [(6, True), (7, False)])
def test_beside_many_members_nothing_new_is_proposed_for_swaps(
    members: int, asks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("torque_bias", "viscous_friction", "coulomb_friction", "torque_constant", "reflected_inertia")
    candidates = [at(name) for name in (*names, "time_delay", "gravity_tilt")][:members]
    bench: Any = Table(candidates, lambda some: 20.0 * len(some))
    scored(monkeypatch, rises)
    asked: list[frozenset[int]] = []
    whole = bench.solve(frozenset(range(members)))
    greedy_search._swap(bench, whole, lambda bench, some: asked.append(some) or [])  # type: ignore[func-returns-value]
    assert bool(asked) == asks
