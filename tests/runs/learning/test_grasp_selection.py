"""Which further grasp is wanted: one that shows what earlier ones hid, or one along another principal axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from tests.runs.learning.test_seen_map import NORMALS as EVERY_NORMAL
from tests.runs.learning.test_seen_map import POINTS as EVERY_POINT
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.planning.grasps import WSG50, Grasps
from twin_diagram.planning.grasps.cost import TUNING as COST
from twin_diagram.runs.learning.coverage import LATER, asks_for_more, order_of, tilts_of
from twin_diagram.runs.learning.display import tool_at
from twin_diagram.runs.learning.grasp_selection import (
    Lacking,
    best_turns,
    by_axes,
    by_pair,
    cameras_about,
    hand_in,
    pictures_of,
)
from twin_diagram.runs.learning.motion import pose
from twin_diagram.runs.learning.seen_map import SeenMap, Voxels, all_about
from twin_diagram.scenario import Learning

Array = npt.NDArray[np.float64]
POINTS, NORMALS = EVERY_POINT[::7], EVERY_NORMAL[::7]
CAMERA = np.array([1.15, 0.0, 0.62])
TILTS = (0.5, -0.3)


def downward(closing: list[float], leaning: float = 0.0) -> Array:
    """A tool's axes that point down, or lean along x [rad], and close along an axis across."""
    z = np.array([np.sin(leaning), 0.0, -np.cos(leaning)])
    y = np.array(closing) - (np.array(closing) @ z) * z
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z])


def grasps(rows: list[tuple[Array, list[float]]], score: list[float], width: float = 0.06) -> Grasps:
    poses = np.array([[*Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]], *p] for R, p in rows])
    n = len(rows)
    return Grasps(poses, np.full(n, width), np.array(score), {"torque": np.zeros(n)}, np.zeros((n, 2, 3)), {})


def cameras() -> Array:
    return cameras_about(CAMERA, [tool_at(Learning(), tilt) for tilt in TILTS], 2.95, 14)


def convex(points: Array, normals: Array, frames: npt.NDArray[np.int64]) -> SeenMap:
    """A map of a body that hides nothing of itself."""
    none = np.full(len(points), 0.5)
    nothing = Voxels(points.min(axis=0), 0.003, np.zeros((60, 60, 60), dtype=bool))
    return SeenMap(points, normals, np.ones(len(points)), frames, none, none, np.ones(len(points), bool), nothing)


def test_cameras_go_about_the_tool_as_it_turns() -> None:
    learning = Learning()
    places = cameras()
    assert places.shape == (28, 3)
    for k, angle in ((0, -2.95), (13, 2.95)):
        X = tool_at(learning, TILTS[0])
        X[:3, :3] = X[:3, :3] @ Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        assert X[:3, :3] @ places[k] + X[:3, 3] == pytest.approx(CAMERA)


def test_a_patch_shows_in_the_pictures_in_which_nothing_of_the_hand_is_before_it() -> None:
    points, normals = np.array([[0.0, 0.03, 0.0], [0.03, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    open_ = np.ones((2, len(all_about(128))), dtype=bool)
    turn = np.arange(12) * np.pi / 6
    around = 0.5 * np.stack([np.cos(turn), np.sin(turn), np.zeros(12)], axis=1)
    hand = Boxes(np.eye(4), np.array([[-0.01, 0.031, -0.01]]), np.array([[0.01, 0.04, 0.01]]))
    bare = Boxes(np.eye(4), np.zeros((0, 3)), np.zeros((0, 3)))
    assert pictures_of(points, normals, open_, bare, around).tolist() == [5, 5]  # every 30°, within 70°
    assert pictures_of(points, normals, open_, hand, around).tolist() == [0, 5]
    # Elsewhere in the hand the finger covers nothing; the camera goes about the hand.
    beside = Boxes(pose(np.eye(3), np.array([0.0, 0.0, 0.05])), hand.low, hand.high)
    assert pictures_of(points, normals, open_, beside, around).tolist() == [5, 5]
    # Turned and moved with the object, hand and cameras see the same of it.
    quarter = Rotation.from_euler("xz", [90, 40], degrees=True).as_matrix()
    some = pictures_of(points, normals, open_, hand, around[:5])
    elsewhere = Boxes(pose(quarter, np.array([0.3, -0.1, 0.2])), hand.low, hand.high)
    moved = points @ quarter.T + elsewhere.X_ST[:3, 3]
    assert pictures_of(moved, normals @ quarter.T, open_, elsewhere, around[:5]).tolist() == some.tolist() == [0, 3]


def test_the_pair_shows_what_the_first_grasp_hid() -> None:
    held = grasps([(downward([0.0, 1.0, 0.0]), [0.0, 0.0, 0.0])], [0.0], 0.09)
    hand = hand_in(held, 0, np.eye(4), WSG50)
    open_ = np.ones((len(POINTS), 128), dtype=bool)
    first = pictures_of(POINTS, NORMALS, open_, hand, cameras())
    seen = convex(POINTS, NORMALS, first)
    assert 0.02 < seen.missing.mean() < 0.5
    again = grasps(
        [
            (downward([0.0, 1.0, 0.0]), [0.0, 0.0, 0.0]),  # the same
            (downward([1.0, 0.0, 0.0]), [0.0, 0.0, 0.0]),  # across
            (downward([1.0, 0.0, 0.0], np.pi), [0.0, 0.0, 0.0]),  # from below
        ],
        [0.0, 0.3, 0.0],
    )
    turns = [cameras()[:14], cameras()[14:]]
    order, shown = by_pair(again, np.eye(4), seen, WSG50, turns)
    assert order == [1, 0] and shown[1] > shown[0] + 0.01
    # What it promises is what it shows.
    more = pictures_of(POINTS, NORMALS, open_, hand_in(again, 1, np.eye(4), WSG50), cameras())
    gained = (seen.missing & (first + more >= 2)).mean()
    assert shown[1] == pytest.approx(gained)
    # Where the object stands elsewhere and turned, its own axes count.
    X_WS = pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.array([0.4, 0.1, 0.1]))
    there = grasps([(X_WS[:3, :3] @ downward([1.0, 0.0, 0.0]), [0.4, 0.1, 0.1])], [0.0])
    assert by_pair(there, X_WS, seen, WSG50, turns)[1][0] == pytest.approx(shown[1])


def test_of_grasps_that_show_alike_the_firmer_one_goes_first() -> None:
    seen = convex(POINTS, NORMALS, np.zeros(len(POINTS), dtype=np.int64))
    again = grasps([(downward([1.0, 0.0, 0.0]), [0.0, 0.0, 0.0])] * 2, [0.3, 0.1])
    assert by_pair(again, np.eye(4), seen, WSG50, [cameras()])[0] == [1, 0]


def test_the_turns_that_show_most_of_what_is_missing_are_taken_the_usual_ones_where_they_show_as_much() -> None:
    hand = hand_in(grasps([(downward([1.0, 0.0, 0.0]), [0.0, 0.0, 0.0])], [0.0], 0.09), 0, np.eye(4), WSG50)
    far_end = convex(POINTS, NORMALS, np.where(NORMALS[:, 2] < -0.5, 0, 5))  # beyond the finger tips
    turns = [cameras_about(CAMERA, [tool_at(Learning(), tilt)], 2.95, 14) for tilt in LATER]
    chosen, shown = best_turns(Lacking.of(far_end), hand, turns)
    assert 0.87 in [LATER[k] for k in chosen] and shown == pytest.approx((NORMALS[:, 2] < -0.5).mean(), abs=1e-9)
    assert tilts_of(far_end, hand, Learning(), CAMERA)[0] == 0.87
    assert tilts_of(far_end, hand, Learning(grasp_selection="pca"), CAMERA) == LATER[:2]
    sides = convex(POINTS, NORMALS, np.where(NORMALS[:, 0] > 0.5, 0, 5))
    assert best_turns(Lacking.of(sides), hand, turns)[0] == (0, 1)


def test_principal_axes_are_taken_one_after_the_other() -> None:
    points = POINTS * [1.0, 1.2, 1.0]
    held = [pose(downward([0.0, 1.0, 0.0]), np.zeros(3))]  # along z
    found = grasps(
        [
            (downward([0.0, 1.0, 0.0]), [0.0, 0.0, 0.0]),
            (downward([0.0, 1.0, 0.0], 0.6), [0.0, 0.0, 0.0]),
            (downward([0.0, 1.0, 0.0], 1.0), [0.0, 0.0, 0.0]),
            (downward([0.0, 1.0, 0.0], 1.02), [0.0, 0.0, 0.0]),
            (downward([0.0, 1.0, 0.0], 1.4), [0.0, 0.0, 0.0]),  # hardly from above
        ],
        [0.0, 0.1, 0.2, 0.15, 0.0],
    )
    assert by_axes(found, np.eye(4), points, held) == [3, 2, 1, 0]
    # Along every axis once: all count again, and the firmest of those that lie along one is the first.
    every = [pose(np.roll(np.eye(3), k, axis=1), np.zeros(3)) for k in range(3)]
    assert by_axes(found, np.eye(4), points, every)[0] == 0


def test_the_scenario_says_which_method() -> None:
    seen = convex(POINTS, NORMALS, np.where(np.abs(NORMALS[:, 1]) > 0.5, 0, 5))
    found = grasps(
        [(downward([0.0, 1.0, 0.0], 1.0), [0.0, 0.0, 0.0]), (downward([1.0, 0.0, 0.0]), [0.0, 0.0, 0.0])],
        [0.0, 0.1],
        0.09,
    )
    held = [pose(downward([0.0, 1.0, 0.0]), np.zeros(3))]
    for method, first in (("pca", 0), ("pair", 1)):
        learning = Learning(grasp_selection=method)
        assert order_of(found, np.eye(4), held, seen, WSG50, learning, CAMERA)[0] == first


def test_grasps_in_which_the_weight_turns_an_object_go_last_whatever_they_show() -> None:
    seen = convex(POINTS, NORMALS, np.where(np.abs(NORMALS[:, 1]) > 0.5, 0, 5))
    along_y, along_x = (downward(axis) for axis in ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]))
    found = grasps([(along_x, [0.0, 0.0, 0.0]), (along_y, [0.0, 0.0, 0.0])], [0.0, 0.0], 0.09)
    held = [pose(along_y, np.zeros(3))]

    def order(*turning: float, firm: bool = False) -> list[int]:
        told = replace(found, terms={"torque": COST.torque * np.array(turning)})
        return order_of(told, np.eye(4), held, seen, WSG50, Learning(), CAMERA, firm=firm)

    assert order(0.0, 0.0) == order(0.4, 0.1) == [0, 1], "the first one shows what is missing"
    assert order(0.8, 0.1) == [1, 0]
    assert order(0.4, 0.1, firm=True) == [1, 0] and order(0.14, 0.11, firm=True) == [0, 1]


def test_a_further_grasp_is_asked_for_where_the_last_one_helped_and_some_is_missing() -> None:
    learning = Learning(grasps=2, most_grasps=4, seen_share=0.98)
    assert asks_for_more(1, [0.99], learning)  # two in any case
    assert not asks_for_more(2, [0.9, 0.985], learning)
    assert asks_for_more(2, [0.9, 0.97], learning)
    assert not asks_for_more(3, [0.9, 0.97, 0.972], learning)
    assert not asks_for_more(4, [0.5, 0.6, 0.7, 0.8], learning)
    assert not asks_for_more(1, [], Learning(grasps=1))
