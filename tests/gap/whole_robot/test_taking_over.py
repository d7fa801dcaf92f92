"""When the robot as a whole is the answer, and what is answered where no search can be made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.gap.made import ARM, ELBOW, effect, record, swing
from tests.gap.whole_robot.test_explain import lacking, noisy
from twin_diagram.gap.findings import Finding, Verdict
from twin_diagram.gap.report.summary import summary
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import taking_over
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.logs import Log
from twin_diagram.model.model import Model

QUIET = np.full(6, 1e-6)
"""A noise that no log has [N·m]."""


def log_of(model: Model, seed: int = 99) -> Log:
    time, q, v, a = swing(6.0, seed)
    return Log(time, ARM.joints, q, torque=model.inverse_dynamics(q, v, a, time=time), source="made")


def test_many_things_at_once_outdo_none_but_not_what_explains_as_much() -> None:
    true, whole = lacking()
    logs = [log_of(true)]
    assert taking_over.outdoes(whole, logs, ARM, named=False, floor=QUIET)
    assert taking_over.outdoes(whole, logs, ARM, named=True, floor=QUIET)
    assert not taking_over.outdoes(whole, logs, true, named=True, floor=QUIET)
    assert not taking_over.outdoes(whole, logs, whole.model, named=True, floor=QUIET)


def test_what_is_not_borne_out_by_unseen_motion_does_not() -> None:
    true, whole = lacking()
    worse = replace(whole, left=30.0 * whole.before)
    assert not taking_over.outdoes(worse, [log_of(true)], ARM, named=False, floor=QUIET)


def test_few_places_are_no_whole_robot() -> None:
    true, whole = lacking()
    few = tuple(replace(f, joints=f.joints[:1], links=f.links[:1]) for f in whole.findings)
    coherent = replace(whole.problem, share=np.full(6, 0.06))
    pieces = replace(whole, findings=few, problem=coherent)
    assert not taking_over.outdoes(pieces, [log_of(true)], ARM, named=False, floor=QUIET)


def test_few_things_that_leave_nothing_but_noise_outdo_none() -> None:
    """A delay of all joints has no place at all; what it leaves is at the torques' noise, or hangs together no more."""
    true, whole = lacking()
    delay = replace(whole.findings[0], name="time_delay", joints=(), links=())
    noisy = replace(whole, findings=(delay,), problem=replace(whole.problem, share=np.full(6, 0.06)))
    assert not taking_over.outdoes(noisy, [log_of(true)], ARM, named=False, floor=QUIET)
    assert taking_over.outdoes(noisy, [log_of(true)], ARM, named=False, floor=whole.left)
    spread = replace(noisy, problem=replace(whole.problem, share=np.full(6, 0.35)))
    assert taking_over.outdoes(spread, [log_of(true)], ARM, named=False, floor=QUIET)
    one = replace(noisy, problem=replace(whole.problem, share=np.array([0.35, 0.06, 0.35, 0.35, 0.35, 0.35])))
    assert not taking_over.outdoes(one, [log_of(true)], ARM, named=False, floor=QUIET)


def test_what_a_search_explains_is_left_alone() -> None:
    _, whole = lacking()
    records = noisy(ARM, ARM, 4.0)
    said = Finding("payload", (), ("tool0",), {}, 0.99)
    for verdict in (
        Verdict("none", False, (), (), (), np.ones(6)),
        Verdict("named", False, (said,), (), (), np.ones(6)),
    ):
        assert taking_over.taken_over(records, [], verdict, ARM, whole, QUIET) == (verdict, ARM, None)


def test_noise_is_that_of_the_torques_where_nothing_was_searched() -> None:
    time, q, v, a = swing(8.0)
    noise = 0.5 * np.random.default_rng(1).normal(size=q.shape)
    verdict = taking_over.unsearched(Records(ARM, (record(ARM, time, q, v, a, extra=noise),)))
    assert verdict.verdict == "unknown" and not verdict.findings
    np.testing.assert_allclose(verdict.noise_floor, 0.5 * np.sqrt(0.1), rtol=0.15)


def test_that_noise_does_not_go_by_which_log_comes_first() -> None:
    """At four times the rate, the same noise of each sample has a quarter of its power below 10 Hz."""
    fast = record(ARM, *swing(6.0), extra=0.5 * np.random.default_rng(1).normal(size=(1200, 6)))
    slow = replace(fast, rate=50.0, time=4.0 * fast.time)
    floors = [taking_over.unsearched(Records(ARM, two)).noise_floor for two in ((fast, slow), (slow, fast))]
    np.testing.assert_allclose(floors[0], 0.5 * np.sqrt(0.4), rtol=0.15)
    np.testing.assert_allclose(*floors)


def test_a_robot_that_lacks_everything_need_not_be_searched() -> None:
    _, whole = lacking()
    noise = 0.5 * whole.left
    assert taking_over.suffices(whole, noise)
    assert taking_over.suffices(whole, 2.0 * whole.left)  # many names, and nothing is left
    aloof = replace(whole, left=np.where(np.arange(6) == 2, 0.5 * whole.before, whole.left))
    assert not taking_over.suffices(aloof, noise)
    few = replace(whole, findings=tuple(replace(f, joints=f.joints[:1], links=f.links[:1]) for f in whole.findings))
    assert not taking_over.suffices(few, noise)


def test_what_friction_holds_on_a_joint_that_hardly_slides_need_not_be_searched_for() -> None:
    """Minutes went into a search for names of what a wrist at rest was held by, beside six joints that were told."""
    _, whole = lacking()
    noise, wrist = 0.5 * whole.left, np.arange(6) == 2
    sums = whole.problem.sums
    slow = [
        replace(r, v=np.where(wrist & (np.arange(len(r.v)) % 5 > 0)[:, None], 0.0, r.v)) for r in sums.records.records
    ]
    resting = replace(sums, records=replace(sums.records, records=tuple(slow)), weights=np.ones_like(sums.weights))
    aloof = replace(whole, left=np.where(wrist, 0.5 * whole.before, whole.left))
    assert taking_over.suffices(replace(aloof, problem=replace(whole.problem, sums=resting)), noise)
    assert not taking_over.suffices(aloof, noise)


def test_of_an_arm_that_was_known_what_tells_much_is_enough() -> None:
    true, whole = lacking()
    logs, expected = [log_of(true)], np.ones(6)
    assert taking_over.tells_of_change(whole, ARM, logs, expected)
    assert not taking_over.tells_of_change(whole, whole.model, logs, expected)
    assert not taking_over.tells_of_change(None, ARM, logs, expected)


def test_one_joint_that_has_changed_is_enough() -> None:
    true, whole = lacking()
    before = whole.model.with_effects([*whole.model.effects, effect("torque_bias", [ARM.joints[ELBOW]], torque=0.1)])
    clean, elbow = log_of(true), np.arange(6) == ELBOW
    noise = 0.1 * np.random.default_rng(1).normal(size=clean.position.shape)
    logs = [replace(clean, torque=clean.motor_torque + noise)]
    assert not taking_over.tells_of_change(whole, before, logs, np.ones(6))  # the others dilute it
    assert taking_over.tells_of_change(whole, before, logs, 1.0 + 2.0 * elbow)
    assert not taking_over.tells_of_change(whole, before, logs, 3.0 - 2.0 * elbow)


def test_what_was_expected_is_no_news() -> None:
    true, whole = lacking()
    logs, as_expected = [log_of(true)], np.ones(6)

    def no_news(beyond: float, found: WholeRobot | None, expected: float = 1.0) -> bool:
        return taking_over.no_news(ARM, logs, found, beyond * as_expected, expected * as_expected)

    assert no_news(1.05, whole)  # whatever was found
    assert not no_news(1.2, whole)
    assert no_news(1.2, None) and not no_news(2.0, None)
    assert no_news(1.2, whole, expected=1e3)  # what refitting gains was to be expected


def test_the_verdict_of_the_whole_says_where_and_whether_something_is_left() -> None:
    true, whole = lacking()
    records = noisy(ARM, true)
    bare = taking_over.unsearched(records)
    verdict = taking_over.as_named(records, bare, whole)
    assert verdict.verdict == "named" and verdict.findings == whole.findings
    assert verdict.where and sum(place.share for place in verdict.where) <= 1.0 + 1e-9
    rough = replace(whole, fitted=10.0 * bare.noise_floor)
    assert taking_over.as_named(records, bare, rough).remainder
    as_before = taking_over.as_named(records, bare, rough, 10.0 * bare.noise_floor)
    assert not as_before.remainder and "little left" not in summary(as_before)


def test_what_friction_holds_at_rest_is_told_apart_from_noise() -> None:
    """The residual that is reported counts rests, too; the fit leaves them out."""
    true, whole = lacking()
    clean = log_of(true)
    logs = [replace(clean, torque=clean.motor_torque + 2.0 * (np.arange(6) == ELBOW))]
    sums, floor = whole.problem.sums, np.ones(6)
    held = (np.arange(6) == ELBOW) & (np.arange(len(sums.columns)) < 100)[:, None]
    columns = sums.columns.copy()
    columns[held, -1] += 50.0
    rests = sums.weighted(sums.weights * ~held).with_columns(columns, [*range(columns.shape[2] - 1), -1])
    told = replace(whole, problem=replace(whole.problem, sums=rests), fitted=0.5 * floor)
    (said,) = taking_over.told_of_rests(told, logs, floor)
    assert said.startswith(f"{ARM.joints[ELBOW]}: ") and "at rest" in said
    assert not taking_over.told_of_rests(replace(whole, fitted=0.5 * floor), logs, floor)
    assert not taking_over.told_of_rests(replace(told, fitted=2.0 * floor), logs, floor)  # in motion, too
    assert not taking_over.told_of_rests(told, [clean], floor)  # what is reported does not show it


def test_a_residual_at_the_noise_floor_is_no_gap() -> None:
    log = log_of(ARM)
    noise = np.random.default_rng(1).normal(size=log.position.shape)
    noisy_log = replace(log, torque=log.motor_torque + noise)
    left = np.exp(taking_over.size_of(ARM, [noisy_log]))
    assert taking_over.is_noise(ARM, [noisy_log], left / 1.2) and not taking_over.is_noise(ARM, [noisy_log], left / 1.3)
