"""What passes by while the fingers open or close: the hand stays, or it would throw what is between them."""

from __future__ import annotations

import numpy as np
import pytest

from tests import planning_bench as bench
from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import Forecast
from twin_diagram.planning.collision.held_shape import at_rest
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus, Track
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, THING_SIZE, Thing, things_of

MOVER = bench.NAMES.index("mover")
GOAL = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.25, 0.09])
"""The hand points down, its fingers along y."""
SPEED = 0.3
"""Of what passes [m/s]."""


def moving(x: float) -> Array:
    """Return the track of the mover that passes along x, 5 cm beside the hand, whose half is 10 cm wide there."""
    pose = np.array([1.0, 0, 0, 0, x, GOAL[5] + 0.10 + 0.03 + 0.05, 0.12])
    return Track(ObjectStatus.MOVING, 0.0, pose, np.array([0, 0, 0, SPEED, 0, 0]), 1e-6 * np.eye(6)).pack()


@pytest.mark.parametrize("around", [True, False])
def test_the_hand_stays_whatever_passes(around: bool) -> None:
    scene, _ = bench.load()
    planner = MotionPlanner(scene, bench.VELOCITY_LIMIT, scenario.Planner(rate=30.0, velocity_share=0.7))
    memory, q, X = planner.initial(bench.HOME), bench.HOME, np.eye(4)
    tracks, places = np.zeros((len(bench.NAMES), TRACK_SIZE)), []
    for tick in range(105):
        now = tick / 30
        if now > 2.0:
            tracks[MOVER] = moving(GOAL[4] + SPEED * (now - 3.0))
            places.append(X[:3, 3])
        seen = at_rest(GOAL[4:], tracks.ravel(), None, None)[0] if around else tracks.ravel()
        memory, _ = planner.tick(memory, now, np.concatenate([q, np.zeros(7)]), seen, GOAL)
        q = memory.trajectory.position(now + 1 / 30)
        X = scene.chain.tool(scene.chain.place(q[None]))[0]
    astray = np.linalg.norm(np.array(places) - places[0], axis=1).max()
    assert np.linalg.norm(places[0] - GOAL[4:]) < 0.001
    assert astray < 0.001 if around else astray > 0.05


def test_what_moves_is_left_out_and_what_stands_is_not() -> None:
    tracks = np.zeros((len(bench.NAMES), TRACK_SIZE))
    still = Track(ObjectStatus.TRACKED, 0.0, np.array([1.0, 0, 0, 0, 0.6, 0.3, 0.05]), np.zeros(6), np.zeros((6, 6)))
    tracks[0], tracks[MOVER] = still.pack(), moving(0.5)
    further = np.zeros((2, FURTHER_TRACK_SIZE))
    further[:, 0] = 1.0
    further[0, OWNER_SIZE:], further[1, OWNER_SIZE:] = tracks[0], tracks[MOVER]
    now = (ObjectStatus.TRACKED, 0.0, 0.0, np.zeros(3), (np.eye(4, 3),))
    rows = np.concatenate([Thing(1, *now).pack(), Thing(2, *now, np.array([0.2, 0.0, 0.0])).pack()])
    assert rows.shape == (2 * THING_SIZE,)
    seen, more, things = at_rest(np.array([0.3, 0.8, 0.1]), tracks.ravel(), further.ravel(), rows)
    assert Forecast.of_tracks(seen).present[[0, MOVER]].tolist() == [True, False]
    assert more is not None and (more.reshape(2, -1)[:, 0] > 0.0).tolist() == [True, False]
    assert things is not None and [thing.stands for thing in things_of(things)] == [True, False]
    things = at_rest(np.array([1.0, 0.0, 0.05]), tracks.ravel(), None, rows)[2]
    assert things is not None and all(thing.stands for thing in things_of(things)), "it is backed out of"


def test_an_arm_without_a_goal_stays_near_what_it_stands_over() -> None:
    """A hand that opened 3 cm over the table was 4 cm up after 0.13 s, and took along what was in it."""
    scene, _ = bench.load()
    planner = MotionPlanner(scene, bench.VELOCITY_LIMIT, scenario.Planner(rate=30.0, velocity_share=0.7))
    tracks, low = np.zeros(len(bench.NAMES) * TRACK_SIZE), np.append(GOAL[:6], 0.03)
    forecast = scene.forecast(tracks, None, None)
    q = planner.guide.joint_goals(bench.HOME, low, forecast, np.random.default_rng(0))[0]
    now = planner.guide.margins_at(q, forecast, np.zeros((0, 7)), at_rest=True)
    assert 0.005 < now.here[0] < now.least  # nearer than anything is kept from what rests
    memory = planner.initial(q)
    for tick in range(30):
        memory, _ = planner.tick(memory, tick / 30, np.concatenate([q, np.zeros(7)]), tracks, np.zeros(7))
        q = memory.trajectory.position((tick + 1) / 30)
    assert np.linalg.norm(scene.chain.tool(scene.chain.place(q[None]))[0][:3, 3] - low[4:]) < 0.002
