"""An arm that lacks everything at once: what is found of it, and that a clean one lacks nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, effect, everywhere, record, swing
from twin_diagram.gap.correction.named_effects import specs_of
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.gap.whole_robot.explain import begun, explain, settled
from twin_diagram.gap.whole_robot.physical_fit import with_noise
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.model.model import Model

DAMPING, LEVEL, BIAS, ROTOR = 3.0, 4.0, 1.5, 0.8
LINKS = ("upper_arm_link", "forearm_link", "wrist_1_link")


def noisy(given: Model, true: Model, seconds: float = 16.0, seed: int = 6) -> Records:
    """A log of a true arm with a little noise, for a given one."""
    time, q, v, a = swing(seconds, seed)
    rng = np.random.default_rng(seed)
    for frequency in (0.17, 0.73):
        w, angle = 2.0 * np.pi * frequency, rng.uniform(0.0, 6.0, 6)
        q = q + 0.4 * np.sin(w * time[:, None] + angle)
        v = v + 0.4 * w * np.cos(w * time[:, None] + angle)
        a = a - 0.4 * w**2 * np.sin(w * time[:, None] + angle)
    made = record(given, time, q, v, a)
    torque = true.inverse_dynamics(q, v, a, time=time) + 0.1 * rng.normal(size=q.shape)
    return Records(given, (replace(made, torque=torque),))


@cache
def lacking() -> tuple[Model, WholeRobot]:
    """An arm whose links are off, with friction, offsets and rotors on all joints, and what is found of it."""
    links = [
        effect("inertial_parameters", links=[link], mass=x, com=[0.01, -0.01, 0.02])
        for link, x in zip(LINKS, (1.2, -0.4, 0.3), strict=True)
    ]
    own = [
        everywhere("viscous_friction", damping=DAMPING),
        everywhere("coulomb_friction", torque=LEVEL),
        everywhere("torque_bias", torque=BIAS),
        everywhere("reflected_inertia", inertia=ROTOR),
    ]
    true = ARM.with_effects([*links, *own])
    found = explain(noisy(ARM, true))
    assert found is not None
    return true, found


def test_noise_is_what_the_fit_leaves_also_where_the_description_is_far_off() -> None:
    carried = effect("payload", links=["tool0"], mass=20.0, com=[0.1, 0.05, 0.15])
    records = noisy(ARM, ARM.with_effects([carried, everywhere("coulomb_friction", torque=LEVEL)]), 5.0)
    problem, z = settled(begun(records, equations(records)))
    np.testing.assert_allclose(with_noise(problem, z).variance, problem.variance, rtol=0.05)


def told(found: WholeRobot, name: str) -> Finding:
    return next(finding for finding in found.findings if finding.name == name)


def values(finding: Finding, key: str) -> np.ndarray:
    each = finding.parameters[key]
    assert isinstance(each, dict)
    return np.array([[float(e.value), float(e.std)] for e in each.values()])


def test_friction_offsets_and_rotors_of_all_joints_are_found() -> None:
    _, found = lacking()
    for name, key, truth in (
        ("viscous_friction", "damping", DAMPING),
        ("coulomb_friction", "torque", LEVEL),
        ("torque_bias", "torque", BIAS),
    ):
        assert told(found, name).joints == ARM.joints
        value, std = values(told(found, name), key).T
        np.testing.assert_allclose(value, truth, rtol=0.1)
        assert np.all(np.abs(value - truth) < 4.0 * std + 1e-3)
    rotors = told(found, "reflected_inertia")
    assert set(rotors.joints) >= {"elbow_joint", "wrist_2_joint"}
    assert len(told(found, "inertial_parameters").links) >= 2


def test_it_predicts_other_motion() -> None:
    true, found = lacking()
    _, q, v, a = swing(6.0, seed=99)
    off = [m.inverse_dynamics(q, v, a) - true.inverse_dynamics(q, v, a) for m in (ARM, found.model)]
    before, after = (np.sqrt(np.mean(x**2, axis=0)) for x in off)
    assert np.all(after < 0.06 * before)
    assert np.all(found.left < 0.1 * found.before)
    assert np.all(found.left >= 0.95 * found.fitted)


def test_the_model_holds_what_is_named_and_nothing_more() -> None:
    _, found = lacking()
    named = [spec for finding in found.findings for spec in specs_of(finding)]
    assert {e.name for e in found.model.effects} == {spec.name for spec in named}
    links = [spec for spec in named if spec.name == "inertial_parameters"]
    assert [spec.links for spec in links] == [[link] for link in told(found, "inertial_parameters").links]
    masses = told(found, "inertial_parameters").parameters["mass"]
    assert isinstance(masses, dict)
    assert [spec.parameters["mass"] for spec in links] == [[masses[spec.links[0]].value] for spec in links]


@pytest.mark.long
def test_a_joint_whose_torque_is_not_logged_bends_no_links() -> None:
    records = noisy(ARM, ARM, 6.0)
    (made,) = records.records
    dead = replace(made, torque=np.where(np.arange(6) == ELBOW, 0.0, made.torque))
    assert explain(replace(records, records=(dead,))) is None


@pytest.mark.long
def test_an_arm_as_described_lacks_nothing() -> None:
    assert explain(noisy(ARM, ARM, 8.0)) is None


@pytest.mark.long
def test_a_placeholder_is_said_to_be_too_much_and_no_more_than_it_is() -> None:
    given = ARM.with_effects([everywhere("coulomb_friction", torque=10.0), everywhere("viscous_friction", damping=1.0)])
    found = explain(noisy(given, ARM))
    assert found is not None
    level, _ = values(told(found, "coulomb_friction"), "torque").T
    assert told(found, "coulomb_friction").joints == ARM.joints
    np.testing.assert_allclose(level, -10.0, atol=0.3)
    assert np.all(level >= -10.0)
    assert np.all(found.left < 0.05 * found.before)


@pytest.mark.long
def test_one_link_is_said_without_its_name_in_each_value() -> None:
    true = ARM.with_effects([effect("inertial_parameters", links=["forearm_link"], mass=2.0, com=[0.0, 0.03, 0.0])])
    found = explain(noisy(ARM, true))
    assert found is not None
    assert [f.name for f in found.findings] == ["inertial_parameters"]
    assert found.findings[0].links == ("forearm_link",)
    assert isinstance(found.findings[0].parameters["mass"], Estimate)
    assert found.terms() == 1 and found.places() == 0
