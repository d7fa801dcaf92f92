"""An image made ready: what is cut out, what is looked up at a pixel and beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.registration_bench import TABLE, frame, model, view
from tests.registration_kernels import colour_at, counted
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame, blur_within, median_of, whole_pixels
from twin_diagram.perception.segmentation.segments import Segments

Array = npt.NDArray[np.float64]
H, W = 120, 160


def segmented(rows: tuple[int, int], columns: tuple[int, int], robot: tuple[int, int] | None = None) -> Segments:
    """One object in a part of the label image (60, 80), and a pixel of the robot."""
    rng = np.random.default_rng(2101)
    label = np.full((60, 80), -1, dtype=np.int16)
    label[rows[0] : rows[1], columns[0] : columns[1]] = 0
    label[0, :] = -3
    if robot:
        label[robot] = -2
    count = int((label >= 0).sum())
    normals = rng.normal(size=(count, 3))
    none = Segments.empty(view(), 2)
    rgb = rng.integers(0, 256, (H, W, 3)).astype(np.uint8)
    depth = rng.uniform(0.4, 0.7, (H, W)).astype(np.float32)
    return replace(none, label_image=label, normals_W=normals, rgb=rgb, depth=depth, table=TABLE.copy(), count=1)


def test_what_stands_on_the_table_is_cut_out_with_a_margin_of_32_pixels() -> None:
    segments = segmented((20, 25), (30, 42), robot=(50, 70))
    found = Frame.of(segments)
    # Rows 20 to 24 of every second pixel are 40 to 48, columns 30 to 41 are 60 to 82.
    assert found.corner == (28, 8)
    assert found.colours[0].shape == found.colours[1].shape == (80 - 8, 114 - 28, 3)
    near = Frame.of(segmented((2, 4), (1, 3)))
    assert near.corner == (0, 0) and near.colours[0].shape[:2] == (6 + 32, 4 + 32)
    far = Frame.of(segmented((50, 60), (70, 80)))
    assert far.corner == (140 - 32, 100 - 32) and far.colours[0].shape[:2] == (120 - 68, 160 - 108)
    nothing = Frame.of(segmented((5, 5), (5, 5)))
    assert nothing.colours[0].shape == (2, 2, 3) and not nothing.normals.any()


def test_colours_are_blurred_among_the_objects_pixels_alone() -> None:
    segments = segmented((20, 25), (30, 42))
    found = Frame.of(segments)
    mask = np.zeros((H, W), dtype=np.float32)
    mask[40:50, 60:84] = 1.0
    part = segments.rgb[8:80, 28:114] / np.float32(255.0)
    for width, colours in zip((3, 9), found.colours, strict=True):
        np.testing.assert_allclose(colours, blur_within(counted(part, mask[8:80, 28:114]), width), atol=1e-6)


def box_blur(image: Array, width: int) -> Array:
    """By sums over a square, mirrored at the edges as OpenCV does."""
    half = width // 2
    padded = np.pad(image, half, mode="reflect")
    rows, columns = image.shape
    return np.array([[padded[r : r + width, c : c + width].mean() for c in range(columns)] for r in range(rows)])


def test_blur_is_a_box_twice_over_the_mask_and_black_far_from_it() -> None:
    rng = np.random.default_rng(2102)
    image, mask = rng.uniform(0.2, 0.9, (20, 22, 3)).astype(np.float32), np.zeros((20, 22), np.float32)
    mask[6:13, 5:12] = 1.0
    found = blur_within(counted(image, mask), 3)
    share = box_blur(box_blur(mask.astype(float), 3), 3)
    for k in range(3):
        total = box_blur(box_blur(image[..., k] * mask.astype(float), 3), 3)
        np.testing.assert_allclose(found[..., k], total / np.maximum(share, 0.05), atol=1e-5)
    assert not found[:, 17:].any()


def test_the_images_edge_is_half_a_pixel_beyond_its_last_ones() -> None:
    camera = view()
    image = replace(frame(), depth=np.ones((H, W), np.float32), robot=np.zeros((H, W), bool), table=np.zeros(3))
    one = replace(model(), points=np.zeros((120, 3)), normals=np.tile(-camera.R_WC[:, 2], (120, 1)))
    for u, v, wanted in (
        (-0.49, 5.0, True),
        (-0.51, 5.0, False),
        (159.49, 5.0, True),
        (159.51, 5.0, False),
        (5.0, -0.49, True),
        (5.0, -0.51, False),
        (5.0, 119.49, True),
        (5.0, 119.51, False),
    ):
        ray = np.array([(u - 79.5) / 250.0, (v - 59.5) / 250.0, 1.0])
        at = Poses(np.eye(3)[None], (camera.p_WC + 0.5 * camera.R_WC @ ray)[None])
        found = look(one, image, at, 1, 0)
        assert bool(found.seen[0, 0]) is wanted, (u, v)
        assert found.deeper[0, 0] == pytest.approx(0.5 if wanted else -0.5)


def test_the_robots_pixels_are_those_of_its_labels() -> None:
    found = Frame.of(segmented((20, 25), (30, 42), robot=(50, 70)))
    wanted = np.zeros((H, W), dtype=bool)
    wanted[100:102, 140:142] = True
    np.testing.assert_array_equal(found.robot, wanted)
    segments = segmented((20, 25), (30, 42))
    np.testing.assert_allclose(Frame.of(segments).normals[20:25, 30:42].reshape(-1, 3), segments.normals_W, rtol=1e-6)


def test_colours_are_looked_up_between_pixels_and_their_slopes_by_a_pixel_each_way() -> None:
    image = frame()
    rng = np.random.default_rng(2105)
    u, v = rng.uniform(12.0, 140.0, (3, 30)), rng.uniform(8.0, 100.0, (3, 30))
    for level in (0, 1):
        colour = image.colours[level].astype(float)

        def at(x: float, y: float, colour: Array = colour) -> Array:
            c, r = x - 9, y - 5
            i, j = int(np.floor(r)), int(np.floor(c))
            a, b = r - i, c - j
            rows = (1 - b) * colour[i : i + 2, j] + b * colour[i : i + 2, j + 1]
            return np.asarray((1 - a) * rows[0] + a * rows[1])

        found, du, dv = colour_at(image, u, v, level)
        for k in np.ndindex(3, 30):
            x, y = u[k], v[k]
            np.testing.assert_allclose(found[k], at(x, y), atol=1e-6)
            np.testing.assert_allclose(du[k], 0.5 * (at(x + 1, y) - at(x - 1, y)), atol=1e-6)
            np.testing.assert_allclose(dv[k], 0.5 * (at(x, y + 1) - at(x, y - 1)), atol=1e-6)


def test_a_plain_look_up_is_that_of_the_slopes() -> None:
    image = frame()
    rng = np.random.default_rng(2303)
    u, v = rng.uniform(12.0, 140.0, (3, 30)), rng.uniform(8.0, 100.0, (3, 30))
    for level in (0, 1):
        np.testing.assert_array_equal(image.plain_colour_at(u, v, level), colour_at(image, u, v, level)[0])


def test_masks_of_cells_are_laid_on_all_their_pixels() -> None:
    rng = np.random.default_rng(2304)
    mask = rng.random((7, 9)) < 0.4
    for stride in (1, 2, 3):
        wanted = np.repeat(np.repeat(mask, stride, axis=0), stride, axis=1)[: 7 * stride - stride + 1, : 9 * stride]
        np.testing.assert_array_equal(whole_pixels(mask, stride, (7 * stride - stride + 1, 9 * stride)), wanted)


@pytest.mark.parametrize("count", [1, 2, 7, 8, 301, 400])
def test_medians_of_whole_numbers_are_counted(count: int) -> None:
    numbers = np.random.default_rng(count).integers(0, 40, count).astype(np.int16)
    assert median_of(np.bincount(numbers)) == np.median(numbers)
    assert median_of(np.bincount(np.repeat(numbers, 2)[1:])) == np.median(np.repeat(numbers, 2)[1:])
