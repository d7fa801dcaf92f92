"""Quaternions against SciPy's rotations, at the ends of their range, too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

RNG = np.random.default_rng(5)


def scalar_first(rotation: Rotation) -> Array:
    return np.asarray(rotation.as_quat()[..., [3, 0, 1, 2]])


def scalar_last(q: Array) -> Array:
    return q[..., [1, 2, 3, 0]]


def test_products_inverses_and_matrices() -> None:
    a, b = Rotation.random(50, RNG), Rotation.random(50, RNG)
    qa, qb = scalar_first(a), scalar_first(b)
    product = rotations.multiply(qa, qb)
    np.testing.assert_allclose(rotations.matrix(product), (a * b).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotations.matrix(rotations.conjugate(qa)), a.inv().as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotations.multiply(qa, rotations.conjugate(qa))[:, 0], 1.0)
    np.testing.assert_allclose(rotations.difference(qb, qa), (b * a.inv()).as_rotvec(), atol=1e-9)
    assert rotations.multiply(qa[:, None], qb[None]).shape == (50, 50, 4)


def test_products_of_quaternions_that_are_no_rotations() -> None:
    """The algebra itself: i j = k and so on, each component by its own."""
    units = np.eye(4)
    table = [[(0, 1), (1, 1), (2, 1), (3, 1)], [(1, 1), (0, -1), (3, 1), (2, -1)]]
    table += [[(2, 1), (3, -1), (0, -1), (1, 1)], [(3, 1), (2, 1), (1, -1), (0, -1)]]
    for i in range(4):
        for j in range(4):
            index, sign = table[i][j]
            np.testing.assert_array_equal(rotations.multiply(2 * units[i], 3 * units[j]), 6 * sign * units[index])


def test_equal_rotations_have_equal_numbers() -> None:
    q = RNG.normal(size=(20, 4))
    for one in (rotations.normalized(q), rotations.normalized(-7.0 * q)):
        np.testing.assert_allclose(np.linalg.norm(one, axis=1), 1.0)
        assert (one[:, 0] >= 0).all()
        np.testing.assert_allclose(one, rotations.normalized(q), atol=1e-15)
    half_turn = np.array([0.0, 0.6, -0.8, 0.0])
    np.testing.assert_allclose(rotations.normalized(2 * half_turn), half_turn)


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-9, 1e-4, 0.5, 2.0, 3.1, np.pi])
def test_exponential_and_logarithm(angle: float) -> None:
    axes = RNG.normal(size=(20, 3))
    phi = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    q = rotations.exp(phi)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0)
    np.testing.assert_allclose(rotations.matrix(q), Rotation.from_rotvec(phi).as_matrix(), atol=1e-12)
    for sign in (1.0, -1.0):
        if angle == np.pi:  # an axis or its opposite
            np.testing.assert_allclose(np.linalg.norm(rotations.log(sign * q), axis=1), np.pi)
        else:
            np.testing.assert_allclose(rotations.log(sign * q), phi, rtol=1e-7, atol=1e-16)


def test_a_half_turn_keeps_its_axis() -> None:
    np.testing.assert_allclose(rotations.log(np.array([0.0, 0.6, 0.8, 0.0])), np.pi * np.array([0.6, 0.8, 0.0]))


def test_from_a_matrix() -> None:
    turns = [*Rotation.random(40, RNG), Rotation.identity()]
    turns += [Rotation.from_rotvec(np.pi * axis) for axis in (*np.eye(3), np.array([0.6, -0.8, 0]))]
    for turn in turns:
        q = rotations.from_matrix(turn.as_matrix())
        assert np.linalg.norm(q) == pytest.approx(1.0) and q[0] >= -1e-12
        np.testing.assert_allclose(rotations.matrix(q), turn.as_matrix(), atol=1e-9)


def test_folding_leaves_a_swing() -> None:
    """After folding, the turn that is left between the two is about an axis in the plane across z, or none."""
    for measured, near in zip(Rotation.random(40, RNG), Rotation.random(40, RNG), strict=True):
        folded = rotations.fold_about_z(scalar_first(measured), scalar_first(near))
        left = near.inv() * Rotation.from_quat(scalar_last(folded))
        assert left.as_rotvec()[2] == pytest.approx(0.0, abs=1e-9)
        turned = measured.inv() * Rotation.from_quat(scalar_last(folded))
        np.testing.assert_allclose(turned.as_rotvec()[:2], 0.0, atol=1e-9)


@pytest.mark.parametrize(("short", "folds"), [(1.9e-9, False), (2.1e-9, True)])
def test_with_opposed_axes_no_turn_is_better(short: float, folds: bool) -> None:
    """Axes count as opposed where they are nearer to that than 2e-9 rad."""
    near = np.array([1.0, 0, 0, 0])
    swing = rotations.exp(np.array([np.pi - short, 0.0, 0.0]))
    measured = rotations.multiply(swing, rotations.exp(np.array([0.0, 0.0, 0.7])))
    folded = rotations.fold_about_z(measured, near)
    assert np.array_equal(folded, measured) != folds
