"""The compiled part of how things go, against the same written plainly."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.perception.things import flow_kernels
from twin_diagram.perception.things.flow import TUNING

Array = npt.NDArray[np.float64]

REACH = np.array(TUNING.reach)


def corner(step: float) -> tuple[Array, Array]:
    """Return places (N, 3) on three faces of 15 cm that meet, `step` apart, and their normals."""
    u, v = (g.ravel() for g in np.meshgrid(*[np.arange(0.02, 0.15, step)] * 2))
    faces = [np.insert(np.column_stack([u, v]), axis, 0.0, axis=1) for axis in range(3)]
    return np.concatenate(faces), np.repeat(np.eye(3), len(u), axis=0)


def lay(places: Array, normals: Array, points: Array, facing: Array, start: Array) -> tuple[float, Array, Array]:
    return flow_kernels.laid(places, normals, points, facing, start, REACH, 0.8, 0.001, 0.035, 4.685, 400.0, 6)


@pytest.mark.parametrize("start", [[0.0, 0.0, 0.0], [0.03, 0.0, 0.01]])
def test_a_corner_is_laid_on_itself_shifted_and_told_as_surely_as_its_faces_say(start: list[float]) -> None:
    points, facing = corner(0.003)
    places, normals = corner(0.02)
    shift = np.array([0.02, -0.015, 0.01])
    left, found, known = lay(places, normals, points + shift, facing, np.array(start))
    np.testing.assert_allclose(found, shift, atol=2e-4)
    assert left < 1e-2 * len(places)
    np.testing.assert_allclose(known, known.T)
    # Alone, each face would tell its own direction to noise / √places; the turn takes some of that.
    alone = len(places) / 3.0 / 0.001**2
    assert (np.linalg.eigvalsh(known) < alone * 1.001).all()
    assert (np.linalg.eigvalsh(known) > 0.05 * alone).all()


def test_what_meets_nothing_is_told_so() -> None:
    points, facing = corner(0.003)
    left, _, _ = lay(points[::50].copy(), facing[::50].copy(), points + 1.0, facing, np.zeros(3))
    assert np.isinf(left)


def test_points_on_one_face_are_those_whose_neighbours_face_alike() -> None:
    rng = np.random.default_rng(1)
    height, width, r, least = 30, 40, 2, 0.9
    labels = rng.random((height, width)) < 0.9
    count = int(labels.sum())
    normals = np.array([0.0, 0.0, 1.0]) + 0.15 * rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    own = np.flatnonzero(rng.random(count) < 0.9)
    cells = np.flatnonzero(labels.ravel())[own]
    whose = np.full((height + 2 * r, width + 2 * r), -1)
    row, column = np.divmod(cells, width)
    whose[row + r, column + r] = own
    plain = np.ones(len(own), dtype=bool)
    for down, right in ((-r, 0), (r, 0), (0, -r), (0, r)):
        other = whose[row + r + down, column + r + right]
        plain &= (other >= 0) & ((normals[own] * normals[other]).sum(axis=1) > least)
    found = flow_kernels.on_one_face(own, cells, normals, width, labels.size, r, least)
    assert 50 < plain.sum() < len(own) - 50
    np.testing.assert_array_equal(found, plain)


def test_an_edge_is_cut_off_by_the_border_by_what_is_nearer_and_by_a_robot_before_it() -> None:
    rng = np.random.default_rng(2)
    height, width, r, robot = 30, 40, 4, -2
    labels = rng.choice(
        np.array([-2, -1, 0, 0, 0, 1], dtype=np.int16), (height, width), p=[0.01, 0.4, 0.2, 0.2, 0.17, 0.02]
    )
    depth = (1.0 + 0.02 * rng.standard_normal((height, width))).astype(np.float32)
    mine = (labels == 0).ravel()
    cells = np.flatnonzero(mine)
    slack = np.full(len(cells), 0.03)
    plain = 0
    for cell, near in zip(cells, slack, strict=True):
        row, column = divmod(int(cell), width)
        if not (r <= row < height - r and r <= column < width - r):
            plain += 1
            continue
        window = np.s_[row - r : row + r + 1, column - r : column + r + 1]
        farther = depth[window].astype(float) - float(depth[row, column])
        other = (labels[window] >= 0) & ~mine.reshape(height, width)[window] & (farther < -near)
        plain += bool((other | ((labels[window] == robot) & (farther < near))).any())
    assert r * width < plain < len(cells)
    assert flow_kernels.cut_off(cells, mine, labels, robot, depth, slack, r) == plain
