"""A cube is found by its green and measured on its faces: the scale of a scene."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.assets.building.cube_scale import is_green, rough_cubes
from twin_diagram.errors import FramesError


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
    found = rough_cubes(points, colours, np.array([0, 0, 1.0, 0]), "cloud")[0]
    assert found.edge == pytest.approx(0.17, rel=0.01)
    np.testing.assert_allclose(found.centre, [0.3, 0.1, 0.085], atol=0.003)
    assert found.holds(cube).mean() > 0.999
    assert not found.holds(np.array([[0.3 + 0.17, 0.1, 0.08]])).any()


def test_a_cube_is_told_from_a_green_table() -> None:
    rng = np.random.default_rng(5)
    cube = cube_cloud(0.17, 0.4, 0.002, rng)
    rest = rng.uniform(-0.5, 0.5, (40000, 3)) * [2, 2, 0] + [0, 0, 1] * rng.normal(0, 0.003, (40000, 1))
    points = np.concatenate([cube, rest])
    found = rough_cubes(points, np.tile([0.2, 0.5, 0.25], (len(points), 1)), np.array([0, 0, 1.0, 0]), "cloud")[0]
    assert found.edge == pytest.approx(0.17, rel=0.02)
    np.testing.assert_allclose(found.centre, [0.3, 0.1, 0.085], atol=0.004)


def test_what_is_no_cube_is_refused() -> None:
    rng = np.random.default_rng(4)
    up, green = np.array([0, 0, 1.0, 0]), np.array([0.1, 0.6, 0.2])
    cube = cube_cloud(0.1, 0.3, 0.0005, rng)
    with pytest.raises(FramesError, match="cloud: no green cube: 0 green points"):
        rough_cubes(cube, np.tile([0.6, 0.1, 0.1], (len(cube), 1)), up, "cloud")
    for stretch in ([1, 1.6, 1], [1, 1, 1.9]):
        bar = (cube - [0.3, 0.1, 0]) * stretch
        with pytest.raises(FramesError, match="what is green is no cube"):
            rough_cubes(bar, np.tile(green, (len(bar), 1)), up, "cloud")


def test_green_is_a_hue() -> None:
    colours = np.array([[0.1, 0.6, 0.2], [0.6, 0.1, 0.1], [0.5, 0.6, 0.5], [0.0, 0.05, 0.0], [0.1, 0.2, 0.7]])
    assert is_green(colours).tolist() == [True, False, False, False, False]
