"""Where a scene is looked at from: the whole arm is in the picture, whatever its size, place and side."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.scenario import ArmModel, Twin, models_dir
from twin_diagram.scene import add_twin_scene
from twin_diagram.visualization.view import points_along, view_of_arm

PANDA = np.array([[0, 0, 0], [0, 0, 0.33], [0.05, 0.0, 0.64], [0.4, 0.0, 0.43], [0.47, 0.0, 0.43], [0.47, 0.0, 0.22]])
HALF_ANGLE = np.radians(37.5)
"""Of Meshcat's picture, from its middle up."""


def angles(p_WPoints, p_WV, p_WT):
    """Return how far points lie off the middle of the picture [rad]."""
    axis = (p_WT - p_WV) / np.linalg.norm(p_WT - p_WV)
    rays = (p_WPoints - p_WV) / np.linalg.norm(p_WPoints - p_WV, axis=1)[:, None]
    return np.arccos(np.clip(rays @ axis, -1.0, 1.0))


@given(st.floats(0.1, 30.0), st.integers(0, 3), st.tuples(*[st.floats(-5.0, 5.0)] * 3))
def test_size_place_and_side_of_an_arm_change_its_picture_in_nothing(size, quarter, at):
    c, s = np.round(np.cos(0.5 * np.pi * quarter)), np.round(np.sin(0.5 * np.pi * quarter))
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    eye, target = view_of_arm(PANDA)
    moved_eye, moved_target = view_of_arm(at + size * PANDA @ R.T)
    np.testing.assert_allclose(moved_eye, at + size * R @ eye, atol=1e-9 * size + 1e-12)
    np.testing.assert_allclose(moved_target, at + size * R @ target, atol=1e-9 * size + 1e-12)


@pytest.mark.parametrize("name", ["ur5e.urdf", "iiwa7.urdf", "panda_hand.urdf"])
def test_the_whole_arm_is_in_the_picture(name):
    scene = add_twin_scene(DiagramBuilder(), Twin(arm=ArmModel(model=str(models_dir() / "arms" / name), tool_frame="")))
    points = points_along(scene)
    eye, target = view_of_arm(points)
    off = angles(points, eye, target)
    assert off.max() < HALF_ANGLE
    assert off.max() > 0.3 * HALF_ANGLE  # and large enough to be looked at


def test_both_ends_of_a_rail_are_in_the_picture(tmp_path):
    rail = tmp_path / "rail.urdf"
    link = (
        '<link name="{}"><inertial><mass value="2"/>'
        '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    joint = (
        '<joint name="{0}_joint" type="{1}"><parent link="{2}"/><child link="{0}"/><origin xyz="{3}"/><axis xyz="{4}"/>'
        '<limit lower="{5}" upper="{6}" effort="100" velocity="1"/></joint>'
        '<transmission name="{0}_drive"><type>transmission_interface/SimpleTransmission</type><joint name="{0}_joint">'
        '<hardwareInterface>EffortJointInterface</hardwareInterface></joint><actuator name="{0}_motor"/></transmission>'
    )
    rail.write_text(
        '<robot name="rail">'
        + "".join(map(link.format, ("base", "cart", "boom")))
        + joint.format("cart", "prismatic", "base", "0 0 0.5", "1 0 0", -2, 3)
        + joint.format("boom", "revolute", "cart", "0 0 1", "0 0 1", -3, 3)
        + "</robot>"
    )
    scene = add_twin_scene(DiagramBuilder(), Twin(arm=ArmModel(model=str(rail), tool_frame="")))
    points = points_along(scene)
    assert {-2.0, 3.0} <= set(np.round(points[:, 0], 9))
    assert angles(points, *view_of_arm(points)).max() < HALF_ANGLE
