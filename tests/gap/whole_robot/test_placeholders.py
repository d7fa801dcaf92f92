"""Friction that a description states and an arm has not got: what is found beside it does not depend on it."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from tests.gap.made import ARM, everywhere, swing
from twin_diagram.gap.findings import Finding
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.whole_robot.few_or_whole import whole_robot
from twin_diagram.gap.whole_robot.placeholders import placeholders, without
from twin_diagram.logs import Log
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel
from twin_diagram.scenario.resources import models_dir

DRY, DAMPING = 10.0, 1.5
"""What the description states."""

LEVEL, SLOPE = 0.8, 0.4
"""What there is."""


@cache
def stating() -> Model:
    """The arm, whose description states the same friction on all joints."""
    text = (models_dir() / "arms" / "ur5e.urdf").read_text(encoding="utf-8")
    text = re.sub(r"(<axis [^>]*/>)", rf'\1<dynamics damping="{DAMPING}" friction="{DRY}"/>', text)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return Model.load(ArmModel(model=str(path), tool_frame=""))


@cache
def log_of(*, rubs: bool) -> Log:
    """A log of the arm with a link that is off and little friction, or with what the description states."""
    friction = {True: (DRY, DAMPING), False: (LEVEL, SLOPE)}[rubs]
    more = [everywhere("coulomb_friction", torque=friction[0]), everywhere("viscous_friction", damping=friction[1])]
    time, q, v, a = swing(10.0)
    torque = ARM.with_effects(more).inverse_dynamics(q, v, a, time=time)
    return Log(time, ARM.joints, q, torque=torque + 0.05 * np.random.default_rng(3).normal(size=q.shape))


def prepared(model: Model, log: Log) -> Records:
    return prepare(model, [log])


def test_what_is_stated_and_true_is_no_placeholder() -> None:
    assert placeholders(prepared(stating(), log_of(rubs=True)), [log_of(rubs=True)]) is None
    assert placeholders(prepared(ARM, log_of(rubs=False)), [log_of(rubs=False)]) is None


def test_without_placeholders_the_description_states_none() -> None:
    found = placeholders(prepared(stating(), log_of(rubs=False)), [log_of(rubs=False)])
    assert found is not None
    np.testing.assert_allclose(found.stated, np.tile([DAMPING, DRY], (6, 1)))
    bare = prepared(ARM, log_of(rubs=False)).records[0]
    np.testing.assert_allclose(found.records.records[0].given, bare.given, atol=1e-9)
    np.testing.assert_allclose(found.records.records[0].passed, bare.passed, atol=1e-9)


def test_one_joint_alone_may_have_one() -> None:
    stated = np.zeros((6, 2))
    stated[2] = DAMPING, DRY
    q, v, a = np.zeros((1, 6)), np.ones((1, 6)), np.zeros((1, 6))
    less = stating().inverse_dynamics(q, v, a) - without(stating(), stated).inverse_dynamics(q, v, a)
    np.testing.assert_allclose(less[0], np.where(np.arange(6) == 2, DRY + DAMPING, 0.0), atol=1e-9)


@pytest.mark.long
def test_two_descriptions_are_corrected_to_the_same_torques() -> None:
    log = log_of(rubs=False)
    plain, stated = (whole_robot(prepared(m, log), [log], known=False) for m in (ARM, stating()))
    assert plain is not None and stated is not None
    _, q, v, a = swing(5.0, seed=9)
    torques = [found.model.inverse_dynamics(q, v, a) for found in (plain, stated)]
    np.testing.assert_allclose(torques[0], torques[1], atol=1e-6)
    np.testing.assert_allclose(plain.left, stated.left)
    assert np.all(stated.before > plain.before)
    for name, key, surplus in (("coulomb_friction", "torque", DRY), ("viscous_friction", "damping", DAMPING)):
        one, other = (values(found.findings, name, key) for found in (plain, stated))
        assert set(other) == set(ARM.joints)
        for joint in ARM.joints:
            np.testing.assert_allclose(other[joint], one.get(joint, 0.0) - surplus, atol=1e-9)


@pytest.mark.long
def test_an_arm_that_lacks_nothing_else_has_what_is_stated_too_much() -> None:
    time, q, v, a = swing(10.0)
    torque = ARM.inverse_dynamics(q, v, a, time=time)
    log = Log(time, ARM.joints, q, torque=torque + 0.05 * np.random.default_rng(3).normal(size=q.shape))
    found = whole_robot(prepared(stating(), log), [log], known=False)
    assert found is not None
    levels = values(found.findings, "coulomb_friction", "torque")
    np.testing.assert_allclose([levels[joint] for joint in ARM.joints], -DRY, atol=0.1)


def values(findings: tuple[Finding, ...], name: str, key: str) -> dict[str, float]:
    (found,) = (one for one in findings if one.name == name)
    each = found.parameters[key]
    assert isinstance(each, dict)
    return {joint: float(np.asarray(one.value)) for joint, one in each.items()}
