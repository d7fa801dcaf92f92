"""Goals that cannot be, then ones that can; starts in contact: what the planner does, tick by tick."""

from __future__ import annotations

import numpy as np
import pytest

from tests import planning_bench as bench
from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import Forecast, Scene
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.signals.pose_vectors import compose, from_matrix, inverse

GOAL = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.1, 0.25])
BEYOND = np.array([0.0, 1.0, 0.0, 0.0, 1.5, 0.0, 0.3])


@pytest.fixture(scope="module")
def planner() -> MotionPlanner:
    scene, _ = bench.load()
    return MotionPlanner(scene, bench.VELOCITY_LIMIT, scenario.Planner())


def standing(p: Array) -> Array:
    """Tracks of the mover alone, at a place."""
    tracks = np.zeros((len(bench.NAMES), TRACK_SIZE))
    pose = np.array([1.0, 0, 0, 0, *p])
    tracks[-1] = Track(ObjectStatus.TRACKED, 0.0, pose, np.zeros(6), 1e-8 * np.eye(6)).pack()
    return tracks.ravel()


NOBODY = np.zeros(len(bench.NAMES) * TRACK_SIZE)


def run(planner: MotionPlanner, goals: list[tuple[int, Array]], tracks: Array, q: Array) -> Array:
    """Return (ticks, n) positions of an arm that follows its commands; each goal holds for so many ticks."""
    memory, rows, tick = planner.initial(q), [], 0
    for count, goal in goals:
        for _ in range(count):
            now = tick / planner.params.rate
            if tick:
                q = memory.trajectory.position(now)
            memory, _ = planner.tick(memory, now, np.concatenate([q, np.zeros(7)]), tracks, goal)
            rows.append(q)
            tick += 1
    return np.array(rows)


def tool(scene: Scene, q: Array) -> Array:
    return np.asarray(scene.chain.tool(scene.chain.place(q[None]))[0, :3, 3])


@pytest.mark.parametrize("bad", [BEYOND, np.full(7, np.nan), np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.1, -0.2])])
def test_after_a_goal_that_cannot_be_one_that_can_is_reached(planner: MotionPlanner, bad: Array) -> None:
    """Out of reach, no number, inside the table; then a good one: it must go."""
    q = run(planner, [(12, bad), (60, GOAL)], NOBODY, bench.HOME)
    start, there = tool(planner.scene, bench.HOME), tool(planner.scene, q[-1])
    assert np.linalg.norm(start - GOAL[4:]) > 0.1, "it has some way to go"
    assert np.isfinite(q).all()
    assert np.linalg.norm(there - GOAL[4:]) < 0.01
    for each in q[:12]:
        around = planner.scene.around(Forecast.of_tracks(NOBODY), np.zeros(1))
        assert planner.scene.clearance.distances(each[None], around, 0.3)[0].min() > 0.0


def test_an_arm_that_starts_in_contact_leaves_it_and_goes(planner: MotionPlanner) -> None:
    scene = planner.scene
    beside = tool(scene, bench.HOME)

    def clearance(tracks: Array, q: Array) -> float:
        around = scene.around(Forecast.of_tracks(tracks), np.zeros(1))
        return float(scene.clearance.distances(q[None], around, 0.3)[0].min())

    nearer = (standing(beside + [0.0, away, 0.0]) for away in np.arange(0.25, 0.0, -0.002))
    tracks = next(each for each in nearer if clearance(each, bench.HOME) < -0.01)
    q = run(planner, [(75, GOAL)], tracks, bench.HOME)
    clear = [clearance(tracks, each) for each in q]
    assert min(clear) > clear[0] - 0.005, "and goes no deeper"
    assert clear[-1] > 0.01
    assert np.linalg.norm(tool(scene, q[-1]) - GOAL[4:]) < 0.01


def test_what_is_held_is_lifted_though_no_straight_way_up_is_within_the_limits() -> None:
    """Two joints near their ends: the goal 6 cm higher is reached with others, by a swing that drags it by 9 cm."""
    scene, library = bench.load()
    names = list(library)
    pieces = [library[name].convex_pieces for name in names]
    q = np.array([1.49, -1.71, -2.22, -2.85, -0.29, 3.69, -1.13])
    X_WT = from_matrix(scene.chain.tool(scene.chain.place(q[None]))[0])
    X_WO = np.array([1.0, 0, 0, 0, *X_WT[4:6], 0.5 * library["can"].size[2]])
    hand = Hand(names.index("can"), on_support=True, X_TO=compose(inverse(X_WT), X_WO))
    planner = MotionPlanner(scene, bench.VELOCITY_LIMIT, scenario.Planner(), pieces_O=pieces)
    raised = X_WT + [0, 0, 0, 0, 0, 0, 0.06]
    assert not len(planner.guide.straight_way(q, raised))
    rows = run(planner.holding(hand.pack().tobytes()), [(40, raised)], NOBODY, q)
    moved = np.array([tool(scene, row) for row in rows]) - X_WT[4:]
    assert moved[:, 2].max() > 0.035
    aside = np.linalg.norm(moved[: np.argmax(moved[:, 2] > 0.03), :2], axis=1).max()
    assert aside < 0.015


def crowded(seed: int) -> tuple[Array, Array]:
    """Return tracks of three boxes about a goal above the table, and the goal (7,)."""
    rng, tracks = np.random.default_rng(seed), np.zeros((len(bench.NAMES), TRACK_SIZE))
    there = np.array([rng.uniform(0.38, 0.6), rng.uniform(0.1, 0.35) * rng.choice([-1, 1]), rng.uniform(0.1, 0.16)])
    yaw = rng.uniform(-1.57, 1.57)
    for k, name in enumerate(bench.NAMES):
        if name in ("cracker_box", "sugar_box", "mover"):
            bearing, away = rng.uniform(0.0, 6.28), rng.uniform(0.12, 0.2)
            p = [*(there + away * np.array([np.cos(bearing), np.sin(bearing), 0.0]))[:2], 0.09 + 0.015 * (k == 0)]
            turn = rng.uniform(0.0, 3.14)
            pose = np.array([np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2), *p])
            tracks[k] = Track(ObjectStatus.TRACKED, 0.0, pose, np.zeros(6), 1e-8 * np.eye(6)).pack()
    return tracks.ravel(), np.array([0.0, np.cos(yaw / 2), np.sin(yaw / 2), 0.0, *there])


@pytest.mark.parametrize("seed", [7, 10, 61])
def test_an_arm_that_knows_a_way_does_not_stand_before_it(planner: MotionPlanner, seed: int) -> None:
    """About where it stood, boxes barred the way around them, too: it stood 20, 27 and 62 cm from its goal for ever."""
    tracks, goal = crowded(seed)
    q = run(planner, [(110, goal)], tracks, bench.HOME)
    assert np.linalg.norm(tool(planner.scene, q[-1]) - goal[4:]) < 0.01
    clear = planner.scene.clearance.distances(
        q, planner.scene.around(Forecast.of_tracks(tracks), np.zeros(len(q))), 0.3
    )
    assert clear.min() > 0.0
