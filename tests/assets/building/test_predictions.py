"""Networks' predictions: views made to agree, scale by a cube, disturbed by known amounts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.assets.building.pictured import Shots, box, cameras, shots
from twin_diagram.assets.building import cube_faces, levelling
from twin_diagram.assets.building.cube_outline import outlined_edges
from twin_diagram.assets.building.cube_scale import Cube, is_green
from twin_diagram.assets.building.depth_view import DepthView, make_view, near_edges, view_points
from twin_diagram.assets.building.fusion import DistanceField, FusionGrid, without, without_hand, without_remains
from twin_diagram.assets.building.inertia import enclosed
from twin_diagram.assets.building.levelling import levelled
from twin_diagram.assets.building.predictions import metric, read_predictions
from twin_diagram.assets.building.reconstruct import reconstruct
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.signals import rotations

EDGE, AT = 0.04, (0.085, 0.015)


def cube_at_an_angle() -> Shots:
    """A grey-red block and a green cube, turned by 17°, before six cameras."""
    cube = box((EDGE, EDGE, EDGE))
    c, s = np.cos(0.3), np.sin(0.3)
    cube.vertices = cube.vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [*AT, 0]
    return shots([box((0.06, 0.05, 0.05)), cube], cameras(6, 0.02, distance=0.42), green=1)


@pytest.fixture(scope="module")
def taken() -> Shots:
    return cube_at_an_angle()


def written(
    taken: Shots,
    file: Path,
    unit: float = 0.37,
    scales: float = 0.0,
    off: tuple[float, float] = (0.0, 0.0),
    focal: tuple[float, float] = (1.0, 1.0),
    unsure: bool = False,
) -> Path:
    """What a network would say of pictures: scales of depth, places and angles off by RMS amounts, K told wrongly."""
    rng = np.random.default_rng(4)
    points, extrinsic, intrinsic, sure = [], [], [], []
    for frame in taken.frames:
        c = frame.camera
        depth = frame.depth * (1 + scales * rng.standard_normal())
        turn = rotations.matrix(rotations.exp(rng.standard_normal(3) * off[1] / np.sqrt(3)))
        c = c.moved(c.R_WC @ turn, c.p_WC + rng.standard_normal(3) * off[0] / np.sqrt(3))
        points.append((c.rays() * depth[..., None] @ c.R_WC.T + c.p_WC) / unit)
        extrinsic.append(np.hstack([c.R_WC.T, -c.R_WC.T @ c.p_WC[:, None] / unit]))
        intrinsic.append([[c.fx * focal[0], 0, c.cx], [0, c.fy * focal[1], c.cy], [0, 0, 1]])
        there = frame.depth > 0
        if unsure:  # a third of the picture, beside what is looked at
            there &= np.abs(np.arange(200) - 100) < 67
        points[-1][~there] = c.p_WC / unit  # at the lens
        sure.append(np.where(there, 2.0, 1.0))
    images = np.stack([np.moveaxis(frame.rgb, -1, 0) for frame in taken.frames if frame.rgb is not None]) / 255.0
    np.savez(
        file,
        world_points=np.stack(points),
        world_points_conf=np.stack(sure),
        extrinsic=np.array(extrinsic),
        intrinsic=np.array(intrinsic),
        images=images,
    )
    return file


@pytest.mark.parametrize(
    "disturbed",
    [
        {"scales": 0.005, "off": (0.003, np.radians(0.3)), "unit": 4.1},
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"scales": 0.02}, marks=pytest.mark.slow),
        pytest.param({"focal": (0.93, 1.05)}, marks=pytest.mark.slow),
        pytest.param({"unsure": True}, marks=pytest.mark.slow),
    ],
)
def test_scale_is_found_to_a_percent(taken: Shots, tmp_path: Path, disturbed: dict[str, float]) -> None:
    file = written(taken, tmp_path / "p.npz", **disturbed)  # type: ignore[arg-type]
    frames, cube, factor = metric(read_predictions(file), EDGE, "predictions")
    assert factor == pytest.approx(disturbed.get("unit", 0.37), rel=0.01)
    assert cube.edge == EDGE
    np.testing.assert_allclose(cube.centre, [*AT, EDGE / 2], atol=0.004)
    assert all(frame.no_surface is not None and frame.no_surface.any() for frame in frames.frames)


def test_confidences_that_overflow_in_half_precision_are_sure(taken: Shots, tmp_path: Path) -> None:
    file = written(taken, tmp_path / "p.npz", unsure=True)
    with np.load(file) as data:
        told = dict(data)
    plain = read_predictions(file)
    told["world_points_conf"] = np.where(told["world_points_conf"] > 1.5, np.inf, 1.0).astype(np.float16)
    np.savez(file, **told)
    for one, other in zip(plain.frames, read_predictions(file).frames, strict=True):
        np.testing.assert_array_equal(one.depth, other.depth)
    told["world_points_conf"][0, 0, 0] = np.nan
    np.savez(file, **told)
    with pytest.raises(FramesError, match="world_points_conf holds values that are no finite numbers"):
        read_predictions(file)


@pytest.mark.long
def test_rims_that_a_network_is_unsure_of_end_where_others_look_past(taken: Shots, tmp_path: Path) -> None:
    file = written(taken, tmp_path / "p.npz")
    with np.load(file) as data:
        told = dict(data)
    edge = np.stack([near_edges(frame.depth, frame.camera.fx, 3) for frame in taken.frames])
    told["world_points_conf"] = np.where(edge, 1.0, told["world_points_conf"])
    np.savez(file, **told)
    read = read_predictions(file)
    assert not any(((one.depth > 0) & rim).any() for one, rim in zip(read.frames, edge, strict=True))
    frames, cube, _ = metric(read, EDGE, "p")
    for one, rim in zip(frames.frames, edge, strict=True):  # rays pass as far as is told there, and find no surface
        assert one.no_surface is not None and one.no_surface[rim & (one.depth > 0)].all()
    found = reconstruct(frames, "p", beside=cube)
    above = found.vertices[found.vertices[:, 2] > 0.003]  # at its foot the table is as unsure
    assert (above < [0.032, 0.027, 0.052]).all() and (above > [-0.032, -0.027, 0]).all()
    assert enclosed(found.vertices, found.faces, "block").volume == pytest.approx(0.06 * 0.05 * 0.05, rel=0.04)


@pytest.mark.slow
def test_cube_of_another_colour_or_shape_is_refused(tmp_path: Path) -> None:
    plain = shots([box((0.06, 0.05, 0.05)), box((EDGE, EDGE, EDGE), AT)], cameras(6, 0.02, distance=0.42))
    with pytest.raises(FramesError, match=r"p\.npz: no green cube: 0 green points"):
        metric(read_predictions(written(plain, tmp_path / "p.npz")), EDGE, "p.npz")
    bar = shots([box((0.06, 0.05, 0.05)), box((EDGE, EDGE, 1.3 * EDGE), AT)], cameras(6, 0.02, distance=0.42), green=1)
    with pytest.raises(FramesError, match="what is green is no cube"):
        metric(read_predictions(written(bar, tmp_path / "p.npz")), EDGE, "p.npz")


@pytest.mark.slow
def test_levelling_finds_each_views_scale(taken: Shots) -> None:
    told = np.array([0.03, -0.02, 0.0, 0.015, -0.03, 0.01])
    views = [
        make_view(f.camera, (f.depth * np.float32(1 + s)).astype(np.float32))
        for f, s in zip(taken.frames, told, strict=True)
    ]
    level = levelled(views, np.array([0.0, 0, 1, 0.004]))
    assert level.scale >= 0.012
    heights = [view_points(view, 4, None)[0][:, 2] for view in level.views]
    of_table = [float(np.median(h[np.abs(h) < 0.015])) for h in heights]
    assert np.ptp(of_table) < 0.002  # before: 0.06 of the cameras' heights, 6 to 25 mm
    exact = levelled([make_view(f.camera, f.depth) for f in taken.frames], np.array([0.0, 0, 1, 0.004]))
    assert exact.scale == 0.003 and exact.plane[3] == pytest.approx(0.0, abs=2e-4)
    for one, frame in zip(exact.views, taken.frames, strict=True):
        np.testing.assert_allclose(one.camera.p_WC, frame.camera.p_WC, atol=2e-4)


def test_outlines_tell_the_edge_and_hidden_ones_nothing(taken: Shots) -> None:
    c, s = np.cos(0.3), np.sin(0.3)
    axes = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    views = [make_view(f.camera, f.depth, None, f.rgb) for f in taken.frames]
    for share in (0.95, 1.0, 1.06):
        edge = share * EDGE
        found, variances = outlined_edges(views, Cube(edge, np.array([*AT, edge / 2]), axes))
        assert len(found) >= 4 and np.median(found) == pytest.approx(EDGE, rel=0.006)
        assert (np.abs(found - EDGE) < 4 * np.sqrt(variances)).all()
    hidden = []
    for view in views:
        assert view.rgb is not None
        u, _, _ = view.camera.project(np.array([*AT, EDGE / 2]))
        covered = view.rgb.copy()
        covered[:, int(u) + 4 :] = (200, 40, 40)
        hidden.append(replace(view, rgb=covered))
    assert len(outlined_edges(hidden, Cube(EDGE, np.array([*AT, EDGE / 2]), axes))[0]) == 0


def before_a_table(taken: Shots, table: tuple[int, int, int], cube: tuple[int, int, int]) -> list[DepthView]:
    """The same views, table and cube painted otherwise."""
    views = []
    for frame in taken.frames:
        assert frame.rgb is not None
        painted = frame.rgb.copy()
        painted[(frame.rgb == 200).all(axis=-1)] = table
        painted[(frame.rgb == (30, 170, 50)).all(axis=-1)] = cube
        views.append(make_view(frame.camera, frame.depth, None, painted))
    return views


def test_outlines_before_what_is_green_tell_nothing() -> None:
    """A cube of 40 mm on a green table was measured as 65 mm, and the object with it."""
    above = ViewCamera(200, 160, 300.0, 300.0, 99.5, 79.5, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.4]))
    view = make_view(above, np.full((160, 200), 0.4, np.float32), None, np.full((160, 200, 3), (30, 170, 50), np.uint8))
    edges, _ = outlined_edges([view], Cube(EDGE, np.array([0.0, 0.0, EDGE / 2]), np.eye(3)))
    assert not len(edges)


def test_outlines_before_what_is_nearly_green_are_whole_pixels(taken: Shots) -> None:
    """Before a cyan table the cube looked 3 % too small where shade lies on it."""
    c, s = np.cos(0.3), np.sin(0.3)
    cube = Cube(EDGE, np.array([*AT, EDGE / 2]), np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
    edges, _ = outlined_edges(before_a_table(taken, (40, 190, 180), (10, 60, 20)), cube)
    assert len(edges) >= 4 and np.median(edges) == pytest.approx(EDGE, rel=0.006)


def test_where_the_cube_stands_nothing_else_is() -> None:
    grid = FusionGrid(np.zeros(3), 0.01, (11, 11, 11))
    full = np.full(grid.shape, -0.02, np.float32)
    field = DistanceField(grid, full, full, full > 0)
    cut = without(field, Cube(0.04, np.array([0.05, 0.05, 0.05]), np.eye(3)))
    assert cut.distance[5, 5, 5] == pytest.approx(0.02) and cut.distance[0, 0, 0] == pytest.approx(-0.02)
    assert cut.distance[7, 5, 5] == pytest.approx(0.0, abs=1e-6)


def test_where_a_hand_was_nothing_of_what_it_held_is_but_for_a_thin_layer() -> None:
    grid = FusionGrid(np.zeros(3), 0.01, (11, 11, 11))
    full = np.full(grid.shape, -0.02, np.float32)
    turned = np.array([[0.0, -1.0, 0.0, 0.05], [1.0, 0.0, 0.0, 0.05], [0.0, 0.0, 1.0, 0.05], [0.0, 0.0, 0.0, 1.0]])
    hand = Boxes(turned, np.array([[-0.01, 0.0, -0.02]]), np.array([[0.01, 0.04, 0.02]]))
    cut = without_hand(DistanceField(grid, full, full, full > 0), hand, 0.002).distance
    # The hand's y is −x here: from 0.01 to 0.05, less the layer.
    assert cut[:, 5, 5] == pytest.approx([-0.012, -0.002, *[0.008] * 3, -0.002, -0.012, *[-0.02] * 4], abs=1e-6)
    assert cut[3, 4:7, 5] == pytest.approx([-0.002, 0.008, -0.002], abs=1e-6)
    assert cut[3, 5, 3:8] == pytest.approx([-0.002, 0.008, 0.008, 0.008, -0.002], abs=1e-6)


def test_a_corner_beside_the_hand_that_nobody_saw_is_nothing_of_what_it_held() -> None:
    """While a wall as thin that was seen stays, and all of an inside that was not."""
    grid = FusionGrid(np.zeros(3), 0.001, (20, 20, 20))
    distance = np.full(grid.shape, 0.003, np.float32)
    distance[2:12, 2:18, 2:18] = -0.003
    distance[12:18, 4:6, 4:7] = -0.003  # beside the hand
    distance[12:18, 2:18, 14:16] = -0.003  # a wall
    known = distance > 0.0
    known[12:18, :, 14:16] = True
    left = without_remains(DistanceField(grid, distance, np.zeros_like(distance), known)).distance < 0.0
    assert left[2:12, 2:18, 2:18].all() and left[12:18, 2:18, 14:16].all()
    assert not left[12:18, 4:6, 4:7].any()


def test_what_stands_beside_is_no_surface_and_ends_rays(taken: Shots) -> None:
    frame = taken.frames[3]
    beside = np.zeros(frame.depth.shape, bool)
    beside[60:80, 90:110] = True
    view = make_view(frame.camera, frame.depth, no_surface=beside)
    assert not view.trust[beside].any() and view.near_edge[beside].all()
    np.testing.assert_array_equal(view.depth, frame.depth)
    assert view.trust[~beside].max() > 0.9


def few(file: Path, images: np.ndarray, views: int = 2, batch: bool = False) -> Path:
    """A file of the right shapes: a wall a metre away before cameras at the origin."""
    rows, columns = np.mgrid[0:6.0, 0:8.0]
    points = np.stack([(columns - 4) / 8, (rows - 3) / 8, np.ones((6, 8))], axis=-1)
    arrays = {
        "world_points": np.stack([points] * views),
        "world_points_conf": np.ones((views, 6, 8)),
        "extrinsic": np.stack([np.eye(3, 4)] * views),
        "intrinsic": np.stack([[[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]] * views),
        "images": np.stack([images] * views),
    }
    np.savez(file, **{name: array[None] if batch else array for name, array in arrays.items()})  # type: ignore[arg-type]
    return file


def test_images_in_another_unit_are_refused_and_all_whole_numbers_are_bytes(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (3, 6, 8))
    for wrong in (picture.astype(float), picture + 1000, picture - 128):
        with pytest.raises(FramesError, match=r"p\.npz: images of .* hold .* must be 0 to (1|255)"):
            read_predictions(few(tmp_path / "p.npz", wrong))
    for images in (picture, picture.astype(np.uint8), picture / 255.0):
        frame = read_predictions(few(tmp_path / "p.npz", images)).read(1)
        np.testing.assert_array_equal(frame.rgb, np.moveaxis(picture, 0, -1))


@pytest.mark.parametrize(("views", "batch"), [(1, False), (1, True), (3, True)])
def test_one_view_is_one_view_and_a_batch_of_one_is_none(tmp_path: Path, views: int, batch: bool) -> None:
    read = read_predictions(few(tmp_path / "p.npz", np.zeros((3, 6, 8)), views, batch))
    assert len(read) == views and read.read(0).depth.shape == (6, 8)


@pytest.mark.parametrize(
    ("inverse", "axes", "said"),
    [
        (True, (1, 1, 1), "is camera-to-world,"),
        (False, (1, -1, -1), "is with OpenGL's axes"),
        (True, (1, -1, -1), "is camera-to-world with OpenGL's axes"),
    ],
)
def test_poses_told_another_way_are_named(
    taken: Shots, tmp_path: Path, inverse: bool, axes: tuple[int, int, int], said: str
) -> None:
    """Without a word they had "no depth", or no plane on which the cube stands."""
    with np.load(written(taken, tmp_path / "p.npz")) as data:
        arrays = dict(data)
    last = np.tile([[[0.0, 0.0, 0.0, 1.0]]], (len(arrays["extrinsic"]), 1, 1))
    X = np.diag([*axes, 1]) @ np.concatenate([arrays["extrinsic"], last], axis=1)
    arrays["extrinsic"] = (np.linalg.inv(X) if inverse else X)[:, :3]
    np.savez(tmp_path / "p.npz", **arrays)
    with pytest.raises(FramesError, match=said):
        read_predictions(tmp_path / "p.npz")


def test_whole_poses_are_read_and_others_refused(tmp_path: Path) -> None:
    file = few(tmp_path / "p.npz", np.zeros((3, 6, 8)), 3)
    with np.load(file) as data:
        arrays = dict(data)
    last = np.tile([[[0.0, 0.0, 0.0, 1.0]]], (3, 1, 1))
    for row, fits in ((last, True), (last[:, :, ::-1], False)):
        np.savez(file, **arrays | {"extrinsic": np.concatenate([arrays["extrinsic"], row], axis=1)})
        if fits:
            np.testing.assert_array_equal(read_predictions(file).read(2).colour.R_WC, np.eye(3))
            continue
        with pytest.raises(FramesError, match=r"extrinsic is \(3, 4, 4\)"):
            read_predictions(file)


@pytest.mark.long
def test_a_view_of_which_the_network_is_sure_of_nothing_is_left_out(taken: Shots, tmp_path: Path) -> None:
    with np.load(written(taken, tmp_path / "p.npz")) as data:
        arrays = dict(data)
    arrays["world_points_conf"][2] = 0.0
    np.savez(tmp_path / "p.npz", **arrays)  # type: ignore[arg-type]
    read = read_predictions(tmp_path / "p.npz")
    assert not read.read(2).depth.any()
    _, _, factor = metric(read, EDGE, "predictions")
    assert factor == pytest.approx(0.37, rel=0.01)
    assert is_green(np.zeros((0, 3))).shape == (0,)


def test_a_step_lays_a_views_plane_on_the_common_one(taken: Shots) -> None:
    """Off by a third of a degree either way and by a millimetre; places are held, so that depth's scale must give."""
    frame = taken.frames[0]
    view, about = make_view(frame.camera, frame.depth), np.array([0.02, 0.01, 0.03])
    n = rotations.matrix(rotations.exp(np.array([0.006, -0.005, 0.0]))) @ [0.0, 0.0, 1.0]
    foot = np.array([0.05, -0.04, 0.001])
    prior = np.array([1e-2] * 3 + [1e12] * 3 + [1e-2])
    step = levelling._step(
        view, (np.append(n, n @ foot), foot), np.array([0.0, 0.0, 1.0, 0.0]), np.zeros(7), prior, about
    )
    R = rotations.matrix(rotations.exp(step[:3]))
    np.testing.assert_allclose(R @ n, [0.0, 0.0, 1.0], atol=1e-4)
    p = frame.camera.p_WC + (foot - frame.camera.p_WC) * np.exp(step[6])
    assert abs((R @ (p - about) + about + step[3:6])[2]) < 1e-4


def test_a_cube_is_turned_to_where_its_faces_lead() -> None:
    """By 1° either way; faces are seen as clouds of points without noise."""
    flat = 0.5 * EDGE * np.stack(np.meshgrid(*2 * [np.linspace(-0.9, 0.9, 12)]), axis=-1).reshape(-1, 2)
    sides = [(axis, side) for axis in range(3) for side in (1.0, -1.0)]
    points = np.concatenate([np.insert(flat, axis, side * EDGE / 2, axis=1) for axis, side in sides])
    normals = np.concatenate([np.tile(side * np.eye(3)[axis], (len(flat), 1)) for axis, side in sides])
    plane, middle = np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.1, 0.0, EDGE / 2])
    for angle in (0.0175, -0.0175):
        R = rotations.matrix(rotations.exp(np.array([0.0, 0.0, angle])))
        first = Cube(EDGE, middle, np.eye(3))
        placed = cube_faces._placed([(points @ R.T + middle, normals @ R.T)], first, 0.16)
        found, sizes, _ = cube_faces._improved(placed, [(0.0, 1e-8)], first, plane)
        np.testing.assert_allclose(found.axes, R.T, atol=2e-3)
        np.testing.assert_allclose(sizes, EDGE, rtol=2e-3)
