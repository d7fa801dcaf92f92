"""The pinhole camera and the normals of an organised cloud, pixel by pixel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from pydrake.math import RollPitchYaw

from twin_diagram.perception.pinhole import Pinhole, back_project, surface_at
from twin_diagram.scenario import Camera, Pose
from twin_diagram.signals.lens import Lens, unit_rays

Array = npt.NDArray[np.float64]
VIEW = Pinhole.from_scenario(Camera(X_WC=Pose([0.3, -0.2, 1.1], [2.8, 0.2, 0.4]), width=33, height=24, focal=41.0))


def test_a_pixel_has_its_centre_at_its_number() -> None:
    assert VIEW.centre == (16.0, 11.5)
    R = RollPitchYaw(2.8, 0.2, 0.4).ToRotationMatrix().matrix()
    np.testing.assert_allclose(VIEW.X_WC.GetAsMatrix4()[:3], np.column_stack([R, [0.3, -0.2, 1.1]]))
    for stride in (1, 2, 5):
        rays = VIEW.rays(stride)
        assert rays.shape == (-(-24 // stride), -(-33 // stride), 3)
        for row in range(rays.shape[0]):
            for column in range(rays.shape[1]):
                ray = [(column * stride - 16.0) / 41.0, (row * stride - 11.5) / 41.0, 1.0]
                np.testing.assert_allclose(rays[row, column], R @ ray, atol=1e-12)


def test_projection_is_the_inverse_of_the_rays() -> None:
    depth = np.random.default_rng(2091).uniform(0.5, 2.0, (24, 33)).astype(np.float32)
    points = back_project(depth, VIEW.rays(), VIEW.p_WC)
    u, v, z = VIEW.project(points)
    np.testing.assert_allclose(u, np.tile(np.arange(33.0), (24, 1)), atol=1e-9)
    np.testing.assert_allclose(v, np.tile(np.arange(24.0)[:, None], (1, 33)), atol=1e-9)
    np.testing.assert_allclose(z, depth, atol=1e-9)
    np.testing.assert_array_equal(back_project(np.zeros((24, 33), np.float32), VIEW.rays(), VIEW.p_WC)[3, 4], VIEW.p_WC)
    behind = VIEW.project(VIEW.p_WC - VIEW.R_WC[:, 2] + VIEW.R_WC[:, 0] * 1e-9)
    assert behind[2] == pytest.approx(-1.0) and np.isfinite(behind[0])


def normal_of(points: Array, valid: npt.NDArray[np.bool_], row: int, column: int) -> Array:
    """By differences over two pixels each way, without those that lack depth or lie 2 cm off."""
    height, width = valid.shape
    here = points[row, column]

    def neighbour(r: int, c: int) -> Array:
        r, c = min(max(r, 0), height - 1), min(max(c, 0), width - 1)
        far = float(np.linalg.norm(points[r, c] - here)) >= 0.02
        return here if far or not valid[r, c] else points[r, c]

    along = neighbour(row, column + 2) - neighbour(row, column - 2)
    down = neighbour(row + 2, column) - neighbour(row - 2, column)
    view = VIEW.p_WC - here
    view /= np.linalg.norm(view)
    normal = np.cross(down, along)
    length = float(np.linalg.norm(normal))
    normal = normal / length if length > 1e-9 else view
    return -normal if normal @ view < 0.0 else normal


def test_normals_are_differences_towards_the_camera() -> None:
    rng = np.random.default_rng(2092)
    v, u = np.mgrid[0:24, 0:33]
    depth = 0.12 + 0.002 * np.sin(0.5 * u) + 0.003 * np.cos(0.4 * v) + 0.03 * (u > 20)
    depth[rng.random(depth.shape) < 0.15] = 0.0
    points = back_project(depth.astype(np.float32), VIEW.rays(), VIEW.p_WC)
    valid = depth > 0.0
    row, column = np.nonzero(valid)
    places, found = surface_at(depth.astype(np.float32), VIEW.rays(), (row, column), VIEW.p_WC)
    np.testing.assert_allclose(places, points[row, column], atol=1e-12)
    for r, c, normal in zip(row, column, found, strict=True):
        np.testing.assert_allclose(normal, normal_of(points, valid, int(r), int(c)), atol=1e-6)


@pytest.mark.parametrize(("width", "focal", "away"), [(640, 600.0, 2.5), (320, 300.0, 1.5), (160, 150.0, 1.0)])
@pytest.mark.parametrize("lean", [0.0, 0.8, 1.05])
def test_a_wall_that_leans_has_its_normal_however_wide_pixels_are_there(
    width: int, focal: float, away: float, lean: float
) -> None:
    """Every second pixel of a coarse or far image is farther from its neighbours than 2 cm."""
    rays = np.ascontiguousarray(unit_rays(Lens.centred(width, width * 3 // 4, focal))[::2, ::2])
    n = np.array([np.sin(lean), 0.0, -np.cos(lean)])
    depth = (-away * np.cos(lean) / (rays @ n)).astype(np.float32)
    row, column = (np.ravel(part) + size // 2 for part, size in zip(np.mgrid[-4:5, -4:5], depth.shape, strict=True))
    _, found = surface_at(depth, rays, (row, column), np.zeros(3))
    np.testing.assert_allclose(found, np.broadcast_to(n, found.shape), atol=1e-3)


def test_where_neighbours_tell_nothing_the_normal_is_the_line_of_sight() -> None:
    depth = np.zeros((24, 33), dtype=np.float32)
    depth[10, 10] = 0.5
    (point,), (normal,) = surface_at(depth, VIEW.rays(), (np.array([10]), np.array([10])), VIEW.p_WC)
    sight = VIEW.p_WC - point
    np.testing.assert_allclose(normal, sight / np.linalg.norm(sight), atol=1e-12)
