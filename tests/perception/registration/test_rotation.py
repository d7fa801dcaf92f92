"""Rotations of many poses at once, held against scipy's one by one, from tiny angles to nearly half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.perception.registration.rotation import (
    components_last,
    cross,
    dot,
    exp,
    from_quaternion,
    log,
    screw,
    skew,
    to_quaternion,
)

RNG = np.random.default_rng(2161)
WAYS = RNG.normal(size=(40, 3))
WAYS /= np.linalg.norm(WAYS, axis=1, keepdims=True)
ANGLES = np.concatenate([[0.0, 1e-12, 7e-10, 1.5e-9, 1e-6, 1e-3], np.linspace(0.05, 3.13, 34)])
VECTORS = ANGLES[:, None] * WAYS


def test_exp_and_log_are_scipys() -> None:
    matrices = Rotation.from_rotvec(VECTORS).as_matrix()
    np.testing.assert_allclose(exp(VECTORS), matrices, atol=1e-12)
    np.testing.assert_allclose(exp(VECTORS.reshape(8, 5, 3)), matrices.reshape(8, 5, 3, 3), atol=1e-12)
    np.testing.assert_allclose(log(matrices), VECTORS, atol=1e-9)
    np.testing.assert_allclose(log(matrices.reshape(8, 5, 3, 3)), VECTORS.reshape(8, 5, 3), atol=1e-9)
    np.testing.assert_allclose(log(np.eye(3)[None]), 0.0)


def test_tiny_turns_keep_their_size() -> None:
    """Below a nanoradian half the difference of a matrix and its transpose is the vector itself."""
    for size in (1e-15, 3e-10, 0.9e-9, 1.1e-9, 3e-9, 1e-7):
        np.testing.assert_allclose(log(exp(size * WAYS)), size * WAYS, rtol=1e-6, atol=1e-18)


def test_products_are_numpys() -> None:
    a, b = RNG.normal(size=(2, 4, 6, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), atol=1e-12)
    np.testing.assert_allclose(np.einsum("...ij,...j->...i", skew(a), b), np.cross(a, b), atol=1e-12)


def test_quaternions_begin_with_the_cosine_and_may_have_any_length() -> None:
    for vector in VECTORS:
        R = Rotation.from_rotvec(vector)
        wxyz = np.roll(R.as_quat(), 1)
        np.testing.assert_allclose(from_quaternion(3.0 * wxyz), R.as_matrix(), atol=1e-12)
        found = to_quaternion(R.as_matrix())
        np.testing.assert_allclose(abs(found @ wxyz), 1.0)


@pytest.mark.parametrize("shape", [(), (5,), (2, 7)])
def test_screws_move_points_as_turns_and_shifts_do(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2301)
    r, way = rng.normal(size=(2, *shape, 3))
    found = screw(r, way)
    np.testing.assert_allclose(found, np.concatenate([np.cross(r, way), way], axis=-1), atol=1e-15)
    np.testing.assert_allclose(cross(r, way), np.cross(r, way), atol=1e-15)
    np.testing.assert_allclose(dot(r, way), (r * way).sum(axis=-1), atol=1e-14)
    # One direction for all points.
    np.testing.assert_allclose(screw(r, way.reshape(-1, 3)[0])[..., :3], np.cross(r, way.reshape(-1, 3)[0]), atol=1e-15)


def test_components_come_last_without_a_copy() -> None:
    rows = np.arange(24.0).reshape(4, 2, 3)
    view = components_last(rows)
    assert view.shape == (2, 3, 4) and np.shares_memory(view, rows)
    np.testing.assert_array_equal(view[1, 2], rows[:, 1, 2])
