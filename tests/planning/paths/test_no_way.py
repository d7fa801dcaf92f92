"""Why no way leads to a goal: of arrays, of a small world where something passes, and of a planner in its Context."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests import planning_bench as bench
from tests.planning.paths.test_route import Wall, situation, world
from twin_diagram import scenario
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.collision_scene import holders
from twin_diagram.planning.mpc_system import Mpc
from twin_diagram.planning.paths.no_way import Hindrance, HindranceKind, distances_at_ends, why_no_way
from twin_diagram.planning.paths.situation import Aim, Route
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, THING_SIZE, Thing

GOAL = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.25, 0.16])


# Of arrays.


def test_without_joint_goals_it_is_out_of_reach() -> None:
    assert why_no_way(np.zeros((0, 4)), np.zeros((0, 4))) == Hindrance(HindranceKind.OUT_OF_REACH)


def test_the_goal_that_lacks_least_tells_what_is_in_the_way() -> None:
    wanted = np.tile([0.01, 0.06, 0.01, 0.01], (3, 1))
    at = np.array([[0.5, 0.02, 0.5, 0.5], [0.009, 0.5, 0.008, 0.5], [0.5, 0.5, 0.5, -0.02]])
    assert why_no_way(at, wanted) == Hindrance(HindranceKind.BLOCKED, 2, 0.008, 0.01)
    assert why_no_way(at[[0, 2]], wanted[:2]) == Hindrance(HindranceKind.ITSELF, 3, -0.02, 0.01)
    assert why_no_way(at[:1], wanted[:1]) == Hindrance(HindranceKind.BLOCKED, 1, 0.02, 0.06)


def test_a_free_goal_leaves_the_way_between() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        wanted = rng.uniform(0.0, 0.05, (4, 5))
        at = wanted + rng.uniform(-0.05, 0.05, (4, 5))
        free = (at >= wanted).all(axis=1).any()
        assert (why_no_way(at, wanted).reason is HindranceKind.NOT_FOUND) == free


@pytest.mark.parametrize(
    ("why", "words"),
    [
        (Hindrance(HindranceKind.OUT_OF_REACH), "no joint positions found that reach it"),
        (Hindrance(HindranceKind.NOT_FOUND), "the arm would be free at the goal, but no way there was found"),
        (
            Hindrance(HindranceKind.BLOCKED, 3, 0.00902, 0.01, "cracker_box"),
            "at the goal the arm would come within 9 mm of cracker_box and keeps 10 mm",
        ),
        (
            Hindrance(HindranceKind.BLOCKED, 3, 0.00998, 0.01, "can#2", holding=True),
            "at the goal the arm with what it holds would come within 9 mm of can#2 and keeps 10 mm",
        ),
        (
            Hindrance(HindranceKind.BLOCKED, 3, -0.0121, 0.01, "unknown#1"),
            "at the goal the arm would reach 12 mm into unknown#1 and keeps 10 mm",
        ),
        (
            Hindrance(HindranceKind.ITSELF, 9, 0.004, 0.01),
            "at the goal the arm would come within 4 mm of itself and keeps 10 mm",
        ),
    ],
)
def test_it_is_told_in_a_sentence(why: Hindrance, words: str) -> None:
    assert why.sentence() == words


# Of what passes.


def test_what_passes_counts_when_the_arm_would_be_there() -> None:
    goal = [2.0, 0.0]  # two seconds away
    for during, near in (((0.0, 1.0), 1e3), ((1.9, 2.5), -0.1)):
        router, _ = world(Wall(where=2.0, during=during))
        at = distances_at_ends(router, situation([0.0, 0.0], [goal], moving=True))
        assert at[0] == pytest.approx([1.0, near, 1.0])
    router, _ = world(Wall(where=2.0, during=(0.0, 9.0)))
    still = situation([0.0, 0.0], [goal])
    np.testing.assert_array_equal(distances_at_ends(router, still), still.at_goals)


# Of a planner.


def standing(p: Array) -> Array:
    pose = np.array([1.0, 0, 0, 0, *p])
    return Track(ObjectStatus.TRACKED, 0.0, pose, np.zeros(6), 1e-12 * np.eye(6)).pack()


@pytest.fixture(scope="module")
def mpc() -> Mpc:
    library = bench.load()[1]
    twin = scenario.Twin(home=bench.HOME.tolist(), library={name: "" for name in library})
    twin.task.start = 0.0
    return Mpc(Model.load(twin.arm), twin, library)


def asked(mpc: Mpc, tracks: Array, further: Array | None = None, things: Array | None = None) -> Hindrance | None:
    """What it says where it knows of joint goals, and of no way to any."""
    context = mpc.CreateDefaultContext()
    values = {"arm_state": np.concatenate([bench.HOME, np.zeros(7)]), "tracks": tracks, "goal": GOAL}
    for name, value in {**values, "parameters": np.zeros(4)}.items():
        mpc.GetInputPort(name).FixValue(context, value)
    if further is not None:
        port = mpc.GetInputPort("further_tracks")
        port.FixValue(context, np.concatenate([further, np.zeros(port.size() - len(further))]))
    if things is not None:
        port = mpc.GetInputPort("things")
        port.FixValue(context, np.concatenate([things, np.zeros(port.size() - len(things))]))
    guide = mpc.planner.guide
    nothing = mpc.planner.scene.forecast(np.zeros_like(tracks))
    goals = guide.joint_goals(bench.HOME, GOAL, nothing, np.random.default_rng(0))
    memory = replace(mpc.memory(context), goal=GOAL, goals=goals, heard=True, route=Route.none(7))
    vector = context.get_mutable_discrete_state(0)
    vector.SetFromVector(memory.pack())
    found = mpc.why_no_way(context, lambda row, identity, what: f"{row} {identity} {what}")
    for other in (replace(memory, heard=False), replace(memory, route=Route(Aim.GOAL, goals[:1]))):
        vector.SetFromVector(other.pack())
        assert mpc.why_no_way(context, lambda *_: "") is None, "nobody knows yet, or there is a way"
    return found


def test_a_planner_names_what_stands_at_its_goal(mpc: Mpc) -> None:
    size, count = TRACK_SIZE, len(bench.NAMES)
    beside = np.array([0.5, -0.25, 0.11])
    tracks = np.zeros((count, size))
    free = asked(mpc, tracks.ravel())
    assert free is not None and free.reason is HindranceKind.NOT_FOUND

    tracks[1] = standing(beside)
    why = asked(mpc, tracks.ravel())
    assert why is not None and (why.reason, why.name) == (HindranceKind.BLOCKED, "1 0 1")
    assert why.near < why.kept == pytest.approx(0.25 * scenario.Planner().clearance)

    further = np.zeros((2, FURTHER_TRACK_SIZE))
    further[1] = [4.0, 3.0, *standing(beside)]
    why = asked(mpc, np.zeros(count * size), further.ravel())
    assert why is not None and why.name == f"{count} 4 3"

    corners = beside + np.array([[x, y, z] for x in (-0.04, 0.04) for y in (-0.04, 0.04) for z in (-0.1, 0.1)])
    thing = Thing(7, ObjectStatus.TRACKED, 0.0, 0.0, beside, (corners,))
    why = asked(mpc, np.zeros(count * size), further[0], np.concatenate([np.zeros(THING_SIZE), thing.pack()]))
    assert why is not None and why.name == f"{count} 7 -1"


def test_bodies_and_their_holders_go_together(mpc: Mpc) -> None:
    count = len(bench.NAMES)
    further = np.zeros((3, FURTHER_TRACK_SIZE))
    further[0], further[2] = [2.0, 1.0, *standing(GOAL[4:])], [5.0, 0.0, *standing(GOAL[4:])]
    corners = np.eye(3)[[0, 1, 2, 0]] * 0.1 + [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0.1]]
    things = [Thing(3, ObjectStatus.TRACKED, 0, 0, np.zeros(3), (corners,)), Thing(4), Thing()]
    packed = np.concatenate([thing.pack() for thing in things])
    scene = mpc.planner.scene
    for one, other in ((further.ravel(), packed), (None, packed), (further.ravel(), None), (None, np.full(9, np.nan))):
        bodies = scene.forecast(np.zeros(count * TRACK_SIZE), one, other)
        assert len(bodies.present) == len(holders(scene.object_count, one, other))
    whose = holders(count, further.ravel(), packed)
    assert whose[count:] == [(count, 2, 1), (count, 5, 0), (count, 3, -1)]
