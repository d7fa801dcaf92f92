"""Distances to the robot's shapes, each by its own formula, and fingers that are half open."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryInstance,
    HalfSpace,
    Mesh,
    ProximityProperties,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform

from twin_diagram import scenario
from twin_diagram.perception.segmentation import robot_kernels
from twin_diagram.perception.segmentation.robot_shape import RobotShape, _shapes, _told

Array = npt.NDArray[np.float64]
CORNERS = np.array([[x, y, z] for x in (-0.3, 0.1) for y in (-0.2, 0.2) for z in (-0.1, 0.1)])


def box(p: Array, half: Array) -> Array:
    rows = []
    for x in np.abs(p) - half:
        rows.append(np.linalg.norm(x[x > 0.0]) if (x > 0.0).any() else x.max())
    return np.array(rows)


def capsule(p: Array) -> Array:
    on = np.clip(p[:, 2], -0.25, 0.25)
    return np.asarray(np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + (p[:, 2] - on) ** 2) - 0.2)


SHAPES: dict[str, tuple[Shape, float, Callable[[Array], Array]]] = {
    "sphere": (Sphere(0.3), 0.3, lambda p: np.sqrt((p**2).sum(axis=1)) - 0.3),
    "box": (Box(0.4, 0.2, 0.6), np.sqrt(0.14), lambda p: box(p, np.array([0.2, 0.1, 0.3]))),
    "capsule": (Capsule(0.2, 0.5), 0.45, capsule),
    "cylinder": (
        Cylinder(0.3, 0.8),
        0.5,
        lambda p: box(np.stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]], axis=1), np.array([0.3, 0.4])),
    ),
    "ellipsoid": (
        Ellipsoid(0.3, 0.2, 0.1),
        0.3,
        lambda p: 0.1 * (np.sqrt((p[:, 0] / 0.3) ** 2 + (p[:, 1] / 0.2) ** 2 + (p[:, 2] / 0.1) ** 2) - 1.0),
    ),
    "hull": (
        Convex(points=CORNERS.T, label="hull"),
        np.sqrt(0.14),
        lambda p: np.max(np.abs(p - [-0.1, 0.0, 0.0]) - [0.2, 0.2, 0.1], axis=1),
    ),
}


def distance_to(shape: Shape) -> tuple[float, Callable[[Array], Array]] | None:
    scene_graph = SceneGraph()
    source = scene_graph.RegisterSource("test")
    geometry = scene_graph.RegisterAnchoredGeometry(source, GeometryInstance(RigidTransform(), shape, "shape"))
    scene_graph.AssignRole(source, geometry, ProximityProperties())
    assert Role.kProximity is not None
    found = _told(scene_graph.model_inspector(), geometry)
    if found is None:
        return None
    # After another one, so that numbers count.
    both = _shapes([(robot_kernels.HULL, np.zeros(3), np.ones((5, 4))), found[1:]])
    return found[0], lambda p: np.array([robot_kernels.distance_to(x, y, z, both, 1) for x, y, z in p])


@pytest.mark.parametrize("name", SHAPES)
def test_the_distance_to_a_shape_is_that_of_its_formula(name: str) -> None:
    shape, radius, wanted = SHAPES[name]
    found = distance_to(shape)
    assert found is not None and found[0] == pytest.approx(radius)
    points = np.random.default_rng(2151).uniform(-0.6, 0.6, (500, 3))
    np.testing.assert_allclose(found[1](points), wanted(points), atol=1e-9)
    assert 5 < np.count_nonzero(wanted(points) < 0.0) < 300


@pytest.mark.parametrize("faces", ["f 1 2 3", "f 1 2 3\nf 1 3 4"])
def test_a_plate_without_thickness_has_a_distance_to_both_sides(tmp_path: Path, faces: str) -> None:
    file = tmp_path / "plate.obj"
    file.write_text(f"v 0 -0.1 -0.1\nv 0 0.1 -0.1\nv 0 0.1 0.1\nv 0 -0.1 0.1\n{faces}\n")
    found = distance_to(Mesh(str(file)))
    assert found is not None
    points = np.array([[x, 0.05, -0.05] for x in (-0.03, -0.001, 0.001, 0.03)])
    np.testing.assert_allclose(found[1](points), [0.03, 0.001, 0.001, 0.03], atol=2e-4)


def test_what_has_no_end_is_no_part_of_a_robot() -> None:
    assert distance_to(HalfSpace()) is None


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotShape:
    """A link that turns and a finger of 1 to 5 cm on it, a ball of 2 cm each, the link's a metre out."""
    inertial = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>"
    ball = "<collision><origin xyz='{} 0 0.1'/><geometry><sphere radius='0.02'/></geometry></collision>"
    file = tmp_path_factory.mktemp("robot") / "arm.urdf"
    file.write_text(
        f"<robot name='arm'><link name='base'>{inertial}</link>"
        f"<link name='tip'>{inertial}{ball.format(1.0)}</link><link name='finger'>{inertial}{ball.format(0.0)}</link>"
        f"<link name='thumb'>{inertial}</link>"
        "<joint name='j' type='revolute'><parent link='base'/><child link='tip'/><axis xyz='0 0 1'/>"
        "<limit lower='-3' upper='3' effort='10' velocity='1'/></joint>"
        "<joint name='f' type='prismatic'><parent link='tip'/><child link='finger'/><origin xyz='2 0 0'/>"
        "<axis xyz='0 1 0'/><limit lower='0.01' upper='0.05' effort='10' velocity='1'/></joint>"
        "<joint name='g' type='prismatic'><parent link='tip'/><child link='thumb'/><origin xyz='2 0 0'/>"
        "<axis xyz='0 -1 0'/><limit lower='0.01' upper='0.05' effort='10' velocity='1'/></joint></robot>"
    )
    return RobotShape(scenario.ArmModel(model=str(Path(file)), tool_frame="", joints=["j"], gripper_joints=["f", "g"]))


def test_the_tool_is_where_the_arm_has_it(robot: RobotShape) -> None:
    turned = robot.tool(np.array([0.7]))
    np.testing.assert_allclose(turned[:2, :2], [[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]], atol=1e-12)
    np.testing.assert_allclose(turned[:3, 3], 0.0, atol=1e-12)


@pytest.mark.parametrize("margin", [0.005, 0.05, 0.4])
def test_near_is_within_the_margin_of_a_shape_where_the_arm_stands(robot: RobotShape, margin: float) -> None:
    assert robot.joint_count == 1
    rng = np.random.default_rng(2152)
    for angle in (0.0, 0.7, -1.9):
        c, s = np.cos(angle), np.sin(angle)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        middles = [R @ [1.0, 0.0, 0.1], R @ [2.0, 0.03, 0.1]]  # half open
        reach = margin + 0.02
        points = np.concatenate([middle + rng.uniform(-1.3, 1.3, (400, 3)) * reach for middle in middles])
        away = np.min([np.linalg.norm(points - middle, axis=1) for middle in middles], axis=0) - 0.02
        np.testing.assert_array_equal(robot.near(points, np.array([angle]), margin), away < margin)
    assert robot.near(np.zeros((0, 3)), np.zeros(1), margin).shape == (0,)
