"""The frame between finger tips, found by the fingers' shapes, beside those that descriptions name."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.planning.collision.ball_cover import arm_plant
from twin_diagram.planning.collision.between_fingers import (
    between_fingers,
    grips,
    refuse_elsewhere,
    refuse_turning,
    told_in,
)
from twin_diagram.planning.collision.hand_shape import Palm, hand_shape
from twin_diagram.planning.grasps.gripper import PANDA_HAND, WSG50, Gripper
from twin_diagram.planning.tasks.grasp_from_above import grasps_from_above
from twin_diagram.planning.tasks.neighbours import Neighbours
from twin_diagram.runs.first_scenario import look_at, write_first_scenario
from twin_diagram.scenario import ArmModel, Pose, load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.twin import make_closed_loop

FINGER = """
<link name="{name}"><inertial><mass value="0.05"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision></link>
<joint name="{name}_joint" type="prismatic"><parent link="palm"/><child link="{name}"/><axis xyz="{axis}"/>
<limit lower="0" upper="0.04" effort="50" velocity="1"/></joint>"""


def hand(folder: Path, axes: tuple[str, str], at: tuple[str, str], size: str) -> Path:
    """Writes an arm of one joint with a hand that points along the palm's x, turned and shifted on the flange."""
    fingers = "".join(
        FINGER.format(name=name, at=place, size=size, axis=axis)
        for name, axis, place in zip(("left", "right"), axes, at, strict=True)
    )
    inertia = '<inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
    path = folder / "hand.urdf"
    path.write_text(f"""<robot name="hand"><link name="base">{inertia}</link>
<link name="arm">{inertia}</link><link name="palm">{inertia}</link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="50" velocity="2"/></joint>
<joint name="mount" type="fixed"><parent link="arm"/><child link="palm"/>
<origin xyz="0 0 0.1" rpy="0 -1.5707963 0.6"/></joint>
{fingers}</robot>""")
    return path


def of_frame(spec: ArmModel) -> tuple[Array, Array]:
    """X_LG by the shapes, and X_LF of the frame that the description names, in the last link."""
    plant, scene_graph, arm, _keep = arm_plant(spec)
    found = between_fingers(plant, scene_graph, arm)
    assert found is not None
    named, last = plant.get_frame(arm.tool_frame), plant.get_body(arm.last_link).body_frame()
    return found, np.asarray(plant.CalcRelativeTransform(plant.CreateDefaultContext(), last, named).GetAsMatrix4())


@pytest.mark.parametrize(
    ("model", "frame"), [("arms/panda_hand.urdf", "panda_tcp"), ("arms/iiwa7_wsg.urdf", "wsg_tcp")]
)
def test_the_frames_of_the_hands_that_come_along_are_found(model: str, frame: str) -> None:
    found, named = of_frame(ArmModel(model=model, tool_frame=frame))
    np.testing.assert_allclose(found[:3, 3], named[:3, 3], atol=1.5e-3)
    np.testing.assert_allclose(found[:3, 2], named[:3, 2], atol=1e-6)
    np.testing.assert_allclose(abs(found[:3, 1] @ named[:3, 1]), 1.0, atol=1e-9)
    assert grips(np.linalg.inv(named) @ found)


@pytest.mark.parametrize(("gripper", "model"), [(PANDA_HAND, "panda_hand"), (WSG50, "iiwa7_wsg")])
def test_how_far_fingers_reach_beyond_the_palm_is_found(gripper: Gripper, model: str) -> None:
    plant, scene_graph, arm, _keep = arm_plant(ArmModel(model=f"arms/{model}.urdf", tool_frame=gripper.frame))
    found = hand_shape(plant, scene_graph, arm).palm
    assert found.free == pytest.approx(gripper.finger_length, abs=1e-3)
    assert found.corners[:, 2].max() == pytest.approx(gripper.finger_front - gripper.finger_length, abs=2e-3)
    np.testing.assert_allclose(np.ptp(found.corners[:, :2], axis=0), gripper.palm_size[:2], atol=0.01)


def test_a_palm_close_behind_the_tips_stays_above_what_is_taken() -> None:
    x, y, z = np.meshgrid([-0.02, 0.02], [-0.03, 0.03], [-0.06, 0.06])
    pieces = (np.stack([x, y, z], axis=-1).reshape(-1, 3),)
    where = np.array([1.0, 0, 0, 0, 0.5, 0, 0.06])
    down, nobody = np.array([0.0, 1, 0, 0]), Neighbours()
    deep, _ = grasps_from_above(pieces, where, 0.08, down, nobody)
    shallow, _ = grasps_from_above(pieces, where, 0.08, down, nobody, palm=Palm(0.035))
    assert deep[0, 6] == pytest.approx(0.09)
    assert shallow[0, 6] == pytest.approx(0.12 - 0.02)  # tips 10 mm lower, 35 mm before the palm, which keeps 5


def test_a_hand_that_points_along_another_axis_is_found_and_told(tmp_path: Path) -> None:
    sides = ("0.06 0 0.0075", "0.06 0 -0.0075")
    model = hand(tmp_path, ("0 0 1", "0 0 -1"), sides, "0.12 0.02 0.015")
    found = look_at(model)
    assert found.frames[0] == "palm"
    # The tips end at x = 0.12 of the palm, fingers meet at its z = 0 and move along z.
    assert found.grip.startswith("X_FG: {translation: [0.11, 0, 0], rpy: [")
    path = tmp_path / "first.yaml"
    write_first_scenario(model, path)
    spec = load_scenario(path).twin.arm
    X_LG, X_LT = of_frame(spec)
    assert grips(np.linalg.inv(X_LT) @ X_LG)
    # Half a turn about the approach is the same hand.
    np.testing.assert_allclose(np.abs(np.linalg.inv(X_LT) @ X_LG), np.eye(4), atol=2e-4)
    plant, scene_graph, arm, _keep = arm_plant(spec)
    refuse_elsewhere(plant, scene_graph, arm)


def test_of_fingers_that_move_the_same_way_nothing_is_said(tmp_path: Path) -> None:
    model = hand(tmp_path, ("0 0 1", "0 0 1"), ("0.06 0 0.01", "0.06 0 -0.01"), "0.12 0.02 0.015")
    plant, scene_graph, arm, _keep = arm_plant(ArmModel(model=str(model), tool_frame=""))
    assert between_fingers(plant, scene_graph, arm) is None
    refuse_elsewhere(plant, scene_graph, arm)


def test_of_fingers_without_shapes_nothing_is_said(tmp_path: Path) -> None:
    model = hand(tmp_path, ("0 0 1", "0 0 -1"), ("0.06 0 0.0075", "0.06 0 -0.0075"), "0.12 0.02 0.015")
    model.write_text(re.sub("<collision>.*</collision>", "", model.read_text()))
    plant, scene_graph, arm, _keep = arm_plant(ArmModel(model=str(model), tool_frame=""))
    assert between_fingers(plant, scene_graph, arm) is None


def test_a_pick_with_fingers_that_turn_is_refused(tmp_path: Path) -> None:
    """Before anything starts: it waited for their opening until its time was over."""
    model = hand(tmp_path, ("0 0 1", "0 0 -1"), ("0.1 0 0.0075", "0.1 0 -0.0075"), "0.04 0.02 0.015")
    text = model.read_text().replace('type="prismatic"', 'type="revolute"').replace('axis xyz="0 0', 'axis xyz="0 1')
    follows = '<child link="right"/><mimic joint="left_joint" multiplier="1"/>'
    model.write_text(text.replace('<child link="right"/>', follows))
    plant, _, arm, _keep = arm_plant(ArmModel(model=str(model), tool_frame=""))
    with pytest.raises(ModelError, match="left_joint turns its fingers"):
        refuse_turning(plant, arm)


def test_a_pick_with_a_tool_frame_at_the_palm_is_refused_with_what_to_write() -> None:
    scenario = load_scenario("pick_and_place")
    scenario.twin.arm.tool_frame = "panda_hand"
    with pytest.raises(ScenarioError) as caught:
        make_closed_loop(scenario)
    said = str(caught.value)
    assert "twin.arm.tool_frame" in said and "panda_hand is 102 mm from there" in said
    assert said.endswith("give the arm X_FG: {translation: [0, 0, 0.1024], rpy: [0, 0, 0]}")
    scenario.twin.arm.X_FG = Pose(translation=[0.0, 0.0, 0.1024])
    plant, scene_graph, arm, _keep = arm_plant(scenario.twin.arm)
    refuse_elsewhere(plant, scene_graph, arm)


def test_without_a_pick_the_tool_frame_may_be_anywhere() -> None:
    scenario = load_scenario("pick_and_place")
    scenario.twin.arm.tool_frame = "panda_hand"
    scenario.twin.task.steps = scenario.twin.task.steps[:0]
    make_closed_loop(scenario)


def test_what_is_told_is_the_lesser_of_the_two_turns() -> None:
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    turned[:3, 3] = (0.0, -0.01, 0.1)
    assert told_in(turned) == "X_FG: {translation: [0, -0.01, 0.1], rpy: [0, 0, 0]}"


def test_an_unknown_frame_is_refused_with_an_offset_too() -> None:
    with pytest.raises(ModelError, match="no frame 'nowhere'"):
        arm_plant(ArmModel(tool_frame="nowhere", X_FG=Pose(translation=[0.0, 0.0, 0.1])))
