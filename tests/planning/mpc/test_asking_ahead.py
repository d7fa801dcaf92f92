"""Ways on from a goal: when they are asked for, and what becomes of them once the goal is the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import load_scene
from twin_diagram.planning.mpc.asking_ahead import going_on, question_ahead
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.paths.guide import Answer, Question
from twin_diagram.planning.paths.route import Aim, Route
from twin_diagram.planning.paths.searching import Searcher
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
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
def asked() -> Asked:
    planner = MotionPlanner(load_scene(scenario.ArmModel(), [], {}), np.full(7, 2.0), scenario.Planner())
    searcher = Asked(planner)
    planner.searcher = searcher
    return searcher


def ticks(asked: Asked, memory: Memory, goal: Array, after: Array | None, count: int, start: int = 0) -> Memory:
    """So many ticks of an arm that follows at once."""
    planner, rate = asked.planner, asked.planner.params.rate
    for tick in range(start, start + count):
        q = memory.trajectory.position(tick / rate)
        state = np.concatenate([q, np.zeros(7)])
        memory, _ = planner.tick(memory, tick / rate, state, np.zeros(0), goal, after=after)
    return memory


def test_a_way_on_is_asked_for_once_and_gone_when_its_goal_comes(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = ticks(asked, asked.planner.initial(HOME), HERE, THERE, 12)
    assert len(asked.questions) == 1 and memory.pending is None
    np.testing.assert_array_equal(asked.questions[0].goal, THERE)
    np.testing.assert_array_equal(asked.questions[0].q, memory.route.points[-1])
    assert len(memory.beyond) == 2 and memory.heard is False, "it says nothing of the goal that there is"
    found = memory.beyond
    router = asked.planner.router  # nothing is in the way: the corner would be left out at once
    monkeypatch.setattr(router, "_shortcut", lambda route, *_: route)
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


def test_what_is_held_has_left_its_support_by_then(asked: Asked) -> None:
    memory = ticks(asked, asked.planner.initial(HOME), HERE, None, 2)
    hand = Hand(0, on_support=True).pack().tobytes()
    question = Question((0,), HOME, HERE, memory.goals, False, np.zeros(0), hand=hand)
    found = question_ahead(asked.planner.guide, memory, question, THERE)
    assert found is not None and not Hand.unpack(np.frombuffer(found.hand)).on_support
    empty = question_ahead(asked.planner.guide, memory, replace(question, hand=b""), THERE)
    assert empty is not None and empty.hand == b""
