"""Torque that acts late, told by shifted logs: of all joints, of one alone, and of none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tests.gap.made import ARM, ELBOW, everywhere, record, swing
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.few_or_whole import told_of_lag, told_of_one_late
from twin_diagram.gap.whole_robot.lagging_torque import in_time
from twin_diagram.gap.whole_robot.late_torque import behind, later, likeliest_shift, one_late, shifted
from twin_diagram.gap.whole_robot.mended_logs import mended
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.gap.whole_robot.unusual import carried, offered, terms_of, with_candidate
from twin_diagram.logs import Log, fingerprint
from twin_diagram.model.model import Model

LATE = 0.012


@cache
def problem(*joints: int, late: float = LATE) -> tuple[RobotProblem, np.ndarray]:
    """Of an arm with friction whose torque acts late on some joints [s]; noise is there before that."""
    records = noisy(ARM, ARM.with_effects([everywhere("viscous_friction", damping=2.0)]), 6.0)
    (made,) = records.records
    torque = made.torque.copy()
    for j in joints:
        torque[:, j] = np.interp(made.time + late, made.time, torque[:, j])
    return settled(begun(records, equations(replace(records, records=(replace(made, torque=torque),)))))


def test_a_delay_of_all_is_told_by_shifted_logs() -> None:
    start, z = problem(*range(6))
    assert likeliest_shift(start, z) == pytest.approx(LATE, abs=1e-3)
    (first,) = offered(terms_of(start.sums, ARM), ("time_delay",))
    late = later(start, z, first)
    assert late is not None
    beside = with_candidate(start, late, 5)
    assert solve(beside, None, carried(start, z, beside))[beside.place(0)] == pytest.approx(LATE, abs=1e-3)


def test_where_nothing_is_late_there_is_no_delay() -> None:
    start, z = problem()
    assert likeliest_shift(start, z) < 1e-3
    (first,) = offered(terms_of(start.sums, ARM), ("time_delay",))
    assert later(start, z, first) is None


def test_one_joint_that_is_late_is_no_delay_of_all() -> None:
    start, z = problem(ELBOW)
    (first,) = offered(terms_of(start.sums, ARM), ("time_delay",))
    assert later(start, z, first) is None
    late = one_late(start, z)
    assert late is not None and late[0] == ELBOW
    assert late[1] == pytest.approx(LATE, abs=2e-3)


ROD = """<robot name="rod"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
  <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" velocity="3" effort="80"/></joint></robot>"""


def test_an_only_joint_that_is_late_is_a_delay_and_no_single_one(tmp_path: Path) -> None:
    (tmp_path / "rod.urdf").write_text(ROD)
    arm = Model.load(tmp_path / "rod.urdf")
    time, *motion = swing(8.0)
    q, v, a = (signal[:, :1] for signal in motion)
    made = record(arm, time, q, v, a)
    noise = 0.02 * np.random.default_rng(1).normal(size=q.shape)
    torque = np.interp(time + LATE, time, (made.given + 0.5 * v)[:, 0])[:, None] + noise
    start, z = settled(begun(records := Records(arm, (replace(made, torque=torque),)), equations(records)))
    (first,) = offered(terms_of(start.sums, arm), ("time_delay",))
    assert later(start, z, first) is not None
    assert one_late(start, z) is None


def test_the_joint_that_is_late_is_told_in_words() -> None:
    nothing = np.zeros(6)
    (said,) = told_of_one_late(WholeRobot(ARM, (), nothing, nothing, nothing, *problem(ELBOW)))
    assert said.startswith("the logged torque of elbow_joint alone seems to act some 12 ms late")


@pytest.mark.parametrize("joints", [(), tuple(range(6))])
def test_where_none_is_late_or_all_are_no_single_joint_is_told(joints: tuple[int, ...]) -> None:
    assert one_late(*problem(*joints)) is None


def test_torques_that_lag_the_motion_are_told_in_words() -> None:
    """A drive's filter; `gap` said that structure is left which has no name, and no more."""
    lags = problem(*range(6), late=-LATE)
    assert behind(*lags) == pytest.approx(LATE, abs=1e-3)
    nothing = np.zeros(6)
    (said,) = told_of_lag(WholeRobot(ARM, (), nothing, nothing, nothing, *lags))
    assert said.startswith("the logged torques seem to come some 12 ms after the motion")


@pytest.mark.parametrize("joints", [(), (ELBOW,), tuple(range(6))])
def test_where_torques_come_before_motion_or_with_it_none_lags(joints: tuple[int, ...]) -> None:
    assert behind(*problem(*joints)) == 0.0


def test_one_joint_that_lags_is_no_lag_of_all() -> None:
    assert behind(*problem(ELBOW, late=-LATE)) == 0.0


def test_what_some_joints_alone_show_is_no_lag_of_all() -> None:
    """On an arm with a push four of six gained 59 nats, and two lost 15."""
    assert behind(*problem(0, 1, 2, 3, late=-LATE)) == 0.0


def test_logs_whose_torques_lag_are_shifted_before_all_else() -> None:
    """The held-out one as well, by what the fitted ones say; where none lags, nothing is done."""
    (lagging,) = problem(*range(6), late=-LATE)[0].sums.records.records
    (sound,) = problem()[0].sums.records.records
    late, right = (Log(one.time, ARM.joints, one.q, torque=one.torque) for one in (lagging, sound))
    notes: list[str] = []
    records = prepare(ARM, [right])
    assert mended(in_time, ARM, [right], late, records, notes) == ([right], late, records)
    assert notes == []
    logs, held, records = mended(in_time, ARM, [late], right, prepare(ARM, [late]), notes)
    inner = slice(20, -20)
    error = (logs[0].motor_torque - right.motor_torque)[inner]
    assert np.std(error) < 0.3 * np.std((late.motor_torque - right.motor_torque)[inner])
    assert np.std(held.motor_torque - right.motor_torque) > 10.0 * np.std(error)
    assert records.records[0].mark == fingerprint(late)
    (said,) = notes
    assert said.startswith("the logged torques come some 12 ms after the motion")


def test_shifted_logs_are_those_of_earlier_torque_and_candidates_have_the_residuals_band() -> None:
    start, _ = problem()
    (record,) = start.sums.records.records
    residual = start.sums.records.reduce(lambda r: r.torque - r.given)
    np.testing.assert_allclose(start.sums.columns[:, :, -1], residual, atol=1e-9)
    before = np.maximum(record.time - LATE, record.time[0])
    earlier = record.reduce(CubicSpline(record.time, record.torque)(before))
    moved = shifted(start.sums, LATE).columns[:, :, -1]
    np.testing.assert_allclose(moved, earlier - record.reduce(record.given), atol=1e-9)
    np.testing.assert_allclose(shifted(start.sums, 0.0).whole, start.sums.whole)


def test_between_samples_torque_keeps_its_noise() -> None:
    """At 100 Hz half a sample along straight lines takes 1.5 % of it, and makes any log likelier by some ten nats."""
    time, q, v, a = swing(10.0)
    one = record(ARM, time, q, v, a, extra=1e3 * np.random.default_rng(2).normal(size=q.shape))
    sums = equations(Records(ARM, (replace(one, time=2.0 * time, rate=100.0, period=0.01),)))
    for part in (0.25, 0.5):
        np.testing.assert_allclose(shifted(sums, part * 0.01).residual_rms, sums.residual_rms, rtol=0.01)
