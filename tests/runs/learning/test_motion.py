"""Timing of paths, axes of tools."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.runs.learning.motion import cloud_cells, pointing, timed

SPEED = np.array([1.0, 0.5])


def test_a_timed_path_keeps_speed_and_acceleration_and_stops_at_way_points() -> None:
    path = np.array([[0.0, 0.0], [1.0, 0.2], [1.0, -0.8]])
    motion = timed(path, SPEED, 3.0)
    v = np.gradient(motion.q, motion.times, axis=0)
    a = np.gradient(v, motion.times, axis=0)
    assert (np.abs(v).max(axis=0) <= SPEED * 1.01).all() and np.abs(a).max() < 3.2
    # One of the limits is met: it is no slower than it must be.
    assert np.abs(v / SPEED).max() > 0.95
    assert motion.q[0] == pytest.approx(path[0]) and motion.q[-1] == pytest.approx(path[-1])
    between = np.linalg.norm(motion.q - path[1], axis=1).argmin()
    assert motion.q[between] == pytest.approx(path[1]) and np.abs(v[between]).max() < 0.05


def test_short_ways_are_bound_by_acceleration() -> None:
    motion = timed(np.array([[0.0, 0.0], [0.01, 0.0]]), SPEED, 3.0)
    assert motion.times[-1] == pytest.approx(np.sqrt(5.7735 * 0.01 / 3.0))


def test_a_tool_points_along_its_approach() -> None:
    R = pointing(np.array([0.0, 0.0, -2.0]), np.array([1.0, 0.0, 0.3]))
    assert R[:, 2] == pytest.approx([0, 0, -1]) and R[:, 1] == pytest.approx([1, 0, 0])
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_cells_keep_the_mean_of_their_points() -> None:
    points = np.array([[0.001, 0.001, 0.001], [0.003, 0.001, 0.001], [0.021, 0.0, 0.0]])
    cells = cloud_cells(points, 0.01)
    assert cells == pytest.approx(np.array([[0.002, 0.001, 0.001], [0.021, 0.0, 0.0]]))
