"""Steps one by one: what they wait for, what they want, what they do when it does not come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.planning.tasks.small_world import BOX, COVARIANCE, DOWN, TICK, SmallWorld, pose, step
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import (
    NOTE_FIELDS,
    OPENED,
    OUTCOME,
    TOLD,
    Note,
    Phase,
    TaskOutcome,
    TaskState,
    Why,
)
from twin_diagram.planning.tasks.step_view import Takeable
from twin_diagram.signals import rotations
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.pose_vectors import compose, errors

GOAL = pose(0.5, -0.2, 0.3, DOWN)
PLACE = pose(0.4, -0.3, 0.05)
PICK_AND_PLACE = (step("pick"), step("place", PLACE))


def notes(state: TaskState) -> list[tuple[int, Note, Why]]:
    rows = state.notes.reshape(-1, NOTE_FIELDS)
    return [(int(n), Note(int(note)), Why(int(why))) for time, n, note, why, *_ in rows if time >= 0]


# Reach and hold.


def test_steps_follow_one_another_and_end_at_rest() -> None:
    world = SmallWorld((step("reach", GOAL), step("hold", seconds=0.5)))
    state = world.until(Phase.MOVE)
    np.testing.assert_array_equal(state.goal, GOAL)
    state = world.until(Phase.HOLD)
    assert not state.goal.any()
    begun = world.now
    state = world.run()
    assert state.outcome is TaskOutcome.DONE and state.step == 2 and not state.goal.any()
    assert world.now - begun == pytest.approx(0.5, abs=2 * TICK)
    assert notes(state) == [
        (0, Note.STARTED, Why.NONE), (0, Note.DONE, Why.NONE), (1, Note.STARTED, Why.NONE), (1, Note.DONE, Why.NONE),
    ]  # fmt: skip
    assert world.tick() is state, "over is over"


@pytest.mark.parametrize(
    ("off", "turn", "speed", "there"),
    [
        (0.009, 0.0, 0.0, True),
        (0.011, 0.0, 0.0, False),
        (0.0, 0.09, 0.0, True),
        (0.0, 0.11, 0.0, False),
        (0.0, 0.0, 0.02, False),
    ],
)
def test_a_goal_is_reached_within_its_tolerances_at_rest(off: float, turn: float, speed: float, there: bool) -> None:
    world = SmallWorld((step("reach", GOAL),), frozen=True, speed=speed)
    world.X_WT = compose(GOAL, np.array([np.cos(turn / 2), 0, 0, np.sin(turn / 2), off, 0, 0]))
    while world.now < TUNING.settled + 5 * TICK:
        world.tick()
    assert (world.state.outcome is TaskOutcome.DONE) == there


def test_near_for_long_is_as_good_as_there_but_far_is_not() -> None:
    for off, outcome in ((0.018, TaskOutcome.DONE), (0.022, TaskOutcome.RUNNING)):
        world = SmallWorld((step("reach", GOAL),), frozen=True)
        world.X_WT = GOAL + np.array([0, 0, 0, 0, off, 0, 0])
        while world.now < TUNING.late + 5 * TICK:
            world.tick()
        assert world.state.outcome is outcome


def test_the_time_limit_ends_step_and_task() -> None:
    world = SmallWorld((step("reach", GOAL, time_limit=2.0), step("hold")), frozen=True)
    state = world.run()
    assert (state.outcome, state.why, state.phase, state.step) == (TaskOutcome.FAILED, Why.TIME_LIMIT, Phase.REST, 0)
    assert not state.goal.any(), "a failed step leaves the arm at rest"
    assert world.now == pytest.approx(2.0, abs=3 * TICK)
    assert notes(state)[-1] == (0, Note.FAILED, Why.TIME_LIMIT)


def test_a_goal_out_of_reach_is_given_up() -> None:
    world = SmallWorld((step("reach", GOAL),), frozen=True, reach=0.0)
    state = world.run()
    assert (state.outcome, state.why) == (TaskOutcome.FAILED, Why.OUT_OF_REACH)
    assert world.now == pytest.approx(TUNING.patience, abs=3 * TICK)


# Follow.


def test_what_moves_is_followed_for_a_time() -> None:
    X_OG = pose(0.0, 0.0, 0.2, DOWN)
    world = SmallWorld((step("follow", X_OG, seconds=2.0),))
    world.until(Phase.FOLLOW)
    while world.now < 1.0:
        world.X_WO[4] += 0.1 * TICK
        state = world.tick()
        assert errors(state.goal, compose(world.X_WO, X_OG))[0] < TUNING.follow_step + 1e-9
    turned = np.array([np.cos(0.2), 0, 0, np.sin(0.2), 0, 0, 0])
    world.X_WO = compose(world.X_WO, turned)
    assert errors(world.tick().goal, compose(world.X_WO, X_OG))[1] < TUNING.follow_turn
    small = world.state.goal
    world.X_WO[4] += 0.5 * TUNING.follow_step
    assert world.tick().goal is small, "a search for joint goals is not made for noise"
    assert world.run().outcome is TaskOutcome.DONE
    assert world.now == pytest.approx(2.0, abs=3 * TICK)


def test_a_target_that_is_lost_leaves_the_arm_at_rest_until_it_is_seen() -> None:
    world = SmallWorld((step("follow", pose(0, 0, 0.2, DOWN), seconds=3.0),))
    world.until(Phase.FOLLOW)
    world.status = ObjectStatus.STALE
    state = world.until(Phase.WAIT)
    assert not state.goal.any()
    world.status = ObjectStatus.MOVING
    state = world.until(Phase.FOLLOW)
    assert [note for _, note, _ in notes(state)] == [Note.STARTED, Note.WAITS, Note.RESUMED]
    world.status = ObjectStatus.LOST
    state = world.run()
    assert (state.outcome, state.why) == (TaskOutcome.FAILED, Why.TARGET_LOST)
    assert not state.goal.any()
    assert world.now - state.notes[-2 * NOTE_FIELDS] == pytest.approx(TUNING.lost, abs=3 * TICK)


def test_what_was_never_seen_is_waited_for_until_the_time_limit() -> None:
    world = SmallWorld((step("follow", pose(0, 0, 0.2, DOWN), time_limit=4.0),), status=ObjectStatus.UNSEEN)
    state = world.run()
    assert state.outcome is TaskOutcome.FAILED and world.now == pytest.approx(4.0, abs=3 * TICK)


# Pick and place.


def test_pick_and_place_goes_through_its_phases_and_puts_it_where_it_belongs() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    state = world.run()
    assert state.outcome is TaskOutcome.DONE
    assert [phase.name for phase in world.phases] == [
        "LOOK", "APPROACH", "DESCEND", "CLOSE", "LIFT", "CARRY", "LOWER", "OPEN", "RETREAT", "REST",
    ]  # fmt: skip
    off, angle = errors(world.X_WO, PLACE)
    assert off == pytest.approx(TUNING.drop + TUNING.drop_doubt, abs=1e-9) and angle < 1e-6, "its height is not sure"
    np.testing.assert_allclose(world.X_WO[4:6], PLACE[4:6], atol=1e-9)
    assert [note for n, note, _ in notes(state)] == [
        Note.STARTED, Note.GRASPED, Note.DONE, Note.STARTED, Note.RELEASED, Note.DONE,
    ]  # fmt: skip
    assert state.hand.held == state.hand.touched == NOTHING


def test_the_approach_comes_from_above_with_open_fingers() -> None:
    world = SmallWorld((step("pick"),))
    state = world.until(Phase.APPROACH)
    assert world.opening == 0.08 and state.force == 30.0
    above = state.goal[4:] - state.grasp[4:]
    np.testing.assert_allclose(above, [0, 0, TUNING.above], atol=1e-9)
    assert state.hand.touched == NOTHING, "on the way there it is an obstacle like any other"
    state = world.until(Phase.DESCEND)
    assert state.hand.touched == 0 and state.hand.held == NOTHING
    np.testing.assert_array_equal(state.goal, state.grasp)


def test_an_object_is_let_go_once_the_hand_is_slow_enough_to_have_closed() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.LOWER)
    for speed, after in ((1.1 * TUNING.slow, Phase.LOWER), (0.9 * TUNING.slow, Phase.OPEN)):
        world.speed = speed
        begun = world.now
        while world.now - begun < TUNING.settled + 3 * TICK:
            state = world.tick()
        assert state.phase is after


def test_nobody_reaches_down_with_fingers_half_open() -> None:
    world = SmallWorld((step("pick", time_limit=3.0),), stuck=0.06)
    state = world.run()
    assert world.phases == [Phase.LOOK, Phase.APPROACH, Phase.REST]
    assert state.why is Why.TIME_LIMIT
    holding = SmallWorld(PICK_AND_PLACE)
    holding.until(Phase.OPEN)
    holding.stuck = 0.06
    assert holding.run().why is Why.TIME_LIMIT


def test_the_arm_gives_way_to_nothing_while_the_fingers_are_around_the_object() -> None:
    world, told = SmallWorld(PICK_AND_PLACE), {}
    while world.state.outcome is TaskOutcome.RUNNING:
        state = world.tick()
        told[state.phase.name] = state.hand.around
    assert [name for name, around in told.items() if around] == ["CLOSE", "OPEN", "RETREAT"]
    late = SmallWorld(PICK_AND_PLACE)
    late.until(Phase.OPEN)
    late.stuck = 0.06
    assert not late.run().hand.around, "a task that is over gives way again"


def test_a_hand_pushed_aside_lets_go_there_and_leaves_straight_up() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.LOWER)
    world.frozen = True
    world.X_WT = aside = world.state.goal + np.array([0, 0, 0, 0, 0.008, 0, 0])
    assert not world.until(Phase.OPEN).goal.any()
    state = world.until(Phase.RETREAT)
    np.testing.assert_allclose(state.goal, aside + np.array([0, 0, 0, 0, 0, 0, TUNING.above]), atol=1e-9)


def test_the_object_is_an_obstacle_again_once_the_fingers_are_off_it() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.RETREAT)
    world.frozen = True
    for risen, done in ((0.9 * TUNING.away, False), (1.1 * TUNING.away, True)):
        world.X_WT = world.state.grasp + np.array([0, 0, 0, 0, 0, 0, risen])
        state = world.tick()
        assert (state.outcome is TaskOutcome.DONE) == done
        assert (state.hand.touched == NOTHING) == done


def test_the_grasp_follows_what_moved_meanwhile() -> None:
    world = SmallWorld((step("pick"),))
    world.until(Phase.APPROACH)
    world.X_WO[4:6] += [0.01, -0.005]
    state = world.until(Phase.DESCEND)
    np.testing.assert_allclose(state.grasp[4:6], world.X_WO[4:6], atol=1e-9)


def test_a_hand_that_leaves_its_way_down_tries_anew_and_keeps_clear_of_the_object_again() -> None:
    for off, astray in ((0.13, False), (0.15, True)):
        world = SmallWorld(PICK_AND_PLACE)
        state = world.until(Phase.DESCEND)
        assert state.hand.touched == 0
        world.frozen = True
        world.X_WT = state.grasp + np.array([0, 0, 0, 0, 0.0, 0.0, off])
        state = world.tick()
        assert (state.phase is Phase.LOOK) == astray and (state.hand.touched == NOTHING) == astray
        assert ((0, Note.TRIED_AGAIN, Why.NO_WAY_DOWN) in notes(state)) == astray


def test_what_is_held_is_where_perception_saw_it_and_the_fingers_put_it() -> None:
    """Along the fingers' axis it is in their middle; its covariance turns with the tool and shrinks there alone."""
    world = SmallWorld((step("pick"),))
    world.until(Phase.CLOSE)
    world.X_WO[5] += 0.004  # along W's y, which is the fingers': the hand need not turn for it
    state = world.until(Phase.LIFT)
    hand = state.hand
    assert hand.held == 0 and hand.on_support
    assert hand.X_TO[5] == pytest.approx(0.0, abs=1e-9)
    variances = np.diag(hand.covariance)
    assert variances[4] == pytest.approx(4e-6 * TUNING.finger_error**2 / (4e-6 + TUNING.finger_error**2))
    assert sorted(variances[[3, 5]]) == pytest.approx([1e-6, 9e-6])
    assert variances[5] == pytest.approx(COVARIANCE[5, 5]), "z stays z, for the tool points down"


def test_contact_with_the_support_is_allowed_while_lifting_and_placing_only() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    allowed: dict[Phase, set[bool]] = {}
    while world.state.outcome is TaskOutcome.RUNNING:
        state = world.tick()
        if state.hand.held == 0:
            allowed.setdefault(state.phase, set()).add(state.hand.on_support)
    assert allowed == {Phase.LIFT: {True}, Phase.CARRY: {False}, Phase.LOWER: {True}} or allowed == {
        Phase.LIFT: {True, False}, Phase.CARRY: {False}, Phase.LOWER: {True},
    }  # fmt: skip
    slow = SmallWorld((step("pick"),))
    slow.until(Phase.LIFT)
    slow.frozen = True
    for height, on_support in ((0.9 * TUNING.clear, True), (1.1 * TUNING.clear, False)):
        slow.X_WT = slow.state.grasp + np.array([0, 0, 0, 0, 0, 0, height])
        assert slow.tick().hand.on_support == on_support


def test_fingers_that_close_on_nothing_try_again_and_give_up() -> None:
    world = SmallWorld((step("pick"),), sticks=False)
    state = world.run()
    assert (state.outcome, state.why) == (TaskOutcome.FAILED, Why.MISSED)
    assert [note for _, note, _ in notes(state)] == [Note.STARTED, Note.TRIED_AGAIN, Note.FAILED]
    assert world.phases.count(Phase.CLOSE) == 2
    assert not state.goal.any() and state.hand.held == NOTHING
    more = SmallWorld((step("pick", tries=3),), sticks=False)
    more.until(Phase.CLOSE)
    more.until(Phase.LOOK)
    more.sticks = True
    assert more.run().outcome is TaskOutcome.DONE


def test_an_object_that_slips_away_fails_the_step() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.CARRY)
    world.sticks = False
    world.frozen = True
    state = world.run()
    assert (state.outcome, state.why, state.step) == (TaskOutcome.FAILED, Why.DROPPED, 1)
    assert not state.goal.any() and state.hand.held == NOTHING


def test_an_object_that_is_seen_elsewhere_is_not_in_the_hand() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.CARRY)
    world.frozen = True
    world.seen_at = world.X_WO + np.array([0, 0, 0, 0, 0.9 * TUNING.elsewhere, 0, 0])
    for _ in range(2 * TUNING.images):
        assert world.tick().outcome is TaskOutcome.RUNNING
    world.seen_at = world.X_WO + np.array([0, 0, 0, 0, 1.2 * TUNING.elsewhere, 0, 0])
    for _ in range(TUNING.images - 1):
        assert world.tick().outcome is TaskOutcome.RUNNING, "one odd image is no loss"
    state = world.tick()
    assert (state.outcome, state.why) == (TaskOutcome.FAILED, Why.SEEN_ELSEWHERE)
    assert state.hand.held == NOTHING


@pytest.mark.parametrize("bearing", [0.0, np.pi / 2])
def test_what_nobody_knows_counts_where_a_grasp_is_chosen_and_how_high_it_is_lifted(bearing: float) -> None:
    """Fingers come down where it does not stand, and a part of the object itself is in nobody's way."""
    beside = BOX * [1.0, 0.6, 2.0] + [0.5 + 0.07 * np.cos(bearing), 0.1 + 0.07 * np.sin(bearing), 0.1]
    chosen: dict[str, float] = {}
    for name, unknown in (("alone", ()), ("beside", (beside,)), ("part", (BOX + [0.5, 0.1, 0.055],))):
        world = SmallWorld((step("pick"),), unknown=unknown)
        state = world.until(Phase.LIFT)
        closing = rotations.matrix(state.grasp[:4])[:2, 1]
        chosen[name] = abs(float(closing @ [np.cos(bearing), np.sin(bearing)]))
        rise = 0.2 + TUNING.over if name == "beside" else TUNING.raised
        assert state.goal[6] - state.grasp[6] == pytest.approx(rise)
    assert chosen["beside"] < 0.5
    assert chosen["part"] == chosen["alone"]


@pytest.mark.parametrize(("gap", "rise"), [(0.001, 0.15), (0.5 * TUNING.beside, 0.15), (2.0 * TUNING.beside, 0.0)])
def test_what_stands_against_another_is_lifted_over_it(gap: float, rise: float) -> None:
    reach = float(np.linalg.norm(BOX[:, :2], axis=1).max())
    tall = BOX * np.array([1.0, 1.0, 0.5 * rise / np.abs(BOX[:, 2]).max() if rise else 1.0])
    world = SmallWorld(PICK_AND_PLACE, library=(Takeable((BOX,), False), Takeable((tall,), False)))
    low = float(world.X_WO[6] + BOX[:, 2].min())
    world.others = (pose(world.X_WO[4], world.X_WO[5] + 2.0 * reach + gap, low - float(tall[:, 2].min())),)
    state = world.until(Phase.LIFT)
    wanted = rise + TUNING.over if rise else TUNING.raised
    assert state.goal[6] - state.grasp[6] == pytest.approx(wanted)
    assert world.run().outcome is TaskOutcome.DONE


@pytest.mark.parametrize(("fallen", "outcome"), [(0.02, TaskOutcome.DONE), (0.1, TaskOutcome.FAILED)])
def test_what_falls_once_it_was_let_go_is_not_said_to_stand_there(fallen: float, outcome: TaskOutcome) -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.OPEN)
    world.tick()
    world.X_WO = world.X_WO + np.array([0, 0, 0, 0, 0, 0, -fallen])
    state = world.run()
    assert state.outcome is outcome
    assert state.why is (Why.NONE if outcome is TaskOutcome.DONE else Why.NOT_WHERE_PUT)
    assert state.hand.held == state.hand.touched == NOTHING, "an obstacle again, wherever it lies"


@pytest.mark.parametrize(("off", "turn", "told"), [(0.003, 0.0, 0), (0.012, 0.0, 1), (0.004, 0.3, 1)])
def test_what_slips_in_the_hand_is_told_once_and_put_where_it_belongs(off: float, turn: float, told: int) -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.CARRY)
    world.frozen = True
    for _ in range(10):
        world.tick()
    closing = rotations.matrix(world.X_WT[:4])[:, 1]
    swing = np.array([*rotations.multiply(rotations.exp(turn * closing), world.X_WO[:4]), *world.X_WO[4:]])
    world.X_WO = swing + np.array([0, 0, 0, 0, 0, 0, -off])
    for _ in range(20):
        state = world.tick()
    assert errors(compose(world.X_WT, state.hand.X_TO), world.X_WO)[0] < TUNING.told_step + 1e-4, "planners are told"
    world.frozen = False
    state = world.run()
    assert state.outcome is TaskOutcome.DONE
    missed, angle = errors(world.X_WO, PLACE)
    assert missed < TUNING.drop + TUNING.drop_doubt + 1e-3 and angle < 0.02
    np.testing.assert_allclose(world.X_WO[4:6], PLACE[4:6], atol=0.002)
    assert [note for _, note, _ in notes(state)].count(Note.SLIPPED) == told
    if told:
        row = next(row for row in state.notes.reshape(-1, NOTE_FIELDS) if int(row[2]) == Note.SLIPPED)
        assert row[4] == pytest.approx(turn, abs=0.02) and row[5] == pytest.approx(off, abs=0.002)


def test_what_is_seen_where_the_fingers_are_not_is_no_slip() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.CARRY)
    world.frozen = True
    before = world.tick().hand.X_TO
    world.seen_at = world.X_WO + np.array([0, 0, 0, 0, 0.02 + 1.5 * TUNING.grip, 0, 0])
    for _ in range(20):
        state = world.tick()
    np.testing.assert_array_equal(state.hand.X_TO, before)


def test_an_image_of_a_hand_that_moves_is_of_where_it_was() -> None:
    for speed, outcome in ((0.5, TaskOutcome.RUNNING), (0.1, TaskOutcome.FAILED)):
        world = SmallWorld(PICK_AND_PLACE, late=0.1)
        world.until(Phase.CARRY)
        world.frozen, world.speed = True, speed
        world.seen_at = world.X_WO + np.array([0, 0, 0, 0, TUNING.elsewhere + 0.03, 0, 0])
        for _ in range(2 * TUNING.images):
            world.tick()
        assert world.state.outcome is outcome


def test_a_step_that_fails_with_something_in_the_hand_keeps_it() -> None:
    world = SmallWorld((step("pick"), step("reach", GOAL, time_limit=1.0)))
    world.until(Phase.MOVE)
    world.frozen = True
    world.X_WT = world.X_WT + np.array([0, 0, 0, 0, 0, 0, 0.3])
    assert world.in_hand is not None
    world.X_WO = compose(world.X_WT, world.in_hand)
    state = world.run()
    assert (state.outcome, state.why) == (TaskOutcome.FAILED, Why.TIME_LIMIT)
    assert state.hand.held == 0 and state.opened == 0.0


def test_what_is_too_wide_is_said_to_be() -> None:
    world = SmallWorld((step("pick"),), library=(Takeable((2.0 * BOX,), False),))
    state = world.run()
    assert (state.outcome, state.why) == (TaskOutcome.FAILED, Why.TOO_WIDE)


def test_a_grasp_to_which_no_way_leads_is_left_for_another_without_being_a_try() -> None:
    world = SmallWorld((step("pick", tries=1),), frozen=True)
    first = world.until(Phase.APPROACH).grasp
    while notes(world.state)[-1][1] is not Note.OTHER_GRASP:
        world.tick()
        assert world.now < TUNING.no_way + 1.0
    other = world.state
    assert (other.phase, other.attempt) == (Phase.APPROACH, 0) and notes(other)[-1][2] is Why.NO_WAY
    off, angle = errors(first, other.grasp)
    assert off > 0.03 or angle > 0.4
    world.frozen = False
    state = world.run()
    assert state.outcome is TaskOutcome.DONE
    assert errors(state.grasp, other.grasp)[1] < 1e-6, "it is the other that was taken"


def test_the_last_try_goes_for_another_grasp_where_the_way_down_is_barred() -> None:
    world = SmallWorld((step("pick", tries=1),))
    first = world.until(Phase.DESCEND).grasp
    world.X_WT = world.X_WT + np.array([0.0, 0, 0, 0, 0.0, 0.0, 2 * TUNING.astray])
    state = world.tick()
    assert state.phase is Phase.APPROACH and state.hand.touched == NOTHING
    assert notes(state)[-1] == (0, Note.OTHER_GRASP, Why.NO_WAY_DOWN)
    assert not np.array_equal(state.grasp, first)
    assert world.run().outcome is TaskOutcome.DONE


@pytest.mark.parametrize("tries", [1, 2])
def test_a_hand_that_gets_stuck_on_its_way_down_goes_for_another_grasp(tries: int) -> None:
    """It rests 3 cm short of it, as before what it may not touch: that is no try, nothing was closed on."""
    world = SmallWorld((step("pick", tries=tries),))
    first = world.until(Phase.DESCEND).grasp
    world.frozen, world.X_WT = True, world.state.goal + np.array([0.0, 0, 0, 0, 0.0, 0.0, 0.03])
    begun = world.now
    state = world.until(Phase.APPROACH)
    assert world.now - begun == pytest.approx(TUNING.no_way_down, abs=3 * TICK)
    assert state.hand.touched == NOTHING and state.attempt == 0
    assert notes(state)[-1] == (0, Note.OTHER_GRASP, Why.NO_WAY_DOWN)
    assert not np.array_equal(state.grasp, first)
    world.frozen = False
    assert world.run().outcome is TaskOutcome.DONE


def test_a_hand_that_creeps_down_is_waited_for() -> None:
    world = SmallWorld((step("pick", tries=1),), speed=1.5 * TUNING.still)
    world.until(Phase.APPROACH)
    world.until(Phase.DESCEND)
    world.frozen, world.X_WT = True, world.state.goal + np.array([0.0, 0, 0, 0, 0.0, 0.0, 0.03])
    begun = world.now
    while world.now < begun + 2.0 * TUNING.no_way_down:
        assert world.tick().phase is Phase.DESCEND


def test_a_grasp_out_of_reach_is_left_for_another_too_and_one_that_was_told_never() -> None:
    world = SmallWorld((step("pick", tries=1),), frozen=True, reach=0.0)
    world.until(Phase.APPROACH)
    while world.state.others == 0:
        world.tick()
    assert notes(world.state)[-1][1:] == (Note.OTHER_GRASP, Why.OUT_OF_REACH)
    state = world.run()
    assert (state.outcome, state.why) == (TaskOutcome.FAILED, Why.OUT_OF_REACH), "in the end it is given up"
    told = SmallWorld((step("pick", pose(0.0, 0.0, 0.02, DOWN), tries=1, time_limit=4.0),), frozen=True)
    assert told.run().why is Why.TIME_LIMIT and told.state.others == 0


def test_what_can_be_taken_in_no_way_any_more_is_given_up_in_the_end() -> None:
    world = SmallWorld((step("pick", tries=1, time_limit=4.0),), frozen=True)
    world.until(Phase.APPROACH)
    world.library = (Takeable((2.0 * BOX,), False),)  # as if it had been turned on its wide side
    state = world.run()
    assert (state.outcome, state.why, state.others) == (TaskOutcome.FAILED, Why.TIME_LIMIT, 0)


@pytest.mark.parametrize("status", [ObjectStatus.UNSEEN, ObjectStatus.MOVING, ObjectStatus.STALE, ObjectStatus.GONE])
def test_nothing_is_taken_that_does_not_lie_still_in_sight(status: ObjectStatus) -> None:
    world = SmallWorld((step("pick", time_limit=2.0),), status=status)
    state = world.run()
    assert world.phases == [Phase.LOOK, Phase.REST]
    assert state.why is (Why.NOT_SEEN if status == ObjectStatus.UNSEEN else Why.TARGET_LOST)


def test_an_object_that_goes_away_during_the_approach_is_looked_for_again() -> None:
    world = SmallWorld((step("pick"),))
    world.until(Phase.APPROACH)
    world.status = ObjectStatus.LOST
    state = world.until(Phase.LOOK)
    assert notes(state)[-1] == (0, Note.TRIED_AGAIN, Why.TARGET_LOST)
    world.status = ObjectStatus.TRACKED
    assert world.run().outcome is TaskOutcome.DONE


def test_a_round_object_is_put_down_without_turning_the_hand() -> None:
    for symmetric, angle in ((True, 0.0), (False, 1.0)):
        goal = compose(PLACE, np.array([np.cos(0.5), 0, 0, np.sin(0.5), 0, 0, 0]))
        world = SmallWorld((step("pick"), step("place", goal)), library=(Takeable((BOX,), symmetric),))
        world.until(Phase.LIFT)
        before = world.X_WT
        after = world.until(Phase.LOWER).goal
        assert errors(before, after)[1] == pytest.approx(angle, abs=1e-6)


# State.


def test_the_state_is_a_vector_and_back() -> None:
    world = SmallWorld(PICK_AND_PLACE)
    world.until(Phase.CARRY)
    world.state = replace(world.state, why=Why.MISSED, attempt=1, elsewhere=2, image=3.0, steady=4.0)
    again = TaskState.unpack(world.state.pack())
    for name, value in vars(world.state).items():
        other = getattr(again, name)
        if name in ("hand", "lies", "after"):
            np.testing.assert_array_equal(other.pack(), value.pack())
        else:
            np.testing.assert_array_equal(other, value)
    packed, state = world.state.pack(), world.state
    said = {"goal": state.goal, "gripper_force_limit": [state.force], "step": [state.step], "notes": state.notes}
    for port, value in (said | {"hand": state.hand.pack()}).items():
        np.testing.assert_array_equal(packed[TOLD[port]], value)
    assert packed[OPENED] == state.opened
    assert packed[list(OUTCOME)].tolist() == [state.outcome, state.why, state.phase]
