"""Verdicts at both sides of each bound that decides them, on data whose fits are known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.candidates.test_records import at
from twin_diagram.gap.findings import Finding, Moment
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.verdict import deciding, leftover_structure
from twin_diagram.gap.verdict.deciding import (
    conclude,
    crowded,
    doubled,
    mostly_left,
    negligible,
    redness,
    share_of,
    trimmed,
)
from twin_diagram.gap.verdict.leftover_structure import LeftOver

Array = npt.NDArray[np.float64]

COUNTS = np.array([900.0, 900.0, 900.0])


class Known:
    """A bench whose hypotheses leave known variances on three joints, all of which were solved."""

    def __init__(
        self,
        candidates: list[Any],
        variances: dict[frozenset[int], list[float]],
        colour: float = 0.0,
        rivals: dict[frozenset[int], float] | None = None,
    ) -> None:
        self.candidates, self.variances, self.rivals = candidates, variances, rivals or {}
        self.counts, self.finest = COUNTS, np.zeros(3)
        self.whitener = Whitener(np.array([[1.0, -colour]] * 3), np.ones(3), (900,))
        self.evidence = 100.0
        self.solver = SimpleNamespace(fits={members: self.solve(members) for members in variances})

    def solve(self, members: frozenset[int]) -> Any:
        return SimpleNamespace(
            members=members,
            order=tuple(sorted(members)),
            variance=np.array(self.variances[members]),
            evidence=self.rivals.get(members, self.evidence if members else 0.0),
        )


def finding(
    name: str = "coulomb_friction", *joints: str, significance: float = 50.0, confidence: float = 0.9
) -> Finding:
    return Finding(name, joints or ("a",), (), {}, confidence, (), None, None, significance)


def verdict(
    monkeypatch: pytest.MonkeyPatch,
    variances: dict[frozenset[int], list[float]],
    *,
    statistic: float = 0.0,
    gain: float = 0.0,
    colour: float = 0.0,
    findings: tuple[Finding, ...] | None = None,
    candidates: list[Any] | None = None,
    counts: Array = COUNTS,
    finest: float = 0.0,
    chosen: frozenset[int] | None = None,
    rivals: dict[frozenset[int], float] | None = None,
    above: float = 0.0,
    share: float | None = None,
) -> Any:
    candidates = [at("coulomb_friction")] if candidates is None else candidates
    bench: Any = Known(candidates, variances, colour, rivals)
    bench.counts, bench.finest = counts, np.full(3, finest)
    fit = bench.solve(max(variances, key=len) if chosen is None else chosen)
    left = LeftOver(statistic, gain, np.zeros(3))
    if share is not None:
        left = LeftOver(statistic, gain, np.array([0.0, statistic, 0.0]), np.array([1.0, share, 1.0]))
    monkeypatch.setattr(leftover_structure, "left_over", lambda *arguments: left)
    named = (finding(),) if findings is None else findings

    def findings_of(records: Any, bench: Any, fit: Any) -> tuple[Finding, ...]:
        return tuple(f for f in named if f.name in {bench.candidates[k].name for k in fit.members})

    monkeypatch.setattr(deciding, "findings_of", findings_of)
    monkeypatch.setattr(deciding, "separations_of", lambda *arguments: ())
    records: Any = SimpleNamespace(n=3, rate=50.0, above=np.full(3, above))
    terms: Any = None
    return conclude(records, terms, bench, fit)


CLEAN, STRONG = frozenset[int](), frozenset({0})


@pytest.mark.parametrize(("share", "trifle"), [(0.9e-3, True), (1.1e-3, False)])
def test_structure_of_a_thousandth_of_a_torque_is_not_spoken_of(
    share: float, trifle: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither where nothing is named nor beside a name, which is then as sure as without."""
    nothing = verdict(monkeypatch, {CLEAN: [1.0, 1.0, 1.0]}, statistic=20.0, share=share)
    assert nothing.verdict == ("none" if trifle else "unknown")
    assert nothing.remainder_statistic == 20.0
    named = verdict(
        monkeypatch, {CLEAN: [9.0, 1.0, 1.0], STRONG: [1.0, 1.0, 1.0]}, statistic=20.0, gain=5.0, share=share
    )
    assert named.verdict == "named" and named.remainder != trifle
    assert named.findings[0].confidence == pytest.approx(0.9 if trifle else 0.675)
    loud = verdict(monkeypatch, {CLEAN: [4.1, 1.0, 1.0]}, statistic=20.0, share=share)
    assert loud.verdict == "unknown"


@pytest.mark.parametrize(
    ("statistic", "variance", "answer"),
    [(7.9, 1.0, "none"), (8.1, 1.0, "unknown"), (0.0, 3.9, "none"), (0.0, 4.1, "unknown")],
)
def test_where_nothing_is_named_something_may_be_left(
    statistic: float, variance: float, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Structure above eight, or four times the noise that was thought possible."""
    found = verdict(monkeypatch, {CLEAN: [1.0, variance, 1.0]}, statistic=statistic)
    assert found.verdict == answer and not found.findings and not found.remainder
    assert found.remainder_statistic == statistic and found.statistic == 0.0
    least = verdict(monkeypatch, {CLEAN: [1.0, 4.1, 1.0]}, finest=0.2)
    assert least.verdict == "none", "beyond the least noise that any log has"
    assert found.noise_floor.shape == (3,)


def test_noise_that_regressions_do_not_see_is_in_the_floor_too(monkeypatch: pytest.MonkeyPatch) -> None:
    below = verdict(monkeypatch, {CLEAN: [1.0, 1.0, 1.0]}).noise_floor
    both = verdict(monkeypatch, {CLEAN: [1.0, 1.0, 1.0]}, above=0.5).noise_floor
    np.testing.assert_allclose(both**2, below**2 + 0.25)


BOTH = {CLEAN: [9.0, 1.0, 1.0], STRONG: [1.0, 1.0, 1.0]}


@pytest.mark.parametrize(
    ("changed", "left"),
    [
        ({"statistic": 6.4}, False),
        ({"statistic": 6.6}, True),
        ({"variances": {CLEAN: [9.0, 1.0, 1.0], STRONG: [1.0, 1.39, 1.0]}}, False),
        ({"variances": {CLEAN: [9.0, 1.0, 1.0], STRONG: [1.0, 1.41, 1.0]}}, True),
        ({"variances": {CLEAN: [9.0, 1.0, 1.0], STRONG: [1.0, 1.75, 1.0]}, "counts": np.full(3, 100.0)}, False),
        ({"variances": {CLEAN: [9.0, 1.0, 1.0], STRONG: [1.0, 1.85, 1.0]}, "counts": np.full(3, 100.0)}, True),
    ],
)
def test_beside_a_name_structure_makes_it_less_sure(
    changed: dict[str, Any], left: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Above 6.5, or where a joint's noise is 1.35 + 45/N times the expected."""
    made = {"variances": BOTH, **changed}
    found = verdict(monkeypatch, **made)
    assert found.verdict == "named" and found.remainder == left
    assert found.findings[0].confidence == pytest.approx(0.9 * (0.75 if left else 1.0))


@pytest.mark.parametrize(("redder", "left"), [(5.8, False), (6.2, True)])
def test_noise_six_times_denser_at_slow_motion_is_no_noise(
    redder: float, left: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def density(pole: float, f: Array) -> float:
        return float(np.mean(1.0 / np.abs(1.0 - pole * np.exp(-2j * np.pi * f / 50.0)) ** 2))

    low, high = 0.0, 0.999
    for _ in range(60):
        middle = 0.5 * (low + high)
        ratio = density(middle, np.linspace(0.1, 1.0, 10)) / density(middle, np.linspace(2.5, 4.0, 10))
        low, high = (middle, high) if ratio < redder else (low, middle)
    noise = Whitener(np.array([[1.0, 0.0], [1.0, -high]]), np.ones(2), (9,))
    assert redness(noise, 50.0) == pytest.approx(redder)
    assert verdict(monkeypatch, BOTH, colour=high).remainder == left
    assert not verdict(monkeypatch, {CLEAN: [1.0, 1.0, 1.0]}, colour=high).remainder


@pytest.mark.parametrize(("share", "answer"), [(0.49, "named"), (0.51, "unknown")])
def test_where_more_is_left_than_was_named_nothing_is_named(
    share: float, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    gained = 900.0 * np.log(9.0)
    found = verdict(monkeypatch, BOTH, statistic=7.0, gain=share * gained)
    assert found.verdict == answer and bool(found.findings) == (answer == "named")
    assert verdict(monkeypatch, BOTH, statistic=6.0, gain=share * gained).verdict == "named"


@pytest.mark.parametrize(("variance", "answer"), [(4.9, "named"), (5.1, "unknown")])
def test_a_joint_that_keeps_most_of_its_residual_takes_the_name_away(
    variance: float, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the energy above the noise, on the joints that the name is about."""
    variances = {CLEAN: [9.0, 9.0, 1.0], STRONG: [variance, 9.0, 1.0]}
    assert verdict(monkeypatch, variances).verdict == answer
    bench: Any = Known([], variances)
    fit = bench.solve(STRONG)
    assert mostly_left(bench, fit, np.array([True, False, False])) == (answer == "unknown")
    assert mostly_left(bench, fit, np.array([False, True, False]))
    assert not mostly_left(bench, fit, np.zeros(3, dtype=bool))
    bench.finest = np.full(3, 0.5)
    assert not mostly_left(bench, bench.solve(STRONG), np.array([True, False, False])) or variance > 5.25 - 0.26


PAIR = {
    CLEAN: [9.0, 9.0, 1.0],
    STRONG: [1.0, 1.0, 1.0],
    frozenset({1}): [1.0, 1.0, 1.0],
    frozenset({0, 1}): [1.0, 1.0, 1.0],
}


@pytest.mark.parametrize(
    ("rival", "evidence", "answer"),
    [
        (frozenset({1}), 99.9, "named"),
        (frozenset({1}), 100.1, "unknown"),
        (frozenset({0, 1}), 105.9, "named"),
        (frozenset({0, 1}), 106.1, "unknown"),
        (CLEAN, 99.9, "named"),
        (CLEAN, 100.1, "unknown"),
    ],
)
def test_where_another_set_is_more_probable_nothing_is_named(
    rival: frozenset[int], evidence: float, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A member more must bring its six nats; another shape of what was chosen says the same."""
    rivals = {frozenset({1}): 0.0, frozenset({0, 1}): 0.0, rival: evidence}
    more = [at("coulomb_friction"), at("torque_bias", 1)]
    found = verdict(monkeypatch, PAIR, candidates=more, chosen=STRONG, rivals=rivals)
    assert found.verdict == answer and bool(found.findings) == (answer == "named")
    same = [at("coulomb_friction"), at("coulomb_friction", shape={"other": 1.0})]
    if rival == frozenset({1}):
        assert verdict(monkeypatch, PAIR, candidates=same, chosen=STRONG, rivals=rivals).verdict == "named"


@pytest.mark.parametrize(("share", "answer"), [(0.67, "named"), (0.66, "unknown")])
def test_a_pair_of_which_one_hardly_hears_its_joint_is_no_name(
    share: float, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two thirds of the samples must count where another unusual name takes what is left; it alone needs fewer."""
    cost = -0.5 * 900.0 * np.log(share)
    two = [at("torque_saturation", unheard_cost=cost), at("torque_constant")]
    findings = (finding("torque_saturation"), finding("torque_constant"))
    one, other, whole = frozenset({0}), frozenset({1}), frozenset({0, 1})
    variances = {CLEAN: [9.0, 1.0, 1.0], one: [4.0, 1.0, 1.0], other: [4.0, 1.0, 1.0], whole: [1.0, 1.0, 1.0]}
    found = verdict(monkeypatch, variances, candidates=two, findings=findings)
    assert found.verdict == answer and len(found.findings) == (2 if answer == "named" else 0)
    assert verdict(monkeypatch, BOTH, candidates=two, findings=findings).verdict == "named"


def test_doubtful_small_findings_are_left_out_and_leave_structure(monkeypatch: pytest.MonkeyPatch) -> None:
    strong, weak = finding(significance=100.0), finding("torque_bias", "b", significance=20.0, confidence=0.4)
    candidates = [at("coulomb_friction"), at("torque_bias", 1)]
    both = frozenset({0, 1})
    variances = {
        CLEAN: [9.0, 9.0, 1.0],
        frozenset({0}): [1.0, 9.0, 1.0],
        frozenset({1}): [9.0, 1.0, 1.0],
        both: [1.0, 1.0, 1.0],
    }
    found = verdict(monkeypatch, variances, findings=(strong, weak), candidates=candidates)
    assert [f.name for f in found.findings] == ["coulomb_friction"] and found.remainder
    assert found.findings[0].confidence == pytest.approx(0.675)
    sure = verdict(monkeypatch, variances, findings=(strong, replace(weak, confidence=0.6)), candidates=candidates)
    assert len(sure.findings) == 2 and not sure.remainder


@pytest.mark.parametrize(
    ("significance", "confidence", "joints", "name", "left_out"),
    [
        (29.0, 0.49, ("b",), "torque_bias", True),
        (31.0, 0.49, ("b",), "torque_bias", False),
        (29.0, 0.51, ("b",), "torque_bias", False),
        (29.0, 0.49, ("b", "c"), "torque_bias", False),
        (29.0, 0.49, ("b",), "viscous_friction", False),
    ],
)
def test_a_finding_is_negligible_that_is_small_doubtful_and_unusual(
    significance: float, confidence: float, joints: tuple[str, ...], name: str, left_out: bool
) -> None:
    """Below three tenths of the strongest and less likely than not, on one joint."""
    strong, weak = finding(significance=100.0), finding(name, *joints, significance=significance, confidence=confidence)
    assert negligible(weak, [strong, weak], 0.9, structure=False) == left_out
    assert negligible(weak, [strong, weak], 0.9, structure=True) == left_out
    sure = replace(weak, confidence=0.9)
    for share, small in ((0.099, True), (0.101, False)):
        assert negligible(sure, [strong, sure], share, structure=True) == small
        assert not negligible(sure, [strong, sure], share, structure=False)
        assert not negligible(strong, [strong, sure], share, structure=True)


def test_shares_are_of_the_likelihood_on_the_members_own_joints() -> None:
    candidates = [at("joint_spring", 0), at("joint_spring", 1)]
    variances = {
        CLEAN: [8.0, 4.0, 9.0],
        frozenset({0, 1}): [1.0, 1.0, 1.0],
        frozenset({0}): [1.0, 2.0, 1.0],
        frozenset({1}): [4.0, 1.0, 1.0],
    }
    bench: Any = Known(candidates, variances)
    bench.counts = np.array([100.0, 300.0, 5000.0])
    fit = bench.solve(frozenset({0, 1}))
    assert share_of(bench, fit, frozenset({0})) == pytest.approx(np.log(4.0) / np.log(8.0))
    assert share_of(bench, fit, frozenset({1})) == pytest.approx(np.log(2.0) / np.log(4.0))
    lost = 100.0 * np.log(8.0) + 300.0 * np.log(4.0)
    assert share_of(bench, fit, frozenset({0, 1})) == pytest.approx(1.0) and lost > 0.0


@pytest.mark.parametrize(("without", "dropped"), [(1.22, True), (1.26, False)])
def test_joints_that_explain_less_than_a_tenth_lose_an_unusual_name(without: float, dropped: bool) -> None:
    candidates = [at("joint_spring", 0), at("joint_spring", 1), at("coulomb_friction", 2)]
    whole = frozenset({0, 1, 2})
    variances = {CLEAN: [9.0, 9.0, 9.0], whole: [1.0, 1.0, 1.0]}
    variances |= {whole - {0}: [9.0, 1.0, 1.0], whole - {1}: [1.0, without, 1.0], whole - {2}: [1.0, 1.0, 1.05]}
    bench: Any = Known(candidates, variances)
    assert trimmed(bench, bench.solve(whole)).members == (whole - {1} if dropped else whole)
    bench.evidence = -np.inf
    fit = bench.solve(whole)
    assert trimmed(bench, fit) is fit


def test_names_that_are_trimmed_keep_the_confidence_that_they_had(monkeypatch: pytest.MonkeyPatch) -> None:
    candidates = [at("joint_spring", 0), at("joint_spring", 1)]
    whole = frozenset({0, 1})
    variances = {
        CLEAN: [9.0, 9.0, 1.0],
        whole: [1.0, 1.0, 1.0],
        frozenset({0}): [1.0, 1.1, 1.0],
        frozenset({1}): [9.0, 1.0, 1.0],
    }
    found = verdict(monkeypatch, variances, statistic=7.0, candidates=candidates, findings=(finding("joint_spring"),))
    assert found.verdict == "named" and found.findings[0].confidence == pytest.approx(0.675)


def test_ripples_of_one_joint_are_doubled_and_others_are_not() -> None:
    bench: Any = Known([at("torque_ripple"), at("torque_ripple"), at("torque_ripple", 1), at("viscous_friction")], {})
    members = [({0, 2}, False), ({0, 1}, True), ({0, 2, 3}, False), ({3}, False)]
    for some, twice in members:
        fit: Any = SimpleNamespace(members=frozenset(some))
        assert doubled(bench, fit) == twice


def test_crowds() -> None:
    strange = [finding(name, joint) for name, joint in (("torque_bias", "a"), ("payload", "b"), ("time_delay", "c"))]
    assert not crowded(strange) and crowded([*strange, finding("joint_spring", "d")])
    assert crowded([finding("torque_bias", "a"), finding("torque_constant", "a")])
    late = replace(finding("viscous_friction", "a"), onset=Moment(0, 1.0))
    assert not crowded([late]) and crowded([late, finding("coulomb_friction", "a")])
    assert not crowded([late, finding("coulomb_friction", "b")])
