"""Clouds, the robot's points, the table, and the segments that are left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.perception.pinhole import Pinhole, back_project, surface_at
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.perception.segmentation.segmentation import (
    Grid,
    segment,
)
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.resources import models_dir

PARAMS = scenario.Perception()


@pytest.fixture(scope="module")
def box() -> Asset:
    return Asset.load(models_dir() / "objects" / "sugar_box")


@pytest.fixture(scope="module")
def can() -> Asset:
    return Asset.load(models_dir() / "objects" / "can")


def scene(box: Asset, can: Asset) -> list[Thing]:
    return [
        Thing(box, 7, yawed(0.4), np.array([0.5, -0.2, box.size[2] / 2])),
        Thing(can, 5, yawed(0.0), np.array([0.6, 0.15, can.size[2] / 2])),
        Thing(box, 7, yawed(-1.0), np.array([0.35, 0.2, box.size[2] / 2])),
    ]


@settings(max_examples=40)
@given(x=st.floats(0.1, 1.0), y=st.floats(-0.5, 0.5), z=st.floats(0.0, 0.4))
def test_projection_and_back(x: float, y: float, z: float) -> None:
    view = camera()
    point = np.array([x, y, z])
    u, v, depth = view.project(point)
    cu, cv = view.centre
    ray = view.R_WC @ np.array([(u - cu) / view.focal, (v - cv) / view.focal, 1.0])
    assert np.allclose(view.p_WC + depth * ray, point, atol=1e-12)


def test_pixel_centres_and_stride() -> None:
    view = Pinhole.from_scenario(scenario.Camera())
    assert view.centre == (319.5, 239.5)
    fine, coarse = view.rays(1), view.rays(3)
    assert np.array_equal(fine[::3, ::3], coarse)
    # The two middle pixels look equally far to either side of the optical axis.
    assert np.allclose(0.5 * (fine[239, 319] + fine[240, 320]), view.R_WC[:, 2])


def test_normals_of_a_sloping_plane() -> None:
    view = camera()
    rays = view.rays()
    normal = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    depth = (-(view.p_WC @ normal) / (rays @ normal)).astype(np.float32)
    points = back_project(depth, rays, view.p_WC)
    assert np.allclose(points @ normal, 0.0, atol=1e-6)
    at = np.nonzero(depth[240:280, 300:340] > 0)
    at = (at[0] + 240, at[1] + 300)
    assert np.allclose(surface_at(depth, rays, at, view.p_WC)[1], normal, atol=1e-3)


def test_things_come_apart(box: Asset, can: Asset) -> None:
    view = camera()
    rgb, depth, owner = picture(view, scene(box, can), np.random.default_rng(3))
    found = segment(rgb, depth, 1.5, Grid.of(view, 2), PARAMS)
    assert found.count == 3 and found.time == 1.5
    truth = owner[::2, ::2]
    for k in range(3):
        pixels = found.label_image[truth == k]
        label = np.bincount(pixels[pixels >= 0]).argmax()
        both = np.logical_and(found.label_image == label, truth == k).sum()
        either = np.logical_or(found.label_image == label, truth == k).sum()
        assert both / either > 0.8, k
        assert (truth[found.label_image == label] == k).all()
    # What is the table's stays the table's.
    assert (found.label_image[truth == -1] < 0).mean() > 0.9999
    assert np.abs(found.table).max() < 2e-3
    assert found.points_W.shape == found.normals_W.shape == found.colours.shape == (len(found.labels), 3)
    assert np.allclose(np.linalg.norm(found.normals_W, axis=1), 1.0)


def test_nothing_can_be_written_to(box: Asset, can: Asset) -> None:
    view = camera()
    rgb, depth, _ = picture(view, scene(box, can))
    found = segment(rgb, depth, 0.0, Grid.of(view, 2), PARAMS)
    for array in (found.points_W, found.labels, found.depth, found.rgb, found.label_image, found.table):
        with pytest.raises(ValueError):
            array[...] = 0
    # And the images that came in are not the ones that go out.
    depth[:] = 0
    assert found.depth.max() > 0


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 1e-3])
def test_images_without_sense_give_no_segments(value: float) -> None:
    view = camera()
    rgb = np.zeros((480, 640, 3), dtype=np.uint8)
    found = segment(rgb, np.full((480, 640), value, dtype=np.float32), 0.0, Grid.of(view, 2), PARAMS)
    assert found.count == 0 and len(found.points_W) == 0
    empty = Segments.empty(view, 2)
    assert empty.time < 0 and empty.label_image.shape == found.label_image.shape


def test_specks_are_no_objects(box: Asset, can: Asset) -> None:
    view = camera()
    rgb, depth, _ = picture(view, scene(box, can)[:1])
    rng = np.random.default_rng(1)
    speck = rng.random(depth.shape) < 0.002
    depth[speck] -= 0.1
    found = segment(rgb, depth, 0.0, Grid.of(view, 2), PARAMS)
    assert found.count == 1


@pytest.fixture(scope="module")
def robot() -> RobotShape:
    return RobotShape(scenario.ArmModel())


def test_distance_to_the_robot_is_drakes(robot: RobotShape) -> None:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    arm = add_arm(plant, scenario.ArmModel())
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyContextFromRoot(context)
    rng = np.random.default_rng(5)
    for _ in range(3):
        q = rng.uniform(-1.5, 1.5, robot.joint_count)
        for index, angle in zip(arm.joint_indices, q, strict=True):
            plant.get_joint(index).set_angle(plant_context, angle)
        for index in arm.gripper_joint_indices:
            joint = plant.get_joint(index)
            middle = (joint.position_lower_limits()[0] + joint.position_upper_limits()[0]) / 2
            joint.set_translation(plant_context, middle)
        query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
        points = rng.uniform([-0.6, -0.6, 0.0], [0.8, 0.6, 1.2], (300, 3))
        exact = np.array([min(one.distance for one in query.ComputeSignedDistanceToPoint(p)) for p in points])
        for margin in (0.005, 0.025, 0.1):
            sure = np.abs(exact - margin) > 1e-6
            assert np.array_equal(robot.near(points, q, margin)[sure], (exact < margin)[sure])


def test_every_kind_of_shape_has_its_distance(tmp_path: Path) -> None:
    (tmp_path / "hull.obj").write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    shapes = [
        "<box size='.1 .2 .3'/>",
        "<sphere radius='.1'/>",
        "<cylinder radius='.05' length='.3'/>",
        "<capsule radius='.05' length='.3'/>",
        "<mesh filename='hull.obj'/>",
    ]
    collisions = "".join(
        f"<collision name='c{k}'><origin xyz='{0.4 * k} 0.1 0' rpy='0.3 0.2 {k}'/>"
        f"<geometry>{shape}</geometry></collision>"
        for k, shape in enumerate(shapes)
    )
    inertial = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>"
    (tmp_path / "arm.urdf").write_text(
        f"<robot name='arm'><link name='base'>{inertial}</link><link name='tip'>{inertial}{collisions}</link>"
        "<joint name='j' type='revolute'><parent link='base'/><child link='tip'/><axis xyz='0 0 1'/>"
        "<limit lower='-3' upper='3' effort='10' velocity='1'/></joint></robot>"
    )
    spec = scenario.ArmModel(model=str(tmp_path / "arm.urdf"), tool_frame="")
    robot = RobotShape(spec)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    add_arm(plant, spec)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    points = np.random.default_rng(0).uniform([-0.3, -0.3, -0.3], [1.9, 0.5, 0.3], (2000, 3))
    exact = np.array([min(one.distance for one in query.ComputeSignedDistanceToPoint(p)) for p in points])
    near = robot.near(points, np.zeros(1), 0.02)
    # Near the corners of a hull the robot may be taken for a little larger than it is, never for smaller.
    assert near[exact < 0.02 - 1e-9].all()
    assert not near[exact > 0.05].any()
    assert (near == (exact < 0.02)).mean() > 0.99


def test_the_robot_is_left_out(box: Asset, can: Asset, robot: RobotShape) -> None:
    view = camera()
    q = np.array([0.3, 0.4, 0.0, -1.9, 0.0, 2.1, 0.785])
    # Balls on the arm's own shapes: where its elbow and hand are.
    probe = np.random.default_rng(2).uniform([0.1, -0.3, 0.1], [0.8, 0.4, 0.6], (20000, 3))
    inside = probe[robot.near(probe, q, -0.02)]
    balls = [(centre, 0.02) for centre in inside[:60]]
    rgb, depth, owner = picture(view, scene(box, can), np.random.default_rng(3), balls=balls)
    truth = owner[::2, ::2]
    near = lambda points, margin: robot.near(points, q, margin)  # noqa: E731
    found = segment(rgb, depth, 0.0, Grid.of(view, 2), PARAMS, near)
    assert (truth == -2).sum() > 200
    kinds = found.label_image[truth == -2]
    assert np.isin(kinds, [SEGMENTS.robot, SEGMENTS.no_depth, SEGMENTS.background]).all()
    assert found.count <= 3
    # Without it the balls are something unknown.
    assert segment(rgb, depth, 0.0, Grid.of(view, 2), PARAMS).count > found.count


def test_shapes_of_another_scene_graph_do_not_leak(robot: RobotShape) -> None:
    assert SceneGraph().model_inspector().num_geometries() == 0
    points = np.array([[0.0, 0.0, 0.2], [3.0, 0.0, 0.0]])
    first = robot.near(points, np.zeros(7), 0.02)
    robot.near(points, np.full(7, 0.5), 0.02)
    assert np.array_equal(robot.near(points, np.zeros(7), 0.02), first)
    assert list(first) == [True, False]
    assert robot.near(np.zeros((0, 3)), np.zeros(7), 0.1).size == 0
