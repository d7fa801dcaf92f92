"""Names stand where their size is known to a third."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.whole_robot.concluding import lost_names, no_surer, told_enough
from twin_diagram.gap.whole_robot.well_told import well_told


def friction(**levels: tuple[float, float]) -> Finding:
    values = {joint: Estimate(value, std, "N·m") for joint, (value, std) in levels.items()}
    return Finding("coulomb_friction", tuple(levels), (), {"torque": values}, 0.9)


def test_joints_that_are_known_too_little_are_left_out() -> None:
    finding = friction(a=(3.0, 0.9), b=(3.0, 1.1), c=(-3.0, 0.9))
    (kept,) = well_told([finding])
    assert kept.joints == ("a", "c") and set(kept.parameters["torque"]) == {"a", "c"}  # type: ignore[arg-type]
    assert well_told([friction(b=(3.0, 1.1))]) == ()
    fine = friction(a=(3.0, 0.9))
    assert well_told([fine]) == (fine,)


def test_a_gain_is_held_against_one_and_a_payload_against_none() -> None:
    def gain(value: float, std: float) -> Finding:
        return Finding("torque_constant", ("a",), (), {"gain": {"a": Estimate(value, std, "1")}}, 0.9)

    assert well_told([gain(0.62, 5.0)]) == () and well_told([gain(0.9, 0.05)]) == ()
    assert len(well_told([gain(0.62, 0.1)])) == 1

    def payload(std: float) -> Finding:
        centre = Estimate([0.0, 0.0, 0.1], [0.1, 0.1, 0.1], "m")
        return Finding("payload", (), ("tool",), {"mass": Estimate(3.0, std, "kg"), "com": centre}, 0.9)

    assert len(well_told([payload(0.9)])) == 1 and well_told([payload(1.1)]) == ()


def test_a_push_is_held_against_none_along_its_own_direction() -> None:
    def push(*std: float) -> Finding:
        wrench = Estimate([2.0, 0.1, -4.0, 0.0, 0.0, 0.0], [*std, 0.0, 0.0, 0.0], "N, N·m")
        return Finding("external_force", (), ("tool",), {"wrench": wrench}, 1.0)

    assert len(well_told([push(1.0, 1.0, 1.0)])) == 1
    assert well_told([push(1.8, 1.6, 1.8)]) == () and lost_names([push(1.8, 1.6, 1.8)]) == {("external_force", "")}


def test_a_tilt_is_told_by_either_angle() -> None:
    def tilt(roll: float, pitch: float) -> Finding:
        told = {"roll": Estimate(roll, 0.01, "rad"), "pitch": Estimate(pitch, 0.01, "rad")}
        return Finding("gravity_tilt", (), (), dict(told), 1.0)

    assert well_told([tilt(0.001, 0.05)]) and well_told([tilt(0.05, 0.001)])
    assert well_told([tilt(-0.02, 0.001)]) == ()


def test_what_has_no_size_stands() -> None:
    curve = {"a": Estimate([0.0, 1.0, 5.0, 6.0], [0.0, 0.0, 9.0, 9.0], "rad, N·m")}
    finding = Finding("joint_spring", ("a",), (), {"curve": curve}, 0.9)
    assert well_told([finding]) == (finding,)


def test_names_that_honest_errors_leave_unsure_are_lost_and_links_are_not() -> None:
    link = Finding("inertial_parameters", (), ("tool",), {"mass": Estimate(0.1, 5.0, "kg")}, 0.9)
    tilt = Finding("gravity_tilt", (), (), {"roll": Estimate(0.1, 0.01, "rad")}, 0.9)
    payload = Finding("payload", (), ("tool",), {"mass": Estimate(3.0, 1.2, "kg")}, 0.9)
    found = [friction(a=(3.0, 1.05), b=(3.0, 1.2)), link, tilt, payload]
    assert lost_names(found) == {("coulomb_friction", "b"), ("payload", "")}


def test_a_limit_a_play_and_a_stiffness_are_sizes() -> None:
    for name, key, unit in (
        ("torque_saturation", "limit", "N·m"),
        ("backlash", "gap", "rad"),
        ("joint_elasticity", "stiffness", "N·m/rad"),
    ):

        def told(value: float, std: float, name: str = name, key: str = key, unit: str = unit) -> Finding:
            return Finding(name, ("a",), (), {key: {"a": Estimate(value, std, unit)}}, 0.9)

        assert well_told([told(8.95, 91.3)]) == (), name
        assert len(well_told([told(8.95, 0.2)])) == 1, name


def test_what_is_lost_may_stay_where_it_is_nearer_than_nothing_and_is_no_surer_than_its_error() -> None:
    def spring(share: float) -> Finding:
        stiffness = {"a": Estimate(2.0, 2.0 * share, "N·m/rad"), "b": Estimate(2.0, 0.2, "N·m/rad")}
        return Finding("joint_spring", ("a", "b"), (), {"stiffness": stiffness}, 0.99)

    lost = {("joint_spring", "a"), ("coulomb_friction", "c")}
    rubs = friction(c=(3.0, 1.3))
    assert told_enough([spring(0.4), rubs], lost) == {("joint_spring", "a")}, "friction has rules of its own"
    assert told_enough([spring(0.9), rubs], lost) == set()
    gain = Finding("torque_constant", ("a",), (), {"gain": {"a": Estimate(1.02, 0.01, "1")}}, 1.0)
    assert told_enough([gain], {("torque_constant", "a")}) == set(), "as gains are"
    assert no_surer([spring(0.4), rubs], set()) == (spring(0.4), rubs)
    told, same = no_surer([spring(0.4), rubs], {("joint_spring", "a")})
    assert same == rubs and told.parameters == spring(0.4).parameters
    assert told.confidence == pytest.approx(1.0 / (1.0 + np.exp(-0.5 * (2.5**2 - 1.0)) * 2.5))
    assert no_surer([spring(0.2)], {("joint_spring", "a")})[0].confidence == 0.99
