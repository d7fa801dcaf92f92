"""The verdict's arithmetic: nothing is more probable than what is named, and no probability is there twice or lost."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.gap.search.test_evidence import JOINTS, ROWS, candidate, white
from twin_diagram.gap.candidates.candidate import linear
from twin_diagram.gap.findings import TUNING as FINDINGS
from twin_diagram.gap.findings import Alternative, Finding, Rest
from twin_diagram.gap.naming import decided
from twin_diagram.gap.report import gap_json
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.greedy_search import plainer, search
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.search.prior_costs import asked, further, price
from twin_diagram.gap.verdict.deciding import guessed, outdone
from twin_diagram.gap.verdict.posterior import claims, findings_of, look_around, most_probable, posterior
from twin_diagram.gap.verdict.probabilities import (
    Claim,
    Hypothesis,
    less_sure,
    normalised,
    outweighed,
    shared_out,
    stand_in,
    surer,
)

names = st.sampled_from(["viscous_friction", "coulomb_friction", "torque_constant", "payload"])
joints = st.sets(st.integers(0, 6), min_size=1, max_size=7).map(lambda some: tuple(sorted(some)))
claim = st.tuples(names, joints, st.just(()))
hypotheses = st.dictionaries(
    st.lists(claim, max_size=3, unique_by=lambda c: c[0]).map(frozenset), st.floats(-80.0, 80.0), min_size=2, max_size=9
)


def whole(finding: Finding) -> float:
    """All of a finding's probability."""
    rest = finding.rest
    return (
        finding.confidence
        + sum(other.probability for other in finding.alternatives)
        + (rest.others + rest.nothing + rest.unseen + rest.nameless)
    )


@settings(max_examples=150, deadline=None)
@given(values=hypotheses, unseen=st.floats(0.0, 0.6))
def test_what_is_named_is_most_probable_and_all_adds_up_to_one(values: dict[Hypothesis, float], unseen: float) -> None:
    probability = normalised(values, 2.0)
    assert sum(probability.values()) == pytest.approx(1.0)
    mine = max(values, key=lambda key: values[key])
    assert probability[mine] == max(probability.values())
    for said in mine:
        shared = shared_out(said, mine, probability, lambda c: unseen if len(c[1]) < 7 else 0.0, 3)
        told = [p for _, p in shared.others]
        assert len(told) <= 3 and told == sorted(told, reverse=True) and min([*told, shared.sure]) >= 0.0
        assert said not in dict(shared.others)
        # What the hypothesis holds cannot stand in the claim's place: it is there anyway.
        assert not mine & set(dict(shared.others))
        rest = shared.rest
        parts = (rest.others, rest.nothing, rest.unseen, rest.nameless)
        assert min(parts) >= 0.0
        assert shared.sure + sum(told) + sum(parts) == pytest.approx(1.0)
        holds = sum(p for key, p in probability.items() if said in key)
        assert shared.sure == pytest.approx(holds * (1.0 - (unseen if len(said[1]) < 7 else 0.0)))


def test_the_odds_are_those_of_the_evidence_at_its_temperature() -> None:
    a, b = frozenset({("payload", (), ("tool",))}), frozenset[Claim]()
    probability = normalised({a: 7.0, b: 1.0}, 2.0)
    assert probability[a] / probability[b] == pytest.approx(math.exp(3.0))


def test_a_hypothesis_counts_for_the_one_claim_that_stands_in_anothers_place() -> None:
    seven: Claim = ("viscous_friction", (0, 1, 2, 3, 4, 5, 6), ())
    six: Claim = ("viscous_friction", (0, 1, 2, 3, 4, 5), ())
    gain: Claim = ("torque_constant", (6,), ())
    dry: Claim = ("coulomb_friction", (1, 3), ())
    assert stand_in(seven, {six, gain}) == six
    assert stand_in(dry, {gain, six}) == six
    assert stand_in(dry, set()) is None
    mine = frozenset({seven, dry})
    probability = {mine: 0.9, frozenset({six, gain, dry}): 0.07, frozenset({dry}): 0.03}
    shared = shared_out(seven, mine, probability, lambda _: 0.0, 3)
    assert shared.others == ((six, pytest.approx(0.07)),)
    assert shared.sure == pytest.approx(0.9) and shared.rest.nothing == pytest.approx(0.03)


def test_what_is_told_of_rivals_beyond_the_third_is_in_the_rest() -> None:
    mine: Claim = ("torque_bias", (0,), ())
    others: list[Claim] = [("torque_bias", (j,), ()) for j in range(1, 6)]
    probability = {frozenset({mine}): 0.5} | {
        frozenset({c}): p for c, p in zip(others, (0.02, 0.2, 0.1, 0.05, 0.13), strict=True)
    }
    shared = shared_out(mine, frozenset({mine}), probability, lambda _: 0.0, 3)
    assert [c[1] for c, _ in shared.others] == [(2,), (5,), (3,)]
    assert shared.rest.others == pytest.approx(0.07)


shares = st.lists(st.floats(0.0, 1.0), min_size=8, max_size=8).filter(lambda x: sum(x) > 0.1)


def made(parts: list[float]) -> Finding:
    """A finding whose probabilities are in proportion to eight numbers."""
    sure, a, b, c, *rest = (x / sum(parts) for x in parts)
    others = tuple(Alternative("torque_bias", ("a",), (), p) for p in sorted((a, b, c), reverse=True))
    return Finding("coulomb_friction", ("a",), (), {}, sure, others, rest=Rest(*rest))


@given(parts=shares, factor=st.floats(0.0, 1.0))
def test_doubt_takes_from_all_alike_and_goes_to_what_has_no_name(parts: list[float], factor: float) -> None:
    before = made(parts)
    after = less_sure(before, factor)
    assert whole(after) == pytest.approx(1.0)
    assert after.confidence == pytest.approx(factor * before.confidence)
    assert after.rest.nameless >= before.rest.nameless - 1e-12
    assert outweighed(after) <= outweighed(before)  # the order stays
    raised = surer(before, 0.8)
    assert raised.confidence == pytest.approx(max(0.8, before.confidence)) and whole(raised) == pytest.approx(1.0)


@given(parts=shares)
def test_the_file_never_holds_more_than_one(parts: list[float]) -> None:
    effect = gap_json._effect(made(parts), files=[0])
    total = effect["confidence"] + sum(other["probability"] for other in effect["alternatives"])
    assert total <= 1.0 + 1e-15
    assert effect["confidence"] == pytest.approx(made(parts).confidence, abs=1e-8)


def test_a_name_that_something_outweighs_is_no_name() -> None:
    sure = made([8.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    outdone = made([3.0, 4.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    guess = made([3.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    assert outweighed(outdone) and not outweighed(sure) and not outweighed(guess)
    assert guess.confidence < FINDINGS.guess and guess.is_guess() and not sure.is_guess()
    assert guessed([sure, outdone]) and guessed([guess]) and not guessed([sure, guess]) and not guessed([])


def test_all_joints_of_an_arm_are_no_less_likely_than_most_of_them() -> None:
    each = [further("viscous_friction", count, 7) for count in range(1, 8)]
    assert each[:2] == [0.0, PRIOR_COSTS.further_joint]
    assert each[2] == pytest.approx(math.log(35.0)) and max(each) == each[2]
    assert each[6] == PRIOR_COSTS.further_joint and each[4] == pytest.approx(math.log(21.0))
    unusual = [further("torque_ripple", count, 7) for count in range(1, 8)]
    assert np.allclose(np.diff(unusual), PRIOR_COSTS.further_joint)
    x = np.ones(ROWS)
    five = [candidate("viscous_friction", j, x) for j in range(5)]
    assert price(five, 7) == pytest.approx(PRIOR_COSTS.new_name + math.log(21.0))


def test_of_a_usual_name_less_is_asked_on_a_third_joint() -> None:
    x = np.ones(ROWS)
    usual = [candidate("viscous_friction", j, x) for j in range(4)]
    unusual = [candidate("torque_constant", j, x) for j in range(4)]
    assert [asked(usual[:k], 6.0) for k in range(5)] == [0.0, 6.0, 12.0, 15.0, 18.0]
    assert [asked(unusual[:k], 6.0) for k in range(5)] == [0.0, 6.0, 12.0, 18.0, 24.0]
    assert asked([*usual, *unusual], 6.0) == 42.0


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.1, 0.5))
def test_the_named_set_is_the_best_of_all_that_were_solved(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    keys = {
        "torque_bias": "torque",
        "viscous_friction": "damping",
        "coulomb_friction": "torque",
        "torque_constant": "gain",
    }
    candidates = [
        replace(candidate(name, j, rng.normal(size=ROWS)), parameters=linear(key))
        for name, key in keys.items()
        for j in range(JOINTS)
    ]
    y = rng.normal(size=(ROWS, JOINTS))
    for k in rng.choice(len(candidates), 4, replace=False):
        y[:, candidates[k].joints[0]] += size * candidates[k].columns[:, 0, 0]
    bench = Bench(y, white(), candidates, [])
    fit = decided(bench, cast(Any, None), search(bench, least=PRIOR_COSTS.least))
    look_around(bench, fit)
    assert most_probable(bench, fit) is fit and not outdone(bench, fit)
    if len(fit.members) > 1:  # of a part of it, the whole is more probable
        assert outdone(bench, bench.solve(frozenset(sorted(fit.members)[:1])))
    probability = posterior(bench, fit)
    assert probability[claims(bench, fit.members)] == max(probability.values())
    model = SimpleNamespace(joints=tuple("abc"), prismatic=frozenset())
    for finding in findings_of(cast(Any, SimpleNamespace(model=model, n=JOINTS)), bench, fit):
        assert whole(finding) == pytest.approx(1.0) and len(finding.alternatives) <= 3


def test_what_the_search_takes_from_a_joint_does_not_outdo_what_it_left() -> None:
    """A dip on one joint, next to none on another: too little for a name, and no reason to name nothing."""
    rng = np.random.default_rng(5)
    candidates, y = [], rng.normal(size=(ROWS, JOINTS))
    for joint, dip in enumerate((1e3, 0.3)):
        level, bump = np.sign(rng.normal(size=ROWS)), rng.normal(size=ROWS)
        plain = replace(candidate("coulomb_friction", joint, level), spread=np.array([3e3]))
        finer = replace(
            plain,
            name="stribeck_friction",
            columns=np.stack([level, bump], axis=1)[:, None, :],
            spread=np.full(2, 3e3),
            lower=np.full(2, -np.inf),
            upper=np.full(2, np.inf),
        )
        candidates += [plain, finer]
        y[:, joint] += 3e3 * level + dip * bump
    bench = Bench(y, white(), candidates, [])
    left, taken = frozenset({1, 2}), frozenset({1, 3})
    fit = plainer(bench, bench.solve(taken))
    look_around(bench, fit)
    assert fit.members == left and bench.solve(taken).evidence > fit.evidence + 1.0
    assert most_probable(bench, fit) is fit and not outdone(bench, fit)
    assert posterior(bench, fit)[claims(bench, left)] > 0.5 > posterior(bench, fit)[claims(bench, taken)] > 0.01
