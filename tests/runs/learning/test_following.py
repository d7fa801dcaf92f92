"""Where the camera was about what is held: by what it saw, whatever the arm says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.runs.learning.held_box import HALF, camera, shown, turned
from twin_diagram.planning.grasps.gripper import WSG50
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.runs.learning.coverage import hands_of
from twin_diagram.runs.learning.display import HeldPicture, NothingHeld
from twin_diagram.runs.learning.following import Followed, apart, follow, follow_anew, found_again, register
from twin_diagram.signals import rotations

X_TB = np.eye(4)
X_TB[:3, 3] = [0.0, 0.0, 0.05]
ANGLES = np.linspace(0.0, 2.4, 13)


def placed(p: list[float]) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = p
    return X


def off(found: Followed, true: list[np.ndarray]) -> list[float]:
    """How far each tool pose takes the box's middle from where it is [m]; `true`: X_TB of each picture."""
    middle = X_TB[:3, 3]
    # S is the tool's frame in the first picture, where the box was at X_TB.
    return [apart(X, X_TB @ np.linalg.inv(own), middle)[0] for X, own in zip(found.X_ST, true, strict=True)]


def test_a_firm_grip_is_followed_to_half_a_millimetre() -> None:
    pictures = [shown(turned(a), X_TB, k) for k, a in enumerate(ANGLES)]
    found = follow(Followed(), pictures, np.eye(4))
    assert max(off(found, [X_TB] * len(pictures))) < 6e-4
    assert not found.slips
    # The cloud is that of the box: on its faces, with normals that lead outwards.
    p_B, n_B = found.points - X_TB[:3, 3], found.normals
    assert np.abs(np.abs(p_B / HALF).max(axis=1) - 1.0).max() < 0.12
    assert (np.einsum("ni,ni->n", p_B / HALF, n_B) > 0.5).mean() > 0.98


@pytest.mark.parametrize("p", [[0.010, 0.0, 0.0], [0.006, 0.0, 0.008]])
def test_a_slip_of_ten_millimetres_is_noticed_and_followed(p: list[float]) -> None:
    true = [X_TB if k < 4 else placed(p) @ X_TB for k in range(len(ANGLES))]
    pictures = [shown(turned(a), X, k) for k, (a, X) in enumerate(zip(ANGLES, true, strict=True))]
    found = follow(Followed(), pictures, np.eye(4))
    assert [slip.picture for slip in found.slips] == [4]
    assert found.slips[0].distance == pytest.approx(0.010, abs=0.002)
    assert max(off(found, true)) < 1.5e-3
    # What the arm's motion alone tells is off by all of it.
    assert apart(np.eye(4), true[-1] @ np.linalg.inv(X_TB), X_TB[:3, 3])[0] == pytest.approx(0.010, abs=1e-4)


def test_the_camera_is_where_the_tool_and_the_arm_put_it() -> None:
    pictures = [shown(turned(a), X_TB, k) for k, a in enumerate(ANGLES[:3])]
    found = follow(Followed(), pictures, np.eye(4))
    for one, X_SC in zip(pictures, found.camera_poses(), strict=True):
        X_TW = np.linalg.inv(one.X_WT)
        assert X_SC[:3, 3] == pytest.approx(X_TW[:3, :3] @ one.picture.camera.p_WC + X_TW[:3, 3], abs=1e-3)
        assert X_SC[:3, :3] == pytest.approx(X_TW[:3, :3] @ one.picture.camera.R_WC, abs=4e-3)


def test_the_hand_was_where_the_middle_picture_of_each_grasp_says() -> None:
    pictures = [replace(shown(turned(0.3 * k), X_TB, k), grasp=int(k > 2)) for k in range(4)]
    poses = [placed([0.001 * k, 0.0, 0.0]) for k in range(4)]
    first, second = hands_of(Followed(pictures, poses), [0.04, 0.06], WSG50)
    assert first.X_ST[0, 3] == pytest.approx(0.001) and second.X_ST[0, 3] == pytest.approx(0.003)
    # Between the pads it is free, beside them there is a finger.
    assert list(first.hold(placed([0.001, 0, 0])[:3, 3] + [[0, 0.019, 0], [0, 0.021, 0]])) == [False, True]
    assert list(second.hold(placed([0.003, 0, 0])[:3, 3] + [[0, 0.029, 0], [0, 0.031, 0]])) == [False, True]
    assert len(hands_of(Followed(pictures[:2], poses[:2]), [0.04, 0.06], WSG50)) == 1


def test_pictures_that_all_show_too_little_are_told_and_not_taken_for_followed() -> None:
    good = [shown(turned(a), X_TB, k) for k, a in enumerate(ANGLES[:2])]
    speck = np.zeros_like(good[0].mask)
    speck[100:105, 118:123] = True
    bad = [replace(one, mask=speck) for one in good]
    for before in (Followed(), follow(Followed(), good, np.eye(4))):
        count = len(before.shown)
        with pytest.raises(NothingHeld, match="no picture can be followed: each of 2 "):
            follow(before, bad, np.eye(4))
        assert len(before.shown) == count
    assert len(follow(Followed(), [bad[0], good[0]], np.eye(4)).shown) == 1


def test_what_crept_in_the_hand_is_found_again_along_every_axis() -> None:
    X_TB = np.eye(4)
    X_TB[2, 3] = 0.05
    pictures = [shown(turned(angle, tilt), X_TB, k) for tilt in (0.9, 0.3, -0.4) for k, angle in
                enumerate(np.linspace(-2.9, 2.9, 10))]  # fmt: skip
    seen = follow(Followed(), pictures, np.eye(4))
    crept = X_TB.copy()
    crept[:3, :3] = rotations.matrix(rotations.exp(np.array([0.0, 0.03, 0.01])))
    crept[:3, 3] += [0.005, 0.0, -0.009]
    glances = [shown(turned(angle, 0.7), crept, 50 + k) for k, angle in enumerate(np.linspace(-2.9, 2.9, 6))]
    X_ST = found_again(seen, glances, seen.X_ST[-1], (0.006, 0.03))
    assert X_ST is not None
    # The box's own frame, in S as it was and as it is found now.
    before, after = seen.X_ST[-1] @ X_TB, X_ST @ crept
    assert np.linalg.norm((before - after)[:3, 3]) < 0.0012
    assert np.abs(before[:3, :3].T @ after[:3, :3] - np.eye(3)).max() < 0.006


@pytest.mark.parametrize("axis", [0, 1])
def test_how_it_was_taken_again_is_told_by_all_pictures_of_the_new_grasp(axis: int) -> None:
    """The first grasp shows three sides of five; the guess of the second is off along one of two axes."""
    seen = follow(Followed(), [shown(turned(a), X_TB, k) for k, a in enumerate(np.linspace(-0.7, 0.7, 6))], np.eye(4))
    # The new grasp begins at sides that nobody saw before.
    more = [shown(turned(a), X_TB, 20 + k) for k, a in enumerate(np.linspace(3.0, 0.0, 13))]
    guess, known = placed(list(0.013 * np.eye(3)[axis])), (0.004, 0.04)
    found = follow_anew(seen, more, guess, known)
    assert max(off(found, [X_TB] * 19)) < 1e-3
    assert not found.slips
    # One by one they go wrong.
    assert max(off(follow(seen, more, guess, known), [X_TB] * 19)) > 5e-3


def can(X_WT: np.ndarray, number: int) -> HeldPicture:
    """The picture of a can without texture that lies across the tool: its turn about its axis shows nowhere."""
    view, radius, half = camera(), 0.033, 0.05
    R, p = X_WT[:3, :3], X_WT[:3, :3] @ [0.0, 0.0, 0.04] + X_WT[:3, 3]
    start, rays = R.T @ (view.p_WC - p), (view.rays() @ view.R_WC.T) @ R
    a = rays[..., 1] ** 2 + rays[..., 2] ** 2
    b = start[1] * rays[..., 1] + start[2] * rays[..., 2]
    root = b**2 - a * (start[1] ** 2 + start[2] ** 2 - radius**2)
    with np.errstate(invalid="ignore"):
        side = (-b - np.sqrt(root)) / a
        end = (np.copysign(half, -rays[..., 0]) - start[0]) / rays[..., 0]
        at = start + side[..., None] * rays
        side = np.where(np.abs(at[..., 0]) <= half, side, np.nan)
        at = start + end[..., None] * rays
        end = np.where(np.hypot(at[..., 1], at[..., 2]) <= radius, end, np.nan)
    t = np.fmin(side, end)
    mask = np.isfinite(t)
    noise = 0.0005 * np.random.default_rng(number).standard_normal(t.shape)
    depth = np.where(mask, np.nan_to_num(t) + noise, 2.0).astype(np.float32)
    rgb = np.zeros((*t.shape, 3), np.uint8)
    picture = Picture(rgb, depth, view, 0.1 * number, np.zeros(7), np.zeros(2))
    return HeldPicture(picture, X_WT, mask, np.zeros_like(mask), 0)


def test_new_sides_of_what_is_round_are_no_slip() -> None:
    turns = [(angle, tilt) for tilt in (0.87, 0.2, -0.45) for angle in np.linspace(-2.9, 2.9, 9)]
    seen = follow(Followed(), [can(turned(angle, tilt), k) for k, (angle, tilt) in enumerate(turns)], np.eye(4))
    assert seen.slips == []
    extent = np.ptp(seen.points, axis=0)
    assert extent == pytest.approx([0.10, 0.066, 0.066], abs=0.005)


def test_a_turn_is_about_the_points_own_middle_wherever_the_frames_origin_is() -> None:
    """The prior speaks of turning and shifting there: half a metre off, a turn about the origin would be a shift."""
    rng, half = np.random.default_rng(0), np.array([0.03, 0.04, 0.06])
    normals = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 300, axis=0)
    cloud = np.where(np.abs(normals) > 0.5, normals, rng.uniform(-1.0, 1.0, normals.shape)) * half
    middle = np.array([0.5, 0.0, 0.0])
    R = rotations.matrix(rotations.exp(np.array([0.0, 0.04, 0.06])))
    X, share = register(
        cloud + middle, normals, cloud[::5] @ R + middle, normals[::5] @ R, np.eye(4), (0.0005, 0.1), 0.012
    )
    assert share > 0.9
    assert rotations.difference(rotations.from_matrix(X[:3, :3]), rotations.from_matrix(R)) == pytest.approx(
        0.0, abs=4e-3
    )
    assert X[:3, :3] @ middle + X[:3, 3] == pytest.approx(middle, abs=5e-4)
