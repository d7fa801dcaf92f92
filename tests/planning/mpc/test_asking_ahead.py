"""Ways on from a goal: when they are asked for, and what becomes of them once the goal is the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.collision_scene import Forecast, load_scene
from twin_diagram.planning.mpc.asking_ahead import NOWHERE, Onward, answered, going_on, question_ahead, revised
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.paths.guide import Answer, Question
from twin_diagram.planning.paths.searching import Searcher
from twin_diagram.planning.paths.situation import Aim, Route
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.layouts import ObjectStatus, Track
from twin_diagram.signals.pose_vectors import moved

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
HERE = np.array([0.0, 1.0, 0.0, 0.0, 0.5, 0.25, 0.3])
THERE = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.25, 0.3])
TURNED = moved(np.array([0.0, np.cos(0.05), np.sin(0.05), 0.0, *THERE[4:]]), np.array([0.004, 0.0, 0.0]))
"""Nearly the same: told anew as it lies in the hand."""


class Asked(Searcher):
    """Answers with a way by a corner that nobody would go by otherwise."""

    def __init__(self, planner: MotionPlanner) -> None:
        self.planner = planner
        self.questions: list[Question] = []

    def ask(self, question: Question) -> None:
        self.questions.append(question)

    def answer(self, question: Question) -> Answer | None:
        end = self.planner.guide.reaching(question.q, question.goal, np.random.default_rng(0))[:1]
        corner = 0.5 * (question.q + end) + [0.0, -0.3, 0, 0, 0, 0, 0]
        return Answer(end, np.vstack([corner, end]))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """With nothing in the way, of which the corner would be left out at once."""
    planner = MotionPlanner(load_scene(scenario.ArmModel(), [], {}), np.full(7, 2.0), scenario.Planner())
    searcher = Asked(planner)
    planner.searcher = searcher
    monkeypatch.setattr(planner.router, "shortcut", lambda route, *_: route)
    return searcher


def ticks(asked: Asked, memory: Memory, goal: Array, after: Array | None, count: int, start: int = 0) -> Memory:
    """So many ticks of an arm that follows at once."""
    planner, rate = asked.planner, asked.planner.params.rate
    for tick in range(start, start + count):
        q = memory.trajectory.position(tick / rate)
        state = np.concatenate([q, np.zeros(7)])
        memory, _ = planner.tick(
            memory, tick / rate, state, np.zeros(0), goal, after=NOWHERE if after is None else Onward(after)
        )
    return memory


def test_a_way_on_is_asked_for_once_and_gone_when_its_goal_comes(asked: Asked) -> None:
    memory = ticks(asked, asked.planner.initial(HOME), HERE, THERE, 12)
    assert len(asked.questions) == 1 and memory.pending is None
    np.testing.assert_array_equal(asked.questions[0].goal, THERE)
    np.testing.assert_array_equal(asked.questions[0].q, memory.route.points[-1])
    assert len(memory.beyond) == 2 and memory.heard is False, "it says nothing of the goal that there is"
    found = memory.beyond
    memory = ticks(asked, memory, TURNED, None, 1, start=12)
    assert memory.route.aim is Aim.GOAL and len(asked.questions) == 1, "nobody waits for a search"
    np.testing.assert_array_equal(memory.route.points[0], found[0])
    chain = asked.planner.scene.chain
    X_WT = chain.tool(chain.place(memory.route.points[-1:]))[0]
    np.testing.assert_allclose(X_WT[:3, 3], TURNED[4:], atol=1e-4)
    assert not memory.next_goal.any() and not len(memory.beyond)


def test_an_arm_is_foreseen_to_rest_at_its_goal_and_go_on_the_way_that_was_found(asked: Asked) -> None:
    guide, params = asked.planner.guide, asked.planner.params
    memory = ticks(asked, asked.planner.initial(HOME), HERE, THERE, 12)
    now = 12 / params.rate
    assert len(memory.beyond) == 2 and Memory.way_on_in(memory.pack(), 7, params.knots)
    q, v, _ = (part[0] for part in memory.trajectory.at(np.array([now])))
    rests = guide.router.travel(q - memory.offset, memory.route, v).duration
    assert going_on(guide, memory, now, rests) is None, "the plan knows better"
    begun = going_on(guide, memory, now, rests + 0.01)
    there = going_on(guide, memory, now, rests + 30.0)
    assert begun is not None and there is not None
    np.testing.assert_allclose(begun, memory.route.points[-1], atol=1e-2)
    np.testing.assert_array_equal(there, memory.beyond[-1])
    nowhere = replace(memory, beyond=memory.beyond[:0])
    assert going_on(guide, nowhere, now, 30.0) is None and not Memory.way_on_in(nowhere.pack(), 7, params.knots)
    assert going_on(guide, replace(memory, route=Route.none(7)), now, 30.0) is None


def test_another_goal_than_the_one_foretold_is_gone_to_as_ever(asked: Asked) -> None:
    memory = ticks(asked, asked.planner.initial(HOME), HERE, THERE, 12)
    memory = ticks(asked, memory, moved(THERE, np.array([0.0, 0.1, 0.0])), None, 1, start=12)
    assert memory.route.aim is Aim.GOAL and len(memory.route.points) == 1


def test_what_is_straight_ahead_is_not_asked_for_and_a_new_one_is(asked: Asked) -> None:
    memory = ticks(asked, asked.planner.initial(HOME), HERE, moved(HERE, np.array([0.0, 0.0, -0.08])), 6)
    assert not asked.questions and memory.next_goal.any()
    ticks(asked, memory, HERE, THERE, 6, start=6)
    assert len(asked.questions) == 1


def test_a_way_on_that_is_blocked_meanwhile_is_forgotten_and_asked_for_anew(
    asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = ticks(asked, asked.planner.initial(HOME), HERE, THERE, 12)
    assert len(memory.beyond) == 2
    monkeypatch.setattr(asked.planner.router, "follows", lambda points, now: False)
    memory = ticks(asked, memory, HERE, THERE, 1, start=12)
    assert not len(memory.beyond) and not memory.next_goal.any()
    ticks(asked, memory, HERE, THERE, 1, start=13)
    assert len(asked.questions) == 2


def test_what_will_be_held_on_the_way_is_told_to_who_searches(asked: Asked) -> None:
    memory = ticks(asked, asked.planner.initial(HOME), HERE, None, 2)
    hand = Hand(0, on_support=True).pack().tobytes()
    question = Question((0,), HOME, HERE, memory.goals, False, np.zeros(0), hand=hand)
    found = question_ahead(asked.planner.guide, memory, question, THERE)
    assert found is not None and found.hand == hand
    state = np.concatenate([memory.trajectory.position(0.04), np.zeros(7)])
    asked.planner.tick(memory, 0.04, state, np.zeros(0), HERE, after=Onward(THERE, hand))
    assert [question.hand for question in asked.questions] == [hand], "while the hand is still empty"


def test_the_way_on_is_kept_while_what_was_closed_on_is_lifted(asked: Asked) -> None:
    """It was sought before the fingers closed: the preview does not lose it until one from there is found."""
    memory = ticks(asked, asked.planner.initial(HOME), HERE, THERE, 12)
    found, up = memory.beyond, moved(HERE, np.array([0.0, 0.0, 0.07]))
    assert len(found) == 2
    lifted = ticks(asked, memory, up, THERE, 2, start=12)
    np.testing.assert_array_equal(lifted.beyond, found)
    assert len(asked.questions) == 2 and lifted.route.aim is Aim.LINE
    np.testing.assert_array_equal(asked.questions[1].q, lifted.route.points[-1])
    later = ticks(asked, lifted, up, THERE, 6, start=14)
    assert len(later.beyond) == 2 and np.abs(later.beyond[0] - found[0]).max() > 0.01, "one from there is found"
    nothing = answered(lifted, found[:0])
    np.testing.assert_array_equal(nothing.beyond, found)
    elsewhere = ticks(asked, memory, up, moved(THERE, np.array([0.0, 0.1, 0.0])), 1, start=12)
    assert not len(elsewhere.beyond), "it leads somewhere else"
    assert not len(ticks(asked, memory, up, None, 1, start=12).beyond)
    unanswered = replace(memory, beyond=found[:0])
    ticks(asked, unanswered, up, THERE, 2, start=12)
    assert len(asked.questions) > 3, "what was not answered is asked for anew"


def test_before_an_arm_has_a_goal_the_way_to_the_first_is_sought(asked: Asked) -> None:
    nowhere = np.zeros(7)
    memory = ticks(asked, asked.planner.initial(HOME), nowhere, THERE, 12)
    assert len(asked.questions) == 1 and len(memory.beyond) == 2
    guide, now = asked.planner.guide, 12 / asked.planner.params.rate
    assert going_on(guide, memory, now, 1.0, pause=1.0) is None, "it has not set off by then"
    begun, there = (going_on(guide, memory, now, ahead, pause=1.0) for ahead in (1.01, 30.0))
    assert begun is not None and there is not None
    np.testing.assert_allclose(begun, HOME, atol=1e-2)
    np.testing.assert_array_equal(there, memory.beyond[-1])
    memory = ticks(asked, memory, THERE, None, 1, start=12)
    assert memory.route.aim is Aim.GOAL and len(asked.questions) == 1, "nobody waits for a search"


def test_a_way_on_is_kept_as_it_will_be_gone() -> None:
    """A search goes by corners that nobody goes by in the end: a preview followed them, half a metre off."""
    asked = Asked(MotionPlanner(load_scene(scenario.ArmModel(), [], {}), np.full(7, 2.0), scenario.Planner()))
    asked.planner.searcher = asked
    memory = ticks(asked, asked.planner.initial(HOME), HERE, THERE, 12)
    assert len(asked.questions) == 1 and len(memory.beyond) == 1
    end = asked.answer(asked.questions[0])
    assert end is not None
    np.testing.assert_array_equal(memory.beyond[0], end.points[-1])


def test_what_is_taken_off_its_support_is_lifted_first_and_then_goes_the_shortest_way() -> None:
    can = Asset.load(models_dir() / "objects" / "can")
    scene = load_scene(scenario.ArmModel(), [], {"can": can})
    planner = MotionPlanner(scene, np.full(7, 2.0), scenario.Planner(), pieces_O=[tuple(can.convex_pieces)])
    gone = Track(ObjectStatus.GONE, 0.0, np.array([1.0, 0, 0, 0, 0, 0, 0]), np.zeros(6), np.eye(6)).pack()
    here, there = (planner.guide.reaching(HOME, X, np.random.default_rng(0))[0] for X in (HERE, THERE))
    up = planner.router.lifted(here, 0.06)
    memory = replace(planner.initial(here), route=Route(Aim.GOAL, here[None]), next_goal=THERE)
    memory = replace(memory, beyond=np.stack([up, 0.5 * (up + there) + 0.1, there]))
    forecast = planner.scene.forecast(gone)
    for hand, left in ((Hand(0, on_support=True), np.stack([up, there])), (Hand(0), there[None])):
        found = revised(planner.empty, memory, forecast, hand.pack().tobytes())
        np.testing.assert_array_equal(found.beyond, left)


def test_what_moves_is_where_it_will_be_when_the_arm_sets_off(asked: Asked) -> None:
    """A box that will have come into the way was not there yet when the way was sought, a second before."""
    memory = ticks(asked, asked.planner.initial(HOME), HERE, None, 2)
    state = np.concatenate([memory.trajectory.position(0.04), np.zeros(7)])
    asked.planner.tick(memory, 0.04, state, np.zeros(0), HERE, after=Onward(THERE, pause=0.8))
    (question,) = asked.questions
    rests = asked.planner.router.travel(question.q, memory.route).duration
    lasts = asked.planner.router.travel(HOME, memory.route).duration
    assert rests == 0.0 and question.later == pytest.approx(0.8 + lasts, abs=0.2)
    moves = Track(
        ObjectStatus.MOVING, 0.0, np.array([1.0, 0, 0, 0, 0, 0, 0]), np.array([0, 0, 0, 0.1, 0, 0]), np.eye(6)
    )
    now = Forecast.of_tracks(moves.pack())
    then, there = replace(now, later=0.5).at(np.array([0.0, 0.3]))[0], now.at(np.array([0.5, 0.8]))[0]
    np.testing.assert_array_equal(then, there)
    assert then[0, 0, 0, 3] == pytest.approx(0.05, abs=1e-3)
