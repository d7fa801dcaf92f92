"""Where things are set down, and how they stand there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from twin_diagram.planning.grasps import Grasps, gripper_of
from twin_diagram.runs.learning.bin_view import SeenThing, narrowest
from twin_diagram.runs.learning.in_the_way import covered_share, in_the_way, wall_points, why_barred
from twin_diagram.runs.learning.setting_down import PutDown, outline, places_in, pose_over, resting, turned
from twin_diagram.runs.learning.thing_grasps import downward, grasps_of_thing, guessed_sides, why_not

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


LOW, HIGH = np.array([0.3, 0.2, 0.01]), np.array([0.6, 0.6, 0.12])


def below(place: np.ndarray) -> np.ndarray:
    """Where the box's points are that stands there, from above."""
    X = pose_over(BOX_T, turned(DOWN, float(place[3])), place[:2], float(place[2]))
    return np.asarray(BOX_T @ X[:3, :3].T + X[:3, 3])[:, :2]


def test_places_are_beside_what_stands_there_before_they_are_upon_it() -> None:
    empty = places_in(LOW, HIGH, [], BOX_T, DOWN)
    assert all(place[2] == 0.01 for place in empty)
    assert np.hypot(*(empty[0][:2] - [0.45, 0.4])) > 0.15, "the middle stays free for others"
    one = PutDown((0.45, 0.3), 0.05, 0.11)
    beside = places_in(LOW, HIGH, [one], BOX_T, DOWN)
    assert all(place[2] == 0.01 for place in beside) and len(beside) > 8
    for place in [*empty, *beside]:
        points = below(place)
        assert (points > LOW[:2] - 0.006).all() and (points < HIGH[:2] + 0.006).all()
    for place in beside:
        assert np.linalg.norm(below(place) - [0.45, 0.3], axis=1).min() > 0.05
    # Where all of the floor is taken, it goes upon something.
    full = places_in(LOW, HIGH, [PutDown((0.45, 0.4), 0.5, 0.11)], BOX_T, DOWN)
    assert full[0][2] == 0.11


def test_what_goes_upon_others_stands_even() -> None:
    """On a shelf, not over the gaps between posts as high, though these are farther from the middle."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(0.3, 0.601, 0.01), np.arange(0.35, 0.451, 0.01)))
    shelf = PutDown((0.45, 0.4), 0.2, 0.06, tuple(zip(x.tolist(), y.tolist(), strict=True)))
    posts = [
        PutDown((x, y), 0.001, 0.06, ((x, y),)) for x in np.arange(0.32, 0.6, 0.05) for y in (0.22, 0.27, 0.53, 0.58)
    ]
    for place in places_in(LOW, HIGH, [shelf, *posts], BOX_T, DOWN)[:5]:
        assert place[2] == 0.06 and (np.abs(below(place)[:, 1] - 0.4) < 0.065).all()


def test_four_large_things_find_room_on_a_bins_floor() -> None:
    """Their circles would not: 24 x 7 cm each, in a bin of 30 by 40 cm."""
    large = RNG.uniform([-0.12, -0.035, 0.0], [0.12, 0.035, 0.2], (4000, 3))
    standing: list[PutDown] = []
    for _ in range(4):
        place = places_in(LOW, HIGH, standing, large, DOWN)[0]
        assert place[2] == 0.01
        standing.append(PutDown.standing(large, DOWN, place))
    for one in standing:
        assert one.top == pytest.approx(0.21, abs=2e-3) and PutDown.of_numbers(one.numbers()) == one
    cells = [cell for one in standing for cell in np.round(np.array(one.cells) / 0.01).astype(int).tolist()]
    assert len(cells) == len({tuple(cell) for cell in cells}), "none stands where another one does"


def grasps(rows: list[tuple[np.ndarray, list[float]]], score: list[float]) -> Grasps:
    from scipy.spatial.transform import Rotation

    poses = np.array([[*Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]], *p] for R, p in rows])
    n = len(rows)
    return Grasps(poses, np.full(n, 0.05), np.array(score), {}, np.zeros((n, 2, 3)), {})


def test_straight_grasps_come_before_better_slanted_ones() -> None:
    slanted = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0], [0.8, 0.0, -0.6]])
    leaning = np.array([[0.8, 0.0, 0.6], [0.0, -1.0, 0.0], [0.6, 0.0, -0.8]])
    found = grasps([(slanted, [0, 0, 0]), (leaning, [0, 0, 0]), (DOWN, [0, 0, 0])], [0.0, 0.05, 0.2])
    assert downward(found).tolist() == [2, 1]


def test_grasps_by_the_very_tips_come_last() -> None:
    found = grasps([(DOWN, [0, 0, 0.1]), (DOWN, [0, 0, 0.1])], [0.0, 0.9])
    found.contacts[0, :, 2] = 0.1 - 0.008
    found.contacts[1, :, 2] = 0.1 + 0.004
    assert downward(found).tolist() == [1, 0]


def test_walls_stand_about_the_inside_and_count_as_nearer() -> None:
    low, high = np.array([0.0, 0.0, 0.0]), np.array([0.3, 0.4, 0.1])
    for room in (0.0, 0.004):
        points = wall_points(low, high, room)
        rim = points[:, 2] > high[2] + room - 1e-9
        rim &= ((points[:, :2] <= low[:2]) | (points[:, :2] >= high[:2])).any(axis=1)
        face = points[~rim]
        assert rim.any() and points[:, 2].max() == pytest.approx(high[2] + room)
        on_a_face = np.isclose(face[:, :2], low[:2] + room) | np.isclose(face[:, :2], high[:2] - room)
        assert on_a_face.any(axis=1).all()
        for axis in (0, 1):
            assert face[:, axis].min() <= low[axis] + room and face[:, axis].max() >= high[axis] - room
            assert points[rim, axis].min() == pytest.approx(low[axis] - 0.008)


def test_fingers_keep_off_walls_and_neighbours_by_more_than_the_arm_sags() -> None:
    """A box of 4 cm, 3 cm off a wall and off another thing, to both sides of which fingers of 1.5 cm fit."""
    gripper, low, high = gripper_of("wsg50"), np.array([0.27, -0.55, 0.01]), np.array([0.56, -0.16, 0.12])
    box = flat(0.09, 0.04, 0.04, 0.0)
    box = SeenThing(box.points + [0.0, low[1] + 0.05 - box.middle[1], 0.0], box.normals, box.pixels, box.viewpoint)
    other = box.points[box.points[:, 2] > 0.049] + [0.0, 0.07, 0.03]
    found = grasps_of_thing(box, gripper, low[2], in_the_way(low, high, [other])[0])
    order = downward(found)
    assert len(order)
    lower, upper = gripper.boxes()
    corners = np.array(np.meshgrid(*zip(lower[:4].min(axis=0), upper[:4].max(axis=0), strict=True))).reshape(3, -1).T
    for k in order:
        y = (corners @ found.R[k].T + found.poses[k, 4:])[:, 1]
        assert y.min() > low[1] + 0.004


def test_no_corner_of_what_lies_beside_is_missed() -> None:
    """A cracker box's face, 21 by 16 cm, whose corner is below the hand's palm: also there points are in the way."""
    rng = np.random.default_rng(0)
    face = np.column_stack([rng.uniform([0.30, -0.50], [0.51, -0.34], (20000, 2)), np.full(20000, 0.11)])
    found = in_the_way(np.array([0.0, -1.0, 0.0]), np.array([1.0, 1.0, 0.12]), [face])
    for points, room in zip(found, (0.004, 0.0), strict=True):
        beside = points[(points[:, 0] > 0.2) & (points[:, 1] > -0.6) & (points[:, 1] < -0.2) & (points[:, 0] < 0.6)]
        assert cKDTree(beside).query(face + [0.0, 0.0, room])[0].max() < 0.009
        assert beside[:, 2] == pytest.approx(0.11 + room), "higher than it is, too: the palm reaches over it"


def seen_from_above(rows: range, columns: range, height: float) -> SeenThing:
    """A rectangle of pixels, each 2 mm wide."""
    pixels = np.array([(v, u) for v in rows for u in columns], dtype=np.int64)
    points = np.column_stack([0.002 * pixels, np.full(len(pixels), height)])
    return SeenThing(points, np.tile([0.0, 0.0, 1.0], (len(pixels), 1)), pixels, np.array([0.0, 0.0, 0.9]))


def test_what_lies_below_something_else_is_told_so() -> None:
    below, above = (
        seen_from_above(range(20, 40), range(20, 50), 0.05),
        seen_from_above(range(20, 60), range(50, 90), 0.11),
    )
    apart = seen_from_above(range(20, 40), range(60, 90), 0.11)
    assert covered_share(below, [above]) == pytest.approx(24 / 96, abs=0.05), "one short side of it"
    assert covered_share(above, [below]) == covered_share(below, [apart]) == covered_share(below, []) == 0.0
    assert why_barred("too wide", below, [above]).startswith("something lies over it, along 2")
    assert why_barred("too wide", above, [below]) == "too wide"


def test_a_box_rests_on_its_sides_the_surest_first() -> None:
    corners = np.array(np.meshgrid([-0.02, 0.02], [-0.03, 0.03], [0.0, 0.12])).reshape(3, -1).T
    found = resting(corners, DOWN)
    assert found[0] == pytest.approx(DOWN)
    heights = []
    for R in found:
        assert R @ R.T == pytest.approx(np.eye(3)) and np.linalg.det(R) == pytest.approx(1.0)
        assert R[2, 2] < 0.0, "the tool comes from above"
        z = corners @ R[2]
        heights.append(round(float(np.ptp(z)), 6))
        assert (z < z.min() + 1e-9).sum() == 4, "it stands on a side, not on an edge"
    # As it stood, and nothing else: on its other sides the tool would come from the side.
    assert heights == [0.12, 0.12]


def test_what_turned_in_the_hand_can_be_set_down_all_the_same() -> None:
    corners = np.array(np.meshgrid([-0.02, 0.02], [-0.03, 0.03], [-0.06, 0.06])).reshape(3, -1).T
    tilted = corners @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # 90° about the closing axis
    as_it_stood = DOWN @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    assert abs(as_it_stood[2, 2]) < 1e-9, "that would need a tool that lies"
    assert any(R[2, 2] < -0.99 and np.ptp(tilted @ R[2]) == pytest.approx(0.04) for R in resting(tilted, as_it_stood))


def test_what_leans_as_it_stood_is_set_down_on_its_nearest_side() -> None:
    corners = np.array(np.meshgrid([-0.02, 0.02], [-0.06, 0.06], [0.0, 0.09])).reshape(3, -1).T
    c, s = np.cos(0.55), np.sin(0.55)
    leaning = DOWN @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    first = resting(corners, leaning)[0]
    assert np.sort(corners @ first[2])[:4] == pytest.approx(-0.09)
    assert np.arccos(0.5 * (np.trace(leaning.T @ first) - 1.0)) == pytest.approx(0.55)
    slightly = DOWN @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -0.02], [0.0, 0.02, 1.0]]) / np.sqrt(1.0004)
    assert resting(corners, slightly)[0] is slightly


def test_what_leant_in_a_heap_is_levelled_before_it_is_let_go() -> None:
    around = np.arange(0.0, 2.0 * np.pi, 0.3)
    rings = [(0.013, 0.12), (0.013, 0.10), (0.035, 0.02), (0.035, -0.06)]  # radius, z in the tool: a bottle, cap below
    bottle = np.array([[r * np.cos(a), r * np.sin(a), z] for r, z in rings for a in around])
    c, s = np.cos(0.24), np.sin(0.24)
    leant = DOWN @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    heights = bottle @ resting(bottle, leant)[0][2]
    assert (heights < heights.min() + 1e-4).sum() == len(around), "it stands on all of its cap, and does not fall over"


def test_points_on_one_plane_rest_as_they_stood() -> None:
    flat = np.random.default_rng(0).uniform(-0.05, 0.05, (50, 3)) * [1.0, 1.0, 0.0]
    assert len(resting(flat, DOWN)) == 1


def test_an_outline_holds_what_was_set_down() -> None:
    points = outline(PutDown((0.4, 0.3), 0.05, 0.11))
    assert np.hypot(*(points[:, :2] - [0.4, 0.3]).T).max() <= 0.05 and (points[:, 2] == 0.11).all() and len(points) > 15


def flat(width: float, length: float, top: float, angle: float = 0.4) -> SeenThing:
    """The top of a box that lies flat under the camera: no side of it is seen."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (3000, 2)) * [length, width], np.full(3000, top)])
    c, s = np.cos(angle), np.sin(angle)
    points = points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [0.42, -0.36, 0.0]
    up = np.tile([0.0, 0.0, 1.0], (3000, 1))
    return SeenThing(points, up, np.zeros((3000, 2), dtype=np.int64), np.array([0.42, -0.36, 0.95]))


def test_what_lies_flat_is_taken_by_sides_that_are_guessed() -> None:
    thing, gripper = flat(0.06, 0.085, 0.04), gripper_of("wsg50")
    found = grasps_of_thing(thing, gripper, 0.01, np.zeros((0, 3)))
    order = downward(found)
    assert len(order) > 3
    best = int(order[0])
    assert found.approach[best] == pytest.approx([0, 0, -1], abs=0.02)
    assert found.width[best] == pytest.approx(0.06, abs=0.01)
    assert abs(found.R[best][:, 1] @ [-np.sin(0.4), np.cos(0.4), 0.0]) > 0.97, "across its narrow side"
    assert found.poses[best, 6] - gripper.finger_front >= 0.01, "above the floor"


def test_guessed_sides_stand_on_the_outline_and_face_outwards() -> None:
    points, normals = guessed_sides(flat(0.06, 0.10, 0.04, 0.0), 0.01)
    own = points - [0.42, -0.36, 0.0]
    assert (np.abs(normals[:, 2]) < 1e-9).all() and np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert (np.einsum("ni,ni->n", own[:, :2], normals[:, :2]) > 0.0).all()
    assert np.maximum(np.abs(own[:, 0]) - 0.05, np.abs(own[:, 1]) - 0.03) == pytest.approx(0.0, abs=0.005)
    assert own[:, 2].min() == pytest.approx(0.01) and own[:, 2].max() < 0.04


def ring(middle: tuple[float, float], through: bool = True) -> SeenThing:
    """A ring of 9 cm with a hole of 4 cm, 3.5 cm high, as seen from above, and the bottom seen through the hole."""
    rng = np.random.default_rng(0)
    square = rng.uniform(-0.045, 0.045, (6000, 2))
    off = np.hypot(*square.T)
    own, hole = square[(off < 0.045) & (off > 0.02)] + middle, square[off < 0.017] + middle
    points = np.column_stack([own, np.full(len(own), 0.042)])
    bottom = np.column_stack([hole, np.full(len(hole), 0.007)])[: len(hole) if through else 0]
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return SeenThing(points, up, np.zeros((len(points), 2), int), np.array([0.42, -0.36, 0.95]), through=bottom)


def test_sides_of_a_hole_through_which_the_bottom_is_seen_are_guessed_and_face_into_it() -> None:
    points, normals = guessed_sides(ring((0.42, -0.36)), 0.01)
    own = points[:, :2] - [0.42, -0.36]
    off, inner = np.hypot(*own.T), np.hypot(*own.T) < 0.03
    outwards = np.einsum("ni,ni->n", own / off[:, None], normals[:, :2])
    assert inner.any() and (outwards[inner] < -0.9).all() and (outwards[~inner] > 0.9).all()
    assert off[inner] == pytest.approx(0.02, abs=0.005) and off[~inner] == pytest.approx(0.045, abs=0.005)
    filled, _ = guessed_sides(ring((0.42, -0.36), through=False), 0.01)
    assert np.hypot(*(filled[:, :2] - [0.42, -0.36]).T).min() > 0.04, "what merely has no depth is no hole"


def test_a_ring_in_a_corner_is_taken_across_its_wall() -> None:
    gripper, low, high = gripper_of("wsg50"), np.array([0.276, -0.554, 0.007]), np.array([0.564, -0.166, 0.12])
    middle = (float(high[0]) - 0.048, float(low[1]) + 0.048)
    fingers, walls = replace(gripper, opening_most=0.055), in_the_way(low, high, [])[0]
    found = grasps_of_thing(ring(middle), fingers, 0.01, walls)
    order = downward(found)
    assert len(order) and found.seen[order].all() and found.width[order] == pytest.approx(0.025, abs=0.005)
    off = found.poses[order, 4:6] - middle
    assert (np.abs(np.einsum("ni,ni->n", off, found.R[order][:, :2, 1])) > 0.02).all(), "a finger is in the hole"
    assert not len(downward(grasps_of_thing(ring(middle, through=False), fingers, 0.01, walls)))


def test_what_is_too_wide_is_told_so() -> None:
    thing, gripper = flat(0.15, 0.2, 0.05), gripper_of("wsg50")
    found = grasps_of_thing(thing, gripper, 0.01, np.zeros((0, 3)))
    assert not len(downward(found)) and narrowest(thing) == pytest.approx(0.147, abs=0.004)
    assert why_not(thing, gripper, found) == "too wide: 15 cm at its narrowest, the fingers open to 11.5 cm"
