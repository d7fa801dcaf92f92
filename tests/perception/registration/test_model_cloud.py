"""A model's tables: spacing, blur on the surface, what is seen from where."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.assets import Asset, symmetry
from twin_diagram.perception.registration.model_cloud import ModelCloud, fibonacci_sphere, other_poses, visible
from twin_diagram.perception.registration.point_kernels import UNPAINTED
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.turned_alike import probability, unweighed

Array = npt.NDArray[np.float64]


@functools.cache
def plates() -> Asset:
    """Two parallel plates, 6 mm apart, that face away from one another: 15 × 12 points 4 mm apart each, jittered."""
    rng = np.random.default_rng(2111)
    grid = np.stack(np.meshgrid(np.arange(15) * 0.004, np.arange(12) * 0.004, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid + rng.normal(0.0, 0.0004, grid.shape)
    top = np.insert(grid, 2, 0.003, axis=1)
    points = np.concatenate([top, top * [1.0, 1.0, -1.0]])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], len(grid), axis=0)
    colours = rng.uniform(0.0, 1.0, points.shape)
    order = rng.permutation(len(points))
    return Asset("plates", None, points[order], normals[order], colours[order], None, (points,), 0.1, np.ones(3))  # type: ignore[arg-type]


@functools.cache
def model() -> ModelCloud:
    return ModelCloud.of(plates(), 100)


def test_spacing_and_radius_are_the_clouds_own() -> None:
    points = plates().points_O
    nearest = [sorted(np.linalg.norm(points - p, axis=1))[1] for p in points]
    assert model().spacing == pytest.approx(2.0 * np.median(nearest))
    assert model().radius == pytest.approx(max(np.linalg.norm(points, axis=1)))


def test_colours_are_blurred_over_the_surface_among_neighbours_that_face_alike() -> None:
    asset = plates()
    for level, sigma in enumerate((0.003, 0.008)):
        for m in range(0, 360, 23):
            apart = np.linalg.norm(asset.points_O - asset.points_O[m], axis=1)
            near = np.argsort(apart)[:24]
            weight = np.exp(-0.5 * (apart[near] / sigma) ** 2)
            weight *= asset.normals_O[near] @ asset.normals_O[m] > 0.7
            wanted = weight @ asset.colours[near] / weight.sum()
            np.testing.assert_allclose(model().colours[level, m], wanted, atol=1e-9)


def test_colours_that_no_picture_showed_do_not_blur_into_those_that_one_did() -> None:
    made_up = plates().points_O[:, 0] > 0.03
    told = []
    for grey in (0.0, 1.0):
        colours = np.where(made_up[:, None], grey, plates().colours)
        told.append(ModelCloud.of(replace(plates(), colours=colours, unpainted=made_up), 100))
    np.testing.assert_array_equal(told[0].colours[:, ~made_up], told[1].colours[:, ~made_up])
    np.testing.assert_array_equal(told[0].texture[~made_up], told[1].texture[~made_up])
    assert (told[0].texture[made_up] == UNPAINTED).all() and told[0].texture[~made_up].max() < UNPAINTED / 1e3


@pytest.mark.parametrize(
    ("symmetries", "left"),
    [
        ((), 47),
        (((2, 0),), 1),  # upside down
        (((2, 0), (0, 2)), 0),
        (((2, 12),), 3),  # half a tooth; upside down, and half a tooth with it
    ],
)
def test_what_symmetries_tell_is_no_mistake(symmetries: tuple[tuple[int, int], ...], left: int) -> None:
    around = exp(2.0 * np.pi * np.outer(np.arange(24) / 24, [0.0, 0.0, 1.0]))
    over = exp(np.array([[np.pi, 0.0, 0.0]]))[0]
    turns = np.concatenate([around[1:], around @ over])
    kept = other_poses(turns, symmetries)
    assert len(kept) == left
    for turn in turns:
        same = [np.eye(3), *kept]
        assert symmetry.apart(turn, np.array(same), symmetries).min() < 1e-6, "each is one of those"
    given = ModelCloud.of(plates(), 100)
    told = replace(given, turns=turns, asset=replace(plates(), symmetries=symmetries))
    np.testing.assert_array_equal(told.mistaken, kept)
    one = RegisteredPose(np.eye(3), np.zeros(3), np.eye(6), 1.0, 1.0, 1.0, 100.0)
    assert (probability(unweighed(told, one).odds) > 0.99) == (left == 0), "of no other pose it is sure at once"


@pytest.mark.parametrize(("angle", "alike"), [(44.0, True), (47.0, False)])
def test_faces_alike_are_those_within_45_degrees(angle: float, alike: bool) -> None:
    rng = np.random.default_rng(2112)
    points = np.stack([np.arange(40) * 0.001, rng.normal(0, 1e-4, 40), np.zeros(40)], axis=1)
    tilt = np.radians(angle)
    normals = np.tile([0.0, 0.0, 1.0], (40, 1))
    normals[20:] = [np.sin(tilt), 0.0, np.cos(tilt)]
    colours = np.zeros((40, 3))
    colours[20:] = 1.0
    asset = Asset("fold", None, points, normals, colours, None, (points,), 0.1, np.ones(3))  # type: ignore[arg-type]
    assert (ModelCloud.of(asset, 10).colours[0, 19, 0] > 0.1) == alike


def test_each_direction_has_the_points_that_are_seen_from_there() -> None:
    cloud = model()
    assert cloud.directions.shape == (160, 3) and cloud.views.shape == (160, 100)
    for k in range(0, 160, 7):
        seen = np.flatnonzero(visible(cloud.points, cloud.normals, cloud.directions[k], 2.0 * cloud.spacing))
        count = min(len(seen), 100)
        assert cloud.view_counts[k] == count
        if count:
            np.testing.assert_array_equal(cloud.views[k], np.resize(seen[:100], 100))
        up = cloud.directions[k][2]
        if abs(up) > 0.15:
            assert count == 100 and (cloud.normals[cloud.views[k]][:, 2] * up > 0.0).all()
    assert ((cloud.view_counts == 0) == (np.abs(cloud.directions[:, 2]) <= 0.1)).all()


def test_directions_are_spread_evenly_from_pole_to_pole() -> None:
    found = fibonacci_sphere(200)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    np.testing.assert_allclose(found[:, 2], 1.0 - (2.0 * np.arange(200) + 1.0) / 200.0)
    apart = np.sort(found @ found.T, axis=1)[:, -2]
    nearest = np.degrees(np.arccos(apart))
    assert 11.0 < nearest.min() and nearest.max() < 15.0  # 14.4° were 200 on a lattice of equal areas
    turn = np.diff(np.unwrap(np.arctan2(found[:, 1], found[:, 0])))
    np.testing.assert_allclose(np.abs(turn), np.pi * (3.0 - np.sqrt(5.0)), atol=1e-9)


# What hides what.


def step(height: float, tilt: float = 0.0) -> npt.NDArray[np.bool_]:
    """A floor and, over its left half, a shelf at a height: which points a camera above sees."""
    grid = np.stack(np.meshgrid(np.arange(20) * 0.005, np.arange(10) * 0.005, indexing="ij"), axis=-1).reshape(-1, 2)
    floor = np.insert(grid, 2, 0.0, axis=1)
    shelf = np.insert(grid[grid[:, 0] < 0.0475], 2, height, axis=1)
    normal = [np.sin(tilt), 0.0, np.cos(tilt)]
    points = np.concatenate([floor, shelf])
    normals = np.tile(normal, (len(points), 1))
    return visible(points, normals, np.array([0.0, 0.0, 1.0]), 0.01)


def test_what_lies_twelve_millimetres_behind_is_hidden() -> None:
    for height, hidden in ((0.011, False), (0.013, True), (-0.013, False)):
        seen = step(height)
        left = np.repeat(np.arange(20) < 10, 10)
        assert seen[:200][~left].all() and (not seen[:200][left].any()) == hidden
        assert seen[200:].all() == (height > -0.012)


def test_what_faces_away_or_nearly_so_is_not_seen() -> None:
    for cosine, sees in ((0.11, True), (0.09, False), (-1.0, False)):
        normals = np.tile([np.sqrt(1.0 - cosine**2), 0.0, cosine], (4, 1))
        points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0]])
        assert (visible(points, normals, np.array([0.0, 0.0, 1.0]), 0.01) == sees).all()


def test_a_slope_hides_nothing_of_itself() -> None:
    """Its points lie far behind one another in a cell, but not above one another's tangent plane."""
    rng = np.random.default_rng(2113)
    across = rng.uniform(0.0, 0.1, (600, 2))
    points = np.column_stack([across, 4.0 * across[:, 0]])
    normals = np.tile(np.array([-4.0, 0.0, 1.0]) / np.sqrt(17.0), (600, 1))
    assert visible(points, normals, np.array([0.0, 0.0, 1.0]), 0.01).all()


def test_hiding_does_not_depend_on_which_way_is_up() -> None:
    rng = np.random.default_rng(2114)
    grid = rng.uniform(0.0, 0.1, (500, 2))
    points = np.concatenate([np.insert(grid, 2, 0.0, axis=1), np.insert(0.4 * grid, 2, 0.05, axis=1)])
    normals = np.tile([0.0, 0.0, 1.0], (1000, 1))
    hidden = 500 - np.count_nonzero(visible(points, normals, np.array([0.0, 0.0, 1.0]), 0.01)[:500])
    for axis in range(3):
        turned, upright = np.roll(points, axis, axis=1), np.roll(normals, axis, axis=1)
        seen = visible(turned, upright, np.roll([0.0, 0.0, 1.0], axis), 0.01)
        assert seen[500:].all() and abs(500 - np.count_nonzero(seen[:500]) - hidden) < 30
    assert 60 < hidden < 130  # of a shelf over 16 % of the floor, with the cells' rim
