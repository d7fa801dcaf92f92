"""Laws of segmentation: the table by weighted least squares, parts by brute force, an image taken apart by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram import scenario
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.segmentation import Grid, connected, fit_table, large_parts, segment
from twin_diagram.perception.segmentation.segments import Segments

Array = npt.NDArray[np.float64]


# The table.


def fitted(points: Array, height: float) -> Array:
    """Four rounds of least squares with Tukey's weights from four robust deviations on, 0.5 mm at least."""
    near = points[np.abs(points[:, 2] - height) < 0.015]
    near = near[:: max(1, len(near) // 4000)]
    middle = near[:, :2].mean(axis=0)
    A = np.column_stack([near[:, :2] - middle, np.ones(len(near))])
    weight = np.ones(len(near))
    for _ in range(4):
        root = np.sqrt(weight)
        plane = np.linalg.lstsq(A * root[:, None], near[:, 2] * root, rcond=None)[0]
        off = near[:, 2] - A @ plane
        scale = max(1.4826 * np.median(np.abs(off)), 0.0005)
        weight = np.array([(1.0 - (x / (4.0 * scale)) ** 2) ** 2 if abs(x) < 4.0 * scale else 0.0 for x in off])
    a, b, c = plane
    return np.array([a, b, c - a * middle[0] - b * middle[1]])


@pytest.mark.parametrize(("noise", "count"), [(0.002, 900), (0.0002, 9000), (0.004, 700)])
def test_the_table_is_the_robust_plane_near_its_known_height(noise: float, count: int) -> None:
    rng = np.random.default_rng(2141)
    xy = rng.uniform([0.1, -0.6], [1.0, 0.6], (count, 2))
    z = 0.3 + xy @ [0.006, -0.004] + noise * rng.standard_normal(count)
    z[::7] += rng.uniform(0.002, 0.04, len(z[::7]))
    points = np.column_stack([xy, z])
    found = fit_table(points, 0.301)
    np.testing.assert_allclose(found, fitted(points, 0.301), atol=1e-7)
    np.testing.assert_allclose(found[:2], [0.006, -0.004], atol=2e-3)


def test_points_a_centimetre_and_a_half_off_are_of_something_else() -> None:
    """The known height may be 1.4 cm off, not 1.6 cm."""
    rng = np.random.default_rng(2142)
    flat = np.column_stack([rng.uniform(-0.5, 0.5, (600, 2)), 0.2 + 1e-5 * rng.standard_normal(600)])
    for off, seen in ((0.0145, True), (-0.0145, True), (0.0155, False), (-0.0155, False)):
        height = fit_table(flat, 0.2 + off)[2]
        assert height == pytest.approx(0.2 if seen else 0.2 + off, abs=1e-4)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("tilt", "believed"), [(0.0195, True), (-0.0195, True), (0.0205, False), (-0.0205, False)])
def test_a_table_that_tilts_by_more_than_a_fiftieth_is_not_believed(axis: int, tilt: float, believed: bool) -> None:
    xy = np.random.default_rng(2143).uniform(-0.3, 0.3, (800, 2))
    found = fit_table(np.column_stack([xy, 0.1 + tilt * xy[:, axis]]), 0.1)
    np.testing.assert_allclose(found[axis], tilt if believed else 0.0, atol=1e-6)


def test_two_hundred_points_make_a_table() -> None:
    xy = np.random.default_rng(2144).uniform(-0.3, 0.3, (200, 2))
    points = np.column_stack([xy, np.full(200, 0.105)])
    assert fit_table(points, 0.1)[2] == pytest.approx(0.105)
    assert fit_table(points[:199], 0.1)[2] == 0.1


# Parts.

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))


def test_parts_are_those_of_a_flood_from_pixel_to_pixel() -> None:
    rng = np.random.default_rng(2145)
    for density in (0.25, 0.4, 0.6):
        inside = rng.random((14, 17)) < density
        points = rng.uniform(0.0, 1.0, (14, 17, 3)) * [0.6, 0.5, 0.4]
        gap = 0.28
        place = {at: k for k, at in enumerate(zip(*np.nonzero(inside), strict=True))}
        number = [-1] * len(place)
        for at, k in place.items():
            if number[k] >= 0:
                continue
            number[k], todo = k, [at]
            while todo:
                row, column = todo.pop()
                for dr, dc in [*STEPS, *((-dr, -dc) for dr, dc in STEPS)]:
                    other = (row + dr, column + dc)
                    if other in place and number[place[other]] < 0:
                        if np.linalg.norm(points[row, column] - points[other]) < gap:
                            number[place[other]] = k
                            todo.append(other)
        found = connected(points, inside, gap)
        same = np.equal.outer(found, found)
        np.testing.assert_array_equal(same, np.equal.outer(number, number))
        assert len(set(number)) > 3


def test_parts_of_just_the_smallest_size_are_kept() -> None:
    label, count = large_parts(np.array([2, 2, 0, 1, 1, 1, 2]), 3)
    assert count == 2 and label.tolist() == [1, 1, -1, 0, 0, 0, 1]


# A whole image: a camera that looks straight down from 1 m at blocks on a table.

DOWN = Pinhole(60, 44, 200.0, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
PARAMS = scenario.Perception(stride=2, workspace=[[-0.5, -0.4, -0.02], [0.5, 0.4, 0.6]], smallest=6)


def image() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    rgb = np.random.default_rng(2146).integers(0, 256, (44, 60, 3)).astype(np.uint8)
    depth = np.full((44, 60), 1.0, dtype=np.float32)
    depth[10:20, 10:20] = 0.9  # a block of 5 × 5 pixels of every second
    depth[30:36, 40:48] = 0.95
    depth[30:34, 20:22] = 0.9  # a speck of 2 × 1
    depth[14, 14], depth[24, 24] = np.nan, 0.0
    return rgb, depth


def test_an_image_is_taken_apart() -> None:
    rgb, depth = image()
    found = segment(rgb, depth, 3.5, Grid.of(DOWN, 2), PARAMS)
    label = np.full((22, 30), -1)
    label[5:10, 5:10], label[15:18, 20:24] = 0, 1
    label[7, 7] = label[12, 12] = -3
    np.testing.assert_array_equal(found.label_image, label)
    assert found.count == 2 and found.time == 3.5 and found.stride == 2
    row, column = np.nonzero(label >= 0)
    np.testing.assert_array_equal(found.labels, label[row, column])
    z = depth[2 * row, 2 * column]
    wanted = np.stack([(2 * column - 29.5) / 200.0 * z, -(2 * row - 21.5) / 200.0 * z, 1.0 - z], axis=1)
    np.testing.assert_allclose(found.points_W, wanted, atol=1e-6)
    np.testing.assert_allclose(found.colours, rgb[2 * row, 2 * column] / 255.0)
    np.testing.assert_allclose(found.table, 0.0, atol=1e-6)
    assert found.depth[14, 14] == 0.0 and np.isnan(depth[14, 14])
    np.testing.assert_array_equal(found.rgb, rgb)
    assert found.normals_W.shape == (len(row), 3)


def test_the_robots_points_are_left_out_where_they_stand() -> None:
    rgb, depth = image()
    asked: list[Any] = []

    def near(points: Array, margin: float) -> npt.NDArray[np.bool_]:
        asked[:] = [points, margin]
        return np.asarray(points[:, 0] > 0.0)

    found = segment(rgb, depth, 0.0, Grid.of(DOWN, 2), PARAMS, near)
    assert asked[1] == PARAMS.robot_clearance and (asked[0][:, 2] > 0.04).all()
    assert found.count == 1 and (found.label_image[15:18, 20:24] == -2).all()
    assert np.count_nonzero(found.label_image == -2) == 12


def test_before_the_first_image_no_pixel_has_depth() -> None:
    for stride, shape in ((1, (44, 60)), (2, (22, 30)), (3, (15, 20)), (7, (7, 9)), (44, (1, 2))):
        none = Segments.empty(DOWN, stride, 0.25)
        rays = Grid.of(DOWN, stride).rays
        assert none.label_image.shape == shape == rays.shape[:2] and (none.label_image == -3).all()
        assert none.depth.shape == (44, 60) and none.rgb.shape == (44, 60, 3) and none.time == -1.0
        np.testing.assert_array_equal(none.table, [0.0, 0.0, 0.25])
        assert none.count == 0 and none.points_W.shape == (0, 3) and none.stride == stride
