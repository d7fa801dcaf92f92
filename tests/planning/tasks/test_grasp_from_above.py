"""Grasps from above: over the middle, across a side that fits, with the hand turned no more than need be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.planning.tasks.small_world import COVARIANCE, DOWN, pose, post
from twin_diagram.planning.collision.hand_shape import Palm
from twin_diagram.planning.tasks.grasp_from_above import TUNING, centred, grasps_from_above, hindered, reached
from twin_diagram.planning.tasks.neighbours import Neighbours
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.pose_vectors import compose, errors, inverse

NONE = Neighbours()


def box(x: float, y: float, z: float) -> tuple[Array, ...]:
    return (np.array([[i * x / 2, j * y / 2, k * z / 2] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]),)


def turned(angle: float, x: float = 0.4, y: float = 0.2, z: float = 0.1) -> Array:
    return pose(x, y, z, np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)]))


@pytest.mark.parametrize("yaw", [0.0, 0.3, -1.2, 2.0])
def test_a_box_that_fits_one_way_is_taken_that_way(yaw: float) -> None:
    """0.12 m by 0.05 m between fingers that open by 0.08 m: across the short side, from above, over the middle."""
    X_WO = turned(yaw)
    found = grasps_from_above(box(0.12, 0.05, 0.1), X_WO, 0.08, DOWN, NONE)[0]
    assert len(found)
    R_WO = rotations.matrix(X_WO[:4])
    for X_WG in found:
        R_WG = rotations.matrix(X_WG[:4])
        np.testing.assert_allclose(R_WG[:, 2], [0, 0, -1], atol=1e-9)
        assert np.linalg.det(R_WG) == pytest.approx(1.0)
        width = np.ptp(box(0.12, 0.05, 0.1)[0] @ R_WO.T @ R_WG[:, 1])
        assert width < 0.08 - TUNING.spare
        np.testing.assert_allclose(X_WG[4:6], X_WO[4:6], atol=1e-9)
    assert abs(rotations.matrix(found[0][:4])[:, 1] @ R_WO[:, 1]) == pytest.approx(1.0), "square to the sides"


def test_what_lies_is_taken_across_however_it_is_turned() -> None:
    """A can on its side fits one way alone, which its axis tells; a box whose x axis stands up by another."""
    turns = np.arange(16) * 2 * np.pi / 16
    ring = np.array([[0.034 * np.cos(a), 0.034 * np.sin(a), z] for a in turns for z in (-0.05, 0.05)])
    for yaw in (0.1, 0.8, 2.5):
        for pieces, tip, symmetric in (((ring,), ("x", 1.57), True), (box(0.10, 0.05, 0.16), ("y", 1.55), False)):
            q = (Rotation.from_euler("z", yaw) * Rotation.from_euler(*tip)).as_quat()[[3, 0, 1, 2]]
            found = grasps_from_above(pieces, pose(0.4, 0.2, 0.05, q), 0.08, DOWN, NONE, symmetric=symmetric)[0]
            assert len(found)
            across = rotations.matrix(found[0][:4])[:, 1] @ rotations.matrix(q)
            assert abs(across[2 if symmetric else 1]) == pytest.approx(0.0 if symmetric else 1.0, abs=0.02)


def test_the_hand_turns_no_more_than_need_be() -> None:
    pieces = box(0.05, 0.05, 0.1)
    for heading in (0.1, 1.5, 3.0, -2.0):
        near = Rotation.from_euler("z", heading) * Rotation.from_quat(DOWN[[1, 2, 3, 0]])
        q = near.as_quat()[[3, 0, 1, 2]]
        first = grasps_from_above(pieces, turned(0.0), 0.08, q, NONE)[0][0]
        assert errors(pose(0, 0, 0, q), first)[1] < np.pi / 4 + 1e-9


def test_how_deep_depends_on_how_tall_it_is() -> None:
    for height, above_bottom in ((0.2, 0.2 - TUNING.depth), (0.06, 0.03), (0.03, 0.015), (0.045, TUNING.bottom)):
        X_WG = grasps_from_above(box(0.05, 0.05, height), turned(0.0, z=height / 2), 0.08, DOWN, NONE)[0][0]
        assert X_WG[6] == pytest.approx(above_bottom)


def test_too_wide_is_none_and_just_narrow_enough_is_one() -> None:
    for width, count in ((0.0725, 0), (0.0715, 2)):
        found = grasps_from_above(box(width, width, 0.1), turned(0.0), 0.08, DOWN, NONE)[0]
        assert len(found) >= count and bool(len(found)) == bool(count)


def test_what_is_too_wide_below_is_taken_by_its_neck() -> None:
    """A body as wide as the fingers open, 0.15 m tall, and a neck of 0.05 m beside its middle: around the neck alone.

    A neck of which the fingers would hold less than a pad is no neck; where the tips would reach past a short one into
    the body, the hand stays higher.
    """
    body = box(0.08, 0.08, 0.15)[0]
    for tall in (0.05, 0.035, 0.01):
        neck = box(0.03, 0.03, tall)[0] + np.array([0.02, 0.01, 0.075 + tall / 2])
        X_WO = turned(0.4, z=0.075)
        found = grasps_from_above((body, neck), X_WO, 0.08, DOWN, NONE)[0]
        assert bool(len(found)) == (tall > TUNING.hold)
        for X_WG in found:
            assert X_WG[6] - TUNING.tip == pytest.approx(0.15) or X_WG[6] == pytest.approx(0.15 + tall - TUNING.depth)
            assert X_WG[6] - 0.009 > 0.15, "the tips stay above what is too wide"
            np.testing.assert_allclose(X_WG[4:6], compose(X_WO, pose(0.02, 0.01, 0.0))[4:6], atol=1e-9)
            for error in (-0.0015, 0.0, 0.0015):
                between = reached((body, neck), compose(inverse(X_WG + error * np.eye(7)[6]), X_WO))
                assert len(between) == 1 and between[0] is neck, "be the hand a little lower or higher than was meant"


def test_what_comes_up_to_the_tips_is_told_in_the_tools_frame() -> None:
    """An object that lies, its x axis up: the piece at its +x end is what a hand from above reaches, not the other."""
    ends = tuple(box(0.04, 0.04, 0.04)[0] + np.array([x, 0.0, 0.0]) for x in (-0.06, 0.06))
    X_WO = pose(0.4, 0.2, 0.08, Rotation.from_euler("ZY", [90, -90], degrees=True).as_quat()[[3, 0, 1, 2]])
    between = reached(ends, compose(inverse(pose(0.4, 0.2, 0.13, DOWN)), X_WO))
    assert len(between) == 1 and between[0] is ends[1]


def test_the_fingers_come_down_where_no_neighbour_is() -> None:
    """The present turn of the hand would put a finger onto the neighbour; a quarter turn more is free of it."""
    pieces = box(0.05, 0.05, 0.1)
    neighbour = Neighbours.of([post(0.4, 0.29, 0.03, 0.2)])
    free = grasps_from_above(pieces, turned(0.0), 0.08, DOWN, NONE)[0][0]
    beside = grasps_from_above(pieces, turned(0.0), 0.08, DOWN, neighbour)[0][0]
    closing = [abs(rotations.matrix(X[:4])[:, 1]) for X in (free, beside)]
    assert closing[0][1] > 0.9 and closing[1][0] > 0.9


HAND = Palm(0.045, box(0.06, 0.2, 0.07)[0] - [0.0, 0.0, 0.07])


def test_what_stands_in_the_palms_way_is_kept_clear_of_along_the_sides() -> None:
    """A box of 85 × 28 mm, and a tall post beside it: over the middle the palm would come too near to that.

    So it is taken 1 or 2 cm farther along, where the palm is free; a low post is in none's way, and of something round
    the pads meet nothing square anywhere else.
    """
    pieces, X_WO = box(0.085, 0.028, 0.073), turned(0.0, z=0.0365)
    plain = grasps_from_above(pieces, X_WO, 0.08, DOWN, NONE, palm=HAND)[0]
    for top, aside in ((0.2, True), (0.05, False)):
        beside = Neighbours.of([post(0.4 + 0.06, 0.2 + 0.10, 0.025, top)])
        found = grasps_from_above(pieces, X_WO, 0.08, plain[0, :4], beside, palm=HAND)[0]
        off = found[0, 4:6] - X_WO[4:6]
        closing = rotations.matrix(found[0, :4])[:2, 1]
        assert abs(closing @ off) < 1e-9, "the pads still meet its middle across"
        assert np.linalg.norm(off) == pytest.approx(0.02 if aside else 0.0, abs=0.011 if aside else 1e-9)
        assert hindered(found[0], 0.08, HAND, beside) < 1e-9
        if aside:
            assert (
                off[0] < 0.0 and hindered(np.array([*found[0, :4], *X_WO[4:6], found[0, 6]]), 0.08, HAND, beside) > 0.0
            )
    ring = np.stack([0.03 * np.cos(np.arange(24) * np.pi / 12), 0.03 * np.sin(np.arange(24) * np.pi / 12)], axis=1)
    can = (np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in (-0.0365, 0.0365)]),)
    everywhere = Neighbours.of([post(0.4 + x, 0.2 + y, 0.05, 0.2) for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    for X_WG in grasps_from_above(can, X_WO, 0.08, DOWN, everywhere, palm=HAND)[0]:
        np.testing.assert_allclose(X_WG[4:6], X_WO[4:6], atol=1e-9)


def test_how_far_neighbours_reach_in_is_told() -> None:
    """Of discs and boxes against a post and a long bar, by hand; bars that lie close along a side are in no way."""
    a_post, bar = post(0.0, 0.0, 0.03, 0.2), box(0.4, 0.02, 0.02)[0] + [0.0, 0.2, 0.01]
    for near in (a_post, bar):
        assert Neighbours.of([near]).top[0] == pytest.approx(near[:, 2].max())
    both = Neighbours.of([a_post, bar])
    assert both.discs(np.array([[0.05, 0.0]]), 0.025) == pytest.approx(0.005, abs=3e-4)
    assert both.discs(np.array([[0.03, 0.04]]), 0.025) == pytest.approx(0.005, abs=5e-4)
    assert both.discs(np.array([[0.1, 0.17]]), 0.025) == pytest.approx(0.005, abs=1e-9)
    assert both.discs(np.array([[0.1, 0.16]]), 0.025) == 0.0
    for low, reached_in in ((0.15, 0.02), (0.25, 0.0)):
        body = box(0.06, 0.36, 0.1)[0] + [0.06, 0.1, low + 0.05]  # from x = 0.03 on, where the post ends
        assert both.body(body, 0.02) == pytest.approx(reached_in, abs=1e-9)
    nobody = Neighbours()
    assert nobody.discs(np.zeros((2, 2)), 1.0) == 0.0 == nobody.body(np.zeros((8, 3)), 0.1)


def test_fingers_tell_where_the_middle_is() -> None:
    """Off its origin, as a body beside its frame is; what y was correlated with moves along in certainty only."""
    pieces = (box(0.04, 0.06, 0.1)[0] + np.array([0.0, 0.01, 0.0]),)
    X_TO = compose(pose(0, 0, 0), pose(0.001, 0.004, 0.02))
    after, covariance = centred(X_TO, COVARIANCE, pieces, 0.001)
    np.testing.assert_allclose(after, [1, 0, 0, 0, 0.001, -0.01, 0.02])
    expected = COVARIANCE.copy()
    expected[4, 4] = 4e-6 * 1e-6 / (4e-6 + 1e-6)
    np.testing.assert_allclose(covariance, expected)
    np.testing.assert_allclose(X_TO[4:], [0.001, 0.004, 0.02])
