"""Poses as vectors agree with matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.signals.hand import HAND_SIZE, NOTHING, Hand
from twin_diagram.signals.pose_vectors import as_matrix, compose, errors, from_matrix, inverse, moved


def drawn(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.concatenate([Rotation.random(random_state=seed).as_quat()[[3, 0, 1, 2]], rng.normal(size=3)])


def test_composed_and_inverted_as_matrices_are() -> None:
    a, b = drawn(1), drawn(2)
    np.testing.assert_allclose(as_matrix(compose(a, b)), as_matrix(a) @ as_matrix(b), atol=1e-12)
    np.testing.assert_allclose(as_matrix(inverse(a)), np.linalg.inv(as_matrix(a)), atol=1e-12)
    np.testing.assert_allclose(as_matrix(from_matrix(as_matrix(a))), as_matrix(a), atol=1e-12)
    np.testing.assert_allclose(moved(a, np.array([1.0, 2.0, 3.0])) - a, [0, 0, 0, 0, 1, 2, 3])


def test_how_far_two_poses_are_apart() -> None:
    a = drawn(3)
    turn = np.concatenate([np.array([np.cos(0.2), 0, np.sin(0.2), 0]), [0.3, 0.0, 0.4]])
    assert errors(a, compose(a, turn)) == pytest.approx((0.5, 0.4))
    minus = a * np.array([-1.0, -1, -1, -1, 1, 1, 1])
    assert errors(a, minus) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_hand_is_a_vector_and_back() -> None:
    hand = Hand(2, NOTHING, True, drawn(4), np.arange(36.0).reshape(6, 6), True, 3)
    vector = hand.pack()
    assert vector.shape == (HAND_SIZE,)
    np.testing.assert_array_equal(Hand.unpack(vector).pack(), vector)
    assert Hand.unpack(vector).support == 3 and Hand.unpack(vector).around
    vector[5] = np.nan
    assert Hand.unpack(vector).held == NOTHING, "what is not finite is an empty hand"
