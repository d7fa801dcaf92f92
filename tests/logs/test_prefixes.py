"""A log whose joints have a prefix before the model's names, or lack one, is the model's all the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_diagram.errors import LogError
from twin_diagram.logs import Log, write_log
from twin_diagram.logs.prefixes import under_names_of
from twin_diagram.model import load_model_for, predict
from twin_diagram.station.replay import reading

UR5E = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINTS = tuple(f"{name}_joint" for name in UR5E)


def log(names: tuple[str, ...]) -> Log:
    rng = np.random.default_rng(3)
    shape = (200, len(names))
    return Log(0.01 * np.arange(200), names, rng.normal(0.0, 0.1, shape), torque=rng.normal(size=shape), source="a.csv")


@pytest.mark.parametrize("prefix", ["left_", "cell/ur5e/"])
def test_a_prefix_before_all_names_makes_no_difference(prefix: str) -> None:
    given = log((*(prefix + joint for joint in JOINTS[::-1]), prefix + "finger"))
    model, own, warnings = load_model_for(given, "arms/ur5e.urdf")
    assert own.joints == model.joints == JOINTS
    np.testing.assert_array_equal(own.position, given.position[:, 5::-1])
    (said,) = [warning.message for warning in warnings if warning.code == "left_out"]
    assert said.startswith(f"a.csv: its {prefix}shoulder_pan_joint and the like are taken for the model's shoulder_pan")


def test_predict_and_replay_take_it(tmp_path: Path) -> None:
    write_log(log(tuple("ur_" + joint for joint in JOINTS)), tmp_path / "log.csv")
    predict("arms/ur5e.urdf", tmp_path / "log.csv", tmp_path / "p.csv")
    messages = reading.read_log(tmp_path / "log.csv", JOINTS, np.ones(6, bool))  # of a replay
    assert messages.position.shape == (200, 6)
    assert (tmp_path / "p.csv").read_text().startswith("time,torque_predicted.shoulder_pan_joint")


def test_the_model_may_have_it_instead() -> None:
    assert under_names_of(["ur_" + joint for joint in JOINTS], log(JOINTS)).joints == tuple("ur_" + j for j in JOINTS)


def test_what_is_not_a_prefix_alone_or_not_one_is_left() -> None:
    two = log((*("left_" + joint for joint in JOINTS), *("right_" + joint for joint in JOINTS)))
    for other in (two, log(JOINTS), log(tuple("ur_" + joint for joint in JOINTS[:5])), log(("a", "b"))):
        assert under_names_of(JOINTS, other) is other
    numbered = replace(log(tuple("j" + joint for joint in JOINTS)), numbered=True)
    assert under_names_of(JOINTS, numbered) is numbered
    with pytest.raises(LogError, match="the log holds left_shoulder_pan_joint"):
        load_model_for(two, "arms/ur5e.urdf")
