"""One arm of a robot that has more: what moves without it stands still."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.cli import main
from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.model import Model
from twin_diagram.runs.first_scenario import look_at
from twin_diagram.scenario import ArmModel
from twin_diagram.signals.arrays import Array

LINK = (
    '<link name="{name}"><inertial><origin xyz="0.1 0.02 0.05"/><mass value="2"/>'
    '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0.001" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}'
    '<axis xyz="{axis}"/><origin xyz="0.1 {side} 0.2" rpy="0.2 0 0"/>'
    '<limit lower="{lower}" upper="2" effort="50" velocity="3"/></joint>'
)


def two_arms(folder: Path) -> Path:
    """A lift that cannot go to zero, which carries two arms with a gripper each; one finger follows the other."""
    joints = [
        dict(name="lift", kind="prismatic", parent="base", child="torso", axis="0 0 1", side=0, lower=0.3, more=""),
        dict(name="lean", kind="revolute", parent="torso", child="chest", axis="0 1 0", side=0, lower=0.25, more=""),
    ]
    for side, y in (("left", 0.3), ("right", -0.3)):
        follows = f'<mimic joint="{side}_finger_1" multiplier="-1" offset="0"/>'
        limbs = [
            ("shoulder", "revolute", "0 1 0", f"{side}_upper", "chest", ""),
            ("elbow", "revolute", "0 0.6 0.8", f"{side}_lower", f"{side}_upper", ""),
            ("finger_1", "prismatic", "1 0 0", f"{side}_thumb", f"{side}_lower", ""),
            ("finger_2", "prismatic", "1 0 0", f"{side}_index", f"{side}_lower", follows),
        ]
        joints += [
            dict(name=f"{side}_{n}", kind=k, parent=p, child=c, axis=a, side=y, lower=-1, more=m)
            for n, k, a, c, p, m in limbs
        ]
    links = ["base", *(str(joint["child"]) for joint in joints)]
    text = "".join([LINK.format(name=name) for name in links] + [JOINT.format(**joint) for joint in joints])
    path = folder / "two_arms.urdf"
    path.write_text(f'<robot name="two_arms">{text}</robot>')
    return path


def test_what_is_beside_the_arm_is_held(tmp_path: Path) -> None:
    path = two_arms(tmp_path)
    model = Model.load(ArmModel(model=str(path), joints=["left_shoulder", "left_elbow"], tool_frame=""))
    assert model.arm.gripper_joints == ("left_finger_1",)  # not the other hand's, nor the lift
    assert model.plant.num_positions() == 4
    # The lift stands as low as it can go, and the chest leans as little: 0.3 m above zero, 0.25 rad.
    whole = MultibodyPlant(0.0)
    add_arm(whole, ArmModel(model=str(path), tool_frame=""))
    whole.Finalize()
    context = whole.CreateDefaultContext()
    q = np.array([0.4, -0.7])
    for name, at in zip(("lift", "lean", "left_shoulder", "left_elbow"), (0.3, 0.25, *q), strict=True):
        joint = whole.GetJointByName(name)
        (joint.set_translation if name == "lift" else joint.set_angle)(context, at)
    expected = whole.GetFrameByName("left_lower").CalcPoseInWorld(context).GetAsMatrix4()
    np.testing.assert_allclose(model.tool_pose(q).GetAsMatrix4(), expected, atol=1e-12)
    own = [whole.GetJointByName(name).velocity_start() for name in model.joints]
    gravity = -whole.CalcGravityGeneralizedForces(context)[own]
    np.testing.assert_allclose(model.inverse_dynamics(q, np.zeros(2), np.zeros(2)), gravity, atol=1e-12)


def test_fingers_that_follow_go_on_following(tmp_path: Path) -> None:
    plant = MultibodyPlant(0.001)
    add_arm(plant, ArmModel(model=str(two_arms(tmp_path)), joints=["right_shoulder", "right_elbow"], tool_frame=""))
    assert plant.num_constraints() == 1
    plant.Finalize()
    assert plant.num_positions() == 4
    assert plant.num_actuators() == 3


def test_init_names_the_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = two_arms(tmp_path), tmp_path / "first.yaml"
    assert main(["init", "--arm", str(path), "--out", str(out)]) == 2
    assert "--joints" in capsys.readouterr().err
    arm = ["left_shoulder", "left_elbow"]
    assert main(["init", "--arm", str(path), "--out", str(out), "--joints", *arm]) == 0
    written = yaml.safe_load(out.read_text())
    assert written["twin"]["arm"]["joints"] == written["world"]["arm"]["joints"] == arm
    assert len(written["twin"]["home"]) == 2


def log_of(model: Model, arm: tuple[str, ...], out: Path) -> dict[str, Array]:
    """Write a log of an arm that does what the model says; return its columns."""
    time = np.arange(0.0, 4.0, 0.01)
    phase = np.stack([(2.0 + k) * time for k in range(len(arm))], axis=1)
    rate = np.arange(2.0, 2.0 + len(arm))
    q, v, a = 0.4 * np.sin(phase), 0.4 * np.cos(phase) * rate, -0.4 * np.sin(phase) * rate**2
    columns = {"time": time}
    columns |= {f"position_measured.{name}": q[:, k] for k, name in enumerate(arm)}
    columns |= {f"torque_measured.{name}": model.inverse_dynamics(q, v, a)[:, k] for k, name in enumerate(arm)}
    np.savetxt(out, np.column_stack([*columns.values()]), delimiter=",", header=",".join(columns), comments="")
    return columns


def assert_predicted(out: Path, columns: dict[str, Array], arm: tuple[str, ...]) -> None:
    header = out.read_text().splitlines()[0].split(",")
    predicted = np.loadtxt(out, delimiter=",", skiprows=1)
    for name in arm:
        got = predicted[50:-50, header.index(f"torque_predicted.{name}")]
        np.testing.assert_allclose(got, columns[f"torque_measured.{name}"][50:-50], atol=0.02)


def test_a_log_of_one_arm_is_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What carries the arm must be logged, or be said to stand still."""
    path, log, out = two_arms(tmp_path), tmp_path / "log.csv", tmp_path / "out.csv"
    arm = ("left_shoulder", "left_elbow")
    columns = log_of(Model.load(ArmModel(model=str(path), joints=list(arm), tool_frame="")), arm, log)
    told = ["predict", "--model", str(path), "--log", str(log), "--out", str(out)]
    assert main(told) == 2
    assert "--joints" in capsys.readouterr().err
    assert main([*told, "--joints", *arm]) == 0
    assert_predicted(out, columns, arm)


def test_an_arm_does_not_feel_the_other(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The other arm need not be named, nor be logged."""
    path, log, out = two_arms(tmp_path), tmp_path / "log.csv", tmp_path / "out.csv"
    text = path.read_text().replace('name="lift" type="prismatic"', 'name="lift" type="fixed"')
    path.write_text(text.replace('name="lean" type="revolute"', 'name="lean" type="fixed"'))
    arm = ("left_shoulder", "left_elbow")
    columns = log_of(Model.load(ArmModel(model=str(path), joints=list(arm), tool_frame="")), arm, log)
    assert main(["predict", "--model", str(path), "--log", str(log), "--out", str(out)]) == 0
    assert "right_shoulder, right_elbow" in caplog.text
    assert_predicted(out, columns, arm)


HAND = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0"/>
<geom size=".05" pos="0 0 .3"/><body name="left" pos="0 .03 .4"><joint name="left_driver" axis="1 0 0"/>
<geom size=".02" pos="0 .03 0"/><body name="left_tip" pos="0 .05 0"><joint name="left_coupler" axis="1 0 0"/>
<geom size=".02" pos="0 0 .03"/></body></body>
<body name="right" pos="0 -.03 .4"><joint name="right_driver" axis="-1 0 0"/><geom size=".02" pos="0 -.03 0"/></body>
</body></worldbody><tendon><fixed name="split"><joint joint="left_driver" coef=".5"/>
<joint joint="right_driver" coef=".5"/></fixed></tendon>
<equality><connect anchor="0 0 .06" body1="left_tip" body2="upper"/>
<joint joint1="right_driver" joint2="left_driver"/></equality>
<actuator><motor joint="shoulder"/>{pull}</actuator></mujoco>"""


@pytest.mark.parametrize(("pull", "left"), [('<general tendon="split"/>', 1), ("", 4)])
def test_knuckles_of_a_hand_that_tendons_pull_are_held(tmp_path: Path, pull: str, left: int) -> None:
    """They hung loose, as nobody reads what pulls them; what is truly without a motor still does."""
    path = tmp_path / "arm.xml"
    path.write_text(HAND.format(pull=pull))
    plant = MultibodyPlant(1e-3)
    assert add_arm(plant, path).joints == ("shoulder",)
    plant.Finalize()
    assert plant.num_velocities() == left and (left > 1 or plant.num_constraints() == 0)
    brought = look_at(path)
    knuckles = {"left_driver", "left_coupler", "right_driver"}
    assert (set(brought.held), bool(brought.loose)) == ((knuckles, False) if left == 1 else (set(), True))
    assert ("nothing is read of the tendons" in "".join(brought.notes(path))) == (left == 1)


FINGER = '<body name="{0}"><joint name="{0}" axis="0 0 1"/><geom type="box" size=".04 .01 .01" pos=".04 {1} 0"/></body>'
UNLINKED = f"""<mujoco model="m"><worldbody><body name="base"><geom size=".1"/>
<body name="upper"><joint name="lift" axis="0 1 0"/><geom size=".1" pos=".2 0 0"/>
<body name="lower" pos=".3 0 0"><joint name="turn 2" axis="1 0 0"/><geom size=".05"/>
{FINGER.format("left", 0.03)}{FINGER.format("right", -0.03)}</body></body></body></worldbody>
<actuator><motor joint="lift"/><motor joint="turn 2"/><motor joint="left"/><motor joint="right"/></actuator></mujoco>"""
"""An arm whose hand has two fingers with a motor each, of which neither follows the other."""


def test_fingers_of_which_none_follows_are_held_beside_an_arm_that_is_named(tmp_path: Path) -> None:
    """They hung loose, though `--joints` says that all others are held, and `init` said that they had no motor."""
    path = tmp_path / "unlinked.xml"
    path.write_text(UNLINKED)
    with pytest.raises(ModelError, match="--joints lift 'turn 2'; "):
        look_at(path)
    model = Model.load(ArmModel(model=str(path), joints=["lift", "turn 2"], tool_frame=""))
    assert model.plant.num_positions() == 2 and model.plant.num_actuators() == 2
    brought = look_at(path, joints=["lift", "turn 2"])
    assert brought.loose == ()
