"""Which grasp is taken: from above where that can be, else of the shape; never with the hand in what it stands on."""

from __future__ import annotations

import numpy as np
import pytest

from tests.planning.tasks.small_world import post
from twin_diagram.assets import Asset
from twin_diagram.planning.grasps.gripper import PANDA_HAND
from twin_diagram.planning.tasks.grasp_choice import TUNING, ShapeGrasps, between_fingers, choices
from twin_diagram.planning.tasks.grasp_from_above import grasps_from_above
from twin_diagram.planning.tasks.neighbours import Neighbours
from twin_diagram.planning.tasks.task_system import shape_grasps
from twin_diagram.scenario.resources import resolve
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
NONE = Neighbours()
HAND = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.1, 0.1) for z in (-0.1, 0.01)])


def box(x: float, y: float, z: float) -> tuple[Array, ...]:
    return (np.array([[a, b, c] for a in (-x / 2, x / 2) for b in (-y / 2, y / 2) for c in (-z / 2, z / 2)]),)


def at(z: float, turn: float = 0.0) -> Array:
    return np.array([np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2), 0.4, 0.1, z])


def flat(p: tuple[float, float, float]) -> Array:
    """Coming along x, closing along y: the hand lies flat."""
    R = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return np.array([*rotations.from_matrix(R), *p])


def test_from_above_goes_before_the_shape() -> None:
    shape = ShapeGrasps(flat((0.0, 0.0, 0.0))[None], np.zeros(1), hand=HAND)
    pieces = box(0.05, 0.04, 0.2)
    found = choices(pieces, at(0.1), 0.08, DOWN, NONE, shape)
    above, _ = grasps_from_above(pieces, at(0.1), 0.08, DOWN, NONE)
    np.testing.assert_allclose(found[0], above[0])
    assert len(found) == len(above) + 1


def test_what_is_too_wide_from_above_is_taken_by_its_shape_wherever_it_stands() -> None:
    shape = ShapeGrasps(np.stack([flat((-0.09, 0.0, 0.03)), flat((0.09, 0.0, 0.03))]), np.array([0.0, 0.3]), hand=HAND)
    back = TUNING.stand_off
    (first, second) = choices(box(0.2, 0.2, 0.2), at(0.1, np.pi / 2), 0.08, DOWN, NONE, shape)
    np.testing.assert_allclose(first[4:], [0.4, 0.1 - 0.09 - back, 0.13], atol=1e-12)  # O's -x is W's -y
    np.testing.assert_allclose(second[4:], [0.4, 0.1 + 0.09 - back, 0.13], atol=1e-12)
    np.testing.assert_allclose(rotations.matrix(first[:4])[:, 2], [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(("height", "taken"), [(0.03 + TUNING.floor + 1e-4, 1), (0.03 + TUNING.floor - 1e-4, 0)])
def test_no_hand_in_the_ground(height: float, taken: int) -> None:
    """The hand is 3 cm thick to either side of a tool that lies flat."""
    shape = ShapeGrasps(flat((0.0, 0.0, height - 0.1))[None], np.zeros(1), hand=HAND)
    assert len(choices(box(0.2, 0.2, 0.2), at(0.3), 0.08, DOWN, NONE, shape)) == taken


@pytest.mark.parametrize(("spare", "taken"), [(1e-4, 1), (-1e-4, 0)])
def test_no_hand_in_what_an_object_lies_on(spare: float, taken: int) -> None:
    """Its x axis up and turned by a quarter: 0.2 m of it stand above the ground, not the 0.3 m that it is wide."""
    R_WO = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    R_WG = rotations.matrix(flat((0.0, 0.0, 0.0))[:4])
    X_OG = np.array([*rotations.from_matrix(R_WO.T @ R_WG), -0.1 + 0.03 + TUNING.floor + spare, 0.0, 0.0])
    X_WO = np.array([*rotations.from_matrix(R_WO), 0.4, 0.1, 0.1])
    shape = ShapeGrasps(X_OG[None], np.zeros(1), hand=HAND)
    assert len(choices(box(0.2, 0.3, 0.25), X_WO, 0.08, DOWN, NONE, shape)) == taken


def test_straight_down_goes_before_from_the_side() -> None:
    """Of two grasps as good, though the hand must turn by a quarter for it."""
    level = flat((-0.09, 0.0, 0.0))
    shape = ShapeGrasps(np.stack([level, [*DOWN, 0.0, 0.0, 0.11]]), np.zeros(2), hand=HAND * [1.0, 1.0, -1.0])
    first, second = choices(box(0.2, 0.2, 0.2), at(0.1), 0.08, level[:4], NONE, shape)
    assert rotations.matrix(first[:4])[2, 2] == pytest.approx(-1.0)
    assert rotations.matrix(second[:4])[2, 2] == pytest.approx(0.0, abs=1e-12)


def test_neighbours_and_turns_are_minded() -> None:
    """Of two grasps alike the one beside which nobody stands, with the hand turned the nearer way round."""
    shape = ShapeGrasps(np.stack([flat((-0.09, 0.0, 0.0)), flat((0.09, 0.0, 0.0))]), np.zeros(2), hand=HAND)
    pieces, X_WO = box(0.2, 0.2, 0.2), at(0.1)
    neighbour = Neighbours.of([post(0.4 - 0.09, 0.1 + 0.08, 0.03, 0.2)])
    found = choices(pieces, X_WO, 0.08, DOWN, neighbour, shape)
    np.testing.assert_allclose(found[0][4:], [0.49 - TUNING.stand_off, 0.1, 0.1], atol=1e-12)
    for near in (
        shape.poses[0][:4],
        rotations.from_matrix(rotations.matrix(shape.poses[0][:4]) @ np.diag([-1, -1, 1])),
    ):
        turned = choices(pieces, X_WO, 0.08, np.asarray(near, dtype=float), NONE, shape)[0]
        assert np.linalg.norm(rotations.difference(turned[:4], near)) < 1e-9


def test_grasps_of_a_mugs_shape_are_those_of_its_rim_and_handle() -> None:
    mug = Asset.load(resolve("objects/mug", {}))
    shape = shape_grasps(mug, PANDA_HAND)
    assert len(shape.poses) >= 10 and len(shape.hand) == 8 * 5
    np.testing.assert_allclose(np.ptp(shape.hand[:, 1]), 0.2, atol=0.02)  # the palm's width
    found = choices(tuple(mug.convex_pieces), np.array([1.0, 0, 0, 0, 0.5, 0.0, 0.05]), 0.08, DOWN, NONE, shape)
    assert len(found) >= 3
    low = (shape.hand @ rotations.matrix(found[0][:4]).T)[:, 2].min() + found[0][6]
    assert low > TUNING.floor


def test_a_gripper_that_nobody_knows_takes_from_above_alone() -> None:
    assert len(shape_grasps(Asset.load(resolve("objects/mug", {})), None).poses) == 0


def test_what_is_between_the_fingers_is_what_the_pads_meet() -> None:
    """Of two grasps of a rim the nearer one's contacts, whichever way round the hand is; from elsewhere, nothing."""
    poses = np.stack([flat((-0.09, 0.0, 0.0)), flat((0.09, 0.0, 0.0))])
    contacts = np.array([[[-0.1, 0.01, 0.0], [-0.1, -0.002, 0.0]], [[0.1, 0.0, 0.0], [0.1, 0.02, 0.0]]])
    shape = ShapeGrasps(poses, np.zeros(2), contacts, HAND)
    for flip in (np.eye(3), np.diag([-1.0, -1.0, 1.0])):
        R = rotations.matrix(poses[1][:4]) @ flip
        p = poses[1][4:] - TUNING.stand_off * R[:, 2] + [0.0, 0.005, 0.0]
        X_TO = np.array([*rotations.from_matrix(R.T), *(-R.T @ p)])
        found = between_fingers(shape, X_TO)
        assert found is not None
        np.testing.assert_array_equal(found, contacts[1])
    far = np.array([*rotations.from_matrix(R.T), *(-R.T @ (p + [0.0, 2 * TUNING.same[0], 0.0]))])
    assert between_fingers(shape, far) is None and between_fingers(ShapeGrasps(), far) is None
    unknown = ShapeGrasps(poses, np.zeros(2), np.full((2, 2, 3), np.nan), HAND)
    assert between_fingers(unknown, X_TO) is None
