"""Planes from depth alone: tilted, raised, noisy, cluttered; shelves and lids; and none where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.planes import Plane, Told, block_sums, find_plane, level_surfaces
from twin_diagram.perception.segmentation.segmentation import Grid, segment, support_plane
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.lens import Lens, unit_rays

Array = npt.NDArray[np.float64]
VIEW = camera(320, 240, 300.0)
UP = np.array([0.0, 0.0, 1.0])


def tilted(view: Pinhole, about: Array, angle: float, height: float) -> tuple[Pinhole, Array, float]:
    """The camera that sees the level table at 0 as one turned by `angle` and raised; the table's normal and offset.

    The turn is about a line through (0.55, 0, 0), in the middle of the workspace.
    """
    k = about / np.linalg.norm(about)
    K = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    R = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    middle = np.array([0.55, 0.0, 0.0])
    p = middle - R @ middle + [0.0, 0.0, height]
    return replace(view, R_WC=R @ view.R_WC, p_WC=R @ view.p_WC + p), R @ UP, float(R @ UP @ p)


@pytest.fixture(scope="module")
def box() -> Asset:
    return Asset.load(models_dir() / "objects" / "cracker_box")


@pytest.fixture(scope="module")
def clutter(box: Asset) -> list[Thing]:
    places = [(0.5, -0.2), (0.62, 0.12), (0.35, 0.2), (0.75, -0.1), (0.5, 0.35)]
    return [Thing(box, k, yawed(0.7 * k), np.array([x, y, box.size[2] / 2])) for k, (x, y) in enumerate(places)]


@pytest.fixture(scope="module")
def seen(clutter: list[Thing]) -> npt.NDArray[np.float32]:
    return picture(VIEW, clutter, np.random.default_rng(4))[1]


def spoilt(depth: npt.NDArray[np.float32], share: float, seed: int) -> npt.NDArray[np.float32]:
    """Noise of `share` · z² [m] that neighbours have in common, as in stereo cameras."""
    import cv2

    rng = np.random.default_rng(seed)
    white, wide = rng.standard_normal((2, *depth.shape))
    wide = cv2.GaussianBlur(wide, (0, 0), 1.25)
    noise = 0.5 * white + 0.87 * wide / wide.std()
    return np.where(depth > 0, depth + share * depth**2 * noise, 0.0).astype(np.float32)


@pytest.mark.parametrize(
    ("angle", "height"),
    [(0.0, 0.0), (2.0, 0.0), (-10.0, 0.05), (20.0, -0.1), (-20.0, 0.1), (8.0, 0.1), (0.0, -0.1)],
)
@pytest.mark.parametrize("about", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, -1.0, 0.0]])
@pytest.mark.parametrize("share", [0.0, 0.0038])
def test_a_tilted_and_raised_table_is_found(
    seen: npt.NDArray[np.float32], about: list[float], angle: float, height: float, share: float
) -> None:
    view, normal, offset = tilted(VIEW, np.array(about), np.radians(angle), height)
    found = support_plane(spoilt(seen, share, 1) if share else seen, Grid.of(view, 1), scenario.Perception())
    assert found is not None
    corner = np.array([[0.2, -0.4], [0.9, 0.4], [0.2, 0.4], [0.9, -0.4]])
    graph = np.array([-normal[0], -normal[1], offset]) / normal[2]
    off = corner @ (found.graph[:2] - graph[:2]) + found.graph[2] - graph[2]
    # Camera noise that is not told (five times of it) costs less than its own size.
    assert np.abs(off).max() < (0.0035 if share else 0.0008)
    assert found.normal @ normal > np.cos(np.radians(0.5 if share else 0.1))
    assert np.linalg.norm(found.normal) == pytest.approx(1.0)


def test_the_same_image_gives_the_same_bits(seen: npt.NDArray[np.float32]) -> None:
    first, second = (support_plane(seen.copy(), Grid.of(VIEW, 1), scenario.Perception()) for _ in range(2))
    assert first is not None and second is not None
    assert (first.normal == second.normal).all() and first.offset == second.offset and first.area == second.area


def test_things_that_touch_the_table_do_not_lift_it(clutter: list[Thing], seen: npt.NDArray[np.float32]) -> None:
    bare = picture(VIEW, [], np.random.default_rng(4))[1]
    for depth in (bare, seen):
        table = support_plane(depth, Grid.of(VIEW, 1), scenario.Perception())
        assert table is not None
        assert abs(table.offset) < 5e-4 and table.normal[2] > np.cos(1e-3)


def test_the_area_is_that_of_what_is_seen(seen: npt.NDArray[np.float32]) -> None:
    bare = picture(VIEW, [])[1]
    rays = VIEW.rays()
    points = VIEW.p_WC + bare[..., None] * rays
    inside = (bare > 0) & (points[..., 0] > 0.1) & (points[..., 0] < 1.0) & (np.abs(points[..., 1]) < 0.6)
    true = np.sum((bare**2 / (300.0**2) / np.abs(rays[..., 2]))[inside])
    found = support_plane(bare, Grid.of(VIEW, 1), scenario.Perception())
    assert found is not None
    assert 0.8 * true < found.area < 1.02 * true
    less = support_plane(seen, Grid.of(VIEW, 1), scenario.Perception())
    assert less is not None and less.area < 0.95 * found.area


def test_lids_are_planes_too(box: Asset) -> None:
    lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    flat = float(np.abs(lying[2]) @ box.size)
    thing = Thing(box, 1, lying, np.array([0.6, 0.0, flat / 2]))
    rgb, depth, _ = picture(VIEW, [thing], np.random.default_rng(5))
    found = segment(rgb, depth, 0.0, Grid.of(VIEW, 1), scenario.Perception(stride=1)).planes
    assert len(found) == 2
    assert abs(found[0].offset) < 1e-3 and abs(found[1].height(np.array([0.6, 0.0, flat]))) < 5e-4
    assert found[1].normal @ UP > np.cos(0.02)
    lid = float(np.prod(np.sort(box.size)[1:]))
    assert found[1].area == pytest.approx(lid, rel=0.1)


def lid(tilt: float, size: float, height: float, sigma: float = 0.0) -> tuple[Array, Array]:
    """Points of a square lid and of a wall below it, each for 4 mm²."""
    x, y = np.meshgrid(np.arange(0.0, size, 0.002), np.arange(0.0, size, 0.002))
    top = np.stack([x, y, height + np.tan(tilt) * (x - size / 2)], axis=-1).reshape(-1, 3)
    wall = np.stack([x, 0.0 * x, height * y / size], axis=-1).reshape(-1, 3)
    points = np.concatenate([top, wall])
    points[:, 2] += sigma * np.random.default_rng(3).standard_normal(len(points))
    return points, np.full(len(points), 4e-6)


@pytest.mark.parametrize(
    ("tilt", "size", "count"), [(0.0, 0.058, 1), (0.0, 0.05, 0), (0.1, 0.15, 1), (-0.1, 0.15, 1), (0.2, 0.3, 0)]
)
def test_what_holds_things_is_level_and_large_enough(tilt: float, size: float, count: int) -> None:
    points, areas = lid(tilt, size, 0.2)
    table = Plane(UP, 0.03, 1.0)
    found = level_surfaces(points, np.zeros(len(points), dtype=np.int64), areas, table, 0.0)
    assert len(found) == count
    if count:
        wanted = np.array([-np.sin(tilt), 0.0, np.cos(tilt)])
        np.testing.assert_allclose(found[0].normal, wanted, atol=2e-3)
        assert found[0].height(np.array([size / 2, 0.02, 0.2])) == pytest.approx(0.0, abs=5e-4)
        assert found[0].area == pytest.approx(size**2, rel=0.25)


def test_each_thing_has_its_own_lid() -> None:
    low, areas = lid(0.0, 0.1, 0.05, 0.001)
    high, more = lid(0.0, 0.2, 0.12, 0.001)
    part = np.repeat([0, 2], [len(low), len(high)])
    points = np.concatenate([low, high + [0.5, 0.0, 0.0]])
    found = level_surfaces(points, part, np.concatenate([areas, more]), Plane(UP, 0.0, 1.0), 0.001)
    assert abs(found[0].height(np.array([0.6, 0.1, 0.12]))) < 5e-4
    assert abs(found[1].height(np.array([0.05, 0.05, 0.05]))) < 5e-4 and len(found) == 2
    assert level_surfaces(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0), Plane(UP, 0.0, 1.0), 0.0) == []


@pytest.mark.parametrize(("height", "wanted"), [(0.0, 0.0), (0.04, 0.0), (-0.1, 0.0), (0.14, 0.0), (0.17, None)])
def test_the_table_is_looked_for_about_its_told_height(height: float, wanted: float | None) -> None:
    depth = picture(VIEW, [], np.random.default_rng(6))[1]
    found = support_plane(depth, Grid.of(VIEW, 1), scenario.Perception(table_height=height))
    assert (None if found is None else round(abs(found.offset), 2)) == wanted


@pytest.mark.parametrize(("angle", "there"), [(22.0, True), (-22.0, True), (24.0, False), (-24.0, False)])
def test_what_is_too_steep_is_no_table(angle: float, there: bool) -> None:
    view, _, _ = tilted(VIEW, np.array([0.0, 1.0, 0.0]), np.radians(angle), 0.0)
    found = support_plane(picture(VIEW, [])[1], Grid.of(view, 1), scenario.Perception())
    assert (found is not None) == there


def test_no_table_in_view_is_said(clutter: list[Thing]) -> None:
    rgb, depth, owner = picture(VIEW, clutter)
    depth[owner < 0] = 0.0
    params = scenario.Perception(stride=1, table_height=0.013)
    found = segment(rgb, depth, 0.0, Grid.of(VIEW, 1), params)
    assert found.planes == () and found.table.tolist() == [0.0, 0.0, 0.013] and found.count == 5
    rgb, depth, _ = picture(VIEW, clutter)
    assert len(segment(rgb, depth, 0.0, Grid.of(VIEW, 1), params).planes) >= 1


@pytest.mark.parametrize("value", [0.0, 1e-3, 0.3])
def test_hostile_images_have_no_table(value: float) -> None:
    depth = np.full((240, 320), value, dtype=np.float32)
    assert support_plane(depth, Grid.of(VIEW, 1), scenario.Perception()) is None
    noise = np.random.default_rng(1).uniform(0.5, 2.0, (240, 320)).astype(np.float32)
    assert support_plane(noise, Grid.of(VIEW, 1), scenario.Perception()) is None


def test_without_a_word_any_plane_will_do() -> None:
    """A wall: the same image, seen by a camera whose pose nobody knows."""
    rays = VIEW.rays() @ VIEW.R_WC
    depth = picture(VIEW, [], np.random.default_rng(8))[1]
    plane = find_plane(depth, rays, np.zeros(3), lambda z: 0.0008 * z**2, Told())
    assert plane is not None
    np.testing.assert_allclose(plane.normal, VIEW.R_WC.T @ UP, atol=1e-3)
    assert plane.offset == pytest.approx(-VIEW.p_WC[2], abs=1e-3)


def test_a_plane_is_what_its_numbers_say() -> None:
    normal = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])
    plane = Plane(normal, 0.25, 1.0)
    a, b, c = plane.graph
    for x, y in ((0.3, 0.4), (-1.0, 2.0)):
        on = np.array([x, y, a * x + b * y + c])
        assert plane.height(on) == pytest.approx(0.0, abs=1e-12)
        assert plane.height(on + 0.07 * normal) == pytest.approx(0.07)


def test_blocks_are_summed_and_what_is_left_over_is_not() -> None:
    images = np.random.default_rng(2305).normal(size=(3, 11, 14))
    wanted = images[:, :8, :12].reshape(3, 2, 4, 3, 4).sum(axis=(2, 4))
    np.testing.assert_allclose(block_sums(images, 4), wanted, atol=1e-12)


@pytest.mark.parametrize("told", [0.0, 0.12])
def test_of_two_planes_the_one_that_was_told_may_be_somewhat_smaller(told: float) -> None:
    """A table at 0 and a shelf at 0.12 m, the one not meant 1.3 times as large, from straight above."""
    lens = Lens.centred(320, 240, 300.0)
    rays = unit_rays(lens) * [1.0, -1.0, -1.0]
    share = 0.373 if told == 0.0 else 0.5  # of the picture's columns show the table, whose pixels are larger
    depth = np.where(np.arange(320) < round(share * 320), 1.0, 0.88) * np.ones((240, 1))
    plane = find_plane(depth, rays, UP, lambda z: 0.0008 * z**2, Told(up=UP, height=told, middle=np.zeros(3)))
    assert plane is not None and plane.offset == pytest.approx(told, abs=1e-3)
    other = find_plane(depth, rays, UP, lambda z: 0.0008 * z**2, Told(up=UP))
    assert other is not None and other.offset == pytest.approx(0.12 - told, abs=1e-3)
