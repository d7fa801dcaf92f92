"""What is put down upon another object stands there, wherever that is by then, or is kept in the hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.planning.tasks.small_world import BOX, DOWN, TICK, SmallWorld, pose, step
from twin_diagram.planning.tasks.bearing import bears
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import Phase, TaskOutcome, Why
from twin_diagram.planning.tasks.step_view import Takeable
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.pose_vectors import compose, errors
from twin_diagram.signals.rotations import multiply

BELOW = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.08, 0.08) for z in (-0.03, 0.03)])
"""Corners of a flat box that bears others."""
UPON = pose(0.02, -0.01, 0.08)
"""Where a box stands upon it, in its frame."""
TURNED = np.array([np.cos(0.3), 0.0, 0.0, np.sin(0.3)])
ON_SIDE = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])


def world(where: Array, goal: Array = UPON, limit: float = 20.0) -> SmallWorld:
    steps = (step("pick"), step("place", goal, support=1, time_limit=limit))
    return SmallWorld(steps, library=(Takeable((BOX,), False), Takeable((BELOW,), False)), others=(where,))


def off(small: SmallWorld) -> float:
    """How far from its place beside the other one an object stands [m]."""
    return errors(small.X_WO, compose(small.others[0], UPON))[0]


def test_it_stands_where_the_other_one_is_by_then() -> None:
    small = world(pose(0.4, -0.3, 0.03, TURNED))
    small.until(Phase.CARRY)
    small.others = (pose(0.45, -0.25, 0.03, TURNED),)
    assert small.run().outcome is TaskOutcome.DONE
    most = TUNING.drop + TUNING.drop_doubt
    assert off(small) == pytest.approx(most, abs=1e-9), "let go above it, for its height is not sure"


def test_without_a_goal_it_stands_on_the_middle_as_it_stood_before() -> None:
    """Whichever side of the other one is up, and also where that is seen a little askew."""
    askew = np.array([np.cos(0.01), np.sin(0.01), 0.0, 0.0])
    for lies, top in ((pose(0.4, -0.3, 0.03, TURNED), 0.06), (pose(0.4, -0.3, 0.08, ON_SIDE), 0.16)):
        for turn in (lies[:4], multiply(askew, lies[:4])):
            small = world(np.concatenate([turn, lies[4:]]), goal=np.zeros(7))
            small.X_WO = pose(0.5, 0.1, 0.05, np.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)]))
            before = small.X_WO[:4].copy()
            assert small.run().outcome is TaskOutcome.DONE
            there = np.array([*before, 0.4, -0.3, top + 0.05 + TUNING.drop + TUNING.drop_doubt])
            away, turned = errors(small.X_WO, there)
            assert away < 2e-4 and turned < 1e-6


def test_the_other_one_may_be_touched_while_lowering_and_never_else() -> None:
    small = world(pose(0.4, -0.3, 0.03))
    told: dict[Phase, set[tuple[bool, int]]] = {}
    while small.state.outcome is TaskOutcome.RUNNING:
        hand = small.tick().hand
        if hand.held == 0:
            told.setdefault(small.state.phase, set()).add((hand.on_support, hand.support))
    assert told[Phase.CARRY] == {(False, NOTHING)}
    assert told[Phase.LOWER] == {(True, 1)}


@pytest.mark.parametrize("beside", [ObjectStatus.UNSEEN, ObjectStatus.LOST, ObjectStatus.GONE])
def test_what_is_not_seen_is_waited_for(beside: ObjectStatus) -> None:
    small = world(pose(0.4, -0.3, 0.03), limit=4.0)
    small.beside = beside
    state = small.until(Phase.CARRY)
    for _ in range(20):
        assert not small.tick().goal.any(), "it rests"
    small.beside = ObjectStatus.TRACKED
    assert small.run().outcome is TaskOutcome.DONE
    never = world(pose(0.4, -0.3, 0.03), limit=4.0)
    never.beside = beside
    state = never.run()
    assert (state.outcome, state.why, state.hand.held) == (TaskOutcome.FAILED, Why.NO_SUPPORT, 0)


def test_nothing_is_put_upon_what_moves_until_it_rests() -> None:
    small = world(pose(0.4, -0.3, 0.03))
    small.beside = ObjectStatus.MOVING
    small.until(Phase.CARRY)
    for _ in range(30):
        small.others = (small.others[0] + np.array([0, 0, 0, 0, 0.004, 0, 0]),)
        assert small.tick().phase is Phase.CARRY
    small.beside = ObjectStatus.TRACKED
    assert small.run().outcome is TaskOutcome.DONE
    assert off(small) < TUNING.told_step + TUNING.drop + TUNING.drop_doubt
    assert small.now > 30 * TICK


@pytest.mark.parametrize("later", [False, True])
def test_what_would_not_stand_there_stays_in_the_hand(later: bool) -> None:
    """The other one lies on another side than was thought, from the begin or since the way there."""
    lies = pose(0.4, -0.3, 0.08, ON_SIDE)
    small = world(pose(0.4, -0.3, 0.03) if later else lies)
    small.until(Phase.CARRY if later else Phase.LIFT)
    small.others = (lies,)
    state = small.run()
    assert (state.outcome, state.why, state.hand.held) == (TaskOutcome.FAILED, Why.NO_STAND, 0)
    assert not state.goal.any() and Phase.LOWER not in small.phases


@pytest.mark.parametrize(("x", "stands"), [(0.09, True), (0.104, True), (0.112, False), (0.15, False)])
def test_the_middle_must_be_borne(x: float, stands: bool) -> None:
    at = pose(0.4, -0.3, 0.03, TURNED)
    assert bears((BOX,), compose(at, pose(x, 0.0, 0.08)), (BELOW,), at, 0.01) == stands


def test_what_is_taken_off_another_one_may_touch_that_until_it_is_clear() -> None:
    small = world(pose(0.5, 0.1, 0.03))
    small.X_WO = compose(small.others[0], UPON)
    assert small.until(Phase.LIFT).hand.support == 1
    small.frozen = True
    for height, support in ((0.9 * TUNING.clear, 1), (1.1 * TUNING.clear, NOTHING)):
        small.X_WT = small.state.grasp + np.array([0, 0, 0, 0, 0, 0, height])
        assert small.tick().hand.support == support
    on_table = world(pose(0.5, -0.3, 0.03))
    assert on_table.until(Phase.LIFT).hand.support == NOTHING


@pytest.mark.parametrize("x", [-0.07, 0.0, 0.07])
def test_what_bears_it_is_in_no_fingers_way(x: float) -> None:
    """Near an end of a long box the hand is turned no further than on the table."""
    across = multiply(np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]), DOWN)  # closing on the narrow side
    grasps = []
    for apart in (0.0, 0.5):
        small = world(pose(0.5 - x, 0.1 + apart, 0.03))
        small.X_WO, small.X_WT[:4] = pose(0.5, 0.1, 0.11), across
        grasps.append(small.until(Phase.APPROACH).grasp)
    np.testing.assert_allclose(grasps[0], grasps[1], atol=1e-9)
