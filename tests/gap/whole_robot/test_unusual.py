"""What is unusual beside what every arm lacks: found, told from nothing, and judged on motion that was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap import made
from tests.gap.made import ARM, ELBOW, LIFT, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.external_force import external_forces
from twin_diagram.gap.candidates.joint_spring import on_joints
from twin_diagram.gap.candidates.payload import payload, payload_about
from twin_diagram.gap.findings import Finding
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.search.proposals import active
from twin_diagram.gap.whole_robot import concluding, physical_fit
from twin_diagram.gap.whole_robot import unusual as whole_unusual
from twin_diagram.gap.whole_robot.beside_the_usual import rise_beside_the_usual
from twin_diagram.gap.whole_robot.column_sums import summed
from twin_diagram.gap.whole_robot.concluding import confidences, of_offsets, own_units, what_each_brings
from twin_diagram.gap.whole_robot.estimates import covariance
from twin_diagram.gap.whole_robot.events import TUNING as EVENTS
from twin_diagram.gap.whole_robot.events import Tried, counted
from twin_diagram.gap.whole_robot.evident import evident
from twin_diagram.gap.whole_robot.explain import begun, concluded, rather, settled, settled_beside
from twin_diagram.gap.whole_robot.first_order import ReadyFits
from twin_diagram.gap.whole_robot.left_out import LeftOut
from twin_diagram.gap.whole_robot.loads import evidence, loaded, rise_with
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.pushes import TUNING, _innermost, pushes
from twin_diagram.gap.whole_robot.torque_equations import OWN, equations
from twin_diagram.gap.whole_robot.unusual import offered, room_for, terms_of, unusual, weighed, with_candidate
from twin_diagram.model.effects import Effect, make
from twin_diagram.scenario import EffectSpec

MASS, COM = 3.0, [0.02, 0.05, 0.06]


@cache
def problem(*added: Effect) -> RobotProblem:
    """Of an arm with viscous friction and something more; friction is free, links are as described."""
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0), *added])
    records = noisy(ARM, true, 10.0)
    whole, _ = settled(begun(records, equations(records)))
    own = np.zeros((6, 4), dtype=bool)
    own[:, 0] = True
    return replace(whole, links_free=np.zeros(6, dtype=bool), own_free=own)


PAYLOAD = effect("payload", links=["tool0"], mass=MASS, com=COM)
GAINS = effect("torque_constant", joints=["shoulder_lift_joint", "elbow_joint"], gain=[1.05, 0.95])
OFFSET = effect("torque_bias", joints=["shoulder_lift_joint"], torque=[2.0])
TILT = effect("gravity_tilt", roll=0.05, pitch=-0.03)


def test_a_payload_is_found_with_its_mass_and_centre() -> None:
    start = problem(PAYLOAD)
    found = loaded(start, solve(start))
    assert found is not None and [c.name for c in found.sums.further] == ["payload"]
    z = solve(found)[found.place(0)]
    np.testing.assert_allclose(z[0], MASS, rtol=0.03)
    np.testing.assert_allclose(z[1:] / z[0], COM, atol=0.01)
    told = concluded(found)
    assert told is not None and "payload" in {finding.name for finding in told.findings}
    (mass,) = [f.parameters["mass"] for f in told.findings if f.name == "payload"]
    assert mass.std >= 0.1 * start.links.described[-1, 0]  # type: ignore[union-attr]  # the last link's own doubt


@pytest.mark.parametrize("com", [(-0.1, -0.1, 0.15), (0.0, 0.25, 0.1), (-0.2, -0.15, 0.05), (0.0, -0.3, 0.1)])
def test_a_payload_off_the_tool_is_found(com: tuple[float, float, float]) -> None:
    """Looked for as a mass without inertia, it was found to be none, though evidence speaks for it by 240 nats."""
    true = ARM.with_effects(
        [everywhere("viscous_friction", damping=2.0), effect("payload", links=["tool0"], mass=1.2, com=list(com))]
    )
    records = noisy(ARM, true, 10.0)
    start, z = settled(begun(records, equations(records)))
    found = loaded(start, z)
    assert found is not None
    own = solve(found)[found.place(0)]
    np.testing.assert_allclose(own[0], 1.2, rtol=0.03)
    np.testing.assert_allclose(own[1:] / own[0], com, atol=0.01)


def test_motors_that_are_off_do_not_hide_a_payload() -> None:
    """Links alone would stand in for gains, and then for the payload, too."""
    start = problem(effect("payload", links=["tool0"], mass=0.6, com=COM), GAINS)
    terms = terms_of(start.sums, ARM)
    load = payload_about(terms, np.array(COM))
    noise = with_noise(start, solve(start))
    both = replace(noise, sums=noise.sums.with_further([load]))
    beside, _ = rise_with(noise, solve(noise), load, [])
    assert beside > evidence(both, with_noise(both, solve(both)))[0] - evidence(noise, noise)[0]
    calm = problem(GAINS)
    assert loaded(calm, solve(calm)) is None


@pytest.mark.parametrize("gain", [0.96, 0.8])
def test_a_gain_is_drawn_to_one_unless_it_is_no_tolerance(gain: float) -> None:
    start = problem(effect("torque_constant", joints=["shoulder_lift_joint"], gain=gain))
    found = unusual(start, solve(start), ARM, ("torque_constant",))
    (candidate,) = found.sums.further
    told = candidate.parameters(solve(found)[found.place(0)], np.eye(1))["gain"][0]
    assert told == pytest.approx(gain, abs=0.01)
    assert np.all(candidate.spread > 0.1) == (gain < 0.9)
    damping = solve(found)[10 * 6 + 4]
    assert damping == pytest.approx(2.0, rel=0.03)  # at the joint, not as the motor's log has it


@pytest.mark.long
def test_a_tilt_takes_the_place_of_nothing_and_nothing_is_found_of_nothing() -> None:
    start = problem(TILT)
    found = unusual(start, solve(start), ARM)
    assert [c.name for c in found.sums.further] == ["gravity_tilt"]
    np.testing.assert_allclose(solve(found)[found.place(0)], [0.05, -0.03], atol=0.004)
    plain = problem()
    assert not unusual(plain, solve(plain), ARM).sums.further
    assert loaded(plain, solve(plain)) is None


def test_a_belt_that_couples_two_wrist_joints_is_found_beside_everything_usual() -> None:
    """A search for few names alone knew of it: beside links that are off, a payload stood in for the rest."""
    wrist = ["wrist_2_joint", "wrist_3_joint"]
    start = problem(effect("coupled_friction", joints=wrist, damping=0.8, torque=2.0))
    found = unusual(start, solve(start), ARM, ("coupled_friction",))
    (belt,) = found.sums.further
    assert "coupled_friction" in whole_unusual.BEYOND and belt.joints == (4, 5)
    np.testing.assert_allclose(solve(found)[found.place(0)], [0.8, 2.0], atol=0.05)
    plain = problem(effect("coulomb_friction", joints=wrist, torque=[1.0, 1.0]))
    assert not unusual(plain, solve(plain), ARM, ("coupled_friction",)).sums.further


SPRING = effect("joint_spring", joints=["elbow_joint"], stiffness=[6.0], rest_angle=[0.5])


@pytest.mark.parametrize(("added", "named"), [(OFFSET, []), (SPRING, ["joint_spring"])])
def test_an_offset_is_no_spring_whose_curve_is_flat(added: Effect, named: list[str]) -> None:
    """A curve took the place of an offset that had earned none yet, and was never held against it."""
    start = problem(added)
    found = unusual(start, solve(start), ARM, ("joint_spring",))
    assert [c.name for c in found.sums.further] == named


def test_a_curve_must_be_evident_beside_everything_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    """One beside a true delay brought 14 nats so, and 24 of left-out motion: it held an offset and rough friction."""
    start = problem(SPRING)
    z = solve(start)
    there = offered(terms_of(start.sums, ARM), ("joint_spring",))
    straight, curve = (next(c for c in there if c.joints == (ELBOW,) and c.variant == v) for v in ("", "curve"))
    left_out = LeftOut.of(start, z)
    assert weighed(start, z, left_out, curve, 5) is not None
    monkeypatch.setattr(whole_unusual, "rise_beside_the_usual", lambda *some: 14.0)
    assert weighed(start, z, left_out, curve, 5) is None
    assert weighed(start, z, left_out, straight, 5) is not None


@pytest.mark.long
def test_a_strong_tilt_is_told_to_what_noise_leaves() -> None:
    """By its first order about half of it, roll was 0.1947 and 38 standard errors off."""
    start = problem(effect("gravity_tilt", roll=0.2, pitch=0.25))
    found = unusual(start, solve(start), ARM)
    z = solve(found)
    for _ in range(2):  # with the noise that is left beside it
        found = with_noise(found, z)
        z = solve(found, None, z)
    np.testing.assert_allclose(z[found.place(0)], [0.2, 0.25], atol=5e-4)


def test_a_name_is_as_sure_as_left_out_motion_makes_it() -> None:
    """A tilt that is there brings a lot, and the same name where there is none nothing: it had 1 either way."""
    found = unusual(problem(TILT), solve(problem(TILT)), ARM)
    plain = with_candidate(problem(), found.sums.further[0], 5)
    sure = []
    for each in (found, plain):
        brought = what_each_brings(each, LeftOut.of(each, solve(each)))
        sure.append(confidences(each, brought)["gravity_tilt"])
    assert sure[0] > 0.999 and sure[1] < 0.9


def test_an_offset_is_only_as_sure_as_motors_that_are_off_leave_it() -> None:
    """Two of them passed for an offset of 0.65 N·m, by 7.6 nats of left-out motion; one that is there stays."""
    bias = np.arange(4) == OWN.index("bias")
    for added, joint, there in ((GAINS, ELBOW, False), (OFFSET, LIFT, True)):
        start = problem(added)
        start = replace(start, own_free=start.own_free | bias)
        z = solve(start)
        brought = what_each_brings(start, LeftOut.of(start, z))
        unit = own_units(start)[len(OWN) * joint + int(np.argmax(bias))]
        told = of_offsets(start, z, brought)[unit][joint]
        assert brought[unit][joint] > 5.0
        assert told > 100.0 if there else told < 0.5


@pytest.mark.parametrize(("added", "joint", "stays"), [(GAINS, ELBOW, False), (OFFSET, LIFT, True)])
def test_an_offset_that_is_missed_stays_where_evidence_speaks_for_it(
    added: Effect, joint: int, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of -2.6 N·m, known to 1.5, stood for a gain that was off, as left-out motion missed it (60280)."""
    start = problem(added)
    own = start.own_free.copy()
    own[joint, OWN.index("bias")] = True
    start = replace(start, own_free=own)
    z = solve(start)
    found = concluding.said_of(start, z, covariance(start, z))
    assert found is not None
    doubtful = ("torque_bias", ARM.joints[joint])

    def lost(findings: Sequence[Finding]) -> set[tuple[str, str]]:
        return {doubtful} & {(one.name, named) for one in findings for named in one.joints}

    monkeypatch.setattr(concluding, "lost_names", lost)
    kept = concluding.well_known(found)
    assert kept is not None and bool(lost(kept.findings)) == stays


@pytest.mark.parametrize(("doubtful", "stays"), [(10.0, True), (1e6, False)])
def test_a_spring_that_is_not_known_to_a_third_stays_where_left_out_motion_misses_it(
    doubtful: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One known to 0.38 was lost in 8 s of an LWR4+, and with it what traded with it: 94 nats, and 1.7 times as far."""
    start = problem(effect("joint_spring", joints=["elbow_joint"], stiffness=8.0, rest_angle=1.0))
    spring = on_joints(terms_of(start.sums, ARM))[ELBOW][0]
    start = replace(start, sums=start.sums.with_further([spring]))
    z = solve(start)
    found = concluding.said_of(start, z, covariance(start, z))
    assert found is not None
    unsure = ("joint_spring", ARM.joints[ELBOW])
    monkeypatch.setattr(concluding, "TUNING", replace(concluding.TUNING, doubtful=doubtful))

    def lost(findings: Sequence[Finding]) -> set[tuple[str, str]]:
        return {unsure} & {(one.name, named) for one in findings for named in one.joints}

    monkeypatch.setattr(concluding, "lost_names", lost)
    kept = concluding.well_known(found)
    assert kept is not None and bool(lost(kept.findings)) == stays


def test_a_tilt_is_evident_beside_everything_usual_and_gains_that_are_off_are_none() -> None:
    """What the arm's motors may do counts against it, and what is told once stays."""
    start = problem(TILT, GAINS)
    found, z = evident(start, solve(start))
    assert [c.name for c in found.sums.further] == ["gravity_tilt"]
    np.testing.assert_allclose(z[found.place(0)], [0.05, -0.03], atol=0.006)
    assert rise_beside_the_usual(found, z, found.sums.further[0]) > 100.0
    calm = problem(GAINS)
    assert not evident(calm, solve(calm))[0].sums.further


def test_what_is_only_nearer_to_its_best_fit_makes_nothing_likelier(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tilt of nothing was evident where the fit without it had not come to its end."""
    start = problem(PAYLOAD, GAINS)
    tilt = next(c for c in offered(terms_of(start.sums, ARM)) if c.name == "gravity_tilt")
    monkeypatch.setattr(physical_fit, "TUNING", replace(physical_fit.TUNING, rounds=1))
    assert rise_beside_the_usual(start, start.mean, tilt) < 1.0


def test_another_way_to_explain_an_arm_must_hold_what_is_evident_and_be_better() -> None:
    start = problem(TILT, GAINS)
    tilted, _ = evident(start, solve(start))
    with_tilt, without = concluded(tilted), concluded(start)
    assert with_tilt is not None and without is not None
    assert rather(with_tilt, without, tilted) is with_tilt
    assert rather(without, with_tilt, tilted) is with_tilt
    assert rather(without, None, tilted) is without


@pytest.mark.parametrize(("name", "variant"), [("gravity_tilt", ""), ("joint_spring", "curve"), ("encoder_offset", "")])
def test_what_a_candidate_brings_is_known_before_it_is_fitted(name: str, variant: str) -> None:
    start = problem(TILT)
    left_out = LeftOut.of(start, solve(start))
    candidate = next(c for c in offered(terms_of(start.sums, ARM)) if (c.name, c.variant) == (name, variant))
    tried = with_candidate(start, candidate, 5)
    fitted = LeftOut.of(tried, solve(tried)).score() - left_out.score()
    assert ReadyFits.of(left_out).gain(candidate) == pytest.approx(fitted, rel=0.02, abs=0.3)


def test_what_was_found_of_links_before_counts_as_if_both_logs_were_fitted_at_once() -> None:
    every = replace(problem(), links_free=np.ones(6, dtype=bool), spread=0.1)
    some, links = np.flatnonzero(every.free), slice(0, 60)
    halves = (every.sums.stretch >= len(every.sums.fold) // 2).astype(np.int64)
    before, after = summed(every.sums.columns, every.sums.weights, halves)
    found, both = solve(every, before), solve(every)[links]
    told = np.linalg.inv(every.system(found, before)[0][np.ix_(some, some)])[links, links]
    later = replace(every, links=replace(every.links, mean=found[links].reshape(6, 10)), told=told, spread=1e-6)
    error = np.sqrt(np.diag(told))
    with_both, alone = (np.linalg.norm((solve(one, after)[links] - both) / error) for one in (later, every))
    assert with_both < 0.5 * alone


def test_what_acts_in_one_log_loads_no_joint_in_another() -> None:
    push = EffectSpec("external_force", [], ["tool0"], {"wrench": [0.0, 0.0, 30.0, 0.0, 0.0, 0.0]}, 1.5, 3.0, "mark 0")
    model = ARM.with_effects([make(push)])
    logs = Records(ARM, tuple(made.record(ARM, *made.swing(5.0, seed=index), index=index) for index in range(2)))
    sums = equations(logs)
    pushed, other = (
        np.max(np.abs(load - record.given))
        for load, record in zip(terms_of(sums, model).load, sums.records.records, strict=True)
    )
    assert pushed > 10.0 and other < 1e-9


def test_what_stands_for_the_same_makes_room() -> None:
    start = problem(PAYLOAD)
    terms = terms_of(start.sums, ARM)
    spring = next(c for c in offered(terms) if c.name == "joint_spring" and c.joints == (2,))
    load = payload(terms)
    links, own = room_for(start.sums.with_further([spring, load]), 5)
    assert not links[5] and np.all(links[:5])
    assert not own[2, 2] and np.sum(~own) == 1
    both = settled_beside(with_candidate(start, load, 5), start)
    assert not both.links_free[5]


def test_sums_with_further_columns_say_what_is_left() -> None:
    start = problem(TILT)
    candidate = next(c for c in offered(terms_of(start.sums, ARM)) if c.name == "gravity_tilt")
    more = with_candidate(start, candidate, 5)
    z = solve(more)
    left = more.sums.left(more.difference(z))
    np.testing.assert_allclose(np.sum(left**2, axis=0), more.squares(z, more.sums.whole), rtol=1e-9)
    step, total = 1e-5, more.sums.whole
    _, gradient = more.system(z + 0.01 * more.deviation, total)
    at = z + 0.01 * more.deviation
    for k in (3, 60, 61, len(z) - 1):
        d = step * more.deviation[k] * np.eye(len(z))[k]
        slope = (more.cost(at + d, total) - more.cost(at - d, total)) / (2.0 * step * more.deviation[k])
        assert gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.max(np.abs(gradient)))


def test_links_that_may_be_anything_are_less_likely_than_a_payload_and_that_says_at_what_spread() -> None:
    start = problem(PAYLOAD)
    load = loaded(start, solve(start))
    assert load is not None
    with_load, spread = evidence(load, load)
    without, wider = evidence(start, load)
    assert with_load - without > 20.0
    assert spread < 0.1 < wider


def test_of_links_that_were_found_before_a_payload_is_as_likely_once_their_spread_is_chosen() -> None:
    """A choice among spreads says nothing of what was known of the links; they were then taken for any arm's."""
    start = replace(problem(PAYLOAD), known=True, spreads=(0.025, 0.05))
    load = payload_about(terms_of(start.sums, ARM), np.array(COM))
    rises = [rise_with(one, solve(one), load, ()) for one in (start, replace(start, spreads=(0.025,)))]
    assert rises[0] == rises[1] and rises[0][0] > 300.0


def test_a_push_is_found_with_its_link_wrench_and_times_and_in_nothing_none() -> None:
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0)])
    push = effect("external_force", links=["forearm_link"], wrench=[20.0, -10.0, 15.0, 0.0, 0.0, 0.0])
    records = noisy(ARM, true, 10.0)
    pushed = noisy(ARM, true.with_effects([*true.effects, push]), 10.0)
    (record,), (other,) = records.records, pushed.records
    during = ((record.time > 4.0) & (record.time < 6.0))[:, None]
    records = replace(records, records=(replace(record, torque=np.where(during, other.torque, record.torque)),))
    whole, start = settled(begun(records, equations(records)))
    found = pushes(whole, start, terms_of(whole.sums, ARM))
    links = [ARM.tree.link[k] for k in range(6)]
    assert found and found[0].links == ("forearm_link",) and links.index("forearm_link") == 2
    assert found[0].onset is not None and found[0].end is not None
    assert found[0].onset[1] == pytest.approx(4.0, abs=0.1) and found[0].end[1] == pytest.approx(6.0, abs=0.1)
    beside = unusual(whole, start, ARM)
    (push_found,) = [c for c in beside.sums.further if c.name == "external_force"]
    wrench = solve(beside)[beside.place(beside.sums.further.index(push_found))]
    np.testing.assert_allclose(wrench[:3], [20.0, -10.0, 15.0], atol=3.0)
    calm = problem()
    assert not pushes(calm, solve(calm), terms_of(calm.sums, ARM))


@pytest.mark.parametrize(
    ("link", "point", "force"),
    [
        ("forearm_link", [-0.28, -0.01, -0.04], [26.6, -13.0, 6.8]),
        ("wrist_2_link", [0.13, 0.09, -0.15], [-17.0, -1.6, -9.1]),
        ("wrist_3_link", [-0.07, -0.14, -0.15], [-12.2, 8.3, 29.8]),
    ],
)
def test_a_push_at_another_point_of_a_link_is_found_there(link: str, point: list[float], force: list[float]) -> None:
    """It passed for one at the origin of a link beside it."""
    values = {"wrench": [*force, 0.0, 0.0, 0.0], "point": point}
    start = problem(make(EffectSpec("external_force", links=[link], parameters=values, onset=3.0, end=6.0)))
    (push,) = pushes(start, solve(start), terms_of(start.sums, ARM))
    assert push.links == (link,)
    beside = with_candidate(start, push, 5)
    z = solve(beside)
    told = push.parameters(z[beside.place(0)], covariance(beside, z)[beside.place(0), beside.place(0)])
    assert np.all(np.abs(told["point"][0] - point) < np.maximum(3.0 * told["point"][1], 0.01))
    assert np.all(np.abs(told["wrench"][0][:3] - force) < 3.0 * told["wrench"][1][:3])


@pytest.mark.long
def test_a_burst_that_is_over_at_once_is_no_push(monkeypatch: pytest.MonkeyPatch) -> None:
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0)])
    records = noisy(ARM, true, 10.0)
    (record,) = records.records
    burst = np.exp(-(((record.time - 5.0) / 0.06) ** 2))[:, None] * np.array([3.0, -12.0, 8.0, 2.0, -2.0, 1.0])
    records = replace(records, records=(replace(record, torque=record.torque + burst),))
    whole, start = settled(begun(records, equations(records)))
    terms = terms_of(whole.sums, ARM)
    assert not pushes(whole, start, terms)
    monkeypatch.setattr("twin_diagram.gap.whole_robot.pushes.TUNING", replace(TUNING, shortest=0.0))
    (brief,) = pushes(whole, start, terms)
    assert brief.onset is not None and brief.end is not None and brief.end[1] - brief.onset[1] < 0.4


def test_what_friction_does_at_a_crawl_is_no_push(monkeypatch: pytest.MonkeyPatch) -> None:
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0)])
    records = noisy(ARM, true, 10.0)
    (record,) = records.records
    v = record.v[:, 1]
    rough = np.zeros_like(record.torque)
    rough[:, 1] = 8.0 * np.sign(v) * np.exp(-((v / 0.08) ** 2))
    records = replace(records, records=(replace(record, torque=record.torque + rough),))
    whole, start = settled(begun(records, equations(records)))
    terms = terms_of(whole.sums, ARM)
    monkeypatch.setattr("twin_diagram.gap.whole_robot.pushes.TUNING", replace(TUNING, shortest=0.0))
    assert not pushes(whole, start, terms)
    monkeypatch.setattr("twin_diagram.gap.whole_robot.pushes.beside_rough_friction", lambda *_: np.inf)
    assert pushes(whole, start, terms)


def test_a_push_whose_wrench_is_told_is_taken_for_one_that_would_have_no_name() -> None:
    def push(score: float, *links: str, told: bool) -> Tried:
        made = Candidate("external_force", (), links, (0,), *[np.zeros(3)] * 4, lambda c, covariance: {})
        return Tried(made, score, 2, np.zeros(2), np.ones(2), np.ones(2), told)

    vague, told = push(205.0, "upper_arm", told=False), push(200.0, "forearm", told=True)
    assert _innermost([vague, told]) is told
    assert _innermost([vague, push(150.0, "forearm", told=True)]) is vague
    assert _innermost([push(204.0, "upper_arm", told=True), push(205.0, "forearm", told=True)]).candidate.links == (
        "upper_arm",
    )


def test_what_links_that_are_off_or_drifting_friction_do_is_no_push(monkeypatch: pytest.MonkeyPatch) -> None:
    """While links stay as described, a load that they carry passes for a push over half of the log."""
    more = effect("payload", links=["tool0"], mass=2.0, com=[0.0, 0.0, 0.05])
    start = problem(more)
    z, terms = solve(start), terms_of(start.sums, ARM)
    left_out, last = LeftOut.of(start, z), ARM.bodies.body_of(ARM.last_link)[0]
    (force,) = [c for c in external_forces(terms) if c.links == ("wrist_3_link",) and c.size == 3]
    span = (0, 2.0), (0, 7.0)
    push = force.during(active(terms, *span), *span)
    assert rise_beside_the_usual(start, z, push) < 5.0
    assert weighed(start, z, left_out, push, last) is None
    monkeypatch.setattr("twin_diagram.gap.whole_robot.unusual.rise_beside_the_usual", lambda *_: np.inf)
    assert weighed(start, z, left_out, push, last) is not None


def test_a_push_costs_what_the_motion_tells_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a wrench on the first link one number turns a joint; priced as six, it had no name."""
    start = problem(make(EffectSpec("external_force", [], ["shoulder_link"], {"wrench": [0.0] * 5 + [0.05]}, 3.0, 6.0)))
    z, terms = solve(start), terms_of(start.sums, ARM)
    left_out, last = LeftOut.of(start, z), ARM.bodies.body_of(ARM.last_link)[0]
    (wrench,) = [c for c in external_forces(terms) if c.links == ("shoulder_link",) and c.size == 6]
    span = (0, 3.0), (0, 6.0)
    push = replace(wrench.during(active(terms, *span), *span), cost=2.0 * float(np.log(EVENTS.blocks)))
    assert counted(push) == 1 and counted(wrench) == 6
    assert weighed(start, z, left_out, push, last) is not None
    monkeypatch.setattr("twin_diagram.gap.whole_robot.unusual.counted", lambda candidate: candidate.size)
    assert weighed(start, z, left_out, push, last) is None


def test_a_push_stands_beside_all_that_is_usual() -> None:
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0)])
    force = effect("external_force", links=["forearm_link"], wrench=[20.0, -10.0, 15.0, 0.0, 0.0, 0.0])
    records, pushed = noisy(ARM, true, 10.0), noisy(ARM, true.with_effects([*true.effects, force]), 10.0)
    (record,), (other,) = records.records, pushed.records
    during = ((record.time > 4.0) & (record.time < 6.0))[:, None]
    drift = 0.3 * np.linspace(-1.0, 1.0, len(record.time))[:, None] * np.sign(record.v)
    torque = np.where(during, other.torque, record.torque) + drift
    records = replace(records, records=(replace(record, torque=torque),))
    whole, start = settled(begun(records, equations(records)))
    terms = terms_of(whole.sums, ARM)
    (push,) = pushes(whole, start, terms)
    assert rise_beside_the_usual(whole, start, push) > 100.0


def test_an_offset_of_an_encoder_stands_beside_all_that_is_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    start = problem(effect("encoder_offset", joints=["elbow_joint"], offset=0.1))
    z, last = solve(start), ARM.bodies.body_of(ARM.last_link)[0]
    (offset,) = [c for c in offered(terms_of(start.sums, ARM), ("encoder_offset",)) if c.joints == (2,)]
    left_out = LeftOut.of(start, z)
    assert weighed(start, z, left_out, offset, last) is not None
    monkeypatch.setattr("twin_diagram.gap.whole_robot.unusual.rise_beside_the_usual", lambda *_: 29.0)
    assert weighed(start, z, left_out, offset, last) is None
