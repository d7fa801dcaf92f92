"""The support by RANSAC and by SyncTwin's equations (1) to (13); scale by a cube."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.assets.building.cube_scale import is_green, measure_cube
from twin_diagram.assets.building.opening import (
    fibonacci_sphere,
    find_opening,
    nearest_in_direction,
    without_support,
)
from twin_diagram.assets.building.support_plane import find_plane, fit_plane, settled
from twin_diagram.errors import FramesError


def ball_on_a_plate(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A ball of 50 mm without its lowest fifth, on what is left of the table; which points are the table's."""
    d = rng.standard_normal((9000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ball = d[d[:, 2] > -0.8] * 0.025
    r, a = 0.025 * np.sqrt(rng.uniform(0.45, 1.2, 900)), rng.uniform(0, 2 * np.pi, 900)
    plate = np.stack([r * np.cos(a), r * np.sin(a), rng.normal(-0.021, 0.0003, 900)], axis=1)
    return np.concatenate([ball, plate]), np.arange(len(ball) + 900) >= len(ball)


def test_fibonacci_directions_are_even() -> None:
    d = fibonacci_sphere(1000)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    np.testing.assert_allclose(d.mean(axis=0), 0.0, atol=2e-3)
    np.testing.assert_allclose(d.T @ d / 1000, np.eye(3) / 3, atol=2e-3)
    cosine = d @ d.T - 2 * np.eye(1000)
    nearest = np.degrees(np.arccos(cosine.max(axis=1)))
    assert nearest.min() > 0.6 * nearest.max()
    assert d[0, 2] == pytest.approx(1 - 2 * 0.5 / 1000)


def test_buckets_keep_least_and_farthest() -> None:
    directions = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    points = np.array([[2.0, 0, 0], [5.0, 0.1, 0], [0, 3.0, 0], [1.0, 1.0, 0]]) + 1
    least, farthest = nearest_in_direction(points, np.ones(3), directions, np.radians(10))
    assert least[:2] == pytest.approx([2.0, 3.0]) and least[2] == np.inf
    assert farthest.tolist() == [1, 2, -1]


def test_opening_is_the_unseen_bottom() -> None:
    points, _ = ball_on_a_plate(np.random.default_rng(0))
    opening = find_opening(points)
    assert opening is not None
    assert opening.axis @ [0, 0, -1] > 0.99  # (13)
    np.testing.assert_allclose(opening.centre, points.mean(axis=0))
    assert opening.plane[:3] @ [0, 0, -1] > 0.99 and opening.plane[3] == pytest.approx(0.021, abs=0.002)
    # The sphere's cap below −0.8 is a tenth of all directions.
    assert opening.share == pytest.approx(0.1, abs=0.08)


def test_denoising_takes_the_table_and_leaves_the_ball() -> None:
    points, plate = ball_on_a_plate(np.random.default_rng(1))
    left = without_support(points)
    assert left[plate].mean() < 0.01
    assert left[~plate & (points[:, 2] > -0.015)].mean() > 0.99


def test_closed_cloud_has_no_opening() -> None:
    d = fibonacci_sphere(4000) * 0.03
    assert find_opening(d) is None
    assert without_support(d).all()


def scene(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    tilt = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    x = np.cross([0, 1.0, 0], tilt)
    x /= np.linalg.norm(x)
    flat = rng.uniform(-0.3, 0.3, (1500, 2))
    table = flat[:, :1] * x + flat[:, 1:] * np.cross(tilt, x) + rng.normal(0, 0.001, (1500, 1)) * tilt + 0.2 * tilt
    floor = flat[:400] @ np.stack([x, np.cross(tilt, x)]) * 0.15 + 0.204 * tilt  # that of a cup: 4 mm above
    wall = np.stack([rng.uniform(0, 0.2, 300), np.full(300, 0.05), rng.uniform(0.25, 0.4, 300)], axis=1)
    points = np.concatenate([table, floor, wall])
    normals = np.concatenate([np.tile(tilt, (1900, 1)), np.tile([0, 1.0, 0], (300, 1))])
    return points, normals


def test_ransac_finds_the_table_and_not_the_floor_of_a_cup() -> None:
    points, normals = scene(np.random.default_rng(0))
    plane = find_plane(points, normals, np.array([0, 0, 1.0]))
    true = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    assert plane is not None and plane[:3] @ true > 0.99999
    assert plane[3] == pytest.approx(0.2, abs=3e-4)  # a fifth of all lies 4 mm above
    np.testing.assert_allclose(find_plane(points, normals, np.array([0, 0, 1.0])), plane)  # same seed, same bits


def test_nothing_flat_is_no_support() -> None:
    d = fibonacci_sphere(3000)
    assert find_plane(d * 0.2, d, np.array([0, 0, 1.0])) is None
    assert find_plane(d[:50], d[:50], np.array([0, 0, 1.0])) is None


def test_fit_weights_points() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.3, 0.3, 5.0]])
    weights = np.array([1.0, 1, 1, 1, 0])
    np.testing.assert_allclose(fit_plane(points, np.array([0, 0, 9.0]), weights), [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(fit_plane(points[:4], np.array([0, 0, -9.0])), [0, 0, -1, 0], atol=1e-12)
    assert settled(points[:4], np.tile([0, 0, 1.0], (4, 1)), np.array([0, 0, 1.0, 0]), points[4])[3] == 0


def cube_cloud(edge: float, turn: float, noise: float, rng: np.random.Generator) -> np.ndarray:
    """A cube on z = 0 about (0.3, 0.1), its bottom unseen."""
    u = rng.uniform(-0.5, 0.5, (4000, 2))
    faces = [np.insert(u, axis, side, axis=1) for axis, side in ((0, -0.5), (0, 0.5), (1, -0.5), (1, 0.5), (2, 0.5))]
    points = np.concatenate(faces) * edge + [0, 0, edge / 2]
    c, s = np.cos(turn), np.sin(turn)
    points = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0.3, 0.1, 0]
    return points + rng.normal(0, noise, points.shape)


@pytest.mark.parametrize("turn", [0.0, 0.4, 0.785, 1.3])
def test_cube_is_measured_to_one_percent(turn: float) -> None:
    rng = np.random.default_rng(3)
    cube = cube_cloud(0.17, turn, 0.17 * 0.02, rng)
    rest = rng.uniform(-0.5, 0.5, (5000, 3)) * [1, 1, 0.001]
    colours = np.concatenate([np.tile([0.1, 0.6, 0.2], (len(cube), 1)), np.tile([0.6, 0.6, 0.6], (5000, 1))])
    printed = rng.uniform(0, 1, (3 * len(cube), 3)) * [0.4, 0.01, 0.3] + [-0.4, -0.2, 0.0]  # on a box, larger than it
    points = np.concatenate([cube, rest, printed])
    colours = np.concatenate([colours, np.tile([0.1, 0.6, 0.2], (len(printed), 1))])
    found = measure_cube(points, colours, np.array([0, 0, 1.0, 0]), "cloud")
    assert found.edge == pytest.approx(0.17, rel=0.01)
    np.testing.assert_allclose(found.centre, [0.3, 0.1, 0.085], atol=0.003)
    assert found.holds(cube).mean() > 0.999
    assert not found.holds(np.array([[0.3 + 0.17, 0.1, 0.08]])).any()


def test_a_cube_is_told_from_a_green_table() -> None:
    rng = np.random.default_rng(5)
    cube = cube_cloud(0.17, 0.4, 0.002, rng)
    rest = rng.uniform(-0.5, 0.5, (40000, 3)) * [2, 2, 0] + [0, 0, 1] * rng.normal(0, 0.003, (40000, 1))
    points = np.concatenate([cube, rest])
    found = measure_cube(points, np.tile([0.2, 0.5, 0.25], (len(points), 1)), np.array([0, 0, 1.0, 0]), "cloud")
    assert found.edge == pytest.approx(0.17, rel=0.02)
    np.testing.assert_allclose(found.centre, [0.3, 0.1, 0.085], atol=0.004)


def test_what_is_no_cube_is_refused() -> None:
    rng = np.random.default_rng(4)
    up, green = np.array([0, 0, 1.0, 0]), np.array([0.1, 0.6, 0.2])
    cube = cube_cloud(0.1, 0.3, 0.0005, rng)
    with pytest.raises(FramesError, match="cloud: no green cube: 0 green points"):
        measure_cube(cube, np.tile([0.6, 0.1, 0.1], (len(cube), 1)), up, "cloud")
    for stretch in ([1, 1.3, 1], [1, 1, 1.5]):
        bar = (cube - [0.3, 0.1, 0]) * stretch
        with pytest.raises(FramesError, match="what is green is no cube"):
            measure_cube(bar, np.tile(green, (len(bar), 1)), up, "cloud")


def test_green_is_a_hue() -> None:
    colours = np.array([[0.1, 0.6, 0.2], [0.6, 0.1, 0.1], [0.5, 0.6, 0.5], [0.0, 0.05, 0.0], [0.1, 0.2, 0.7]])
    assert is_green(colours).tolist() == [True, False, False, False, False]
