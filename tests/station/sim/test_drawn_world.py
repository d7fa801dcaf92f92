"""Pictures that are drawn without VTK: against Drake's VTK renderer, closed forms, and where they give up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import (
    Box,
    DepthRange,
    Ellipsoid,
    GeometryInstance,
    Mesh,
    PerceptionProperties,
    QueryObject,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.scenario import Camera, Pose, Scenario, WorldObject
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import Lens
from twin_diagram.station.sim import world_renderer
from twin_diagram.station.sim.drawn_shapes import drawn_shapes
from twin_diagram.station.sim.drawn_world import DrawnWorld
from twin_diagram.station.sim.raster_kernels import clipped, draw
from twin_diagram.station.sim.render_settings import clipping, lights, render_params
from twin_diagram.station.sim.world_renderer import LensView, WorldRenderer

VIEW = LensView(Lens.centred(320, 240, 300.0))
X_WC = RigidTransform(RollPitchYaw(-2.27, 0.0, 1.571), [1.4, 0.0, 0.85])


def tabletop() -> Scenario:
    scenario = load_scenario("demo")
    scenario.world.objects["mover"] = WorldObject("objects/flask", X_WO=Pose([0.55, -0.05, 0.1], [0.0, 0.0, 0.4]))
    return scenario


@pytest.fixture(scope="module")
def both(egl: None) -> tuple[WorldRenderer, WorldRenderer, Array]:
    """What draws itself, Drake's renderer, positions."""
    scenario, camera = tabletop(), Camera()
    told = (scenario, render_params(), clipping(camera), DepthRange(*camera.depth_range))
    with pytest.MonkeyPatch.context() as patch:
        drawn = WorldRenderer(*told)
        patch.setattr(world_renderer, "drawn_shapes", lambda scene_graph: None)
        vtk = WorldRenderer(*told)
    assert drawn._drawn is not None and vtk._drawn is None
    plant = drawn._plant
    return drawn, vtk, np.asarray(plant.GetPositions(plant.CreateDefaultContext()))


def test_depth_is_drakes_but_at_edges(both: tuple[WorldRenderer, WorldRenderer, Array]) -> None:
    drawn, vtk, q = both
    ours, theirs = drawn.depth(q, VIEW, X_WC), vtk.depth(q, VIEW, X_WC)
    assert (np.isfinite(ours) == np.isfinite(theirs)).mean() > 0.9995
    there = np.isfinite(ours) & np.isfinite(theirs)
    off = np.abs(ours[there] - theirs[there])
    assert np.median(off) < 1e-6 and (off > 1e-3).mean() < 3e-3


def test_colours_are_drakes_but_at_edges(both: tuple[WorldRenderer, WorldRenderer, Array]) -> None:
    drawn, vtk, q = both
    ours, theirs = (each.colour(q, VIEW, X_WC).astype(int)[..., :3] for each in (drawn, vtk))
    off = np.abs(ours - theirs).max(axis=-1)
    assert (off <= 1).mean() > 0.92 and (off <= 10).mean() > 0.95
    assert np.abs((ours - theirs).mean(axis=(0, 1))).max() < 0.2
    assert ours.std() > 40.0


def test_of_two_pictures_only_what_moves_is_drawn_twice(both: tuple[WorldRenderer, WorldRenderer, Array]) -> None:
    drawn, vtk, q = both
    arm, thing = q.copy(), q.copy()
    arm[:7] += 0.01
    plant = drawn._plant
    body = plant.get_body(drawn.objects["cracker_box"])
    thing[body.floating_positions_start() + 4] += 0.004
    for moved in (arm, thing, q + 1e-9):
        first, second = drawn.colours(q, moved, VIEW, X_WC)
        np.testing.assert_array_equal(first, drawn.colour(q, VIEW, X_WC))
        whole = drawn.colour(moved, VIEW, X_WC).astype(int)
        assert (np.abs(second - whole).max(axis=-1) > 1).sum() <= 3
        assert (np.abs(first - whole).max() > 20) == (moved is not q and np.abs(moved - q).max() > 1e-6)
    assert vtk.colours(q, thing, VIEW, X_WC)[0] is not None


def test_a_picture_asks_for_each_frame_s_pose_once(
    both: tuple[WorldRenderer, WorldRenderer, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second call for all frames takes 4 % of a picture's time."""
    drawn, _, q = both
    world, asked = drawn._drawn, 0
    assert world is not None
    poses = world.poses

    def counted(query: QueryObject) -> tuple[Array, Array]:
        nonlocal asked
        asked += 1
        R, p = poses(query)
        for frame, rotation, place in zip(world._shapes.frames, R, p, strict=True):
            X_WF = query.GetPoseInWorld(frame)
            np.testing.assert_array_equal(rotation, X_WF.rotation().matrix())
            np.testing.assert_array_equal(place, X_WF.translation())
        return R, p

    monkeypatch.setattr(world, "poses", counted)
    moved = q.copy()
    moved[:7] += 0.01
    drawn.colours(q, moved, VIEW, X_WC)
    assert asked == 2


def test_labels_are_drakes_but_at_edges(both: tuple[WorldRenderer, WorldRenderer, Array]) -> None:
    drawn, vtk, q = both
    label = int(drawn.objects["cracker_box"])
    ours, theirs = (each.shows(q, VIEW, X_WC, [label]) for each in (drawn, vtk))
    assert theirs.sum() > 500 and (ours != theirs).sum() < 0.02 * theirs.sum()


def world_of(*shapes: tuple[Box | Ellipsoid | Mesh, RigidTransform]) -> tuple[SceneGraph, DrawnWorld | None]:
    """A world of shapes that stand still, grey, and what draws it."""
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    source = plant.RegisterAsSourceForSceneGraph(scene_graph)
    plant.Finalize()
    for k, (shape, X_WG) in enumerate(shapes):
        instance = GeometryInstance(X_WG, shape, f"shape{k}")
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", Rgba(0.5, 0.5, 0.5))
        instance.set_perception_properties(properties)
        scene_graph.RegisterAnchoredGeometry(source, instance)
    found = drawn_shapes(scene_graph)
    return scene_graph, None if found is None else DrawnWorld(found, lights(), (0.0, 0.0, 1.0), 0.05, 20.0)


def query_of(scene_graph: SceneGraph) -> object:
    context = scene_graph.CreateDefaultContext()
    return scene_graph.get_query_output_port().Eval(context)


def test_a_floor_that_reaches_behind_the_camera_is_a_plane() -> None:
    scene_graph, world = world_of((Box(40.0, 40.0, 0.2), RigidTransform([0.0, 0.0, -0.1])))
    assert world is not None
    lens, X = Lens(64, 48, 50.0, 55.0, 30.0, 25.0), RigidTransform(RollPitchYaw(-2.0, 0.2, 0.3), [0.0, 0.0, 1.3])
    depth = world.depth(query_of(scene_graph), lens, X, 0.1, 10.0)
    v, u = np.mgrid[:48, :64]
    rays = np.stack([(u - 30.0) / 50.0, (v - 25.0) / 55.0, np.ones(u.shape)], axis=-1) @ X.rotation().matrix().T
    with np.errstate(divide="ignore"):
        exact = np.where(rays[..., 2] < 0.0, -1.3 / rays[..., 2], np.inf)
    seen = exact < 10.0
    np.testing.assert_array_equal(np.isfinite(depth), seen)
    np.testing.assert_allclose(depth[seen], exact[seen], rtol=1e-5)


def test_what_is_nearer_hides_what_is_farther_and_ranges_are_kept() -> None:
    near, far = RigidTransform([0.0, 0.0, 1.0]), RigidTransform([0.0, 0.0, 2.0])
    scene_graph, world = world_of((Box(0.4, 0.4, 0.2), near), (Box(9.0, 9.0, 0.2), far))
    assert world is not None
    lens, query = Lens.centred(41, 41, 40.0), query_of(scene_graph)
    depth = world.depth(query, lens, RigidTransform(), 0.5, 5.0)
    assert depth[20, 20] == pytest.approx(0.9) and depth[0, 0] == pytest.approx(1.9)
    assert ((depth < 1.0).sum() - 1) ** 0.5 == pytest.approx(0.4 / 0.9 * 40.0, abs=1.0)
    assert world.depth(query, lens, RigidTransform(), 1.0, 1.5)[20, 20] == 0.0
    assert np.isinf(world.depth(query, lens, RigidTransform(), 1.0, 1.5)[0, 0])


def test_half_a_pixel_of_a_surface_is_half_its_colour() -> None:
    # Seen from below, where no light falls: black before a blue sky.
    scene_graph, world = world_of((Box(4.0, 4.0, 0.2), RigidTransform([2.0, 0.0, 1.1])))
    assert world is not None
    image = world.colour(query_of(scene_graph), Lens.centred(5, 5, 2.0), RigidTransform())
    np.testing.assert_array_equal(image[2, :, 2], [255, 255, 128, 0, 0])
    assert (image[..., 3] == 255).all()


def test_neighbouring_triangles_leave_no_gap_and_overlap_nowhere() -> None:
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), axis=-1)
    grid[1:-1, 1:-1] += 0.03 * rng.standard_normal((7, 7, 2))
    points = np.concatenate([grid, np.ones((9, 9, 1))], axis=-1).reshape(-1, 3)
    corner = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 9], corner[:, None] + [1, 10, 9]])
    lens, samples = np.array([20.0, 20.0, 20.0, 20.0]), np.array([[0.013, 0.007], [-0.3, 0.21]])
    count = np.zeros((2, 41, 41), dtype=int)
    for face in faces:
        nearest, who = np.zeros((2, 41, 41), np.float32), np.full((2, 41, 41), -1, np.int32)
        draw(points, face[None], np.zeros(1, dtype=bool), lens, 0.1, samples, nearest, who)
        count += who >= 0
    assert count.max() == 1 and (count[:, 1:-1, 1:-1] == 1).all()


def test_what_is_before_the_camera_is_cut_off() -> None:
    polygon = np.empty((4, 5))
    corners = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, -2.0], [0.0, 1.0, 2.0]])
    count = clipped(corners, 1.0, polygon)
    assert count == 4 and (polygon[:count, 2] >= 1.0 - 1e-12).all()
    assert clipped(corners - [0.0, 0.0, 5.0], 1.0, polygon) == 0


def test_shapes_of_another_kind_are_left_to_drake() -> None:
    assert world_of((Ellipsoid(0.1, 0.2, 0.3), RigidTransform()))[1] is None


def test_an_asset_that_was_built_anew_is_drawn_with_its_new_texture(tmp_path: Path) -> None:
    """What was read of its files before, in the same process, is that of the old one."""
    import cv2

    name = tmp_path / "visual.obj"
    name.write_text(
        "mtllib visual.mtl\nusemtl surface\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
        "f 1/1/1 2/2/1 3/3/1\n"
    )
    (tmp_path / "visual.mtl").write_text("newmtl surface\nmap_Kd visual.png\n")
    for colour in (40, 200):
        cv2.imwrite(str(tmp_path / "visual.png"), np.full((4, 4, 3), colour, np.uint8))
        scene_graph, _ = world_of((Mesh(str(name)), RigidTransform()))
        found = drawn_shapes(scene_graph)
        assert found is not None
        np.testing.assert_array_equal(found.texels, colour)


@pytest.mark.parametrize("line", ["Kd 0.5 0.5 0.5", "map_Bump bumps.png", "newmtl other"])
def test_materials_of_another_kind_are_left_to_drake(tmp_path: Path, line: str) -> None:
    from twin_diagram.station.sim.drawn_shapes import only_texture

    library = tmp_path / "visual.mtl"
    library.write_text("newmtl surface\nKd 1 1 1\nKs 0 0 0\nmap_Kd visual.png\n")
    assert only_texture(library) == tmp_path / "visual.png"
    library.write_text(library.read_text() + line + "\n")
    assert only_texture(library) is None
    library.write_bytes("# Küche\nnewmtl surface\nmap_Kd visual.png\n".encode("latin-1"))
    assert only_texture(library) is None, "a remark in another encoding is no error"
