"""A hand one of whose fingers follows the other is, to all that look at shapes, the hand whose fingers have motors."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.description.followers import Followers
from twin_diagram.model.description.unparsed import following
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.planning.braking.drake_distances import DrakeDistances, Shapes
from twin_diagram.planning.collision.ball_cover import Balls, arm_balls, arm_plant
from twin_diagram.planning.collision.chain import depths
from twin_diagram.planning.collision.geometry_to_solids import points_of
from twin_diagram.planning.tasks.task_system import Fingers
from twin_diagram.scenario.resources import models_dir
from twin_diagram.scene.twin_scene import add_twin_scene
from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.grip_contact import COMPLIANCE
from twin_diagram.station.sim.world_plant import build_world

BOTH = scenario.ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp")
Q = np.array([0.3, 0.4, 0.1, -1.9, 0.2, 2.3, 0.9])
MASS = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
LINK = f'<link name="{{0}}"><inertial>{MASS}</inertial>'
BAR = '<collision><origin xyz="0.05 0 0"/><geometry><box size="0.1 0.01 0.01"/></geometry></collision></link>'
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3} 0 0"/>'
    '<axis xyz="0 0 1"/><limit lower="{4}" upper="{5}" effort="9" velocity="2"/>{6}</joint>'
)

MOTOR = '<transmission type="SimpleTransmission"><joint name="{0}"/><actuator name="{0}_motor"/></transmission>'


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> scenario.ArmModel:
    """The Panda's hand as its maker describes it: the second finger follows the first."""
    arms = models_dir() / "arms"
    text = (arms / "panda_hand.urdf").read_text()
    motor = r'<transmission name="panda_finger_joint2_transmission">.*?</transmission>'
    text, count = re.subn(motor, "", text, flags=re.DOTALL)
    at = text.index("</joint>", text.index('<joint name="panda_finger_joint2"'))
    assert count == 1
    path = tmp_path_factory.mktemp("hand") / "hand.urdf"
    path.write_text(text[:at] + '<mimic joint="panda_finger_joint1"/>' + text[at:])
    for folder in arms.iterdir():
        if folder.is_dir():
            (path.parent / folder.name).symlink_to(folder)
    return dataclasses.replace(BOTH, model=str(path))


def cover(spec: scenario.ArmModel) -> Balls:
    plant, scene_graph, arm, _ = arm_plant(spec)
    return arm_balls(plant, scene_graph, arm, depths(plant, arm.joint_indices))


def test_the_planner_covers_a_finger_that_follows(one: scenario.ArmModel) -> None:
    told, found = cover(BOTH), cover(one)
    np.testing.assert_allclose(found.centres_L, told.centres_L, atol=1e-12)
    np.testing.assert_allclose(found.radii, told.radii, atol=1e-12)


def test_the_stop_monitor_looks_at_a_finger_that_follows(one: scenario.ArmModel) -> None:
    near = {}
    for spec, fingers in ((BOTH, np.full(2, 0.04)), (one, np.full(1, 0.04))):
        drake = DrakeDistances(spec, [], {}, 0, 1)
        X = np.eye(4)
        # A little cube beside the tip of the second finger, which opens towards it.
        X[:3, 3] = drake.tool(Q)[:3] @ [0.0, -0.09, 0.0, 1.0]
        cube = 0.01 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        drake.surround(Shapes(np.ones(1, dtype=bool), [], [(cube,)]))
        near[spec.model] = drake.near(Q, np.zeros(7), fingers, np.ones(1, dtype=bool), X[None], 0.3).distance.min()
    assert near[one.model] == pytest.approx(near[BOTH.model], abs=1e-6)


def test_the_eyes_leave_out_a_finger_that_follows(one: scenario.ArmModel) -> None:
    told, found = RobotShape(BOTH), RobotShape(one)
    points = np.random.default_rng(0).uniform(-0.12, 0.12, (4000, 3))
    centre = DrakeDistances(BOTH, [], {}, 0, 0).tool(Q)[:3, 3]
    for wide in (0.0, 0.02, 0.04, None):
        two, first = (None, None) if wide is None else (np.full(2, wide), np.full(1, wide))
        expected = told.near(points + centre, Q, 0.005, two)
        assert expected.any()
        np.testing.assert_array_equal(found.near(points + centre, Q, 0.005, first), expected)


def test_the_twin_shows_a_finger_that_follows_and_knows_how_wide_the_hand_opens(one: scenario.ArmModel) -> None:
    scene = add_twin_scene(DiagramBuilder(), scenario.Twin(arm=one, fixtures=[], library={}))
    positions = scene.default_positions.copy()
    positions[scene.gripper_position_index] = 0.03
    scene.followers.follow(positions)
    assert positions[scene.plant.GetJointByName("panda_finger_joint2").position_start()] == 0.03
    fingers = Fingers.of(scene.plant, scene.arm, np.zeros(1), scene.followers.widening)
    assert fingers.widest == pytest.approx(0.08) and fingers.opening(np.array([0.03])) == pytest.approx(0.06)


def test_a_finger_that_follows_grips_as_the_other_does(one: scenario.ArmModel) -> None:
    """Its pad is soft in the simulated world, and what it touches of an object is no collision."""
    world = build_world(DiagramBuilder(), scenario.Scenario(world=scenario.World(arm=one), twin=scenario.Twin(arm=one)))
    gripping = Followers.gripping(world.plant, world.arm.arm)
    assert [joint.name() for joint in gripping] == ["panda_finger_joint1", "panda_finger_joint2"]
    inspector = world.scene_graph.model_inspector()
    shapes = world.plant.GetCollisionGeometriesForBody(world.plant.GetBodyByName("panda_rightfinger"))
    assert any(inspector.GetProximityProperties(shape).HasProperty(*COMPLIANCE) for shape in shapes)


def turning(folder: Path, chain: str) -> scenario.ArmModel:
    """An arm whose gripper turns: a bar, on it a tip that follows it, and on that one that follows the tip."""
    links = "".join(LINK.format(name) + ("</link>" if name == "base" else BAR) for name in ("base", "a", "b", "c", "d"))
    joints = [
        JOINT.format("arm", "base", "a", 0.0, -1, 1, ""),
        JOINT.format("bar", "a", "b", 0.1, -0.7, 0.7, ""),
        JOINT.format("tip", "b", "c", 0.1, -3, 3, f'<mimic joint="{chain}" multiplier="-1" offset="0.2"/>'),
        JOINT.format("nail", "c", "d", 0.1, -3, 3, '<mimic joint="tip" multiplier="2" offset="-0.1"/>'),
    ]
    path = folder / "turning.urdf"
    path.write_text(f'<robot name="turning">{links}{"".join(joints)}</robot>')
    return scenario.ArmModel(model=str(path), joints=["arm"], gripper_joints=["bar"], tool_frame="")


def test_who_follows_through_others_and_who_follows_itself(tmp_path: Path) -> None:
    def found(chain: str) -> Array:
        plant = MultibodyPlant(0.0)
        arm = add_arm(plant, turning(tmp_path, chain))
        plant.Finalize()
        positions = np.zeros(4)
        positions[plant.GetJointByName("bar").position_start()] = 0.5
        followers = Followers.of(plant, arm)
        assert followers.widening.tolist() == [1.0]
        followers.follow(positions)
        return positions

    np.testing.assert_allclose(found("bar"), [0.0, 0.5, -0.5 + 0.2, 2 * (-0.5 + 0.2) - 0.1])
    np.testing.assert_allclose(found("nail"), [0.0, 0.5, 0.0, 0.0])


@pytest.mark.parametrize(
    ("palm", "motors"),
    [("a", ()), ("a", ("arm", "bar")), ("a", ("arm", "bar", "other")), ("base", ()), ("base", ("arm", "bar"))],
)
def test_a_joint_that_turns_fingers_is_no_joint_of_the_arm(tmp_path: Path, palm: str, motors: tuple[str, ...]) -> None:
    """An xArm's hand was its seventh joint, off by 13 rad within 2 s. A rod beside the arm makes no hand."""
    spec = turning(tmp_path, "bar")
    path, other = Path(spec.model), JOINT.format("other", palm, "e", 0.0, -3, 3, '<mimic joint="bar" multiplier="-1"/>')
    driven = "".join(MOTOR.format(name) for name in motors)
    path.write_text(path.read_text().replace("</robot>", f"{LINK.format('e')}{BAR}{other}{driven}</robot>"))
    arm = add_arm(MultibodyPlant(0.0), path)
    hand = (("arm",), ("bar",)) if palm == "a" else (("arm", "bar"), ())
    assert (arm.joints, arm.gripper_joints) == hand
    named = add_arm(MultibodyPlant(0.0), dataclasses.replace(spec, joints=["arm", "bar"], gripper_joints=[]))
    assert (named.joints, named.gripper_joints) == (("arm", "bar"), ())


def test_fingers_that_turn_are_covered_all_the_way(tmp_path: Path) -> None:
    plant, scene_graph, arm, _ = arm_plant(turning(tmp_path, "bar"))
    balls = arm_balls(plant, scene_graph, arm, depths(plant, arm.joint_indices))
    inspector, context = scene_graph.model_inspector(), plant.CreateDefaultContext()
    followers = Followers.of(plant, arm)
    for angle in np.linspace(-0.7, 0.7, 29):
        positions = np.zeros(4)
        positions[plant.GetJointByName("bar").position_start()] = angle
        followers.follow(positions)
        plant.SetPositions(context, positions)
        for name in ("b", "c", "d"):
            body = plant.GetBodyByName(name)
            for geometry in plant.GetCollisionGeometriesForBody(body):
                X = (body.EvalPoseInWorld(context) @ inspector.GetPoseInFrame(geometry)).GetAsMatrix4()
                points = points_of(inspector, geometry) @ X[:3, :3].T + X[:3, 3]
                outside = np.linalg.norm(points[:, None] - balls.centres_L, axis=2) - balls.radii
                assert outside.min(axis=1).max() < 2e-4, (angle, name)


MJCF_HAND = """<mujoco model="m"><worldbody><body name="a"><joint name="arm" axis="0 0 1" range="-60 60"/>{0}
  <body name="l"><joint name="left" type="slide" axis="0 1 0" range="0 0.04"/>{0}
    <geom type="box" size=".01 .01 .05" pos="0 0.01 0.1"/></body>
  <body name="r"><joint name="right" type="slide" axis="0 1 0" range="-0.08 0"/>{0}
    <geom type="box" size=".01 .01 .05" pos="0 -0.01 0.1"/></body></body></worldbody>
  <equality>{1}</equality><actuator><motor joint="arm"/><position joint="left" kp="100"/></actuator></mujoco>"""
INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>'


@pytest.mark.parametrize(
    "equal",
    [
        '<joint joint1="right" joint2="left" polycoef="0 -2 0 0 0"/>',
        '<joint joint1="left" joint2="right" polycoef="0 -0.5 0 0 0"/>',  # the one without a motor follows
    ],
)
def test_a_finger_that_an_mjcf_holds_equal_follows(tmp_path: Path, equal: str) -> None:
    path = tmp_path / "hand.xml"
    path.write_text(MJCF_HAND.format(INERTIAL, equal))
    spec = scenario.ArmModel(model=str(path), tool_frame="")
    plant, scene_graph, arm, _ = arm_plant(spec)
    assert arm.gripper_joints == ("left",)
    followers = Followers.of(plant, arm)
    assert [joint.name() for joint in followers.joints] == ["right"] and followers.widening.tolist() == [3.0]
    balls = arm_balls(plant, scene_graph, arm, depths(plant, arm.joint_indices))
    # Opened, the right finger reaches from y = -0.02 - 0.08 on.
    lowest = (balls.centres_L[:, 1] - balls.radii).min()
    assert -0.1 - 0.013 - 1e-9 < lowest <= -0.1
    world = build_world(
        DiagramBuilder(), scenario.Scenario(world=scenario.World(arm=spec), twin=scenario.Twin(arm=spec))
    )
    assert world.plant.num_constraints() == 1


@pytest.mark.parametrize(
    "equal",
    [
        '<joint joint1="right" joint2="left" polycoef="0 1 0.5 0 0"/>',
        '<joint joint1="right" joint2="left" active="false"/>',
        '<joint joint1="right" polycoef="0.01 0 0 0 0"/>',
    ],
)
def test_what_is_not_in_proportion_follows_nobody(tmp_path: Path, equal: str) -> None:
    path = tmp_path / "hand.xml"
    path.write_text(MJCF_HAND.format(INERTIAL, equal))
    assert not following(path)
    path.write_text(MJCF_HAND.format(INERTIAL, '<joint joint1="right" joint2="left" polycoef="0 one"/>'))
    with pytest.raises(ModelError, match="equality of joint 'right': polycoef"):
        following(path)


SDF_LINK = '<link name="{0}"><inertial><mass>1</mass></inertial></link>'
SDF_JOINT = (
    '<joint name="{0}" type="{1}"><parent>{2}</parent><child>{3}</child><axis><xyz>0 1 0</xyz><limit><lower>0</lower>'
    "<upper>0.04</upper><effort>{4}</effort></limit>{5}</axis>{6}</joint>"
)


@pytest.mark.parametrize(
    ("own", "drakes", "declared"),
    [
        ("", '<drake:mimic joint="left" multiplier="2" offset="0.004"/>', ""),
        ("", '<drake:mimic joint="left" multiplier="2" offset="0.004"/>', ' xmlns:drake="http://drake.mit.edu"'),
        (
            '<mimic joint="left"><multiplier>2</multiplier><offset>0.024</offset><reference>0.01</reference></mimic>',
            "",
            "",
        ),
    ],
    ids=["drake", "drake, declared", "sdf"],
)
def test_a_finger_of_an_sdf_follows(tmp_path: Path, own: str, drakes: str, declared: str) -> None:
    path = tmp_path / "hand.sdf"
    path.write_text(
        f'<sdf version="1.11"{declared}><model name="m">{"".join(map(SDF_LINK.format, "bulr"))}'
        + SDF_JOINT.format("turn", "revolute", "b", "u", 9, "", "")
        + SDF_JOINT.format("left", "prismatic", "u", "l", 5, "", "")
        + SDF_JOINT.format("right", "prismatic", "u", "r", 0, own, drakes)
        + "</model></sdf>"
    )
    spec = scenario.ArmModel(model=str(path), tool_frame="")
    plant = MultibodyPlant(0.0)
    arm = add_arm(plant, spec)
    plant.Finalize()
    assert arm.joints == ("turn",) and arm.gripper_joints == ("left",)
    followers, q = Followers.of(plant, arm), np.array([0.0, 0.03, 0.0])
    assert [joint.name() for joint in followers.joints] == ["right"]
    followers.follow(q)
    assert q[2] == pytest.approx(0.064)
    world = build_world(
        DiagramBuilder(), scenario.Scenario(world=scenario.World(arm=spec), twin=scenario.Twin(arm=spec))
    )
    assert world.plant.num_constraints() == 1
