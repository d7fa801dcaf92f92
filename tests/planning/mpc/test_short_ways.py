"""Short straight moves of the tool: what bars them for a moment is waited for."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.collision_scene import load_scene
from twin_diagram.planning.mpc.planner import TUNING, MotionPlanner
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.paths.guide import Answer, Question
from twin_diagram.planning.paths.searching import Searcher
from twin_diagram.planning.paths.situation import Aim
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ObjectStatus, Track
from twin_diagram.signals.pose_vectors import moved

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
ABOVE = np.array([0.0, 1.0, 0.0, 0.0, 0.5, 0.25, 0.2])
DOWN = moved(ABOVE, np.array([0.0, 0.0, -0.08]))
BESIDE = np.array([1.0, 0.0, 0.0, 0.0, 0.5, 0.32, 0.03])
"""A can that stands here leaves the hand alone, above it and next to it; one that moves there is too near below."""
NEAR = BESIDE + np.array([0, 0, 0, 0, 0, 0.06, -0.04])
BELOW = BESIDE + np.array([0, 0, 0, 0, 0, 0, 0.03])


class Asked(Searcher):
    """Finds nothing."""

    def __init__(self) -> None:
        self.questions: list[Question] = []

    def ask(self, question: Question) -> None:
        self.questions.append(question)

    def answer(self, question: Question) -> Answer | None:
        return Answer(question.goals, np.zeros((0, 7)))


@pytest.fixture(scope="module")
def planner() -> MotionPlanner:
    can = Asset.load(models_dir() / "objects" / "can")
    scene = load_scene(scenario.ArmModel(), [], {"can": can})
    return MotionPlanner(scene, np.full(7, 2.0), scenario.Planner(rate=50.0))


@pytest.fixture
def asked(planner: MotionPlanner) -> Asked:
    searcher = Asked()
    planner.searcher = searcher
    return searcher


def seen(X_WO: Array, *, moves: bool) -> Array:
    status = ObjectStatus.MOVING if moves else ObjectStatus.TRACKED
    speed = np.array([0, 0, 0, 0.02, 0, 0]) if moves else np.zeros(6)
    return Track(status, 0.0, X_WO, speed, 1e-6 * np.eye(6)).pack()


def above(planner: MotionPlanner) -> Array:
    return planner.guide.reaching(HOME, ABOVE, np.random.default_rng(0))[0]


def ticks(planner: MotionPlanner, memory: Memory, tracks: Array, count: int) -> Memory:
    """So many ticks of an arm that follows at once and is to go down."""
    rate = planner.params.rate
    for tick in range(memory.tick, memory.tick + count):
        state = np.concatenate([memory.trajectory.position(tick / rate), np.zeros(7)])
        memory, _ = planner.tick(memory, tick / rate, state, tracks, DOWN)
    return memory


def test_a_way_is_free_or_barred_by_what_passes_or_by_what_stays(planner: MotionPlanner) -> None:
    q = above(planner)
    told = {
        name: planner.guide.line(q, DOWN, planner.scene.forecast(seen(X_WO, moves=moves)))
        for name, X_WO, moves in (("free", BESIDE, False), ("passes", BESIDE, True), ("stays", BELOW, False))
    }
    assert {name: (free, passes) for name, (_, free, passes) in told.items()} == {
        "free": (True, False),
        "passes": (False, True),
        "stays": (False, False),
    }
    for points, _, _ in told.values():
        np.testing.assert_array_equal(points, planner.guide.straight_way(q, DOWN))
    far, free, passes = planner.guide.line(q, moved(DOWN, np.array([0.3, 0, 0])), planner.scene.forecast(np.zeros(0)))
    assert not len(far) and not free and not passes


def test_a_way_that_was_waited_for_is_taken_with_room_to_spare(planner: MotionPlanner) -> None:
    """Else what flickers between moving and at rest has the hand stop half way down, and give way beside its can."""
    q, near = above(planner), planner.scene.forecast(seen(NEAR, moves=True))
    assert planner.guide.line(q, DOWN, near)[1] and not planner.guide.line(q, DOWN, near, waited=True)[1]
    still = planner.scene.forecast(seen(BESIDE, moves=False))
    assert planner.guide.line(q, DOWN, still, waited=True)[1]


def test_a_hand_waits_above_for_what_passes_and_goes_straight_down_then(planner: MotionPlanner, asked: Asked) -> None:
    """A hand above a can swung to the arm's other side since a box 7 cm off had been at rest for 0.04 s only."""
    memory = ticks(planner, planner.initial(above(planner)), seen(BESIDE, moves=True), 5)
    assert memory.route.aim is Aim.NOTHING and len(memory.goals) == 1 and not asked.questions
    assert np.abs(memory.trajectory.knots - above(planner)).max() < 0.3, "it gives way a little"
    memory = ticks(planner, memory, seen(BESIDE, moves=False), 4)
    assert memory.route.aim is Aim.LINE and not asked.questions


def test_after_a_while_another_way_is_sought(planner: MotionPlanner, asked: Asked) -> None:
    waits = TUNING.patience + planner.params.route_after
    count = round(waits * planner.params.rate)
    memory = ticks(planner, planner.initial(above(planner)), seen(BESIDE, moves=True), count - 2)
    assert not asked.questions
    ticks(planner, memory, seen(BESIDE, moves=True), 6)
    assert len(asked.questions) == 1 and asked.questions[0].more_goals


def test_what_stays_in_the_way_is_not_waited_for(planner: MotionPlanner, asked: Asked) -> None:
    memory = ticks(planner, planner.initial(above(planner)), seen(BELOW, moves=False), 1)
    assert len(memory.goals) > 1 and (memory.route.aim is not Aim.NOTHING or len(asked.questions) == 1)
