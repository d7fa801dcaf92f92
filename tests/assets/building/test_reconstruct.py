"""From pictures to a mesh: volume, walls, poses, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.assets.building.pictured import Shots, box, cameras, cup, shots, write
from twin_diagram.assets import Asset
from twin_diagram.assets.building import build_from_frames, build_from_predictions
from twin_diagram.assets.building.contradictions import agreeing
from twin_diagram.assets.building.decimation import enclosed_volume, is_closed
from twin_diagram.assets.building.depth_view import DepthView, make_view, surface_normals, thinned, view_points
from twin_diagram.assets.building.fusion import FusionGrid, fuse
from twin_diagram.assets.building.looking_past import check_unseen
from twin_diagram.assets.building.outlines import outline
from twin_diagram.assets.building.predictions import metric, read_predictions
from twin_diagram.assets.building.reconstruct import (
    Reconstruction,
    held_points,
    looked_over,
    object_points,
    reconstruct,
)
from twin_diagram.assets.building.selection import the_one_thing
from twin_diagram.assets.building.view_poses import align, mean_surface
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.mesh import read_png
from twin_diagram.cli import main
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.native import import_open3d
from twin_diagram.signals import rotations


def apart(found: Reconstruction, body: trimesh.Trimesh) -> np.ndarray:
    """Distances from the body's surface to what was built [m]."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor(found.vertices.astype(np.float32)), o3d.core.Tensor(found.faces.astype(np.uint32))
    )
    points = trimesh.sample.sample_surface(body, 4000, seed=0)[0].astype(np.float32)
    return np.asarray(scene.compute_distance(o3d.core.Tensor(points)).numpy())


@pytest.fixture(scope="module")
def mug() -> Shots:
    return shots([cup()], cameras(14, 0.025))


@pytest.fixture(scope="module")
def built_mug(mug: Shots) -> Reconstruction:
    return reconstruct(mug)


@pytest.mark.long
def test_cup_keeps_its_wall_and_its_hollow(built_mug: Reconstruction) -> None:
    body = cup()
    assert is_closed(built_mug.faces)
    assert enclosed_volume(built_mug.vertices, built_mug.faces) == pytest.approx(body.volume, rel=0.06)
    off = apart(built_mug, body)
    assert off.mean() < 0.0004 and np.quantile(off, 0.95) < 0.0012
    assert 0.02 < built_mug.unseen < 0.25  # its bottom, an eighth
    assert built_mug.plane is not None
    np.testing.assert_allclose(built_mug.plane, [0, 0, 1, 0], atol=2e-4)


def test_wrong_poses_are_put_right() -> None:
    taken = shots([box((0.06, 0.04, 0.03))], cameras(12, 0.015, high=60))
    rng = np.random.default_rng(5)
    off = [np.concatenate([rng.normal(0, 0.003, 3), rng.normal(0, 0.0015, 3)]) for _ in taken.frames]
    centre = np.array([0, 0, 0.015])
    wrong = taken.told(off, centre)
    views = [make_view(frame.camera, frame.depth) for frame in wrong.frames]
    low, high = np.array([-0.03, -0.02, 0.0]), np.array([0.03, 0.02, 0.03])
    found = align(views, low, high, np.array([0, 0, 1.0, 0]))

    def off_surface(cameras_now: list[ViewCamera]) -> float:
        """RMS by which what each view shows is off across the surface [m]; what no surface tells does not count."""
        twists, parts = [], []
        for frame, view, camera in zip(taken.frames, views, cameras_now, strict=True):
            R = camera.R_WC @ frame.camera.R_WC.T
            shift = camera.p_WC - R @ frame.camera.p_WC + R @ centre - centre
            twists.append(np.concatenate([rotations.log(rotations.from_matrix(R)), shift]))
            points, normals, _ = view_points(view.at(frame.camera), 2, 0.2)
            near = np.abs(points - centre).max(axis=1) < 0.035
            parts.append(np.hstack([np.cross(points - centre, normals), normals])[near])
        common = np.mean(twists, axis=0)  # all of them may move alike
        moves = np.concatenate([J @ (twist - common) for J, twist in zip(parts, twists, strict=True)])
        return float(np.sqrt((moves**2).mean()))

    assert off_surface([frame.camera for frame in wrong.frames]) > 0.001
    assert off_surface([view.camera for view in found.views]) < 0.0003
    assert found.noise < 0.0005 and found.explained.min() > 0.9


def test_few_views_of_a_cup_are_told_across_the_picture_by_outlines() -> None:
    taken, centre = shots([cup()], cameras(8, 0.025)), np.array([0, 0, 0.025])
    rng = np.random.default_rng(0)
    wrong = taken.told([np.append(np.zeros(3), [*rng.normal(0, 0.0015, 2), 0.0]) for _ in taken.frames], np.zeros(3))
    views = [make_view(frame.camera, frame.depth) for frame in wrong.frames]
    found = align(views, np.array([-0.03, -0.03, 0.0]), np.array([0.03, 0.03, 0.05]), np.array([0, 0, 1.0, 0]))
    left = []
    for frame, view in zip(taken.frames, found.views, strict=True):
        R = view.camera.R_WC @ frame.camera.R_WC.T
        left.append((view.camera.p_WC - R @ (frame.camera.p_WC - centre) - centre)[:2])
    off = np.linalg.norm(left - np.mean(left, axis=0), axis=1)
    assert np.sqrt((off**2).mean()) < 0.0004  # by what faces the cameras alone: 1.3 mm


def test_an_outline_lies_where_a_thing_ends_and_faces_outwards() -> None:
    view = make_view(*above_a_box())
    points, normals = outline(view)
    place, out = points @ view.camera.R_WC.T + view.camera.p_WC, normals @ view.camera.R_WC.T
    side = np.argmax(np.abs(place[:, :2]) / [0.03, 0.02], axis=1)
    rows = np.arange(len(place))
    clear = np.abs(place[:, :2] / [0.03, 0.02]).min(axis=1) < 0.75  # a corner is round
    assert np.count_nonzero(clear) > 100
    np.testing.assert_allclose(np.abs(place[rows, side]), np.array([0.03, 0.02])[side], atol=0.0007)  # half a pixel
    facing = out[rows, side] * np.sign(place[rows, side])
    assert facing[clear].min() > 0.98
    np.testing.assert_allclose(place[:, 2], 0.03, atol=1e-3)
    low = shots([box((0.06, 0.04, 0.008))], cameras(1, 0.0, low=70)).frames[0]
    assert len(outline(make_view(low.camera, low.depth))[0]) == 0  # what lies on a table ends where that goes on


def above_a_box() -> tuple[ViewCamera, np.ndarray]:
    """A camera straight above a box, and what it sees."""
    R = np.diag([1.0, -1.0, -1.0])
    camera = ViewCamera(200, 160, 300.0, 300.0, 99.5, 79.5, R, np.array([0.0, 0.0, 0.38]))
    return camera, shots([box((0.06, 0.04, 0.03))], [camera]).frames[0].depth


def test_what_a_view_does_not_tell_is_said(mug: Shots) -> None:
    views = [make_view(frame.camera, frame.depth) for frame in mug.frames]
    found = align(views, np.array([-0.03, -0.03, 0.0]), np.array([0.03, 0.03, 0.05]), np.array([0, 0, 1.0, 0]))
    sure = np.sqrt(np.einsum("vii->vi", found.covariances))
    assert (sure[:, 2] > 2 * sure[:, 0]).all() and sure[:, 2].max() < 0.0036  # turned about the cup's axis


def test_right_poses_stay(mug: Shots) -> None:
    views = [make_view(frame.camera, frame.depth) for frame in mug.frames]
    found = align(views, np.array([-0.03, -0.03, 0.0]), np.array([0.03, 0.03, 0.05]), np.array([0, 0, 1.0, 0]))
    for before, after in zip(views, found.views, strict=True):
        assert np.linalg.norm(before.camera.p_WC - after.camera.p_WC) < 0.0006


def test_what_all_views_must_do_together_is_done() -> None:
    taken = shots([cup()], cameras(12, 0.025, high=60))
    inward = [frame.camera.R_WC[:, 2] * [1, 1, 0] for frame in taken.frames]
    inward = [0.001 * way / np.linalg.norm(way) for way in inward]  # a cup too slender, its walls too thin
    wrong = taken.told([np.append(np.zeros(3), way) for way in inward], np.zeros(3))
    views = [make_view(frame.camera, frame.depth) for frame in wrong.frames]
    found = align(views, np.array([-0.03, -0.03, 0.0]), np.array([0.03, 0.03, 0.05]), np.array([0, 0, 1.0, 0]))
    left = [
        (view.camera.p_WC - frame.camera.p_WC) @ way / 0.001
        for view, frame, way in zip(found.views, taken.frames, inward, strict=True)
    ]
    assert np.mean(left) < 0.0004


def test_mean_surface_keeps_both_sides_of_a_wall_apart() -> None:
    rng = np.random.default_rng(0)
    flat = rng.uniform(0, 0.05, (4000, 2))
    near, far = np.insert(flat, 2, 0.0, axis=1), np.insert(flat, 2, 0.002, axis=1)
    up = np.tile([0.0, 0, 1], (4000, 1))
    place, normal = mean_surface(np.concatenate([near, far]), np.concatenate([-up, up]), 0.006, np.full(3, 0.5))
    assert set(np.round(place[:, 2] * normal[:, 2], 9)) == {-0.0, 0.002}


def test_normals_of_a_slope_and_a_ball() -> None:
    camera = cameras(1, 0.0)[0].moved(np.eye(3), np.zeros(3))
    rays = camera.rays()
    n = np.array([0.4, -0.2, -1.0]) / np.linalg.norm([0.4, -0.2, -1.0])
    depth = (n @ [0, 0, 0.5] / (rays @ n)).astype(np.float32)
    got = surface_normals(depth, camera, np.zeros(depth.shape, bool))
    np.testing.assert_allclose(got[20, 30], n, atol=2e-3)
    np.testing.assert_allclose(got[100, 150], n, atol=2e-3)
    assert (got[0, 0] == 0).all()  # too little of the window


def test_looked_through_is_outside_and_never_seen_is_inside() -> None:
    taken = shots([box((0.04, 0.03, 0.02))], cameras(6, 0.01))
    views = [make_view(frame.camera, frame.depth) for frame in taken.frames]
    grid = FusionGrid.around(np.array([-0.02, -0.015, 0]), np.array([0.02, 0.015, 0.02]), 0.002, 0.01)
    field = fuse(views, grid, 0.0005, np.array([0, 0, 1.0, 0]))
    p = grid.points()
    half = np.abs(p - [0, 0, 0.01]) - [0.02, 0.015, 0.01]
    deep, clear = half.max(axis=-1) < -0.003, half.max(axis=-1) > 0.003
    assert (field.distance[deep] < 0).all()
    assert (field.distance[clear & (p[..., 2] > 0.001)] > 0).mean() > 0.99
    assert (field.distance[p[..., 2] < -0.001] > 0).all()
    # Two millimetres in front of a face that views see well, the distance says so.
    front = (np.abs(p[..., 2] - 0.02) < 0.0025) & (np.abs(p[..., :2]) < 0.01).all(axis=-1)
    np.testing.assert_allclose(field.distance[front], p[front][:, 2] - 0.02, atol=3e-4)


@pytest.mark.parametrize("voxel", [0.001, 0.0015])
def test_a_thin_floor_stays_whole_on_a_coarse_grid_and_the_supports_noise_goes(voxel: float) -> None:
    tray = cup(0.06, 0.003, 0.02)
    taken = shots([tray], cameras(16, 0.01, 25.0))
    views = [looked_over(taken.read(k)) for k in range(len(taken))]
    grid = FusionGrid.around(np.array([-0.09, -0.09, -0.004]), np.array([0.09, 0.09, 0.024]), voxel, 0.0)
    plane = np.array([0.0, 0.0, 1.0, -0.0004])  # as low as it may be found: the table lies 0.4 mm above it
    field = fuse(views, grid, 0.0008, plane)
    x, y, z = np.moveaxis(grid.points(), -1, 0)
    floor = (np.hypot(x, y) < 0.05) & (z > 0.0) & (z < 0.0025)
    assert (field.distance[floor] < 0).mean() > 0.99
    table = (np.hypot(x, y) > 0.065) & (np.hypot(x, y) < 0.085)
    assert not (field.distance[table] < 0).any()


def test_a_book_that_stands_on_edge_is_fused() -> None:
    """A layer of its grid has 35,000 points, more than OpenCV looks up in one row."""
    R = np.column_stack([[0, 1.0, 0], [0, 0, -1.0], [-1.0, 0, 0]])
    camera = ViewCamera(320, 240, 300, 300, 159.5, 119.5, R, np.array([0.6, 0.0, 0.125]))
    view = make_view(camera, np.full((240, 320), 0.585, np.float32))
    grid = FusionGrid(np.array([0.005, -0.1, 0.0]), 0.00125, (16, 160, 220))
    assert grid.shape[1] * grid.shape[2] > 2**15
    field = fuse([view], grid, 0.0005)
    near = np.abs(grid.points()[..., 0] - 0.015) < 0.0022
    np.testing.assert_allclose(field.distance[near], (grid.points()[..., 0] - 0.015)[near], atol=1e-5)


def test_rays_beside_edges_do_not_hollow_what_most_views_show_to_be_full() -> None:
    # Three of sixty views have a gap where the box's middle is, as narrow as edges are unsure.
    middle = np.array([0, 0, 0.02])
    views = []
    for frame in shots([box((0.06, 0.05, 0.04))], cameras(60, 0.02), masked=True).frames:
        camera, depth, mask = frame.camera, frame.depth.copy(), frame.mask
        assert mask is not None
        if frame.number % 20 == 7:
            x, y, z = camera.R_WC.T @ (middle - camera.p_WC)
            u, v = round(camera.fx * x / z + camera.cx), round(camera.fy * y / z + camera.cy)
            gap = np.s_[v - 4 : v + 5, u - 4 : u + 5]
            depth[gap], mask = 0.9, mask.copy()
            mask[gap] = False
        views.append(make_view(camera, depth, mask, reach=6))
    grid = FusionGrid.around(np.array([-0.03, -0.025, 0]), np.array([0.03, 0.025, 0.04]), 0.0015, 0.01)
    field = fuse(views, grid, 0.0005)
    half = (np.abs(grid.points() - middle) - [0.03, 0.025, 0.02]).max(axis=-1)
    above = grid.points()[..., 2] > 0.004  # below is the table's
    assert (field.distance[(half < -0.004) & above] < 0).all()
    assert (field.distance[(half > 0.004) & above] > 0).mean() > 0.99


def test_masks_choose_one_of_two(tmp_path: Path) -> None:
    bodies = [box((0.04, 0.03, 0.03)), box((0.03, 0.03, 0.03), (0.07, 0.02))]
    views = cameras(8, 0.015)
    found = reconstruct(shots(bodies, views, masked=True))
    assert enclosed_volume(found.vertices, found.faces) == pytest.approx(36e-6, rel=0.06)
    assert np.abs(found.vertices[:, 0]).max() < 0.0225
    with pytest.raises(FramesError, match=r"scan: two things, 7\d mm apart: mask one of them"):
        reconstruct(shots(bodies, views), "scan")


def test_refused_by_what_is_shown(mug: Shots) -> None:
    with pytest.raises(FramesError, match="scan: 2 views, at least 3"):
        reconstruct(Shots(mug.frames[:2]), "scan")
    with pytest.raises(FramesError, match="scan: nothing is there"):
        reconstruct(shots([box((0.01, 0.01, 0.002))], cameras(4, 0.0)), "scan")
    far = [
        replace(f, depth=f.depth * 100, camera=f.camera.moved(f.camera.R_WC, 100 * f.camera.p_WC)) for f in mug.frames
    ]
    far = [replace(f, colour=f.camera) for f in far]
    with pytest.raises(
        FramesError, match=r"scan: the cameras would be 3\d(\.\d)? m from what they look at; is a unit wrong"
    ):
        reconstruct(Shots(far), "scan")


def test_a_view_that_contradicts_is_named(mug: Shots) -> None:
    body = shots([box((0.04, 0.03, 0.07))], [mug.frames[3].camera]).frames[0]
    frames = [*mug.frames[:3], replace(body, number=3), *mug.frames[4:]]
    with pytest.raises(FramesError, match="scan: view 3 contradicts the others"):
        reconstruct(Shots(frames), "scan")


def test_a_view_that_looks_through_all_others_contradicts() -> None:
    """Its depth is ten times too large: of what it shows itself nothing is near the thing."""
    frames = shots([box((0.05, 0.04, 0.03))], cameras(6, 0.015), masked=True).frames
    frames[4] = replace(frames[4], depth=10.0 * frames[4].depth)
    with pytest.raises(FramesError, match=r"scan: view 4 contradicts the others: it looks through \d+ %"):
        reconstruct(Shots(frames), "scan")


def test_what_is_kilometres_large_is_a_wrong_unit() -> None:
    """Before cells are laid out for it: there would be 10¹⁵."""
    points = np.random.default_rng(0).uniform(-700.0, 700.0, (500, 3))
    with pytest.raises(FramesError, match=r"scan: what is there would be 1.4e\+03 × .* m large; is a unit wrong"):
        the_one_thing(points, "scan")


def test_what_no_view_shows_is_not_built() -> None:
    check_unseen(0.5, "scan")
    with pytest.raises(FramesError, match="scan: 96 % of what was built is seen in no view"):
        check_unseen(0.96, "scan")


def test_views_that_were_told_each_others_poses_contradict() -> None:
    frames = shots([box((0.05, 0.04, 0.03))], cameras(6, 0.015), masked=True).frames
    two, four = frames[2].camera, frames[4].camera
    frames[2], frames[4] = replace(frames[2], camera=four, colour=four), replace(frames[4], camera=two, colour=two)
    with pytest.raises(FramesError, match=r"scan: view [24] contradicts the others: they look through \d\d %"):
        reconstruct(Shots(frames), "scan")


def views_of(body: trimesh.Trimesh, others: trimesh.Trimesh, odd: list[int]) -> list[DepthView]:
    """Ten views of a body, of which some show another one."""
    both = [shots([one], cameras(10, 0.015), masked=True).frames for one in (body, others)]
    frames = [both[k in odd][k] for k in range(10)]
    return [make_view(frame.camera, frame.depth, frame.mask) for frame in frames]


def test_views_of_a_held_object_that_contradict_are_left_out() -> None:
    body, other = box((0.05, 0.04, 0.03)), box((0.03, 0.02, 0.09))
    low, high = np.array([-0.025, -0.02, 0.0]), np.array([0.025, 0.02, 0.09])
    assert agreeing(views_of(body, other, []), low, high, 0.0005) == list(range(10))
    assert agreeing(views_of(body, other, [2, 7]), low, high, 0.0005) == [k for k in range(10) if k not in (2, 7)]
    # Where more contradict than may be left out nobody tells which: all are kept, and refused.
    assert agreeing(views_of(body, other, [0, 2, 5, 7]), low, high, 0.0005) == list(range(10))


def test_views_from_one_side_are_refused() -> None:
    (frame,) = shots([box((0.05, 0.04, 0.03))], cameras(1, 0.015), masked=True).frames
    with pytest.raises(FramesError, match=r"scan: all 5 views show the object from one side, within 0\.0°; 15°"):
        reconstruct(Shots([replace(frame, number=k) for k in range(5)]), "scan")


def test_frames_become_an_asset_of_the_library(tmp_path: Path) -> None:
    folder = write(shots([box((0.05, 0.04, 0.03))], cameras(8, 0.015)), tmp_path / "scan")
    built = build_from_frames(folder, "block", tmp_path / "library", density=500.0)
    asset = Asset.load(built.folder)
    assert built.mass == pytest.approx(500 * 60e-6, rel=0.04)
    np.testing.assert_allclose(asset.size, [0.05, 0.04, 0.03], atol=0.0025)  # pixels are 1.2 mm
    spec = read_spec(built.folder)
    assert spec.unseen is not None and 0.1 < spec.unseen < 0.4  # its bottom is a fifth
    assert spec.volume is not None and spec.volume_std is not None and 0 < spec.volume_std < 0.1 * spec.volume
    assert spec.mass_std == pytest.approx(500 * spec.volume_std)
    assert spec.centre_std is not None and max(spec.centre_std) < 0.002 and spec.inertia_std is not None
    texture = read_png(built.folder / "visual.png")
    assert np.median(texture.reshape(-1, 3), axis=0).tolist() == [200, 40, 40]
    assert asset.unpainted is not None
    low = asset.points_O[:, 2] - asset.points_O[:, 2].min()
    assert asset.unpainted[(asset.normals_O[:, 2] < -0.9) & (low < 0.001)].mean() > 0.95, "nobody saw its bottom"
    off = np.sort(asset.size / 2 - np.abs(asset.points_O - asset.points_O.mean(axis=0)), axis=1)[:, 1]
    # Of its edges pictures show pixels that may have the background's colour: 2.5 of them are left out.
    assert asset.unpainted[(low > 0.005) & (off > 0.003)].mean() < 0.01
    assert asset.unpainted[low > 0.005].mean() < 0.06
    shown = asset.normals_O[:, 2] > -0.5  # its bottom takes the colour of what is near
    assert (np.abs(asset.colours[shown] - np.array([200, 40, 40]) / 255).max(axis=1) < 0.05).mean() > 0.95


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--unit", "mm"], "--unit mm: is of a mesh"),
        (["--cube-edge", "0.05"], "--cube-edge 0.05: scales predictions"),
        (["--masks", "nowhere"], "nowhere: no such folder"),
        (["--name", "../up"], "no path"),
        (["--mass", "-1"], "--mass -1: must be positive"),
    ],
)
def test_command_refuses_in_one_line(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(shots([box((0.05, 0.04, 0.03))], cameras(3, 0.015)), tmp_path / "scan")
    told = {"--name": "block", "--library": str(tmp_path / "library")} | dict(
        zip(options[::2], options[1::2], strict=True)
    )
    status = main(["assets", "build", str(folder), *(part for pair in told.items() for part in pair)])
    lines = capsys.readouterr().err.splitlines()
    assert status == 2 and len(lines) == 1 and said in lines[0]
    assert not (tmp_path / "library").exists()


def predicted(taken: Shots, unit: float) -> dict[str, np.ndarray]:
    """What a network would say of pictures, in a unit of its own."""
    points, extrinsic, intrinsic = [], [], []
    for frame in taken.frames:
        c = frame.camera
        points.append((c.rays() * frame.depth[..., None] @ c.R_WC.T + c.p_WC) / unit)
        extrinsic.append(np.hstack([c.R_WC.T, -c.R_WC.T @ c.p_WC[:, None] / unit]))
        intrinsic.append([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
    images = np.stack([np.moveaxis(frame.rgb, -1, 0) for frame in taken.frames if frame.rgb is not None]) / 255.0
    sure = np.stack([np.where(frame.depth > 0, 2.0, 1.0) for frame in taken.frames])
    arrays = {"world_points": np.stack(points), "world_points_conf": sure, "images": images}
    return arrays | {"extrinsic": np.array(extrinsic), "intrinsic": np.array(intrinsic)}


@pytest.fixture(scope="module")
def prediction() -> dict[str, np.ndarray]:
    return predicted(
        shots([box((0.05, 0.04, 0.03)), box((0.03, 0.03, 0.03), (0.075, 0.01))], cameras(8, 0.01), green=1), 0.37
    )


@pytest.mark.long
def test_predictions_are_scaled_and_the_cube_is_left_out(tmp_path: Path, prediction: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "predictions.npz", **prediction)
    _, _, factor = metric(read_predictions(tmp_path / "predictions.npz"), 0.03, "predictions")
    assert factor == pytest.approx(0.37, rel=0.01)
    built = build_from_predictions(tmp_path / "predictions.npz", "block", tmp_path / "library", 0.03)
    np.testing.assert_allclose(built.size, [0.05, 0.04, 0.03], atol=0.002)
    assert built.volume == pytest.approx(60e-6, rel=0.06)


def test_predictions_that_cannot_be(tmp_path: Path, prediction: dict[str, np.ndarray]) -> None:
    file = tmp_path / "predictions.npz"
    first = prediction["extrinsic"].copy()
    first[0, :, :3] *= 1.2
    nan = prediction["world_points"].copy()
    nan[2, 3, 4] = np.nan
    cases: list[tuple[dict[str, np.ndarray], str]] = [
        ({"images": np.array([object()] * 8)}, "not readable as arrays"),
        ({"images": prediction["images"][:, :2]}, r"images are \(8, 2, 160, 200\)"),
        ({"intrinsic": prediction["intrinsic"][:5]}, r"intrinsic is \(5, 3, 3\)"),
        ({"extrinsic": first}, "extrinsic 0 is no rotation"),
        ({"world_points": nan}, "world_points holds values that are no finite numbers"),
    ]
    for change, said in cases:
        np.savez(file, **(prediction | change))
        with pytest.raises(FramesError, match=said):
            read_predictions(file)
    np.savez(file, images=prediction["images"])
    with pytest.raises(FramesError, match="has no world_points"):
        read_predictions(file)
    file.write_bytes(b"PK nothing")
    with pytest.raises(FramesError, match="not readable as arrays"):
        read_predictions(file)


def test_a_thin_arm_in_a_small_picture_is_the_objects() -> None:
    """It is four pixels thick: thinned, it lies beside edges from all sides."""
    arm = box((0.04, 0.008, 0.008)).apply_translation([0.04, 0.0, 0.06])
    taken = shots([trimesh.util.concatenate([box((0.04, 0.04, 0.09)), arm])], cameras(5, 0.045, distance=0.6))
    views = [looked_over(frame) for frame in taken.frames]
    points, _ = object_points(views, "arm", 0)
    assert points[:, 0].max() == pytest.approx(0.06, abs=0.002)  # thinned, 0.020
    large = replace(taken.frames[0], depth=np.tile(taken.frames[0].depth, (4, 4)))
    assert looked_over(large).depth.shape == (2 * taken.frames[0].depth.shape[0], 2 * taken.frames[0].depth.shape[1])


def test_thinned_view_sees_the_same_place(mug: Shots) -> None:
    frame = mug.frames[2]
    view = thinned(frame, 2)
    point = frame.camera.rays()[80, 100] * frame.depth[80, 100] @ frame.camera.R_WC.T + frame.camera.p_WC
    u, v, z = view.camera.project(point)
    assert (u, v) == (pytest.approx(50), pytest.approx(40))
    assert view.depth[40, 50] == pytest.approx(z)


def test_nothing_behind_is_looked_through_where_masks_say_so() -> None:
    taken = shots([box((0.05, 0.04, 0.03))], cameras(10, 0.015), masked=True)
    bare = [replace(f, depth=np.where(f.mask, f.depth, 0).astype(np.float32)) for f in taken.frames]
    found = reconstruct(Shots(bare), "turntable")
    assert found.plane is None
    x, y, _ = np.ptp(found.vertices, axis=0)
    assert 0.049 < x < 0.064 and 0.039 < y < 0.055  # masks are grown by four pixels of 1.2 mm


def low_dish() -> Shots:
    """A cone 20 mm high before cameras that see all of its surface at more than 53° from its normal."""
    return shots([trimesh.creation.cone(0.07, 0.02)], cameras(6, 0.01, 10, 16, distance=0.4))


@pytest.mark.slow
def test_a_dish_that_low_cameras_see_from_the_side_alone_is_built() -> None:
    built = reconstruct(low_dish())
    assert enclosed_volume(built.vertices, built.faces) == pytest.approx(np.pi * 0.07**2 * 0.02 / 3, rel=0.15)


def test_views_that_show_the_object_from_the_side_alone_agree_all_the_same() -> None:
    views = [make_view(frame.camera, frame.depth) for frame in low_dish().frames]
    low, high = np.array([-0.07, -0.07, 0.0]), np.array([0.07, 0.07, 0.02])
    found = align(views, low, high, np.array([0.0, 0.0, 1.0, 0.0]))
    for view, told in zip(found.views, views, strict=True):
        np.testing.assert_allclose(view.camera.p_WC, told.camera.p_WC, atol=1e-3)
    elsewhere = align(views, low + 3.0, high + 3.0, None)  # where nothing is, they stay as they were told
    for view, told in zip(elsewhere.views, views, strict=True):
        np.testing.assert_array_equal(view.camera.p_WC, told.camera.p_WC)
    assert not elsewhere.explained.any() and (np.linalg.eigvalsh(elsewhere.covariances) > 0).all()


def test_walls_behind_what_is_held_in_the_air_are_none_of_it() -> None:
    """Each view has another one there, and masks are grown: the rims counted as a second thing."""
    size = (0.05, 0.04, 0.06)
    taken = shots([box(size)], cameras(8, 0.03), masked=True)
    held = [replace(f, depth=np.where(f.mask, f.depth, np.float32(0.5))) for f in taken.frames]
    views = [thinned(frame, 1) for frame in held]
    for points, plane in (object_points(views, "held", 0), held_points(views, "held")):
        assert plane is None
        np.testing.assert_allclose(np.ptp(points, axis=0), size, atol=0.004)
