"""Beyond the goal: where the arm is once it has gone on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import load_scene
from twin_diagram.planning.mpc.going_on import going_on
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.mpc.planner_state import Memory
from twin_diagram.planning.mpc.trajectory import Trajectory
from twin_diagram.planning.paths.route import Aim, Route
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.next_goals import NextGoal
from twin_diagram.signals.pose_vectors import from_matrix, moved

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])


@pytest.fixture(scope="module")
def planner() -> MotionPlanner:
    return MotionPlanner(load_scene(scenario.ArmModel(), [], {}), np.full(7, 2.0), scenario.Planner())


@pytest.fixture(scope="module")
def memory(planner: MotionPlanner) -> Memory:
    """At rest at its goal, with commands that lead by 0.01 rad."""
    fresh = planner.initial(HOME)
    trajectory = Trajectory.at_rest(0.0, 0.12, 16, HOME + 0.01)
    return replace(fresh, trajectory=trajectory, offset=np.full(7, 0.01), route=Route(Aim.LINE, HOME[None]))


def tool(planner: MotionPlanner, q: Array) -> Array:
    chain = planner.scene.chain
    return from_matrix(chain.tool(chain.place((q - 0.01)[None]))[0])


def test_it_goes_down_and_up_again_when_it_is_told_to(planner: MotionPlanner, memory: Memory) -> None:
    here = tool(planner, HOME + 0.01)
    down, far = moved(here, np.array([0.0, 0.0, -0.06])), moved(here, np.array([0.0, -0.2, 0.0]))
    after = [NextGoal(down, 0.3), NextGoal(far, 0.0, 1.5)]
    unknown = going_on(planner, memory, 0.0, 9.0, after)
    assert unknown is not None
    np.testing.assert_allclose(tool(planner, unknown)[4:], down[4:], atol=1e-4)  # it may have to go around
    beyond = planner.guide.reaching(HOME, far, np.random.default_rng(0))[:1]
    memory = replace(memory, next_goal=far, beyond=beyond)
    for ahead in (0.1, 0.3):
        assert going_on(planner, memory, 2.0, ahead, after) is None, "not yet"
    soon, there, last = (going_on(planner, memory, 0.0, ahead, after) for ahead in (0.45, 1.4, 9.0))
    assert soon is not None and there is not None and last is not None
    assert down[6] < tool(planner, soon)[6] < here[6] and np.abs(tool(planner, soon)[4:6] - here[4:6]).max() < 1e-3
    np.testing.assert_allclose(tool(planner, there)[4:], down[4:], atol=1e-4)
    np.testing.assert_allclose(tool(planner, last)[4:], far[4:], atol=1e-4)
    again = going_on(planner, memory, 0.0, 9.0, after)
    assert again is not None
    np.testing.assert_array_equal(last, again)


def test_without_a_way_or_a_goal_that_can_be_reached_nothing_is_said(planner: MotionPlanner, memory: Memory) -> None:
    here = tool(planner, HOME + 0.01)
    nowhere = NextGoal(moved(here, np.array([9.0, 0.0, 0.0])))
    assert going_on(planner, memory, 0.0, 1.0, [nowhere]) is None
    assert going_on(planner, memory, 0.0, 1.0, []) is None
    lost = replace(memory, route=Route.none(7))
    assert going_on(planner, lost, 0.0, 1.0, [NextGoal(here)]) is None
