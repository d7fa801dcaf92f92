"""What the arm does about a grasp: here where it holds nothing."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.runs.learning.motion import Mover, pointing, pose
from twin_diagram.runs.learning.picking import TUNING, Reach, Taken, before_grasp, lift_over, take, unlike
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.pose_vectors import from_matrix


class EmptyFingers:
    """A cell in which fingers meet nothing; it is where it was told to go."""

    def __init__(self, q: Array) -> None:
        self.commanded = self.q = q
        self.opening, self.widest, self.gone = 0.11, 0.11, [q]

    def grip(self, opened: float, seconds: float = 0.7) -> float:
        self.opening = 0.11 * opened
        return self.opening

    def wait(self, seconds: float) -> None: ...

    def about(self, phase: str, place: Array) -> EmptyFingers:
        return self

    def __enter__(self) -> None: ...

    def __exit__(self, *of: object) -> None: ...

    def follow(self, times: Array, q: Array) -> None:
        self.gone += list(q)
        self.commanded = self.q = q[-1]


def test_from_where_it_held_nothing_the_hand_goes_back_and_up() -> None:
    twin = load_scenario("bin_picking").twin
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    approach = np.array([0.3, 0.0, -1.0]) / np.hypot(0.3, 1.0)
    X_WT = pose(pointing(approach, np.array([0.0, 1.0, 0.0])), np.array([0.42, -0.36, 0.05]))
    before = X_WT.copy()
    before[:3, 3] -= TUNING.retreats[0] * approach
    start = mover.goals(before, home)[0]
    reach = Reach(0, X_WT, mover.path(home, start[None]), mover.line(start, X_WT, TUNING.grazing))
    cell = EmptyFingers(home)
    assert take(mover, cell, reach) is None  # type: ignore[arg-type]
    tips = np.array([mover.tool(q)[:3, 3] for q in cell.gone])
    deepest = int(np.argmin(tips[:, 2]))
    np.testing.assert_allclose(tips[deepest], X_WT[:3, 3], atol=1e-3)
    turning = deepest + int(np.argmin(np.linalg.norm(tips[deepest:] - before[:3, 3], axis=1)))
    np.testing.assert_allclose(tips[turning], before[:3, 3], atol=1e-3)
    np.testing.assert_allclose(tips[-1, :2], before[:2, 3], atol=2e-3)
    assert tips[-1, 2] > before[2, 3] + TUNING.least_lift - 1e-3 and cell.opening > 0.1


@pytest.mark.parametrize(("reaches", "height"), [(0.16, 0.33), (0.05, 0.23)])
def test_what_may_hang_from_the_pads_is_lifted_over_the_walls(reaches: float, height: float) -> None:
    """A bottle held by its neck turned as it was lifted, met a wall with its far end on its way, and fell."""
    twin = load_scenario("bin_picking").twin
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    X_WT = pose(pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])), np.array([0.45, -0.33, 0.04]))
    lifted = X_WT.copy()
    lifted[2, 3] = 0.23
    cell = EmptyFingers(mover.goals(lifted, home)[0])
    lying = X_WT[:3, 3] + np.linspace(0.0, 1.0, 5)[:, None] * [-reaches, 0.0, 0.0]
    lift_over(mover, cell, Taken(X_WT, 0.03, 0), lying, 0.12)  # type: ignore[arg-type]
    assert mover.tool(cell.commanded)[2, 3] == pytest.approx(height, abs=2e-3)


def test_in_a_corner_of_a_bin_the_straight_way_begins_over_the_walls() -> None:
    """Where a ring was left, held across its wall: 10 cm before that a finger is 8 mm off the bin's rim."""
    twin = load_scenario("bin_picking").twin
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    down = pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    for place, retreat in (([0.42, -0.36, 0.035], TUNING.retreats[0]), ([0.518, -0.473, 0.035], TUNING.retreats[1])):
        starts = before_grasp(mover, pose(down, np.array(place)), home)
        assert 0 < len(starts) <= 3 and mover.tool(starts[0])[2, 3] == pytest.approx(place[2] + retreat, abs=1e-3)
        mover.line(starts[0], pose(down, np.array(place)), TUNING.grazing)


def test_grasps_like_one_that_held_nothing_come_last() -> None:
    down = pointing(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
    across = pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    failed = pose(down, np.array([0.5, 0.0, 0.1]))
    half_turned = down * [-1.0, -1.0, 1.0]
    some = [
        (half_turned, [0.51, 0.0, 0.1]),
        (across, [0.5, 0.0, 0.1]),
        (down, [0.5, 0.0, 0.13]),
        (down, [0.5, 0.0, 0.1]),
    ]
    poses = np.array([from_matrix(pose(R, np.array(p))) for R, p in some])
    assert unlike(poses, np.array([3, 0, 2, 1]), [failed]) == [2, 1, 3, 0]
    assert unlike(poses, np.array([3, 0, 2, 1]), []) == [3, 0, 2, 1]
