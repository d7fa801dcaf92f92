"""How well a box was seen is known exactly: it hides nothing of itself but what faces away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.runs.learning.held_box import HALF, shown, turned
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.runs.learning.seen_map import SeenMap, Voxels, all_about, seen_map, sights

Array = npt.NDArray[np.float64]
STEP = 0.002


def box_surface() -> tuple[Array, Array]:
    """Points every 2 mm on the box's six faces, with outward normals."""
    points, normals = [], []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        a, b = (np.arange(-HALF[k] + STEP / 2, HALF[k], STEP) for k in others)
        grid = np.stack(np.meshgrid(a, b), axis=-1).reshape(-1, 2)
        for side in (-1.0, 1.0):
            face, outward = np.zeros((len(grid), 3)), np.zeros(3)
            face[:, others], face[:, axis], outward[axis] = grid, side * HALF[axis], side
            points.append(face)
            normals.append(np.tile(outward, (len(grid), 1)))
    return np.concatenate(points), np.concatenate(normals)


def frame(number: int, angle: float, tilt: float) -> RgbdFrame:
    """A picture of the box with its camera's pose in the box's frame."""
    X_WT = turned(angle, tilt)
    one = shown(X_WT, np.eye(4), number)
    camera = one.picture.camera
    R, p = X_WT[:3, :3].T @ camera.R_WC, X_WT[:3, :3].T @ (camera.p_WC - X_WT[:3, 3])
    camera = camera.moved(R, p)
    return RgbdFrame(number, 0.0, one.picture.rgb, one.picture.depth, one.mask, camera, camera)


FRAMES = [frame(k, angle, 0.6) for k, angle in enumerate(np.arange(12) * np.pi / 6)]
"""A full turn, in which the end at −z is never seen."""
FROM_BELOW = [frame(20 + k, angle, -0.7 - np.pi / 2) for k, angle in enumerate(np.arange(12) * np.pi / 6)]
POINTS, NORMALS = box_surface()


def expected(points: Array, normals: Array, frames: list[RgbdFrame]) -> tuple[Array, Array, Array]:
    """In how many pictures points of a convex body are seen, at which least distance and angle: by the formula."""
    lines = np.array([one.camera.p_WC for one in frames])[:, None] - points
    distance = np.linalg.norm(lines, axis=2)
    angle = np.arccos(np.einsum("kni,ni->kn", lines, normals) / distance)
    seen = (angle < np.deg2rad(70.0)) & (distance < 0.8)
    return seen.sum(axis=0), np.where(seen, distance, np.inf).min(axis=0), np.where(seen, angle, np.inf).min(axis=0)


@pytest.fixture(scope="module")
def found() -> SeenMap:
    there = NORMALS[:, 2] > -0.5
    return seen_map(POINTS[there], NORMALS[there], FRAMES)


def test_the_map_says_how_often_from_how_near_and_how_straight_each_patch_was_seen(found: SeenMap) -> None:
    inner = (np.abs(found.points) > HALF - 0.004).sum(axis=1) == 1  # no edge beside it
    count, distance, angle = expected(found.points, found.normals, FRAMES)
    measured = inner & (np.abs(found.normals).max(axis=1) > 0.999)
    assert measured.sum() > 1000
    # At the limit of 70° the normal of a patch decides.
    assert np.abs(found.frames - count)[measured].max() <= 1
    assert (found.frames == count)[measured].mean() > 0.97
    both = measured & (found.frames == count) & (count > 0)
    assert found.distance[both] == pytest.approx(distance[both], abs=1e-6)
    assert found.angle[both] == pytest.approx(angle[both], abs=1e-6)


def test_an_end_that_no_picture_shows_is_missing_and_its_share_is_told(found: SeenMap) -> None:
    sides = 8.0 * (HALF[0] * HALF[1] + HALF[1] * HALF[2] + HALF[0] * HALF[2])
    # Of points on a grid the twelve next lie within two steps, a circle of 12.6.
    measured = 12.0 / (4.0 * np.pi) * found.area[np.isfinite(found.distance)].sum()
    assert measured == pytest.approx(sides - 4.0 * HALF[0] * HALF[1], rel=0.02)
    assert 1.0 - found.seen_share == pytest.approx(4.0 * HALF[0] * HALF[1] / sides, abs=0.04)
    below = found.points[found.missing]
    # What was not looked behind may reach beyond the end itself, by the room that is left about the cloud.
    assert (below[:, 2] < -HALF[2] + 0.01).all() and below[:, 2].min() > -HALF[2] - 0.02
    assert found.normals[found.missing][:, 2].mean() < -0.6


def test_all_of_it_is_seen_once_the_other_end_was_shown() -> None:
    frames = FRAMES + FROM_BELOW
    assert expected(POINTS, NORMALS, frames)[0].min() >= 2
    assert seen_map(POINTS, NORMALS, frames).seen_share > 0.995


def test_what_is_behind_the_hand_is_not_seen(found: SeenMap) -> None:
    def behind_a_hand(one: RgbdFrame) -> RgbdFrame:
        assert one.mask is not None
        depth, mask = one.depth.copy(), one.mask.copy()
        depth[:, 115:125] = np.where(mask[:, 115:125], 0.3, depth[:, 115:125])
        mask[:, 115:125] = False
        return replace(one, depth=depth, mask=mask)

    there = NORMALS[:, 2] > -0.5
    less = seen_map(POINTS[there], NORMALS[there], [behind_a_hand(one) for one in FRAMES])
    same = np.isfinite(found.distance)
    lost = found.frames[same] - less.frames[: len(found.frames)][same]
    assert (lost >= 0).all() and lost.max() >= 3


def test_what_the_hand_filled_is_not_taken_for_the_object() -> None:
    there = NORMALS[:, 2] > -0.5
    low, high = np.array([[-0.1, -0.1, -0.2]]), np.array([[0.1, 0.1, -HALF[2]]])
    missing = seen_map(POINTS[there], NORMALS[there], FRAMES, [Boxes(np.eye(4), low, high)])
    below = missing.points[missing.missing]
    assert below[:, 2].min() > -HALF[2] - 0.002
    elsewhere = np.eye(4)
    elsewhere[:3, 3] = [0.0, 0.0, -0.3]
    assert not Boxes(elsewhere, low, high).hold(POINTS).any()


def test_all_that_a_finger_hid_is_missing() -> None:
    """Its rim, too, which lies beside what was measured."""
    low, high = np.array([[HALF[0], -0.010, -0.015]]), np.array([[HALF[0] + 0.015, 0.010, 0.020]])
    finger = Boxes(np.eye(4), low, high)
    hidden = (NORMALS[:, 0] > 0.5) & (np.abs(POINTS[:, 1]) < 0.010) & (np.abs(POINTS[:, 2] - 0.0025) < 0.0175)
    frames = [hidden_by(finger, one) for one in (*FRAMES, *FROM_BELOW)]
    found = seen_map(POINTS[~hidden], NORMALS[~hidden], frames, [finger])
    sides = 8.0 * (HALF[0] * HALF[1] + HALF[1] * HALF[2] + HALF[0] * HALF[2])
    assert 1.0 - found.seen_share == pytest.approx(0.020 * 0.035 / sides, rel=0.35)


def hidden_by(finger: Boxes, one: RgbdFrame) -> RgbdFrame:
    """A picture with a finger's front before the box: pixels that show its place show the finger, 15 mm nearer."""
    assert one.mask is not None
    y, z = np.meshgrid(*(np.linspace(finger.low[0, k], finger.high[0, k], 80) for k in (1, 2)))
    depth, mask = one.depth.copy(), one.mask.copy()
    for x in np.linspace(finger.low[0, 0], finger.high[0, 0], 8):
        u, v, far = one.camera.project(np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1))
        at = np.rint(v).astype(int), np.rint(u).astype(int)
        near = far < np.where(depth[at] > 0, depth[at], np.inf) + 1e-4
        at = at[0][near], at[1][near]
        depth[at], mask[at] = far[near], False
    return replace(one, depth=depth, mask=mask)


def test_lines_of_sight_end_at_what_is_full() -> None:
    full = np.zeros((40, 40, 40), dtype=bool)
    full[:, :, :10] = True
    full[:, 30:, :] = True  # a wall on one side of the ground
    voxels = Voxels(np.zeros(3), 0.003, full)
    open_ = sights(voxels, np.array([[0.06, 0.06, 0.03]]), np.array([[0.0, 0.0, 1.0]]))[0]
    directions = all_about(len(open_))
    up = directions[:, 2] > np.cos(np.deg2rad(70.0))
    assert not open_[~up].any()
    # The wall begins 0.03 m beside it and ends 0.12 m up; lines begin 0.0075 m above the ground.
    with np.errstate(divide="ignore"):
        along, height = (0.03 * directions[:, k] / directions[:, 1] for k in (0, 2))
    blocked = up & (directions[:, 1] > 0.0) & (height < 0.115 - 0.0375) & (np.abs(along) < 0.055)
    assert blocked.sum() > 5 and not open_[blocked].any()
    assert open_[up & (directions[:, 1] < 0.0)].all()
