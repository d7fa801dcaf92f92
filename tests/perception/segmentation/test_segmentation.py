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
from twin_diagram.perception.pinhole import Pinhole, back_project, grid_normals
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.perception.segmentation.segmentation import (
    Grid,
    above_table,
    connected,
    fit_table,
    in_workspace,
    large_parts,
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
    assert np.allclose(grid_normals(points, depth > 0, at, view.p_WC), normal, atol=1e-3)


@settings(max_examples=25)
@given(
    a=st.floats(-0.008, 0.008), b=st.floats(-0.008, 0.008), c=st.floats(-0.005, 0.005), seed=st.integers(0, 2**32 - 1)
)
def test_table_is_found_among_other_things(a: float, b: float, c: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform([0.1, -0.6], [1.0, 0.6], (6000, 2))
    plane = np.column_stack([xy, xy @ [a, b] + c + 0.001 * rng.standard_normal(6000)])
    clutter = np.column_stack([rng.uniform([0.1, -0.6], [1.0, 0.6], (2500, 2)), rng.uniform(-0.01, 0.3, 2500)])
    found = fit_table(np.concatenate([plane, clutter]), 0.0)
    corner = np.array([[0.2, -0.4, 1.0], [0.9, 0.4, 1.0], [0.2, 0.4, 1.0]])
    assert np.abs(corner @ found - corner @ [a, b, c]).max() < 1.2e-3


def test_no_table_leaves_the_known_height() -> None:
    assert np.array_equal(fit_table(np.zeros((0, 3)), 0.02), [0.0, 0.0, 0.02])
    rng = np.random.default_rng(0)
    steep = rng.uniform(-1, 1, (5000, 3))
    steep[:, 2] = 0.05 * steep[:, 0]
    assert np.array_equal(fit_table(steep[np.abs(steep[:, 2]) < 0.014], 0.0), [0.0, 0.0, 0.0])


def test_connected_parts_of_a_grid() -> None:
    points = np.zeros((20, 30, 3))
    points[..., 0], points[..., 1] = np.meshgrid(np.arange(30) * 0.005, np.arange(20) * 0.005)
    inside = np.ones((20, 30), dtype=bool)
    assert set(connected(points, inside, 0.02)) == {0}
    # A step in depth cuts; a single column without depth does not; two do.
    step = points.copy()
    step[:, 15:, 2] = 0.03
    assert len(set(connected(step, inside, 0.02))) == 2
    inside[:, 15] = False
    assert len(set(connected(points, inside, 0.02))) == 1
    inside[:, 16] = False
    assert len(set(connected(points, inside, 0.02))) == 2
    assert connected(points, np.zeros_like(inside), 0.02).size == 0


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


def dominant_plane(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Normal towards the origin and a point of the plane that most points lie on."""
    best, count = (np.zeros(3), np.zeros(3)), 0
    for _ in range(200):
        a, b, c = points[rng.integers(0, len(points), 3)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length > 1e-4:
            normal /= length
            near = int((np.abs((points[::20] - a) @ normal) < 0.008).sum())
            if near > count:
                best, count = (normal, a), near
    normal, a = best
    for _ in range(3):
        near = points[np.abs((points - a) @ normal) < 0.01]
        a = near.mean(axis=0)
        normal = np.linalg.svd(near[::10] - a, full_matrices=False)[2][2]
    return (normal if normal @ a < 0 else -normal), a


@pytest.mark.parametrize(
    ("name", "apart"),
    [
        ("learn/learn5", 2),
        ("test/test1", 2),
        ("test/test5", 2),
        ("test/test26", 1),
        ("test/test33", 3),
        ("test/test40", 2),
    ],
)
def test_real_tabletops(data_dir: Path, egl: None, name: str, apart: int) -> None:
    """Real Kinect images; their labels score the result and do nothing else. Objects that touch count as one."""
    file = data_dir / "kinect_tabletop" / f"{name}.pcd"
    if not file.is_file():
        pytest.skip(f"no {file}")
    from twin_diagram.native import import_open3d

    o3d = import_open3d()
    cloud = o3d.t.io.read_point_cloud(str(file))
    points = cloud.point.positions.numpy().astype(float)
    colours = cloud.point.colors.numpy().reshape(480, 640, 3)
    truth = cloud.point.label.numpy().reshape(480, 640)[::2, ::2].astype(int)
    normal, p_CT = dominant_plane(points[np.isfinite(points).all(axis=1)], np.random.default_rng(0))
    x = np.cross([0.0, 0.0, 1.0], normal)
    x /= np.linalg.norm(x)
    R_WC = np.stack([x, np.cross(normal, x), normal])
    view = Pinhole(640, 480, 525.0, R_WC, -R_WC @ p_CT)
    depth = np.nan_to_num(points[:, 2]).reshape(480, 640).astype(np.float32)
    params = scenario.Perception(workspace=[[-1.5, -1.5, -0.02], [1.5, 1.5, 0.6]])
    found = segment(colours, depth, 0.0, Grid.of(view, 2), params)

    on_object, claimed = truth >= 20, found.label_image >= 0
    assert (on_object & claimed).sum() / on_object.sum() > 0.97
    assert (on_object & claimed).sum() / (claimed & (truth > 0)).sum() > 0.99
    owners = set()
    for thing in np.unique(truth[on_object] // 10):
        labels = found.label_image[(truth // 10 == thing) & claimed]
        owners.add(int(np.bincount(labels).argmax()))
    assert len(owners) == apart


# Thresholds.


def test_the_workspace_is_open() -> None:
    corners = [[-1.0, -0.5, 0.0], [1.0, 0.5, 0.6]]
    middle = np.mean(corners, axis=0)
    for axis in range(3):
        for edge, way in ((corners[0], 1), (corners[1], -1)):
            at, beyond, within = (middle.copy() for _ in range(3))
            at[axis], beyond[axis], within[axis] = edge[axis], edge[axis] - way * 1e-6, edge[axis] + way * 1e-6
            assert in_workspace(np.array([[at, beyond, within, middle]]), corners)[0].tolist() == [0, 0, 1, 1]


def test_what_stands_out_of_a_tilted_table_is_found_by_its_height() -> None:
    """The clearance asked for, or four standard deviations of depth where these are more: 0.8 mm at 1 m."""
    table = np.array([0.1, -0.2, 0.3])
    x, y = np.meshgrid(np.linspace(0.2, 0.8, 5), np.linspace(-0.4, 0.4, 5))
    top = table[0] * x + table[1] * y + table[2]
    for depth, least, needed in ((0.5, 0.006, 0.006), (2.0, 0.006, 0.0128), (1.0, 0.001, 0.0032)):
        for share, found in ((0.99, False), (1.01, True)):
            points = np.stack([x, y, top + share * needed], axis=2)
            assert (above_table(points, np.full(x.shape, depth, np.float32), table, least) == found).all()


def test_parts_are_numbered_anew_where_they_are_large_enough() -> None:
    part = np.array([0, 1, 1, 2, 2, 2, 3, 1, 4, 4])
    label, count = large_parts(part, 3)
    assert count == 2 and label.tolist() == [-1, 0, 0, 1, 1, 1, -1, 0, -1, -1]
    assert large_parts(np.zeros(0, dtype=np.int64), 3)[1] == 0
