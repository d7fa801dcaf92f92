"""What is held by a hand that is turned and tilted: each quantity in its own frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.planning.tasks.small_world import BOX, COVARIANCE, SmallWorld, pose, step
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import Phase
from twin_diagram.planning.tasks.step_view import Takeable
from twin_diagram.signals import rotations
from twin_diagram.signals.pose_vectors import compose, errors, inverse

ROD = BOX * [0.5, 0.5, 3.0]
"""2 cm by 3 cm, 0.3 m tall."""
TURNED = np.asarray(Rotation.from_euler("ZYX", [0.7, 0.5, np.pi - 0.4]).as_quat()[[3, 0, 1, 2]], dtype=float)
LEANING = np.asarray(Rotation.from_euler("ZY", [1.0, 0.3]).as_quat()[[3, 0, 1, 2]], dtype=float)
PLACE = pose(0.4, -0.3, 0.15, LEANING)
BESIDE = pose(0.0, 0.0, -0.055, TURNED)
"""X_OG: 55 mm from the rod's middle, along it."""


def world() -> SmallWorld:
    at, steps = pose(0.5, 0.1, 0.15, LEANING), (step("pick", BESIDE), step("place", PLACE))
    return SmallWorld(steps, X_WO=at, library=(Takeable((ROD,), False),))


def test_its_covariance_turns_with_the_tool() -> None:
    """What is not known along the fingers' axis goes; what is left is that of the track, along the tool's axes."""
    state = world().until(Phase.LIFT)
    R_TW = np.kron(np.eye(2), rotations.matrix(compose(PLACE, BESIDE)[:4]).T)
    seen = R_TW @ COVARIANCE @ R_TW.T
    expected = seen - np.outer(seen[4], seen[4]) / (seen[4, 4] + TUNING.finger_error**2)
    np.testing.assert_allclose(state.hand.covariance, expected, atol=1e-12)


def test_it_is_let_go_higher_for_what_is_not_known_of_its_height() -> None:
    one = world()
    state = one.until(Phase.LIFT)
    one.state = replace(state, hand=replace(state.hand, covariance=0.1 * state.hand.covariance))
    state = one.until(Phase.CARRY)
    hand = compose(PLACE, inverse(state.hand.X_TO))
    up = rotations.matrix(hand[:4])[2]
    doubt = TUNING.drop_sigmas * np.sqrt(up @ state.hand.covariance[3:, 3:] @ up)
    assert 0.0 < doubt < TUNING.drop_doubt
    assert state.grasp[6] - hand[6] == pytest.approx(TUNING.drop + doubt, abs=1e-9)


def test_what_slips_along_itself_is_followed() -> None:
    """The hand is still around the rod: told by where the tool is along it, not across."""
    one = world()
    one.until(Phase.CARRY)
    one.frozen = True
    for _ in range(10):
        one.tick()
    one.X_WO = compose(one.X_WO, pose(0.0, 0.0, -0.012))
    for _ in range(20):
        state = one.tick()
    assert errors(compose(one.X_WT, state.hand.X_TO), one.X_WO)[0] < TUNING.told_step + 1e-4
