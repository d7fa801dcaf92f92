"""The support by RANSAC: the table, and not what is flat beside it."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.assets.building.support_plane import find_plane, fit_plane, settled
from twin_diagram.signals.directions import fibonacci_sphere


def scene(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    tilt = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    x = np.cross([0, 1.0, 0], tilt)
    x /= np.linalg.norm(x)
    flat = rng.uniform(-0.3, 0.3, (1500, 2))
    table = flat[:, :1] * x + flat[:, 1:] * np.cross(tilt, x) + rng.normal(0, 0.001, (1500, 1)) * tilt + 0.2 * tilt
    floor = flat[:400] @ np.stack([x, np.cross(tilt, x)]) * 0.15 + 0.204 * tilt  # that of a cup: 4 mm above
    wall = np.stack([rng.uniform(0, 0.2, 300), np.full(300, 0.05), rng.uniform(0.25, 0.4, 300)], axis=1)
    points = np.concatenate([table, floor, wall])
    normals = np.concatenate([np.tile(tilt, (1900, 1)), np.tile([0, 1.0, 0], (300, 1))])
    return points, normals


def test_ransac_finds_the_table_and_not_the_floor_of_a_cup() -> None:
    points, normals = scene(np.random.default_rng(0))
    plane = find_plane(points, normals, np.array([0, 0, 1.0]))
    true = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    assert plane is not None and plane[:3] @ true > 0.99999
    assert plane[3] == pytest.approx(0.2, abs=3e-4)  # a fifth of all lies 4 mm above
    np.testing.assert_allclose(find_plane(points, normals, np.array([0, 0, 1.0])), plane)  # same seed, same bits


def test_nothing_flat_is_no_support() -> None:
    d = fibonacci_sphere(3000)
    assert find_plane(d * 0.2, d, np.array([0, 0, 1.0])) is None
    assert find_plane(d[:50], d[:50], np.array([0, 0, 1.0])) is None


def test_fit_weights_points() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.3, 0.3, 5.0]])
    weights = np.array([1.0, 1, 1, 1, 0])
    np.testing.assert_allclose(fit_plane(points, np.array([0, 0, 9.0]), weights), [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(fit_plane(points[:4], np.array([0, 0, -9.0])), [0, 0, -1, 0], atol=1e-12)
    assert settled(points[:4], np.tile([0, 0, 1.0], (4, 1)), np.array([0, 0, 1.0, 0]), points[4])[3] == 0
