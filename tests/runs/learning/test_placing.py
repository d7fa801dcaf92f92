"""Where things are set down, how they stand there, and which grasps hide other sides."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.planning.grasps import Grasps
from twin_diagram.runs.learning.bin_view import downward, wall_points
from twin_diagram.runs.learning.regrasping import order_of
from twin_diagram.runs.learning.setting_down import PutDown, places_in, pose_over, turned

DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""A tool that points down."""
UP = np.diag([1.0, 1.0, 1.0])
RNG = np.random.default_rng(0)
BOX_T = RNG.uniform([-0.02, -0.03, -0.01], [0.04, 0.03, 0.09], (400, 3))
"""Points of a box in the hand, off the tool's axis, which reaches 9 cm beyond the finger tips."""


def test_what_is_held_stands_with_its_lowest_point_at_the_height_and_its_middle_over_the_place() -> None:
    for yaw in (0.0, 0.7, -2.0):
        X = pose_over(BOX_T, turned(DOWN, yaw), np.array([0.5, -0.1]), 0.06)
        points = BOX_T @ X[:3, :3].T + X[:3, 3]
        assert points[:, 2].min() == pytest.approx(0.06)
        assert 0.5 * (points.min(axis=0) + points.max(axis=0))[:2] == pytest.approx([0.5, -0.1])
        assert X[:3, 2] == pytest.approx([0, 0, -1])


def test_a_turn_is_about_the_vertical() -> None:
    assert turned(DOWN, np.pi / 2)[:, 0] == pytest.approx([-1, 0, 0])
    assert turned(DOWN, 0.4)[:, 2] == pytest.approx(DOWN[:, 2])


def test_places_are_beside_what_stands_there_before_they_are_upon_it() -> None:
    low, high = np.array([0.3, 0.2, 0.01]), np.array([0.6, 0.6, 0.12])
    empty = places_in(low, high, [], BOX_T, DOWN)
    assert empty[0][:2] == pytest.approx([0.45, 0.4], abs=0.03) and empty[0][2] == 0.01
    one = PutDown((0.45, 0.3), 0.05, 0.11)
    beside = places_in(low, high, [one], BOX_T, DOWN)
    assert all(place[2] == 0.01 for place in beside)
    assert np.hypot(beside[0][0] - 0.45, beside[0][1] - 0.3) > 0.05 + 0.042
    # Where all of the floor is taken, it goes upon something.
    full = places_in(low, high, [PutDown((0.45, 0.4), 0.5, 0.11)], BOX_T, DOWN)
    assert full[0][2] == 0.11


def grasps(rows: list[tuple[np.ndarray, list[float]]], score: list[float]) -> Grasps:
    from scipy.spatial.transform import Rotation

    poses = np.array([[*Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]], *p] for R, p in rows])
    n = len(rows)
    return Grasps(poses, np.full(n, 0.05), np.array(score), {}, np.zeros((n, 2, 3)), {})


def test_grasps_that_hide_other_sides_come_first() -> None:
    held = np.eye(4)
    held[:3, :3] = DOWN
    across = turned(DOWN, np.pi / 2)
    found = grasps(
        [(DOWN, [0.0, 0.0, 0.005]), (across, [0.0, 0.0, 0.0]), (DOWN, [0.05, 0.0, 0.0]), (UP, [0.0, 0.05, 0.0])],
        [0.1, 0.3, 0.2, 0.05],
    )
    # The first is the old one over again, the last comes from below.
    assert order_of(found, np.eye(4), [held]) == [1, 2, 0]
    # Where the object stands elsewhere and turned, its own axes count.
    X_WS = np.eye(4)
    X_WS[:3, :3] = turned(np.eye(3), np.pi / 2)
    X_WS[:3, 3] = [0.0, 0.0, 0.0]
    assert order_of(found, X_WS, [held])[0] == 0


def test_straight_grasps_come_before_better_slanted_ones() -> None:
    slanted = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0], [0.8, 0.0, -0.6]])
    leaning = np.array([[0.8, 0.0, 0.6], [0.0, -1.0, 0.0], [0.6, 0.0, -0.8]])
    found = grasps([(slanted, [0, 0, 0]), (leaning, [0, 0, 0]), (DOWN, [0, 0, 0])], [0.0, 0.05, 0.2])
    assert downward(found).tolist() == [2, 1]


def test_walls_stand_about_the_inside() -> None:
    low, high = np.array([0.0, 0.0, 0.0]), np.array([0.3, 0.4, 0.1])
    points = wall_points(low, high)
    inside = ((points[:, :2] > low[:2]) & (points[:, :2] < high[:2])).all(axis=1)
    assert not inside.any() and points[:, 2].max() <= 0.1
    for axis in (0, 1):
        assert points[:, axis].min() < low[axis] and points[:, axis].max() > high[axis]
