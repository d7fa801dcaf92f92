"""One line for a robot that lacks many things at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin_diagram.gap.findings import Estimate, Finding, Verdict
from twin_diagram.gap.report.words import headline

JOINTS = ("a", "b", "c", "d", "e")


def on(name: str, key: str, joints: tuple[str, ...] = JOINTS, confidence: float = 0.9) -> Finding:
    return Finding(name, joints, (), {key: {j: Estimate(1.0, 0.1, "N·m") for j in joints}}, confidence)


def verdict(*findings: Finding, remainder: bool = False) -> Verdict:
    return Verdict("named", remainder, findings, (), (), np.ones(5))


PAYLOAD = Finding("payload", (), ("tool",), {"mass": Estimate(2.7, 0.2, "kg")}, 0.9)
FRICTION, ROTORS = on("viscous_friction", "damping"), on("reflected_inertia", "inertia")


def test_what_is_unusual_comes_first_then_what_all_arms_lack_then_what_is_left() -> None:
    said = headline(verdict(FRICTION, ROTORS, PAYLOAD))
    assert said == "payload 2.70 ± 0.20 kg; friction and rotors on all joints; little left"


def test_nothing_is_said_to_be_little_where_something_is_left() -> None:
    links = Finding("inertial_parameters", (), ("l1", "l2"), {"mass": {}}, 0.9)
    said = headline(verdict(FRICTION, on("coulomb_friction", "torque", JOINTS[:2]), ROTORS, links, remainder=True))
    assert said == "friction and rotors on all joints; inertia on 2 links; structure left that has no name"


def test_nothing_is_said_to_be_little_where_the_held_out_run_is_not_explained() -> None:
    said = headline(replace(verdict(FRICTION, ROTORS, PAYLOAD), unexplained=("b", "c")))
    assert said.endswith("friction and rotors on all joints; the held-out run is not explained on 2 joints")


def test_a_guess_has_no_place_in_it() -> None:
    spring = on("joint_spring", "stiffness", ("b",), confidence=0.2)
    said = headline(verdict(FRICTION, on("torque_bias", "torque", ("c",)), spring))
    assert said == ("friction on all joints; offsets on c; something more that can be guessed at only; little left")


def test_a_tilt_is_told_about_both_axes() -> None:
    angles = {"roll": Estimate(0.001, 0.002, "rad"), "pitch": Estimate(0.11, 0.01, "rad")}
    said = headline(verdict(FRICTION, ROTORS, Finding("gravity_tilt", (), (), angles, 0.9)))
    assert said.startswith("tilted base (roll 0.0010 ± 0.0020 rad, pitch 0.110 ± 0.010 rad); friction and rotors")


def test_few_names_are_a_sentence() -> None:
    assert headline(verdict(PAYLOAD, on("coulomb_friction", "torque", ("a",)))).startswith("The model lacks a payload")
