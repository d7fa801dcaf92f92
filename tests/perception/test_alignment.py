"""Images of bent lenses and of depth cameras of their own, brought onto the colours' grid; the truth is a ray cast."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.perception.alignment import Alignment, DepthGrid
from twin_diagram.perception.pinhole import Pinhole, back_project
from twin_diagram.scenario import Camera, DepthCamera, Pose
from twin_diagram.scenario.poses import pose
from twin_diagram.signals.lens import Lens

Array = npt.NDArray[np.float64]
BENT = [0.08, -0.05, 0.002, -0.001, 0.0]
TWO_EYES = Camera(
    X_WC=Pose([0.2, 0.1, 1.0], [2.9, 0.1, 0.3]),
    width=160, height=120, fx=150.0, fy=147.0, cx=78.0, cy=61.0, distortion=BENT,
    depth=DepthCamera(
        X_DC=Pose([-0.015, 0.002, 0.001], [0.01, -0.02, 0.005]), width=212, height=120, fx=105.0, fy=106.0, cx=104.0,
        distortion=[-0.05, 0.02, 0.0, 0.001, 0.0], scale=0.5,
    ),
)  # fmt: skip


def cast(view: Pinhole, plane: Array) -> Array:
    """Depth of a plane n·x = d in W, with a square post on it half as far from the camera in its middle."""
    rays = view.rays()
    n, d = plane[:3], plane[3]
    depth = (d - n @ view.p_WC) / (rays @ n)
    front = (0.5 * d + 0.5 * n @ view.p_WC - n @ view.p_WC) / (rays @ n)
    at = back_project(front.astype(np.float32), rays, view.p_WC)
    post = np.abs(at[..., :2] - [0.2, 0.1]).max(axis=-1) < 0.05
    return np.where(post, front, depth)


PLANE = np.array([0.05, -0.03, 1.0, 0.0])
PLANE_AHEAD = np.array([0.4, -0.3, 1.0, 1.3])


def test_depth_of_a_camera_of_its_own_comes_onto_the_colours_grid() -> None:
    own = Pinhole.of_depth(TWO_EYES)
    assert (own.width, own.height, own.fx, own.fy, own.centre) == (212, 120, 105.0, 106.0, (104.0, 59.5))
    alignment = Alignment.of(TWO_EYES)
    assert alignment.camera == alignment.camera.straight and not alignment.camera.optics.distortion
    seen = alignment.depth((cast(own, PLANE) / 0.5).astype(np.float32))  # in units of half a metre
    wanted = cast(alignment.camera, PLANE)
    assert seen.shape == (120, 160) and seen.dtype == np.float32
    near = np.abs(seen - wanted) < 0.004
    # Half a pixel aside is 1 mm of depth here; edges are a pixel wide, and what only one eye sees is missing.
    assert near.mean() > 0.96 and (seen == 0.0).mean() < 0.03
    post = wanted < 0.75
    assert np.abs(seen[post & near] - wanted[post & near]).max() < 0.004 and near[post].mean() > 0.95


@pytest.mark.parametrize("slim", [(60.0, 120.0), (120.0, 60.0)])
def test_pixels_that_are_not_square_leave_no_holes(slim: tuple[float, float]) -> None:
    """Each of four by two or two by four of the colours' pixels; about the grid's rim depth ends."""
    lens = Lens(40, 40, *slim, 19.5, 19.5)
    grid = DepthGrid.of(lens, np.eye(3), np.zeros(3), Lens(80, 80, 240.0, 240.0, 39.5, 39.5))
    warped = grid.warped(np.full((40, 40), 1.0, dtype=np.float32))
    reach = [min(40, int(19 * 240.0 / f)) for f in slim]
    assert (warped[40 - reach[1] : 40 + reach[1], 40 - reach[0] : 40 + reach[0]] == 1.0).all()


def test_the_nearest_of_several_points_wins() -> None:
    lens, target = Lens.centred(9, 1, 10.0), Lens.centred(3, 1, 3.0)
    grid = DepthGrid.of(lens, np.eye(3), np.zeros(3), target)
    depth = np.full((1, 9), 2.0, np.float32)
    depth[0, 4] = 1.0
    np.testing.assert_array_equal(grid.warped(depth), [[2.0, 1.0, 2.0]])
    depth[0, 4], depth[0, 0], depth[0, 1] = np.nan, np.inf, -1.0
    np.testing.assert_array_equal(grid.warped(depth), [[2.0, 2.0, 2.0]])
    np.testing.assert_array_equal(grid.warped(np.zeros((1, 9), np.float32)), [[0.0, 0.0, 0.0]])


def test_a_finer_grid_gets_no_holes_and_the_same_grid_the_same_depth() -> None:
    lens = Lens.centred(40, 30, 40.0)
    depth = np.random.default_rng(5).uniform(0.5, 2.0, (30, 40)).astype(np.float32)
    same = DepthGrid.of(lens, np.eye(3), np.zeros(3), lens).warped(depth)
    np.testing.assert_array_equal(same, depth)
    flat = np.full((30, 40), 1.5, np.float32)
    np.testing.assert_array_equal(DepthGrid.of(lens, np.eye(3), np.zeros(3), lens).warped(flat), flat)
    fine = DepthGrid.of(lens, np.eye(3), np.array([0.003, 0.0, 0.0]), Lens.centred(76, 56, 76.0)).warped(flat)
    assert (fine[:, 1:-1] == 1.5).all()


def test_points_are_made_from_depths_own_grid() -> None:
    grid = Alignment.of(TWO_EYES).depth_grid
    assert grid is not None
    own = Pinhole.of_depth(TWO_EYES)
    depth = cast(own, PLANE).astype(np.float32) / np.float32(0.5)
    depth[3, 4] = 0.0
    p_C, there = grid.points(depth)
    assert there.sum() == 212 * 120 - 1 and not there[3, 4]
    p_W = pose(TWO_EYES.X_WC).multiply(p_C.astype(float).T).T
    np.testing.assert_allclose(p_W, back_project(depth * np.float32(0.5), own.rays(), own.p_WC)[there], atol=2e-6)


def test_a_bent_lens_is_straightened() -> None:
    camera = Camera(width=160, height=120, focal=150.0, distortion=BENT)
    alignment, view = Alignment.of(camera), Pinhole.from_scenario(camera)
    x, y = np.moveaxis(view.rays()[..., :2], -1, 0)
    picture = (128 + 80 * np.sin(6 * x) + 40 * np.cos(5 * y)).astype(np.uint8)
    straight = Pinhole.from_scenario(Camera(width=160, height=120, focal=150.0))
    x, y = np.moveaxis(straight.rays()[..., :2], -1, 0)
    wanted = 128 + 80 * np.sin(6 * x) + 40 * np.cos(5 * y)
    found = alignment.colours(np.repeat(picture[..., None], 3, axis=2))
    assert found.shape == (120, 160, 3)
    assert np.abs(found[4:-4, 4:-4, 1] - wanted[4:-4, 4:-4]).max() < 4.0
    depth = (1.0 + 0.1 * np.round(picture / 64)).astype(np.float32)
    assert np.isin(alignment.depth(depth)[4:-4, 4:-4], depth).mean() > 0.9  # nothing between two surfaces
    slanted = cast(view, PLANE_AHEAD).astype(np.float32)
    off = alignment.depth(slanted)[2:-2, 2:-2] / cast(straight, PLANE_AHEAD)[2:-2, 2:-2] - 1.0
    assert (np.abs(off) < 3e-4).mean() > 0.99  # all but the post's rim


def test_images_that_are_as_they_should_be_are_left_alone() -> None:
    alignment = Alignment.of(Camera(width=16, height=12, fx=20.0, fy=21.0, cx=8.0))
    rgb, depth = np.zeros((12, 16, 3), np.uint8), np.zeros((12, 16), np.float32)
    assert alignment.colours(rgb) is rgb and alignment.depth(depth) is depth
    assert (alignment.camera.fx, alignment.camera.fy, alignment.camera.centre) == (20.0, 21.0, (8.0, 5.5))


def test_projection_is_the_inverse_of_bent_rays() -> None:
    view = Pinhole.from_scenario(TWO_EYES)
    u, v, z = view.project(view.p_WC + 1.3 * view.rays())
    np.testing.assert_allclose(u, np.tile(np.arange(160.0), (120, 1)), atol=1e-7)
    np.testing.assert_allclose(v, np.tile(np.arange(120.0)[:, None], (1, 160)), atol=1e-7)
    np.testing.assert_allclose(z, 1.3)
    u, v, _ = view.straight.project(view.p_WC + 1.3 * view.straight.rays())
    np.testing.assert_allclose(u[7], np.arange(160.0), atol=1e-9)


def test_a_lens_that_folds_the_image_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"twin\.camera\.distortion: .*folds"):
        Alignment.of(Camera(width=64, height=48, focal=20.0, distortion=[-0.5, 0.0, 0.0, 0.0]))
    with pytest.raises(ScenarioError, match=r"twin\.camera\.distortion"):
        Alignment.of(Camera(distortion=[0.1, 0.1]))
