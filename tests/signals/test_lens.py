"""Lenses against OpenCV's formulas, and their tables against their own inverse."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twin_diagram.signals.between_pixels import depth_between
from twin_diagram.signals.lens import (
    Lens,
    distort,
    distortion_derivative,
    rays_through,
    straightening,
    undistort,
    unit_rays,
)

BENT = Lens(64, 48, 60.0, 58.0, 30.0, 25.0, (0.1, -0.05, 0.002, -0.003, 0.01))


def test_pixels_are_opencvs() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (200, 2)), np.ones(200)])
    K = np.array([[60.0, 0.0, 30.0], [0.0, 58.0, 25.0], [0.0, 0.0, 1.0]])
    wanted = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(BENT.distortion))[0][:, 0]
    np.testing.assert_allclose(np.column_stack(BENT.pixel(points[:, 0], points[:, 1])), wanted, atol=1e-9)


@pytest.mark.parametrize("k", range(5))
def test_the_derivative_is_that_of_each_coefficient(k: int) -> None:
    distortion = tuple(0.07 if j == k else 0.0 for j in range(5))
    x, y, h = np.array([0.3, -0.2]), np.array([-0.4, 0.1]), 1e-6
    right, left = distort(x + h, y, distortion), distort(x - h, y, distortion)
    down, up = distort(x, y + h, distortion), distort(x, y - h, distortion)
    xx, xy, yy = distortion_derivative(x, y, distortion)
    np.testing.assert_allclose(xx, (right[0] - left[0]) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(xy, (right[1] - left[1]) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(xy, (down[0] - up[0]) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(yy, (down[1] - up[1]) / (2 * h), atol=1e-8)


def test_rays_lead_back_to_their_pixels() -> None:
    for lens in (BENT, BENT.straight):
        rays = unit_rays(lens)
        row, column = np.array([[3, 17], [9, 30]])
        np.testing.assert_allclose(rays_through(lens, column, row), rays[row, column], atol=1e-9)
        assert rays.shape == (48, 64, 3) and not rays.flags.writeable and (rays[..., 2] == 1.0).all()
        u, v = lens.pixel(rays[..., 0], rays[..., 1])
        np.testing.assert_allclose(u, np.tile(np.arange(64.0), (48, 1)), atol=1e-8)
        np.testing.assert_allclose(v, np.tile(np.arange(48.0)[:, None], (1, 64)), atol=1e-8)
    np.testing.assert_allclose(unit_rays(BENT.straight)[25, 30], [0.0, 0.0, 1.0])
    assert unit_rays(BENT.straight)[26, 31] == pytest.approx([1 / 60, 1 / 58, 1.0])


def test_a_lens_that_folds_the_image_has_no_rays_there() -> None:
    x, y = np.array([0.1, 1.5]), np.array([0.0, 0.0])
    found = undistort(*distort(x[:1], y[:1], (-0.4, 0.0, 0.0, 0.0, 0.0)), (-0.4, 0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(np.ravel(found), [0.1, 0.0], atol=1e-9)
    assert np.isnan(undistort(x, y, (-0.4, 0.0, 0.0, 0.0, 0.0))[0][1])  # no x has x - 0.4 x³ = 1.5


def test_straightening_says_where_the_lens_shows_each_pixel_of_the_straight_one() -> None:
    u, v = straightening(BENT)
    assert u.dtype == np.float32 and u.shape == (48, 64)
    x, y = (60 - 30.0) / 60.0, (40 - 25.0) / 58.0
    np.testing.assert_allclose([u[40, 60], v[40, 60]], BENT.pixel(np.array(x), np.array(y)), atol=1e-4)


def test_a_centred_lens_has_square_pixels_about_the_middle() -> None:
    lens = Lens.centred(33, 24, 41.0)
    assert (lens.fx, lens.fy, lens.centre, lens.distortion) == (41.0, 41.0, (16.0, 11.5), ())
    assert BENT.straight == Lens(64, 48, 60.0, 58.0, 30.0, 25.0)


def test_depth_between_pixels_is_a_surfaces_own() -> None:
    """Between a box of 10 cm and its table, and beside a hole, depth lay up to 14 mm from any surface."""
    lens = Lens(160, 120, 150.0, 150.0, 79.5, 59.5, (0.1, -0.2, 0.001, 0.0005, 0.0))
    x, y, _ = np.moveaxis(unit_rays(lens), -1, 0)
    table = (1.0 / (1.0 + 0.2 * x + 0.3 * y)).astype(np.float32)
    box = np.where((np.abs(x) < 0.15) & (np.abs(y) < 0.1), 0.9 * table, table).astype(np.float32)
    box[:8, 100:120] = 0.0
    places = straightening(lens)
    x, y, _ = np.moveaxis(unit_rays(lens.straight), -1, 0)
    true = 1.0 / (1.0 + 0.2 * x + 0.3 * y)
    found = depth_between(box, *places)
    off = np.minimum(np.abs(found / true - 1.0), np.abs(found / (0.9 * true) - 1.0))
    edge = np.abs(depth_between(table, *places) / true - 1.0) > 1e-4
    assert edge.mean() < 0.04  # the border alone, and what lies beyond
    # Half a pixel of the table's slope is what the nearest pixel is off by.
    assert off[(found > 0) & ~edge].max() < 0.002 and (found[~edge] == 0).sum() > 50


def test_where_the_steps_lead_nowhere_there_is_no_place() -> None:
    """They end at places whose own map is regular, and which the lens shows elsewhere."""
    x, y = (np.ravel(a) for a in np.meshgrid(np.linspace(-1.2, 1.2, 25), np.linspace(-0.9, 0.9, 19)))
    for distortion in ((0.46, -0.561, 0.058, -0.019, 0.048), (-0.588, -0.357, -0.017, 0.068, 0.001)):
        a, b = undistort(x, y, distortion)
        there = np.isfinite(a)
        u, v = distort(a[there], b[there], distortion)
        np.testing.assert_allclose([u, v], [x[there], y[there]], atol=1e-9)
        assert 0.05 < there.mean() < 1.0
