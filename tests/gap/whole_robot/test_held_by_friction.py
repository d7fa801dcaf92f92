"""A joint that mostly rests, held by dry friction: what holds it is neither a push nor late."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, PAN
from tests.gap.whole_robot.test_explain import noisy
from tests.gap_bench import arm, run
from twin_diagram.gap.findings import Finding, Verdict
from twin_diagram.gap.residuals.stiction import one_way, slides, unmoved
from twin_diagram.gap.whole_robot import late_torque
from twin_diagram.gap.whole_robot.concluding import own_terms
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.few_or_whole import told_of_one_way
from twin_diagram.gap.whole_robot.held_by_friction import dry_levels, without_held
from twin_diagram.gap.whole_robot.late_torque import one_late
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.gap.whole_robot.pushes import TUNING, pushes
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.gap.whole_robot.unusual import terms_of
from twin_diagram.gap.workflow import run_gap
from twin_diagram.logs import write_log
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

LEVEL = 6.0


@cache
def held() -> tuple[RobotProblem, Array]:
    """Of an arm whose first joint moves a little there and back; what holds it turns round between."""
    records = noisy(ARM, ARM, 10.0)
    (record,) = records.records
    time, q, v, a = record.time, record.q.copy(), record.v.copy(), record.a.copy()
    there, back = (np.pi * np.clip(time - begin, 0.0, 1.0) for begin in (1.0, 7.0))
    q[:, PAN] = q[0, PAN] + 0.03 * (np.cos(back) - np.cos(there))
    v[:, PAN] = 0.03 * np.pi * (np.sin(there) - np.sin(back))
    a[:, PAN] = np.gradient(v[:, PAN], time)
    given = ARM.inverse_dynamics(q, v, a)
    torque = given + record.torque - record.given
    torque[:, PAN] += LEVEL * (1.0 - np.clip((time - 5.5) / 0.25, 0.0, 2.0))
    rests = replace(record, q=q, v=v, a=a, torque=torque, given=given, passed=given)
    return settled(begun(records, equations(replace(records, records=(rests,)))))


def test_what_dry_friction_holds_is_no_push(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, start = held()
    terms = terms_of(whole.sums, ARM)
    assert not pushes(whole, start, terms)
    monkeypatch.setattr("twin_diagram.gap.whole_robot.pushes.TUNING", replace(TUNING, held=0.0))
    monkeypatch.setattr("twin_diagram.gap.whole_robot.pushes.mostly_resting", lambda *_: np.zeros(6, dtype=bool))
    assert pushes(whole, start, terms)


def test_what_holds_a_joint_that_mostly_rests_is_no_push_whatever_its_friction_is_told_as(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of few samples that slide friction may be told as next to none."""
    whole, start = held()
    monkeypatch.setattr("twin_diagram.gap.whole_robot.pushes.TUNING", replace(TUNING, held=0.0))
    assert not pushes(whole, start, terms_of(whole.sums, ARM))


def test_without_what_is_held_friction_is_what_it_is() -> None:
    whole, start = held()
    slid, z = without_held(whole, start, terms_of(whole.sums, ARM), [PAN])
    assert np.mean(slid.sums.weights[:, PAN]) < 0.3 and np.all(slid.sums.counts <= whole.sums.counts)
    np.testing.assert_array_equal(slid.sums.weights[:, 1:], whole.sums.weights[:, 1:])
    assert dry_levels(slid, z)[PAN] == pytest.approx(LEVEL, rel=0.02)
    assert slid.variance[PAN] < 0.01 * whole.variance[PAN]


def test_what_is_held_does_not_count_for_a_joint_that_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """What holds a joint follows its last motion, and so a later torque suits it."""
    judged = []

    def none(problem: RobotProblem, z: Array) -> Array:
        judged.append(float(np.mean(problem.sums.weights[:, PAN])))
        return np.zeros((len(late_torque.COARSE), problem.n))

    monkeypatch.setattr(late_torque, "gains_alone", none)
    assert one_late(*held()) is None
    assert judged[0] < 0.3


def test_a_joint_that_never_slides_tells_of_no_damping() -> None:
    whole, _ = held()
    (record,) = whole.sums.records.records
    crawl = record.v.copy()
    crawl[:, PAN] *= 0.15  # at most 14 mrad/s
    records = replace(whole.sums.records, records=(replace(record, v=crawl),))
    assert slides(whole.sums.records).all()
    assert slides(records).tolist() == [False, *[True] * 5]
    assert own_terms(records)[PAN].tolist() == [False, True, True, True]
    assert own_terms(records)[1:].all()


def test_a_joint_is_unmoved_that_no_run_moves() -> None:
    whole, _ = held()
    (record,) = whole.sums.records.records
    still = replace(record, q=record.q.copy(), v=record.v.copy())
    still.q[:, PAN], still.v[:, PAN] = record.q[0, PAN], 0.0
    assert unmoved(replace(whole.sums.records, records=(still,))).tolist() == [True, *[False] * 5]
    assert not unmoved(replace(whole.sums.records, records=(still, record))).any()
    slow = replace(record, v=0.01 * record.v)  # as far, in a hundred times the time
    assert not unmoved(replace(whole.sums.records, records=(slow,))).any()


def test_a_joint_that_slides_one_way_only_has_friction_and_offset_in_one() -> None:
    """A run in which it turns the other way parts them; what it is held back by is no such turn."""
    whole, _ = held()
    (record,) = whole.sums.records.records
    forward = replace(record, v=record.v.copy())
    forward.v[:, ELBOW] = np.abs(record.v[:, ELBOW])
    forward.v[:20, ELBOW] = -0.1  # for a tenth of a second
    records = replace(whole.sums.records, records=(forward,))
    assert not one_way(whole.sums.records).any()
    assert one_way(records).tolist() == [joint == ELBOW for joint in range(6)]
    assert not one_way(replace(records, records=(forward, record))).any()

    def told(name: str, joint: int) -> list[str]:
        finding = Finding(name, (records.model.joints[joint],), (), {}, 0.9)
        return told_of_one_way(Verdict("named", True, (finding,), (), (), np.ones(6)), records)

    (said,) = told("coulomb_friction", ELBOW)
    assert said.startswith("elbow_joint: turns one way only")
    assert not told("coulomb_friction", PAN) and not told("viscous_friction", ELBOW)


@pytest.mark.long
def test_what_holds_a_joint_that_no_run_moves_has_no_name(tmp_path: Path) -> None:
    """Motors give 2 N·m more than the elbow weighs: friction may hold it, or a sensor be off."""
    model, runs = Model.load(arm(tmp_path)), []
    noise = np.random.default_rng(0)
    for seed in (1, 2):
        log = run(model, [], seed)
        q = log.position.copy()
        q[:, 1] = -0.6
        v, a = (np.gradient(x, log.time, axis=0) for x in (q, np.gradient(q, log.time, axis=0)))
        torque = model.inverse_dynamics(q, v, a) + 0.1 * noise.normal(size=q.shape)
        torque += 3.0 * np.sign(v) * [1.0, 0.0] + [0.0, 2.0]
        runs.append(tmp_path / f"held_{seed}.csv")
        write_log(replace(log, position=q, torque=torque), runs[-1])
    found = run_gap(arm(tmp_path), runs[0], runs[1])
    assert [(one.name, one.joints) for one in found.verdict.findings] == [("coulomb_friction", ("shoulder",))]
    assert found.verdict.remainder and any("elbow: never moves" in note for note in found.notes)
    assert [place.joint for place in found.verdict.where] == ["shoulder", "elbow"]
