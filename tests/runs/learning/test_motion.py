"""Timing of paths, axes of tools."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from twin_diagram.runs.learning.motion import TUNING as MOTION
from twin_diagram.runs.learning.motion import Mover, NoWay, cloud_cells, columns, pointing, pose, timed
from twin_diagram.runs.learning.setting_down import TUNING as SETTING_DOWN
from twin_diagram.runs.learning.setting_down import line_down, way_back
from twin_diagram.scenario.file import load_scenario

SPEED = np.array([1.0, 0.5])


def test_a_timed_path_keeps_speed_and_acceleration_and_stops_at_way_points() -> None:
    path = np.array([[0.0, 0.0], [1.0, 0.2], [1.0, -0.8]])
    motion = timed(path, SPEED, 3.0)
    v = np.gradient(motion.q, motion.times, axis=0)
    a = np.gradient(v, motion.times, axis=0)
    assert (np.abs(v).max(axis=0) <= SPEED * 1.01).all() and np.abs(a).max() < 3.2
    # One of the limits is met: it is no slower than it must be.
    assert np.abs(v / SPEED).max() > 0.95
    assert motion.q[0] == pytest.approx(path[0]) and motion.q[-1] == pytest.approx(path[-1])
    between = np.linalg.norm(motion.q - path[1], axis=1).argmin()
    assert motion.q[between] == pytest.approx(path[1]) and np.abs(v[between]).max() < 0.05


def test_short_ways_are_bound_by_acceleration() -> None:
    motion = timed(np.array([[0.0, 0.0], [0.01, 0.0]]), SPEED, 3.0)
    assert motion.times[-1] == pytest.approx(np.sqrt(5.7735 * 0.01 / 3.0))


def test_a_tool_points_along_its_approach() -> None:
    R = pointing(np.array([0.0, 0.0, -2.0]), np.array([1.0, 0.0, 0.3]))
    assert R[:, 2] == pytest.approx([0, 0, -1]) and R[:, 1] == pytest.approx([1, 0, 0])
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_cells_keep_the_mean_of_their_points() -> None:
    points = np.array([[0.001, 0.001, 0.001], [0.003, 0.001, 0.001], [0.021, 0.0, 0.0]])
    cells = cloud_cells(points, 0.01)
    assert cells == pytest.approx(np.array([[0.002, 0.001, 0.001], [0.021, 0.0, 0.0]]))


def test_columns_stand_under_what_was_seen() -> None:
    points = np.array([[0.01, 0.01, 0.10], [0.012, 0.012, 0.14], [0.06, 0.01, 0.08]])
    boxes = columns(points, 0.02, 0.025)
    assert len(boxes) == 2 and not columns(np.zeros((0, 3)), 0.0, 0.025)
    first = min(boxes, key=lambda box: box.p_GB[0])
    assert first.p_GB[2] + first.half[2] == pytest.approx(0.14) and first.p_GB[2] - first.half[2] == pytest.approx(0.02)


def test_ways_keep_clear_of_what_stands_about_until_it_is_gone() -> None:
    twin = load_scenario("bin_picking").twin
    mover = Mover(twin, {}, np.full(7, 2.0))
    home = np.array(twin.home)
    tip = mover.tool(home)[:3, 3]
    thing = tip + np.random.default_rng(0).uniform(-0.03, 0.03, (300, 3))
    assert mover.free(home[None], 0.01)[0]
    mover.stand("here", [thing], 0.0)
    assert not mover.free(home[None], 0.01)[0] and mover.free(home[None], 0.01, standing=False)[0]
    mover.stand("there", [thing + [0.0, 0.5, 0.0]], 0.0)
    mover.stand("here", [], 0.0)
    assert mover.free(home[None], 0.01)[0]
    with pytest.raises(ValueError), mover.blocked(tip - 0.02, tip + 0.02):
        assert not mover.free(home[None], 0.01)[0]
        raise ValueError
    assert mover.free(home[None], 0.01)[0]


def test_what_is_swung_keeps_farther_from_what_stands_about_than_open_fingers_before_a_grasp() -> None:
    twin = load_scenario("bin_picking").twin
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)[None]
    mover.stand("here", [mover.tool(home[0])[:3, 3] - [0.0, 0.0, 0.06] + np.zeros((1, 3))], 0.0)
    gap = float(mover.distances(home)[0, -2])
    assert MOTION.close < gap and mover.free(home, gap + 0.01)[0]
    assert not mover.free(home, gap + 0.001, on_purpose=False)[0] and mover.free(home, gap - 0.001, on_purpose=False)[0]


def test_room_is_what_is_left_beyond_what_must_be() -> None:
    twin = load_scenario("bin_picking").twin
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    mover.stand("here", [np.array([[0.5, 0.1, 0.2]])], 0.0)
    q = home + np.random.default_rng(0).normal(size=(200, 7)) * 0.6
    room = mover.room(q, 0.02)
    free = mover.free(q, 0.02, on_purpose=False)
    assert 20 < free.sum() < 180 and ((room >= 0.0).all(axis=1) == free).all()
    slope = (mover.room(q + 1e-4, 0.02) - room) / 1e-4
    assert (np.abs(slope[room < 0.02]) < 4.0).all() and (np.abs(slope[room < 0.0]) > 0.01).mean() > 0.8


def test_what_is_held_low_can_be_set_down_in_a_bin_and_the_way_back_leads_over_its_walls() -> None:
    """The tool's frame 12 mm over the lowest point of what it holds, which is let go 3 mm over the bottom."""
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    low, high = (np.array(corner) for corner in twin.learning.into_bin)
    for place, closing in (((low + high) / 2, [1.0, 0.0, 0.0]), (high - [0.144, 0.055, 0.0], [1.0, 0.0, 0.0])):
        down = pose(pointing(np.array([0.0, 0.0, -1.0]), np.array(closing)), np.array([*place[:2], low[2] + 0.015]))
        above = down + np.outer([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.2])
        line = mover.line(mover.goals(above, home)[0], down)
        assert mover.bare_free(line, SETTING_DOWN.grazing)
        assert not mover.free(line, SETTING_DOWN.grazing).all(), "with fewer balls tips stand in the bottom"
        back = way_back(mover, line[-1])
        assert mover.bare_free(back, SETTING_DOWN.grazing) and mover.bare_free(back[-1:], MOTION.clearance)


def test_the_way_back_leads_over_what_was_set_down() -> None:
    """A box of 17.5 cm held by its middle: after 10 cm the tips were still beside its upper end."""
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    low, high = (np.array(corner) for corner in twin.learning.into_bin)
    R_WT = pointing(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
    down = pose(R_WT, np.array([*(low + high)[:2] / 2, 0.09]))
    q = mover.goals(down + np.outer([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.2]), home)[0]
    q = mover.line(q, down)[-1]
    box = np.random.default_rng(0).uniform([-0.02, -0.03, low[2]], [0.02, 0.03, low[2] + 0.175], (3000, 3))
    with mover.as_if(box + [*down[:2, 3], 0.0], float(low[2])):
        end = way_back(mover, q)[-1:]
        assert mover.bare_free(end, MOTION.clearance, standing=True)
    assert mover.tool(end[0])[2, 3] > 0.22 and mover.free(end, MOTION.clearance)[0]


def test_an_end_beside_something_lets_no_way_lead_through_another_thing() -> None:
    twin = load_scenario("bin_picking").twin
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    goal = home + np.array([1.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    some = np.random.default_rng(0).uniform(-0.02, 0.02, (300, 3))
    beside, between = mover.tool(home)[:3, 3] + some, mover.tool(0.5 * (home + goal))[:3, 3] + some
    mover.stand("there", [beside, between], float(between[:, 2].min()) - 0.02)
    assert mover.distances(home[None])[0, -2] < 0.0, "the way begins in it"
    way = mover.path(home, goal[None])
    dense = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(way)])
    beyond = np.abs(dense - home).max(axis=1) > MOTION.ends
    assert (mover.distances(dense[beyond])[:, :-1] > MOTION.clearance - 0.002).all()


def test_fingers_open_higher_where_tips_would_stand_on_the_platform_and_keep_off_walls() -> None:
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    low, high = (np.array(corner) for corner in twin.learning.platform)
    R_WT = pointing(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
    for under, gap in ((0.012, SETTING_DOWN.gaps[0]), (0.005, SETTING_DOWN.gaps[1])):
        X = pose(R_WT, np.array([*(low + high)[:2] / 2, high[2] + under]))
        above = mover.goals(X + np.outer([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.1]), home)[0]
        assert mover.tool(line_down(mover, above, X)[-1])[2, 3] == pytest.approx(X[2, 3] + gap, abs=1e-4)
    low, high = (np.array(corner) for corner in twin.learning.into_bin)
    up = np.outer([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.2])
    for off in (0.1, 0.083):
        X = pose(R_WT, np.array([low[0] + off, (low + high)[1] / 2, low[2] + 0.015]))
        above = mover.goals(X + up, home)[0]
        assert mover.bare_free(mover.line(above, X), SETTING_DOWN.grazing)
        if off == 0.1:
            line_down(mover, above, X)
        else:
            with pytest.raises(NoWay, match="in the way"):
                line_down(mover, above, X)
