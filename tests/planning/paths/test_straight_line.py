"""Short moves of the tool that are straight in space: where they go, when there are none, and how they are followed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import Scene, load_scene
from twin_diagram.planning.paths import inverse_kinematics
from twin_diagram.planning.paths.straight_line import straight_way
from twin_diagram.signals.arrays import Array

HOME = np.array([0.3, 0.1, 0.0, -2.0, 0.0, 2.1, 1.1])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], {})


def above(scene: Scene, seed: int, sideways: float = 0.0, turn: float = 0.0) -> tuple[Array, Array]:
    """Return joint angles and a goal 8 cm below the tool there, which is off by so much sideways and turned."""
    rng = np.random.default_rng(seed)
    X_WG = np.eye(4)
    X_WG[:3, :3] = (Rotation.from_euler("z", rng.uniform(-1, 1)) * Rotation.from_rotvec([np.pi, 0, 0])).as_matrix()
    X_WG[:3, 3] = [rng.uniform(0.4, 0.55), rng.uniform(-0.3, 0.3), 0.12]
    X_WT = X_WG.copy()
    X_WT[:3, :3] = Rotation.from_rotvec([0, 0, turn]).as_matrix() @ X_WG[:3, :3]
    X_WT[:3, 3] += [sideways, 0.0, 0.08]
    found = inverse_kinematics.solve(scene.chain, X_WT, HOME, scene.lower, scene.upper, rng)
    return found[0], X_WG


def tools(scene: Scene, q: Array, way: Array) -> Array:
    """Return (N, 4, 4) of the tool along a way, straight in joint angles from point to point."""
    points = np.vstack([q, way])
    line = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(points)])
    return np.asarray(scene.chain.tool(scene.chain.place(line)))


@pytest.mark.parametrize("seed", range(4))
def test_the_tool_keeps_to_the_plumb_line_from_the_middle_of_its_way_on(scene: Scene, seed: int) -> None:
    q, X_WG = above(scene, seed, sideways=0.012, turn=0.1)
    way = straight_way(scene.chain, q, X_WG, scene.lower, scene.upper)
    assert len(way) == 4  # 25 mm apart at most
    X = tools(scene, q, way)
    np.testing.assert_allclose(X[-1], X_WG, atol=2e-4)
    off = np.linalg.norm(X[:, :2, 3] - X_WG[:2, 3], axis=1)
    turned = Rotation.from_matrix(X[:, :3, :3] @ X_WG[:3, :3].T).magnitude()
    height = X[:, 2, 3] - X_WG[2, 3]
    low = height < 0.0399
    assert off[low].max() < 3e-4 and turned[low].max() < 3e-3
    assert off[height > 0.045].min() > 1e-3  # and is led there evenly, not at once
    assert (np.diff(height) < 1e-12).all()


def test_a_move_to_the_side_is_straight_from_its_start(scene: Scene) -> None:
    q, _ = above(scene, 0)
    start = scene.chain.tool(scene.chain.place(q[None]))[0]
    goal = start.copy()
    goal[:3, 3] += [0.06, 0.02, -0.05]
    way = straight_way(scene.chain, q, goal, scene.lower, scene.upper)
    p = tools(scene, q, way)[:, :3, 3] - start[:3, 3]
    line = (goal[:3, 3] - start[:3, 3]) / np.linalg.norm(goal[:3, 3] - start[:3, 3])
    assert np.linalg.norm(p - np.outer(p @ line, line), axis=1).max() < 4e-4


@pytest.mark.parametrize(
    ("along", "turn", "there"), [(0.018, 0.0, False), (0.022, 0.0, True), (0.149, 0.19, True), (0.152, 0.0, False)]
)
def test_near_and_far_goals_need_no_line(scene: Scene, along: float, turn: float, there: bool) -> None:
    q, _ = above(scene, 1)
    goal = scene.chain.tool(scene.chain.place(q[None]))[0]
    goal[2, 3] += along
    goal[:3, :3] = Rotation.from_rotvec([0, 0, turn]).as_matrix() @ goal[:3, :3]
    assert (len(straight_way(scene.chain, q, goal, scene.lower, scene.upper)) > 0) == there


def test_there_is_none_past_a_limit_nor_for_a_tool_that_turns(scene: Scene) -> None:
    q, X_WG = above(scene, 2)
    way = straight_way(scene.chain, q, X_WG, scene.lower, scene.upper)
    joint = int(np.abs(way[-1] - q).argmax())
    rises = way[-1][joint] > q[joint]
    for beyond in (0.045, 0.055):  # the way keeps 0.05 rad from limits
        low, high = scene.lower.copy(), scene.upper.copy()
        if rises:
            high[joint] = way[:, joint].max() + beyond
        else:
            low[joint] = way[:, joint].min() - beyond
        assert (len(straight_way(scene.chain, q, X_WG, low, high)) > 0) == (beyond > 0.05)
    turned = X_WG.copy()
    turned[:3, :3] = Rotation.from_rotvec([0, 0, 0.21]).as_matrix() @ turned[:3, :3]
    assert not len(straight_way(scene.chain, q, turned, scene.lower, scene.upper))
