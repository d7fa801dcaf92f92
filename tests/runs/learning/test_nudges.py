"""Which way a thing is pushed that cannot be grasped: into free room, off the rim, not against what bars it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from twin_diagram.planning.grasps import gripper_of
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.nudges import TUNING, Nudge, nudges_of
from twin_diagram.runs.learning.nudging import TUNING as NUDGING
from twin_diagram.runs.learning.nudging import is_clear, tool_poses
from twin_diagram.runs.learning.pressing import begun_at
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array

LOW, HIGH = np.array([0.28, -0.56, 0.01]), np.array([0.56, -0.16, 0.12])
WSG = gripper_of("wsg50")
HALF = 0.5 * WSG.opening_least + WSG.finger_thickness
NONE = np.zeros((0, 3))


def flat(middle: tuple[float, float], edges: tuple[float, float], top: float, turned: float = 0.0) -> SeenThing:
    """Return the level upper face of a box as a camera above it sees it: some point a square of 2 mm."""
    x, y = (np.arange(-0.5 * edge, 0.5 * edge, 0.002) for edge in edges)
    own = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
    points = own @ Rotation.from_rotvec([0.0, 0.0, turned]).as_matrix().T + [*middle, top]
    points = points[np.random.default_rng(0).permutation(len(points))]
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return SeenThing(points, up, np.zeros((len(points), 2), dtype=np.int64), np.array([0.42, -0.36, 0.95]))


def bottom_beside(*things: SeenThing) -> Array:
    """Return where a bin's bottom is seen beside things."""
    x, y = np.meshgrid(np.arange(LOW[0], HIGH[0], 0.003), np.arange(LOW[1], HIGH[1], 0.003))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, LOW[2])])
    for thing in things:
        points = points[cKDTree(thing.points[:, :2]).query(points[:, :2])[0] > 0.004]
    return points


def pushes(thing: SeenThing, *others: SeenThing) -> list[Nudge]:
    rest = np.vstack([NONE, *(one.points for one in others)])
    return nudges_of(thing, rest, bottom_beside(thing, *others), (LOW, HIGH), HALF)


@pytest.mark.parametrize("turned", [0.0, 0.2, -0.2])
def test_what_lies_over_a_rim_is_pushed_into_the_bin(turned: float) -> None:
    """A cracker box over rim and ring; as one looks along y, the half of the bin before it is free."""
    best = pushes(flat((0.44, -0.22), (0.21, 0.16), 0.17, turned))[0]
    assert best.along @ [0.0, -1.0, 0.0] > np.cos(TUNING.askew)
    assert best.middle == pytest.approx(best.across @ [0.44, -0.22, 0.0], abs=0.005), "through its middle"
    assert best.near == pytest.approx(best.along @ [0.44, -0.22, 0.0] - 0.08, abs=0.01) and best.edge == pytest.approx(
        0.17
    )
    assert 0.12 <= best.length <= TUNING.farthest and best.gain > 0.8


def test_a_push_goes_no_farther_than_to_the_wall() -> None:
    thing = flat((0.44, -0.40), (0.21, 0.16), 0.09)
    for one in pushes(thing):
        moved = thing.points + one.length * one.along
        assert (moved[:, :2] > LOW[:2] - 0.01).all() and (moved[:, :2] < HIGH[:2] + 0.01).all(), one


def test_a_higher_neighbour_bars_its_way_and_a_low_one_is_not_worth_it() -> None:
    thing = flat((0.42, -0.25), (0.24, 0.16), 0.09)
    free = pushes(thing)[0]
    assert free.along == pytest.approx([0.0, -1.0, 0.0], abs=1e-6)
    high, low = flat((0.42, -0.40), (0.2, 0.04), 0.12), flat((0.42, -0.40), (0.2, 0.04), 0.04)
    there = [one for one in pushes(thing, high) if one.along[1] < -0.9]
    assert not there or there[0].length <= 0.06, "it would shove what stands there"
    over = [one for one in pushes(thing, low) if one.along[1] < -0.9]
    assert over and over[0].gain < free.gain - 0.1, "what it lies across then is in its way anew"


def test_what_has_no_free_room_is_left() -> None:
    assert pushes(flat((0.42, -0.36), (0.27, 0.38), 0.09)) == []


def test_fingers_come_down_beside_its_edge_and_press_below_it() -> None:
    thing = flat((0.44, -0.22), (0.21, 0.16), 0.17)
    nudge = pushes(thing)[0]
    poses = tool_poses(nudge, nudge.edge - NUDGING.depths[0], WSG)
    tips = poses[:, :3, 3] + WSG.finger_front * poses[:, :3, 2]
    leading = tips @ nudge.along + 0.5 * WSG.finger_width
    assert tips[:, 2] == pytest.approx(0.14) and tips @ nudge.across == pytest.approx(nudge.middle)
    assert leading[0] == pytest.approx(nudge.near - NUDGING.before)
    assert leading[-1] == pytest.approx(nudge.near + nudge.length)
    assert is_clear(poses, WSG, NONE, thing.points)
    place = (nudge.middle + 0.01) * nudge.across + (nudge.near + 0.5 * nudge.length) * nudge.along
    barred, below = place + [[0.0, 0.0, 0.15]], place + [[0.0, 0.0, 0.12]]
    assert not is_clear(poses, WSG, barred, thing.points) and is_clear(poses, WSG, below, thing.points)
    raised = np.vstack([thing.points, place + [[0.0, 0.0, 0.24]]])  # its other end, below which the palm has no room
    assert is_clear(poses, WSG, NONE, raised)
    nearer = nudge.middle * nudge.across + (nudge.near + 0.01) * nudge.along + [[0.0, 0.0, 0.24]]
    assert not is_clear(poses, WSG, NONE, np.vstack([thing.points, nearer]))


BEYOND_RIM = Nudge(np.array([-0.89, 0.456, 0.0]), -0.161, -0.771, 0.179, 0.15, 1.24)
"""Of a cracker box that lies over the bin's far corner, back into it."""


@pytest.mark.parametrize("lean", [0.0, 0.35])
def test_a_hand_that_leans_presses_where_one_that_hangs_straight_down_does(lean: float) -> None:
    poses = tool_poses(BEYOND_RIM, 0.149, WSG, lean)
    corner = poses @ [-0.5 * WSG.finger_width, 0.0, WSG.finger_front, 1.0]
    other = poses @ [0.5 * WSG.finger_width, 0.0, WSG.finger_front, 1.0]
    ahead = max((corner, other), key=lambda one: float(one[0, :3] @ BEYOND_RIM.along))
    along = ahead[:, :3] @ BEYOND_RIM.along / (BEYOND_RIM.along @ BEYOND_RIM.along)
    assert along[0] == pytest.approx(BEYOND_RIM.near - NUDGING.before, abs=1e-3)
    assert along[-1] == pytest.approx(BEYOND_RIM.near + BEYOND_RIM.length, abs=1e-3)
    assert ahead[:, 2] == pytest.approx(0.149, abs=1e-4)
    assert min(corner[:, 2].min(), other[:, 2].min()) >= 0.149 - 1e-4, "no lower than its tips' leading edge"
    assert -poses[0, 2, 2] == pytest.approx(np.cos(lean), abs=1e-3)
    assert (poses[0, :3, 2] @ BEYOND_RIM.along <= 1e-9) and poses[:, :3, :3] == pytest.approx(
        np.broadcast_to(poses[0, :3, :3], (len(poses), 3, 3))
    )


def test_beyond_a_far_rim_a_hand_reaches_that_leans_back_over_the_thing() -> None:
    twin = load_scenario("bin_picking").twin
    tools: Any = SimpleNamespace(
        mover=Mover(twin, {}, np.full(7, 2.0)), cell=SimpleNamespace(commanded=np.array(twin.home))
    )
    straight, leaning = (begun_at(tools, tool_poses(BEYOND_RIM, 0.149, WSG, lean), -0.015) for lean in NUDGING.leans)
    assert straight is None, "82 cm from the arm's axis"
    assert leaning is not None
