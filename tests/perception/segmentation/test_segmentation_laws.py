"""Laws of segmentation: the table by weighted least squares, parts by brute force, an image taken apart by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import Segments

Array = npt.NDArray[np.float64]


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
        asked.append((points, margin))
        return np.asarray(points[:, 0] > 0.0)

    found = segment(rgb, depth, 0.0, Grid.of(DOWN, 2), PARAMS, near)
    assert asked[0][1] == PARAMS.robot_clearance and all((points[:, 2] > 0.04).all() for points, _ in asked)
    assert found.count == 1 and (found.label_image[15:18, 20:24] == -2).all()
    assert np.count_nonzero(found.label_image == -2) == 12


def near_below(limit: float) -> Any:
    """A robot that fills all below a height, seen as a wall of the points' x: distance is x + 0.09 m."""
    return lambda points, margin: points[:, 0] + 0.09 - limit < margin


def test_a_thing_that_touches_the_robot_is_seen_up_to_it() -> None:
    """A block of 10 × 10 cm from x = -0.09 m on; the robot is what is left of its edge, or of a line in it."""
    rgb, depth = image()
    depth[14, 14] = 0.9
    block = (slice(5, 10), slice(5, 10))
    fine = PARAMS.__class__(**{**vars(PARAMS), "robot_clearance": 0.01})
    # Columns are 9 mm apart, the first at x = -0.08775: distances 2, 11, 20 mm … plus what the robot is short of.
    # Within 10 mm they are the robot's, but from 4 mm on the block's surface goes on there.
    for short, robots in ((0.02, 0), (0.004, 0), (0.0025, 0), (0.001, 1), (0.0, 1), (-0.01, 2)):
        found = segment(rgb, depth, 0.0, Grid.of(DOWN, 2), fine, near_below(-short))
        label = found.label_image[block]
        assert (label[:, :robots] == -2).all() and (label[:, robots:] == 0).all(), short
        assert found.count == 2


def test_what_stays_within_the_robots_rim_is_no_thing() -> None:
    rgb, depth = image()
    depth[14, 14] = 0.9
    block = (slice(5, 10), slice(5, 10))
    whole = np.full((5, 5), -2)
    # The robot takes the first two columns; of the others, this many lie beyond the rim.
    for rim, label in ((0.031, [-2, -2, -2]), (0.03, [-2, -2, -2])):
        near = lambda points, margin, rim=rim: points[:, 0] + 0.09 < (0.019 if margin < 0.0121 else rim + 0.05)  # noqa: E731
        fine = PARAMS.__class__(**{**vars(PARAMS), "robot_clearance": 0.012})
        found = segment(rgb, depth, 0.0, Grid.of(DOWN, 2), fine, near)
        np.testing.assert_array_equal(found.label_image[block], whole)
        assert found.count == 1 and set(np.unique(found.labels)) == {0}, label


def test_an_image_of_nothing_but_the_robot_has_no_things() -> None:
    rgb, depth = image()
    found = segment(rgb, depth, 0.0, Grid.of(DOWN, 2), PARAMS, lambda points, margin: np.ones(len(points), bool))
    assert found.count == 0 and len(found.points_W) == 0
    assert (found.label_image[15:18, 20:24] == -2).all() and (found.label_image[0] == -1).all()


def test_before_the_first_image_no_pixel_has_depth() -> None:
    for stride, shape in ((1, (44, 60)), (2, (22, 30)), (3, (15, 20)), (7, (7, 9)), (44, (1, 2))):
        none = Segments.empty(DOWN, stride, 0.25)
        rays = Grid.of(DOWN, stride).rays
        assert none.label_image.shape == shape == rays.shape[:2] and (none.label_image == -3).all()
        assert none.depth.shape == (44, 60) and none.rgb.shape == (44, 60, 3) and none.time == -1.0
        np.testing.assert_array_equal(none.table, [0.0, 0.0, 0.25])
        assert none.count == 0 and none.points_W.shape == (0, 3) and none.stride == stride
