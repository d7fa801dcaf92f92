"""What hangs on a thing is part of it; what stands, leans over or may stand unseen stays a thing of its own."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import box_hit, camera
from twin_diagram.perception.segmentation.hovering import Sight, touching, without_hovering
from twin_diagram.perception.segmentation.segmentation import Grid, label_pixels
from twin_diagram.scenario import Perception

Array = npt.NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
BODY: Box = ((0.5, 0.0, 0.06), (0.08, 0.08, 0.12))
HANDLE: Box = ((0.52, 0.055, 0.06), (0.02, 0.03, 0.06))


def seen(boxes: list[Box], stride: int = 1) -> npt.NDArray[np.int16]:
    """Labels of boxes (middle, edges) in the air above a table, before the usual camera with a little noise."""
    view = camera()
    rays = view.rays()
    z = -view.p_WC[2] / rays[..., 2]
    for middle, edges in boxes:
        z = np.minimum(z, box_hit(view.p_WC - np.array(middle), rays, np.array(edges) / 2)[0])
    z = (z + 0.0008 * np.random.default_rng(1).standard_normal(z.shape)).astype(np.float32)
    depth = np.ascontiguousarray(z[::stride, ::stride])
    params = Perception(stride=stride, smallest=240 // stride**2)
    return label_pixels(depth, Grid.of(view, stride), params).label_image


@pytest.mark.parametrize(
    ("other", "count"),
    [
        (HANDLE, 1),
        (((0.52, 0.055, 0.03), (0.02, 0.03, 0.06)), 2),  # the same on the table: something that touches
        (((0.5, 0.0, 0.14), (0.04, 0.04, 0.04)), 2),  # on top
        (((0.5, 0.0, 0.13), (0.04, 0.2, 0.02)), 2),  # on top and far over the sides
        (((0.445, 0.0, 0.17), (0.03, 0.08, 0.04)), 2),  # behind: its foot is hidden
    ],
)
@pytest.mark.parametrize("stride", [1, 2])
def test_what_the_table_does_not_hold_up_hangs_on_its_neighbour(other: Box, count: int, stride: int) -> None:
    assert seen([BODY], stride).max() == 0
    assert seen([BODY, other], stride).max() + 1 == count


def test_an_arrangement_seen_from_the_side_and_the_head_downwards() -> None:
    """Labels, depth and heights turned in the image's plane: the same join."""
    label = np.full((40, 40), -1, dtype=np.int32)
    label[10:30, 10:20], label[14:22, 20:24] = 0, 1
    label[34:38, 2:6] = 2
    height = np.clip(np.float32(0.01) * np.arange(30, -10, -1, dtype=np.float32)[:, None].repeat(40, 1), 0, None)
    depth = np.ones((40, 40), dtype=np.float32)
    R = np.column_stack([[0.0, -1.0, 0.0], [-0.6, 0.0, -0.8], [0.8, 0.0, -0.6]])
    up = np.array([0.0, 0.0, 1.0])
    for quarter in range(4):
        c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
        sight = Sight.of(R @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), up, 0.004)
        assert abs(sight.down) + abs(sight.right) == 1 and sight.level == pytest.approx(0.8)
        turned = [np.rot90(image, quarter) for image in (label, depth, height)]
        joined = without_hovering(turned[0], turned[1], turned[2], 0.006, 0.02, sight)
        expected = np.where(label == 1, 0, np.where(label == 2, 1, label))
        assert (np.rot90(joined, -quarter) == expected).all(), quarter


def test_parts_touch_over_neighbouring_pixels_that_are_near_in_depth() -> None:
    label = np.array([[0, 0, 1], [0, 0, 1], [-1, 2, 2]], dtype=np.int32)
    depth = np.array([[1.0, 1.0, 1.01], [1.0, 1.0, 1.5], [1.0, 1.0, 1.5]], dtype=np.float32)
    assert touching(label, depth, 3, 0.02).tolist() == [[0, 1, 1], [1, 0, 1], [1, 1, 0]]


def test_from_straight_above_nothing_is_seen_to_hover() -> None:
    sight = Sight.of(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]), 0.004)
    assert (sight.down, sight.right, sight.level) == (0, 0, 0.0)
    label = np.zeros((10, 10), dtype=np.int32)
    label[:3, 3:6] = 1
    height = np.where(label == 1, 0.05, 0.1).astype(np.float32)
    depth = np.ones((10, 10), dtype=np.float32)
    assert (without_hovering(label, depth, height, 0.006, 0.02, sight) == label).all()
