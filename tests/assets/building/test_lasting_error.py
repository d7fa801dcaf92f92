"""What all pictures have wrong at the same pixels is told from shape and poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from tests.assets.building.pictured import Shots, box, cameras, cup, shots
from twin_diagram.assets.building.depth_view import DepthView, cropped
from twin_diagram.assets.building.lasting_equations import Nodes, Problem
from twin_diagram.assets.building.lasting_error import LastingError, lasting_error, one_camera
from twin_diagram.assets.building.view_poses import align, surface_cells

LOW, HIGH = np.array([-0.03, -0.03, 0.0]), np.array([0.03, 0.03, 0.05])
TABLE = np.array([0.0, 0.0, 1.0, 0.0])
WAVE = 15.0 * 200 / 640
"""σ of waves in pictures 200 pixels wide [px]."""


def field(shape: tuple[int, int], sigma: float, seed: int) -> np.ndarray:
    """White noise blurred to a variance of 1."""
    rough = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), sigma, mode="wrap")
    return np.asarray(rough * 2 * np.sqrt(np.pi) * sigma)


def spoiled(taken: Shots, waves: np.ndarray, white: float) -> Shots:
    """Pictures whose inverse depth is off by waves (h, w), alike in all, and by white noise of its own [1/m]."""
    rng = np.random.default_rng(3)
    frames = []
    for frame in taken.frames:
        off = waves + white * rng.standard_normal(frame.depth.shape)
        depth = np.where(frame.depth > 0, frame.depth / (1 + frame.depth * off), 0).astype(np.float32)
        frames.append(replace(frame, depth=depth))
    return Shots(frames)


def windows(taken: Shots) -> list[DepthView]:
    corners = np.stack(np.meshgrid(*np.stack([LOW - 0.01, HIGH + 0.01], axis=1)), axis=-1).reshape(-1, 3)
    views = [cropped(frame, corners, 30) for frame in taken.frames]
    return [view for view in views if view is not None]


def told(taken: Shots) -> LastingError | None:
    return lasting_error(align(windows(taken), LOW, HIGH, TABLE), LOW, HIGH)


@pytest.fixture(scope="module")
def pictures() -> Shots:
    return shots([cup()], cameras(12, 0.025))


@pytest.mark.parametrize("ring", [False, pytest.param(True, marks=pytest.mark.long)])
def test_waves_are_told_and_taken_out(pictures: Shots, ring: bool) -> None:
    if ring:
        pictures = shots([box((0.05, 0.035, 0.04))], cameras(12, 0.02, low=35.0, high=35.0))
    waves = 0.004 * field((160, 200), WAVE, 1)
    wrong = spoiled(pictures, waves, 0.003)
    found = told(wrong)
    assert found is not None and found.evidence > 50
    right = spoiled(pictures, 0 * waves, 0.003)  # the same white noise
    before, after = [], []
    for off, true in zip(windows(wrong), windows(right), strict=True):
        inner = (off.trust > 0.5) & (true.trust > 0.5)
        freed = found.taken_from(off)
        scale = 1 / true.depth[inner] ** 2
        before.append((off.depth - true.depth)[inner] * scale)
        after.append((freed.depth - true.depth)[inner] * scale)
    was, left = (float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for x in (before, after))
    # From a ring of one height, sides are seen at the same pixels at the same slant: part of it looks like shape.
    assert left < (0.75 if ring else 0.6) * was


@pytest.mark.long
def test_without_waves_nothing_is_found(pictures: Shots) -> None:
    patches = [0.003 * field((160, 200), 1.0, 10 + k) for k in range(len(pictures.frames))]
    fresh = [spoiled(Shots([f]), own, 0.001).frames[0] for f, own in zip(pictures.frames, patches, strict=True)]
    assert told(Shots(fresh)) is None


@pytest.mark.long
@pytest.mark.parametrize("ring", [False, True])
@pytest.mark.parametrize("white", [0.0, 0.003])
def test_shape_is_not_taken_for_waves(pictures: Shots, ring: bool, white: float) -> None:
    if ring:
        pictures = shots([box((0.05, 0.035, 0.04))], cameras(12, 0.02, low=35.0, high=35.0))
    assert told(spoiled(pictures, np.zeros((160, 200)), white)) is None


def test_two_cameras_share_no_error(pictures: Shots) -> None:
    views = windows(pictures)
    assert one_camera(views)
    other = replace(views[0].camera, fx=views[0].camera.fx + 1)
    assert not one_camera([replace(views[0], camera=other), *views[1:]])
    assert not one_camera([replace(views[0], corner=(0, 0)), *views[1:]])
    found = align(views, LOW, HIGH, TABLE)
    assert (
        lasting_error(replace(found, views=[replace(found.views[0], camera=other), *found.views[1:]]), LOW, HIGH)
        is None
    )
    assert lasting_error(replace(found, views=found.views[:8]), LOW, HIGH) is None  # too few


def test_values_between_nodes() -> None:
    nodes = Nodes.over(np.array([[10.0, 20.0], [40.0, 60.0]]), 8.0)
    row, column = (nodes.first[k] + nodes.step * np.arange(nodes.count[k]) for k in range(2))
    values = 2.0 * row[:, None] - 0.5 * column
    pixels = np.array([[10.0, 20.0], [17.3, 33.9], [40.0, 60.0]])
    np.testing.assert_allclose(nodes.interpolation(pixels) @ values.ravel(), 2 * pixels[:, 0] - 0.5 * pixels[:, 1])
    inverse, determinant = nodes.precision()
    assert np.linalg.slogdet(inverse)[1] == pytest.approx(determinant, rel=1e-6)
    assert Nodes.over(np.array([[0.0, 0.0], [4000.0, 3000.0]]), 8.0).size < 1300


def test_windows_get_the_part_of_the_picture_they_show(pictures: Shots) -> None:
    view = windows(pictures)[0]
    row, column = np.arange(0, 161, 4.0), np.arange(0, 201, 4.0)
    error = LastingError(np.zeros(2), 4.0, 1e-4 * (row[:, None] + 2 * column), 100.0)
    v, u = np.indices(view.depth.shape)
    np.testing.assert_allclose(
        error.over(view), 1e-4 * (v + view.corner[0] + 2 * (u + view.corner[1])), rtol=1e-3, atol=1e-6
    )
    freed = error.taken_from(view)
    there = view.depth > 0
    np.testing.assert_allclose(1 / freed.depth[there] - 1 / view.depth[there], error.over(view)[there], atol=2e-4)
    assert (freed.depth[~there] == 0).all()


def test_cells_of_no_points_are_none() -> None:
    place, normal, cell = surface_cells(np.zeros((0, 3)), np.zeros((0, 3)), 0.004, np.zeros(3))
    assert len(place) == len(normal) == len(cell) == 0


def test_each_point_is_in_the_cell_whose_mean_it_is_part_of() -> None:
    rng = np.random.default_rng(2)
    points = np.append(rng.uniform(0, 0.02, (400, 2)), rng.normal(0, 0.0005, (400, 1)), axis=1)
    place, normal, cell = surface_cells(points, np.tile([0.0, 0, 1], (400, 1)), 0.004, rng.random(3))
    assert (normal == [0, 0, 1]).all()
    for k in range(len(place)):
        np.testing.assert_allclose(points[cell == k].mean(axis=0), place[k])
    assert np.bincount(cell[cell >= 0]).min() >= 3


def test_each_row_is_about_the_node_of_its_largest_share() -> None:
    rng = np.random.default_rng(0)
    pixels = np.concatenate([rng.uniform(0, 100, (500, 2)), [[20.0, 20.0], [25.0, 20.0]]])  # on a node, between two
    B = Nodes.over(pixels, 10.0).interpolation(pixels)[rng.permutation(len(pixels))]
    none = np.zeros(len(pixels))
    told = Problem(B, none, none, 0.0, none, B, none.astype(int), B)
    assert np.array_equal(told.nearest_node(), B.toarray().argmax(axis=1))
