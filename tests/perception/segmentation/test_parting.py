"""What touches comes apart, what is one stays one; the cuts by their own formulas."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.parting import (
    arm_length,
    far_sides,
    grown,
    hollow,
    joined,
    numbered,
    part,
    specks_joined,
)
from twin_diagram.perception.segmentation.segmentation import Grid, label_pixels, segment
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]
LYING = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def library() -> dict[str, Asset]:
    return {name: Asset.load(models_dir() / "objects" / name) for name in ("cracker_box", "sugar_box", "can")}


def extent(asset: Asset, R: Array) -> float:
    return float(np.abs(R[2]) @ asset.size)


def intersection_over_union(label: npt.NDArray[np.int16], owner: npt.NDArray[np.int64], k: int) -> float:
    on = owner == k
    return max(
        float((on & (label == j)).sum() / (on | (label == j)).sum()) for j in range(max(1, int(label.max()) + 1))
    )


@pytest.mark.parametrize("top", ["sugar_box", "can"])
@pytest.mark.parametrize("yaw", [0.1, 0.9, 2.2])
@pytest.mark.parametrize("stride", [1, 2])
def test_a_stack_of_two_is_two(library: dict[str, Asset], top: str, yaw: float, stride: int) -> None:
    view = camera()
    below, above = library["cracker_box"], library[top]
    R = yawed(yaw) @ LYING
    R_top = yawed(yaw + 0.5) @ (LYING if top == "sugar_box" else np.eye(3))
    low = extent(below, R)
    things = [
        Thing(below, 7, R, np.array([0.5, 0.0, low / 2])),
        Thing(above, 5, R_top, np.array([0.5, 0.0, low + extent(above, R_top) / 2])),
    ]
    rgb, depth, owner = picture(view, things, np.random.default_rng(3))
    found = segment(
        rgb, depth, 0.0, Grid.of(view, stride), scenario.Perception(stride=stride, smallest=240 // stride**2)
    )
    assert found.count == 2
    truth = np.where(depth > 0, owner, -3)[::stride, ::stride]
    for k in (0, 1):
        assert intersection_over_union(found.label_image, truth, k) > 0.85, k
    # The lower one's lid holds something, and is said to be a plane.
    assert any(abs(plane.height(np.array([0.5, 0.0, low]))) < 2e-3 for plane in found.planes[1:])


def test_boxes_that_touch_at_an_angle_are_two_and_one_box_is_one(library: dict[str, Asset]) -> None:
    view = camera()
    box = library["cracker_box"]
    half = box.size / 2
    things = [
        Thing(box, 7, yawed(0.8), np.array([0.5, 0.0, half[2]])),
        Thing(box, 5, yawed(-0.8), np.array([0.5, 0.14, half[2]])),
    ]
    rgb, depth, _ = picture(view, things[:1], np.random.default_rng(3))
    assert segment(rgb, depth, 0.0, Grid.of(view, 2), scenario.Perception()).count == 1
    rgb, depth, owner = picture(view, things, np.random.default_rng(3))
    found = segment(rgb, depth, 0.0, Grid.of(view, 2), scenario.Perception())
    assert found.count == 2
    truth = np.where(depth > 0, owner, -3)[::2, ::2]
    assert min(intersection_over_union(found.label_image, truth, k) for k in (0, 1)) > 0.85


def test_every_pixel_of_a_whole_image_gets_its_label(library: dict[str, Asset]) -> None:
    """At stride 1 the parts are found at every second pixel; the rest follow, as exactly as the depth tells."""
    view = camera()
    things = [
        Thing(library["sugar_box"], 7, yawed(0.4), np.array([0.5, -0.2, library["sugar_box"].size[2] / 2])),
        Thing(library["can"], 5, yawed(0.0), np.array([0.6, 0.15, library["can"].size[2] / 2])),
        Thing(library["cracker_box"], 5, yawed(1.0), np.array([0.35, 0.05, library["cracker_box"].size[2] / 2])),
    ]
    _, depth, owner = picture(view, things, np.random.default_rng(3))
    apart = label_pixels(depth, Grid.of(view, 1), scenario.Perception(stride=1))
    assert apart.label_image.shape == depth.shape and apart.count == 3
    assert ((apart.label_image == -3) == (depth == 0)).all()
    truth = np.where(depth > 0, owner, -3)
    for k in range(3):
        assert intersection_over_union(apart.label_image, truth, k) > 0.93, k
    standing = apart.label_image >= 0
    assert (truth[standing] >= 0).mean() > 0.9995
    first = [int(np.flatnonzero(apart.label_image.ravel() == k)[0]) for k in range(3)]
    assert first == sorted(first)


# The cuts.


def wedge(angle: float, width: int = 60, depth: float = 1.0, pitch: float = 0.003) -> npt.NDArray[np.float32]:
    """Two planes that meet in the middle column and turn by `angle` there, towards the camera if positive."""
    x = (np.arange(width) - width // 2) * pitch
    # Planes z = depth + s |x|, seen through a pinhole: z = depth / (1 - s |x|), s < 0 where the edge is hollow.
    slope = -np.tan(angle / 2)
    z = depth / (1.0 - slope * np.abs(x))
    return np.tile(z, (40, 1)).astype(np.float32)


@pytest.mark.parametrize(("angle", "cut"), [(0.42, False), (0.54, True), (1.2, True), (-0.54, False), (-1.2, False)])
@pytest.mark.parametrize("turned", [False, True])
def test_an_edge_is_hollow_from_its_angle_on(angle: float, cut: bool, turned: bool) -> None:
    z = wedge(angle)
    z = np.ascontiguousarray(z.T) if turned else z
    along_rows, along_columns = hollow(z, 0.003, 6)
    if turned:
        along_rows, along_columns = along_columns.T, along_rows.T
    assert along_rows[10:-10, 30].all() == cut and along_rows[10:-10, 30].any() == cut
    # The band is no wider than the arm, with the little that smoothing adds; slanting arms are in both.
    assert not along_rows[:, : 30 - 8].any() and not along_rows[:, 30 + 9 :].any()
    if cut and abs(angle) < 0.6:
        assert not along_columns[10:-10, 30].any()


def test_a_step_is_no_hollow_edge_and_nothing_is_without_depth() -> None:
    z = np.full((40, 60), 1.0, dtype=np.float32)
    z[:, 30:] = 1.5
    # Smoothing makes two columns of slope.
    assert not any(np.delete(mask, [29, 30], axis=1).any() for mask in hollow(z, 0.003, 6))
    z[:, 30:] = 1.05  # small enough to be a slope: hollow behind it, and not before
    small = hollow(z, 0.003, 6)[0][10:-10]
    assert not small[:, :29].any() and small[:, 31:35].all() and not small[:, 38:].any()
    assert not any(mask.any() for mask in hollow(np.zeros((40, 60), np.float32), 0.003, 6))
    assert not any(mask.any() for mask in hollow(np.ones((5, 5), np.float32), 0.003, 6))


@pytest.mark.parametrize(("step", "seen"), [(0.019, False), (0.021, True)])
def test_the_far_side_of_a_step_is_marked(step: float, seen: bool) -> None:
    z = np.full((9, 9), 1.0, dtype=np.float32)
    z[3:6, 3:6] -= step
    wanted = np.zeros((9, 9), dtype=bool)
    wanted[3:6, [2, 6]] = wanted[[2, 6], 3:6] = seen
    np.testing.assert_array_equal(far_sides(z, 0.02), wanted)
    z[2, 4] = 0.0  # no depth: no step
    wanted[2, 4] = False
    np.testing.assert_array_equal(far_sides(z, 0.02), wanted)


@pytest.mark.parametrize(
    ("sigma", "pitch", "arm"), [(1e-4, 3e-3, 3), (2e-3, 3e-3, 4), (2.4e-3, 3e-3, 5), (1e-2, 3e-3, 8)]
)
def test_the_arm_grows_with_noise(sigma: float, pitch: float, arm: int) -> None:
    assert arm_length(sigma, pitch) == arm


def test_parts_hang_together_over_edges_and_are_large_enough() -> None:
    mask = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 0, 1, 0]], dtype=bool)
    label, count = numbered(mask, 2)
    assert count == 2 and label.tolist() == [[0, 0, -1, -1], [-1, -1, 1, 1], [-1, -1, 1, -1]]
    assert numbered(mask, 3)[1] == 1 and numbered(mask, 4)[1] == 0
    assert numbered(mask, 2, connectivity=8)[0].tolist() == [[0, 0, -1, -1], [-1, -1, 0, 0], [-1, -1, 0, -1]]


def test_parts_grow_a_pixel_a_round_into_what_is_free() -> None:
    label = np.full((1, 9), -1, dtype=np.int32)
    label[0, 0], label[0, 8] = 0, 1
    into = np.ones((1, 9), dtype=bool)
    assert grown(label, into, 2).tolist() == [[0, 0, 0, -1, -1, -1, 1, 1, 1]]
    into[0, 6] = False
    assert grown(label, into, 9).tolist() == [[0, 0, 0, 0, 0, 0, -1, 1, 1]]
    corner = np.array([[0, -1], [-1, -1]], dtype=np.int32)
    assert grown(corner, np.array([[0, 0], [0, 1]], dtype=bool), 3)[1, 1] == -1


def test_parts_are_joined_where_their_border_is_not_hollow() -> None:
    label = np.zeros((8, 8), dtype=np.int32)
    label[:, 4:] = 1
    label[6:] = 2
    whole, none = np.ones((8, 8), dtype=bool), np.zeros((8, 8), dtype=bool)
    assert len(np.unique(joined(label, 3, whole, (none, none)))) == 1
    upright, level = none.copy(), none.copy()
    upright[:, 3:5], level[5:7] = True, True
    np.testing.assert_array_equal(joined(label, 3, whole, (upright, level)), label)
    # A turn along rows does not part what lies one above the other, nor the other way round.
    assert joined(label, 3, whole, (level, upright)).max() == 0
    split = joined(label, 3, whole, (upright, none))
    assert split[0, 0] == split[7, 0] == split[7, 7] == 0  # over part 2, which borders on both
    # Half of the border decides.
    for rows, parts in ((2, 1), (4, 2)):
        upright = none.copy()
        upright[:rows, 3:5] = True
        assert len(np.unique(joined(label, 3, whole, (upright, level)))) == parts + 1
    assert joined(np.zeros((3, 3), np.int32), 1, np.ones((3, 3), bool), (none[:3, :3], none[:3, :3])).max() == 0


def test_nothing_stands_on_an_empty_table() -> None:
    label, count = part(np.ones((30, 40), np.float32), np.zeros((30, 40), bool), 0.003, 1e-3, 0.02, 10)
    assert count == 0 and (label == -1).all()


def test_a_thing_without_a_core_is_one_if_it_is_large_enough() -> None:
    """A rod two pixels wide."""
    z, standing = np.ones((40, 60), np.float32), np.zeros((40, 60), dtype=bool)
    standing[5:35, 30:32] = True
    z[standing] = 0.8
    for smallest, found in ((60, 1), (61, 0)):
        label, count = part(z, standing, 0.003, 1e-3, 0.02, smallest)
        assert count == found and ((label == 0) == (standing if found else False)).all()


def test_what_is_too_small_for_a_thing_belongs_to_what_it_touches() -> None:
    """A bottle's neck, six pixels wide: shoulders rise away from the camera to the hollow edge at its foot."""
    z, standing = np.full((40, 60), 1.5, np.float32), np.zeros((40, 60), dtype=bool)
    standing[15:35, 20:40] = standing[7:15, 27:33] = True
    z[15:35, 20:40] = 1.1 + 0.004 * np.clip(22.0 - np.arange(15, 35), 0.0, None)[:, None]
    z[7:15, 27:33] = 1.1
    label, count = part(z, standing, 0.003, 1e-3, 0.02, 240)
    assert count == 1 and (label[7:15, 27:33] == 0).all() and (label[~standing] == -1).all()
    for aside in (1.3, 0.9):  # far behind, or before it: no part of it, and too small for a thing
        z[7:15, 27:33] = aside
        label, count = part(z, standing, 0.003, 1e-3, 0.02, 240)
        assert count == 1 and (label[7:14, 27:33] == -1).all()


def test_specks_go_to_the_longest_border_within_the_gap() -> None:
    label = np.full((7, 12), -1, dtype=np.int32)
    label[:, :5], label[:, 8:] = 0, 1
    label[2:5, 5:7] = 2
    label[3, 7] = 2
    z = np.ones(label.shape, np.float32)
    joint = specks_joined(label, 3, z, 0.02, 20)
    assert (joint[2:5, 5:7] == 0).all() and joint[3, 7] == 0 and (joint[:, 8:] == 1).all()
    z[:, :5] = 1.1  # a step away: the other side, short as it is
    assert (specks_joined(label, 3, z, 0.02, 20)[2:5, 5:7] == 1).all()
    z[:, 8:] = 0.9
    np.testing.assert_array_equal(specks_joined(label, 3, z, 0.02, 20), label)
    np.testing.assert_array_equal(specks_joined(label, 3, z, 0.02, 1), label)  # nothing is small
    np.testing.assert_array_equal(specks_joined(label, 3, z, 0.02, 99), label)  # nothing is a thing


def test_parts_are_numbered_by_size_and_an_empty_mask_has_none() -> None:
    mask = np.zeros((12, 20), dtype=bool)
    label, count = numbered(mask, 1)
    assert count == 0 and (label == -1).all()
    mask[1:4, 1:4] = mask[6:8, 2:4] = mask[6:11, 10:15] = True
    label, count = numbered(mask, 5)
    assert count == 2 and (label == -1).sum() == mask.size - 9 - 25
    assert {int((label == k).sum()) for k in range(2)} == {9, 25}
    assert numbered(mask, 9)[1] == 2 and numbered(mask, 10)[1] == 1


@pytest.mark.parametrize("many", [4, 300])
def test_parts_grow_into_what_is_free_only(many: int) -> None:
    """However many there are: numbers beyond a byte are kept."""
    label = np.full((3, 4 * many), -1, dtype=np.int32)
    label[1, ::4] = np.arange(many)
    into = np.ones(label.shape, dtype=bool)
    into[:, 3::4] = False
    found = grown(label, into, 2)
    wanted = np.repeat(np.arange(many), 4)
    for column in (0, 1):
        np.testing.assert_array_equal(found[:, column::4], np.broadcast_to(wanted[column::4], (3, many)))
    np.testing.assert_array_equal(found[1, 2::4], np.arange(many))
    assert (found[0, 2::4] == -1).all() and (found[:, 3::4] == -1).all()
