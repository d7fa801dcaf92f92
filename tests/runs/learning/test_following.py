"""Where the camera was about what is held: by what it saw, whatever the arm says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.runs.learning.held_box import HALF, shown, turned
from twin_diagram.runs.learning.display import NothingHeld
from twin_diagram.runs.learning.following import Followed, apart, follow, found_again
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
