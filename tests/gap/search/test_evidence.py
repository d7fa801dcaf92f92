"""Evidence, search and verdicts on made-up columns whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.stribeck_friction import TUNING as STRIBECK_FRICTION
from twin_diagram.gap.candidates.torque_ripple import TUNING as TORQUE_RIPPLE
from twin_diagram.gap.findings import Finding, Moment
from twin_diagram.gap.naming import uneven
from twin_diagram.gap.residuals import whitening
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.greedy_search import handicaps, plainer, search
from twin_diagram.gap.search.normal_equations import TUNING as NORMAL_EQUATIONS
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.search.prior_costs import compatible, price
from twin_diagram.gap.search.scoring import score_candidates
from twin_diagram.gap.search.stiction_proposals import peaks_of
from twin_diagram.gap.verdict.deciding import crowded, mostly_left, negligible, redness, trimmed

Array = npt.NDArray[np.float64]
ROWS, JOINTS = 600, 3


def candidate(name: str, joint: int, column: Array, **more: object) -> Candidate:
    return Candidate(
        name=name,
        joints=(joint,),
        links=(),
        rows=(joint,),
        columns=column[:, None, None],
        spread=np.array([3.0]),
        lower=np.array([-np.inf]),
        upper=np.array([np.inf]),
        parameters=linear("torque"),
        **more,  # type: ignore[arg-type]
    )


def white(sigma: float = 1.0) -> whitening.Whitener:
    return whitening.Whitener(np.ones((JOINTS, 1)), np.full(JOINTS, sigma), (ROWS,))


def offers(rng: np.random.Generator) -> list[Candidate]:
    names = ("torque_bias", "viscous_friction", "coulomb_friction", "torque_constant")
    return [candidate(name, j, rng.normal(size=ROWS)) for name in names for j in range(JOINTS)]


@pytest.mark.parametrize("size", [2.5, 0.3, 0.15])
def test_evidence_is_the_marginal_likelihood(size: float) -> None:
    """At the variance that it settles on, against the log density of a Gaussian with covariance σ² 1 + X Λ⁻¹ Xᵀ.

    Of an effect far smaller than its prior's width, at the width that suits it best, which has its price.
    """
    rng = np.random.default_rng(0)
    column = rng.normal(size=ROWS)
    y = np.zeros((ROWS, JOINTS))
    y[:, 0] = size * column + rng.normal(size=ROWS)
    bench = Bench(y, white(), [candidate("torque_bias", 0, column)], [])
    fit, empty = bench.solve(frozenset({0})), bench.solve(frozenset())

    def density(variance: float, covariance: Array) -> float:
        C = variance * np.eye(ROWS) + covariance
        return -0.5 * float(np.linalg.slogdet(C)[1] + y[:, 0] @ np.linalg.solve(C, y[:, 0]))

    full, *narrower = (density(fit.variance[0], w**2 * np.outer(column, column)) for w in np.geomspace(3.0, 0.05, 60))
    none = density(empty.variance[0], np.zeros((ROWS, ROWS)))
    best = max(full, max(narrower) - NORMAL_EQUATIONS.scale_price)
    assert (best > full) == (size < 1.0)
    assert fit.evidence + PRIOR_COSTS.new_name == pytest.approx(best - none, abs=0.02)
    if size < 1.0:  # what is to be ranked is not worth its own noise level
        assert score_candidates(bench, frozenset())[0] == pytest.approx(fit.evidence + PRIOR_COSTS.new_name, rel=0.25)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_planted_names_are_found_and_no_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    candidates = offers(rng)
    planted = frozenset(int(k) for k in rng.choice(len(candidates), 2, replace=False))
    y = rng.normal(size=(ROWS, JOINTS))
    for k in planted:
        y[:, candidates[k].joints[0]] += 0.6 * candidates[k].columns[:, 0, 0]
    assert search(Bench(y, white(), candidates, []), least=6.0).members == planted


def test_standard_errors_cover_what_they_should() -> None:
    rng = np.random.default_rng(1)
    column = rng.normal(size=ROWS)
    off = []
    for _ in range(300):
        y = rng.normal(size=(ROWS, JOINTS))
        y[:, 1] += 0.5 * column
        bench = Bench(y, white(), [candidate("torque_bias", 1, column)], [])
        coefficients, covariance = bench.part(bench.solve(frozenset({0})), 0)
        off.append((coefficients[0] - 0.5) / np.sqrt(covariance[0, 0]))
    assert np.std(off) == pytest.approx(1.0, abs=0.12)


def test_noise_that_was_thought_too_small_does_not_make_names() -> None:
    rng = np.random.default_rng(2)
    y = 3.0 * rng.normal(size=(ROWS, JOINTS))
    assert not search(Bench(y, white(), offers(rng), []), least=6.0).members


def test_prices_of_names_joints_and_kinds_of_dry_friction() -> None:
    x = np.ones(ROWS)
    one, two = candidate("coulomb_friction", 0, x), candidate("coulomb_friction", 1, x, cost=1.5)
    other = candidate("stribeck_friction", 2, x)
    assert price([one], JOINTS) == PRIOR_COSTS.new_name
    assert price([one, two], JOINTS) == PRIOR_COSTS.new_name + PRIOR_COSTS.further_joint + 1.5
    assert price([one, other], JOINTS) == 2 * PRIOR_COSTS.new_name + STRIBECK_FRICTION.mixed
    ripples = [candidate("torque_ripple", j, x, shape={"cycles": c}) for j, c in ((0, 4.0), (0, 9.0), (1, 4.0))]
    assert price(ripples, JOINTS) == PRIOR_COSTS.new_name + 2 * PRIOR_COSTS.further_joint + TORQUE_RIPPLE.harmonic


def test_what_excludes_each_other_does_so_both_ways() -> None:
    x = np.ones(ROWS)
    dry, held = candidate("coulomb_friction", 0, x), candidate("stribeck_friction", 0, x)
    elsewhere = candidate("stribeck_friction", 1, x)
    assert not compatible([dry], held) and not compatible([held], dry) and not compatible([dry], dry)
    assert compatible([dry], elsewhere)


def test_a_push_is_no_noise_and_noise_is_no_push() -> None:
    rng = np.random.default_rng(3)
    rate, count = 50.0, 2500
    noise = rng.normal(size=(count, 2))
    assert np.all(whitening.ordinary(noise, (count,), rate) == 1.0)
    pushed = noise.copy()
    pushed[1000:1150, 1] += 2.5
    weights = whitening.ordinary(pushed, (count,), rate)
    assert np.all(weights[:, 0] == 1.0) and np.all(weights[1010:1140, 1] == 0.0)
    assert np.mean(weights[:, 1]) > 0.85
    apart = whitening.ordinary(pushed, (1000, 1500), rate)
    assert np.all(apart[:950] == 1.0)


@pytest.mark.parametrize(("corner", "low", "high"), [(0.0, 0.8, 1.2), (4.0, 1.0, 2.5), (0.3, 8.0, np.inf)])
def test_redness_of_noise_with_a_known_corner(corner: float, low: float, high: float) -> None:
    rate = 50.0
    pole = np.exp(-2.0 * np.pi * corner / rate) if corner else 0.0
    noise = whitening.Whitener(np.array([[1.0, -pole]]), np.ones(1), (1000,))
    assert low <= redness(noise, rate) <= high


def finding(
    name: str, *joints: str, significance: float = 10.0, confidence: float = 0.9, late: bool = False
) -> Finding:
    onset = Moment(0, 3.0) if late else None
    return Finding(name, joints, (), {}, confidence, (), onset, None, significance)


def test_two_unusual_names_on_a_joint_are_a_crowd() -> None:
    assert crowded([finding("torque_bias", "a"), finding("joint_spring", "a")])
    assert crowded([finding("coulomb_friction", "a"), finding("viscous_friction", "a", late=True)])
    assert not crowded([finding("coulomb_friction", "a"), finding("joint_spring", "a")])
    assert not crowded([finding("torque_bias", "a"), finding("joint_spring", "b", late=True)])
    strange = ("torque_bias", "payload", "time_delay", "coupled_friction")
    many = [finding(name, joint) for name, joint in zip(strange, "abcd", strict=True)]
    assert crowded(many)
    assert not crowded([*many[:3], finding("coulomb_friction", "d")])


def test_what_is_left_unnamed() -> None:
    strong = finding("payload", significance=200.0)
    doubtful = finding("torque_bias", "a", significance=9.0, confidence=0.3)
    usual = finding("coulomb_friction", "a", significance=9.0, confidence=0.3)
    assert negligible(doubtful, [strong, doubtful], 0.5, structure=False)
    assert not negligible(usual, [strong, usual], 0.5, structure=False)
    assert negligible(usual, [strong, usual], 0.05, structure=True)
    assert not negligible(strong, [strong, usual], 0.05, structure=True)


def test_a_name_keeps_the_joints_on_which_it_explains_something() -> None:
    """Of a spring that is strong on one joint and next to nothing, though sure, on another beside strong friction."""
    rng = np.random.default_rng(7)
    x, y = rng.normal(size=(2, ROWS))
    springs = [candidate("joint_spring", j, x) for j in (0, 1)]
    frictions = [candidate("viscous_friction", j, y) for j in (0, 1)]
    residual = rng.normal(size=(ROWS, JOINTS))
    residual[:, 0] += 3.0 * x
    residual[:, 1] += 9.0 * y + 0.4 * x
    bench = Bench(residual, white(), springs + frictions, [])
    fit = bench.solve(frozenset({0, 1, 3}))
    assert fit.evidence > bench.solve(frozenset({0, 3})).evidence + 20.0
    assert trimmed(bench, fit).members == {0, 3}
    alone = bench.solve(frozenset({1, 3}))
    assert trimmed(bench, alone) is alone, "no name goes wholly"


def test_friction_peaks_where_it_holds_and_lets_go() -> None:
    friction = np.array([-2.0, -2.0, -2.0, -2.2, -4.0, 0.5, 4.4, 2.4, 2.0, 2.0, 2.0])
    stuck = np.zeros(len(friction), dtype=bool)
    stuck[4:7] = True
    assert peaks_of(friction, stuck) == pytest.approx([4.0, 4.4])
    assert not len(peaks_of(np.abs(friction), stuck)), "a stop is no reversal"
    assert not len(peaks_of(friction, np.zeros(len(friction), dtype=bool)))
    assert not len(peaks_of(friction, np.ones(len(friction), dtype=bool)))


@pytest.mark.parametrize(
    ("plain_name", "finer_name", "beyond", "named"),
    [
        ("coulomb_friction", "stribeck_friction", 0.35, "coulomb_friction"),
        ("coulomb_friction", "stribeck_friction", 3.0, "stribeck_friction"),
        ("reflected_inertia", "joint_elasticity", 0.35, "reflected_inertia"),
        ("reflected_inertia", "joint_elasticity", 3e3, "joint_elasticity"),
    ],
)
def test_what_is_next_to_nothing_beyond_a_plainer_law_is_not_named(
    plain_name: str, finer_name: str, beyond: float, named: str
) -> None:
    rng = np.random.default_rng(4)
    level, bump = np.sign(rng.normal(size=ROWS)), rng.normal(size=ROWS)
    plain = candidate(plain_name, 0, level)
    finer = replace(
        plain,
        name=finer_name,
        columns=np.stack([level, bump], axis=1)[:, None, :],
        spread=np.array([3e3, 3e3]),
        lower=np.full(2, -np.inf),
        upper=np.full(2, np.inf),
    )
    y = rng.normal(size=(ROWS, JOINTS))
    y[:, 0] += 3e3 * level + beyond * bump
    bench = Bench(y, white(), [replace(plain, spread=np.array([3e3])), finer], [])
    found = bench.solve(frozenset({1}))
    assert found.evidence > bench.solve(frozenset({0})).evidence, "as evidence goes, it is there"
    assert {bench.candidates[k].name for k in plainer(bench, found).members} == {named}
    less = handicaps(bench, bench.solve(frozenset({0})))
    assert less[finer_name] > 0.0
    assert finer_name not in handicaps(bench, found)


@pytest.mark.parametrize("joint", range(JOINTS))
def test_a_delay_that_one_joint_alone_has_is_told(joint: int) -> None:
    """Though the joint that moves most tells most of it."""
    rng = np.random.default_rng(6)
    rates = rng.normal(size=(ROWS, JOINTS)) * np.array([4.0, 1.0, 1.0])
    late = replace(
        candidate("time_delay", 0, rates[:, 0]), joints=(), rows=tuple(range(JOINTS)), columns=rates[:, :, None]
    )
    y = rng.normal(size=(ROWS, JOINTS)) + 0.3 * rates
    y[:, joint] += 0.4 * rates[:, joint]
    bench = Bench(y, white(), [late], [])
    assert uneven(bench, bench.solve(frozenset({0})), 0)[0] == joint
    even = Bench(rng.normal(size=(ROWS, JOINTS)) + 0.3 * rates, white(), [late], [])
    assert not uneven(even, even.solve(frozenset({0})), 0)


def test_the_least_noise_that_any_log_has_is_no_structure() -> None:
    """Beside torques of 4000 standard deviations, twice the noise is what filters and sampling leave."""
    rng = np.random.default_rng(3)
    size = np.array([4000.0, 0.0, 0.0])
    bench = Bench(rng.normal(size=(ROWS, JOINTS)), white(), offers(rng), [], size=size)
    nothing = bench.solve(frozenset())
    assert bench.finest[0] == pytest.approx(4.0) and nothing.variance[0] > 4.5
    np.testing.assert_allclose(nothing.variance - bench.finest, 1.0, atol=0.15)
    all_joints = np.ones(JOINTS, dtype=bool)
    pushed = Bench(rng.normal(size=(ROWS, JOINTS)) + 9.0 * offers(rng)[0].columns[:, :, 0], white(), offers(rng), [])
    assert mostly_left(pushed, pushed.solve(frozenset()), all_joints)
