"""Routes in a world of two joints whose distances are known in closed form."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.planning.collision.unsure_pose import Unsure
from twin_diagram.planning.paths.route import STEEP, Router
from twin_diagram.planning.paths.route_tuning import RouteTuning
from twin_diagram.planning.paths.situation import FOLLOWED, INSIDE, Aim, Route, Situation
from twin_diagram.signals.arrays import Array

SPEED = np.array([1.0, 0.5])
MARGIN = 0.04


class Wall:
    """A wall of height `top` at joint 1 in [1, 1.2], and something that passes joint 1 = `where` at times `during`."""

    def __init__(self, top: float = 1.0, where: float = 9.0, during: tuple[float, float] = (0.0, 0.0)) -> None:
        self.top, self.where, self.during = top, where, during
        self.asked: list[tuple[Array, Array]] = []

    def wall(self, q: Array) -> Array:
        return np.maximum(np.maximum(1.0 - q[:, 0], q[:, 0] - 1.2), q[:, 1] - self.top)

    def passing(self, q: Array, times: Array) -> Array:
        there = (times >= self.during[0]) & (times <= self.during[1])
        return np.where(there, np.abs(q[:, 0] - self.where) - 0.1, 1e3)

    def distances(self, q: Array, around: Any, reach: float, own: bool = True, own_reach: float | None = None) -> Array:
        assert len(around.times) == len(q)
        self.asked.append((q, around.times))
        wall = self.wall(q) if around.fixtures else np.full(len(q), 1e3)
        passing = self.passing(q, around.times) if around.moving else np.full(len(q), 1e3)
        every = np.stack([wall, passing, np.where(own, 1.0, 1e3) * np.ones(len(q))], axis=1)
        return np.where(every < reach, every, 1e3)


def world(wall: Wall, **tuning: Any) -> tuple[Router, Any]:
    def around(forecast: Any, times: Array, *, fixtures: bool = True) -> Any:
        return SimpleNamespace(times=times, fixtures=fixtures, moving=bool((forecast.present & forecast.moving).any()))

    scene: Any = SimpleNamespace(
        chain=SimpleNamespace(  # its tool is always as high
            size=2, gravity_W=np.array([0.0, 0.0, -9.81]), place=np.asarray, tool=lambda q: np.zeros((len(q), 4, 4))
        ),
        clearance=wall,
        around=around,
        lower=np.array([-4.0, -1.0]),
        upper=np.array([2.9, 2.5]),
    )
    # There is no tool that could be lifted.
    return Router(scene, SPEED, RouteTuning(**{"over": 0, **tuning})), scene


def situation(q: Any, goals: Any, *, moving: bool = False) -> Situation:
    from twin_diagram.planning.collision.collision_scene import Forecast

    one = np.ones(1, dtype=bool)
    pose = np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1)
    forecast = Forecast(one, one & moving, *pose)
    goals = np.array(goals, dtype=float).reshape(-1, 2)
    return Situation(
        np.array(q, dtype=float),
        forecast,
        goals,
        np.full(3, 1.0),
        np.full((len(goals), 3), 1.0),
        np.array([True, False]),
        MARGIN,
        0.01,
        0.012,
    )


MARGINS = np.array([MARGIN, MARGIN, 0.012])


def test_arrivals_along_a_line_follow_the_slowest_joint() -> None:
    router, _ = world(Wall())
    points = np.array([[0.0, 0.0], [0.35, 0.05], [0.35, 0.25]])
    q, times = router.timed(points)
    # 0.35 rad in four pieces of at most 0.1 rad, then 0.2 rad at 0.5 rad/s in two.
    np.testing.assert_allclose(times, [0.0, 0.0875, 0.175, 0.2625, 0.35, 0.55, 0.75])
    np.testing.assert_allclose(q[:, 0], [0.0, 0.0875, 0.175, 0.2625, 0.35, 0.35, 0.35])
    np.testing.assert_allclose(q[[0, 4, 5, 6], 1], [0.0, 0.05, 0.15, 0.25])


def test_samples_stay_within_a_turn_and_the_limits() -> None:
    router, _ = world(Wall())
    np.testing.assert_allclose(router._drawn, [[-np.pi, -1.0], [2.9, 2.5]])


def test_a_way_is_found_about_where_the_arm_is_though_that_is_more_than_half_a_turn_off() -> None:
    router, scene = world(Wall(where=-3.6))
    scene.lower = np.array([-7.0, -1.0])
    now = situation([-4.0, 0.0], [[-4.4, 0.4]])
    np.testing.assert_allclose(router.search(now, np.random.default_rng(0))[-1], now.goals[0])
    beyond, _ = world(Wall())
    beyond.scene.lower[:], beyond.scene.upper[:] = [3.5, -1.0], [6.0, 2.5]
    np.testing.assert_allclose(Router(beyond.scene, SPEED)._drawn, [[3.5, -1.0], [6.0, 2.5]])


class Lifting(Router):
    """Lifts along joint 2."""

    def lifted(self, q: Array, height: float) -> Array:
        return np.asarray(q + [0.0, height])


def test_a_way_over_goes_straight_up_and_down_where_its_ends_are_narrow() -> None:
    """Close to a wall the way to a lifted middle, or from it, runs into it; from farther off it does not."""
    _, scene = world(Wall(top=0.5))
    router = Lifting(scene, SPEED, RouteTuning(over=1, lifts=(0.3, 0.8), resolution=0.02))
    for start, way in (
        ([0.9, 0.0], [[0.9, 0.8], [1.45, 0.8], [2.0, 0.0]]),
        ([0.1, 0.1], [[1.05, 0.85], [2.0, 0.0]]),
        ([0.9, 0.0], [[0.9, 0.8], [1.3, 0.8], [1.3, 0.0]]),
    ):
        now = situation(start, way[-1:])
        free, wanted = router._free_goals(now)
        plain = router._over(now, free, wanted)
        assert (plain is not None) == (len(way) == 2)
        found = plain if plain is not None else router._over(now, free, wanted, STEEP)
        assert found is not None
        np.testing.assert_allclose(found, way)
        assert router.first_blocked(now, found, wanted[0]) is None
        searched = router.search(now, np.random.default_rng(0))
        times = [router.travel(now.q, Route(Aim.GOAL, points)).duration for points in (searched, found)]
        assert len(searched) and times[0] <= times[1] + 1e-9


def test_what_rests_on_something_is_lifted_off_it_first() -> None:
    """Though the straight way is free, and as long as the rise is not done; with nothing to lift off it is taken."""
    _, scene = world(Wall(top=0.5))
    goal = [-0.5, 0.0]
    now, rng = situation([0.0, 0.0], [goal]), np.random.default_rng(0)
    plain = Lifting(scene, SPEED, RouteTuning(over=1, lifts=(0.3,)))
    np.testing.assert_allclose(plain.decide(Route.none(2), now, rng, fresh=True)[0].points, [goal])
    router = Lifting(scene, SPEED, RouteTuning(over=1, lifts=(0.3,)), rises=True)
    route, wants = router.decide(Route.none(2), now, rng, fresh=True)
    assert not route.to_goal and wants
    way = router.search(now, rng)
    np.testing.assert_allclose(way[0], [0.0, 0.3])
    np.testing.assert_allclose(way[-1], goal)
    for at, left in (([0.0, 0.1], len(way)), ([0.0, 0.25], len(way) - 1)):
        assert len(router.decide(Route(Aim.GOAL, way), situation(at, [goal]), rng)[0].points) == left
    # A wall between, higher than what is lifted: around it, from above where it stood.
    _, scene = world(Wall(top=0.5), checks=4000)
    router = Lifting(scene, SPEED, RouteTuning(over=1, lifts=(0.1,), checks=4000), rises=True)
    way = router.search(situation([0.5, 0.0], [[1.9, 0.0]]), rng)
    np.testing.assert_allclose(way[[0, -1]], [[0.5, 0.1], [1.9, 0.0]])


def test_the_first_blocked_moment_is_when_a_margin_is_lost() -> None:
    router, _ = world(Wall(), resolution=0.01)
    now = situation([0.0, 0.0], [[2.0, 0.0]])
    assert router.first_blocked(now, np.array([[0.95, 0.0]]), MARGINS) is None
    assert router.first_blocked(now, np.array([[0.965, 0.0]]), MARGINS) == pytest.approx(0.965, abs=0.002)
    assert router.first_blocked(now, np.array([[2.0, 0.0]]), MARGINS) == pytest.approx(0.96, abs=0.011)
    assert router.first_blocked(now, np.array([[0.0, 1.1], [2.0, 1.1]]), MARGINS) is None
    # The own distance counts, too, and where the arm is now does not.
    assert router.first_blocked(now, np.array([[0.5, 0.0]]), np.array([MARGIN, MARGIN, 1.5])) == pytest.approx(0.01)
    inside = situation([1.1, 0.0], [])
    assert router.first_blocked(inside, np.array([[1.1, 0.0], [1.1, 0.001]]), MARGINS) is not None


def test_an_end_is_watched_up_to_the_horizon() -> None:
    """Every 0.4 s after arrival, to two seconds."""
    for during, blocked in (((1.35, 1.45), 1.4), ((1.75, 1.85), 1.8), ((2.05, 3.0), None), ((0.65, 0.95), None)):
        router, _ = world(Wall(where=0.2, during=during))
        now = situation([0.0, 0.0], [], moving=True)
        assert router.first_blocked(now, np.array([[0.4, 0.0]]), MARGINS) is None
        found = router.first_blocked(now, np.array([[0.2, 0.0]]), MARGINS)
        assert found is None if blocked is None else found == pytest.approx(blocked)
    wall = Wall()
    router, _ = world(wall)
    router.first_blocked(situation([0.0, 0.0], []), np.array([[0.4, 0.0]]), MARGINS)
    np.testing.assert_allclose(wall.asked[-1][1], [0.1, 0.2, 0.3, 0.4, 0.8, 1.2, 1.6, 2.0])
    np.testing.assert_allclose(wall.asked[-1][0][4:], np.tile([0.4, 0.0], (4, 1)))


def test_an_end_is_free_where_nothing_comes_until_the_horizon() -> None:
    ends = np.array([[0.5, 0.0], [0.97, 0.0], [0.2, 0.0]])
    for during, free in (
        ((0.0, 0.0), [1, 0, 1]),
        ((1.95, 2.05), [1, 0, 0]),
        ((0.19, 0.21), [1, 0, 0]),
        ((1, 1.5), [1, 0, 1]),
    ):
        router, _ = world(Wall(where=0.2, during=during))
        found = router.ends_free(situation([0.0, 0.0], [], moving=True), ends, MARGINS)
        np.testing.assert_array_equal(found, np.array(free, dtype=bool), err_msg=str(during))
    # An end farther than the horizon is asked for when the arm arrives.
    router, _ = world(Wall(where=-3.0, during=(2.9, 3.1)))
    far = np.array([[-3.0, 0.0]])
    assert not router.ends_free(situation([0.0, 0.0], [], moving=True), far, MARGINS)[0]
    assert router.ends_free(situation([0.0, 0.0], [], moving=False), far, MARGINS)[0]


def test_the_nearest_free_goal_is_gone_to_straight() -> None:
    router, _ = world(Wall())
    rng = np.random.default_rng(0)
    goals = [[0.6, 0.0], [0.3, 0.0], [0.0, 0.2], [1.1, 0.0]]
    route, wants = router.decide(Route.none(2), situation([0.0, 0.0], goals), rng)
    assert (route.aim, wants) == (Aim.GOAL, False)
    np.testing.assert_allclose(route.points, [[0.3, 0.0]])  # joint 2 is slower: 0.2 rad of it last longer
    # A goal within the margin and what is spared is none: 0.04 + 0.02.
    for q, aim in ((0.945, Aim.NOTHING), (0.935, Aim.GOAL)):
        route, _ = router.decide(Route.none(2), situation([0.0, 0.0], [[q, 0.0]]), rng)
        assert route.aim is aim


def test_of_goals_as_far_the_one_that_moves_fewer_joints_is_gone_to() -> None:
    router, _ = world(Wall())
    # 0.50 s by one joint alone; 0.48 s by both.
    goals = [[-0.48, 0.24], [-0.5, 0.0]]
    route, _ = router.decide(Route.none(2), situation([0.0, 0.0], goals), np.random.default_rng(0))
    np.testing.assert_allclose(route.points, [[-0.5, 0.0]])
    # What is much quicker is gone to by however many.
    goals[0] = [-0.3, 0.15]
    route, _ = router.decide(Route.none(2), situation([0.0, 0.0], goals), np.random.default_rng(0))
    np.testing.assert_allclose(route.points, [[-0.3, 0.15]])


def test_the_way_around_is_searched_where_it_may_be() -> None:
    router, _ = world(Wall())
    now = situation([0.5, 0.0], [[1.7, 0.0]])
    route, wants = router.decide(Route.none(2), now, np.random.default_rng(0))
    assert (route.aim, wants) == (Aim.NOTHING, True)
    points = router.search(now, np.random.default_rng(0))
    assert len(points) > 1
    np.testing.assert_allclose(points[-1], [1.7, 0.0])
    assert np.abs(points[0] - now.q).max() > 1e-6  # where the arm is stands not among them
    assert router.first_blocked(now, points, MARGINS) is None
    closed, _ = world(Wall(top=9.0))
    assert closed.search(now, np.random.default_rng(0)).shape == (0, 2)
    # A goal in the wall is no goal, and nothing is wanted; a goal in sight needs no search.
    blocked = situation([0.5, 0.0], [[1.1, 0.0]])
    assert not router.decide(Route.none(2), blocked, np.random.default_rng(0))[1]
    assert router.search(blocked, np.random.default_rng(0)).shape == (0, 2)
    np.testing.assert_allclose(router.search(situation([0.5, 0.0], [[0.7, 0.0]]), np.random.default_rng(0)), [[0.7, 0]])
    assert router.search(situation([0.5, 0.0], []), np.random.default_rng(0)).shape == (0, 2)


def test_what_was_found_a_while_ago_is_followed_as_routes_are_kept() -> None:
    for top, kept in ((1.2 - 0.6 * MARGIN - 0.001, True), (1.2 - 0.6 * MARGIN + 0.001, False)):
        router, _ = world(Wall(top=top), resolution=0.01)
        now = situation([0.5, 1.2], [[1.7, 1.2]])
        assert router.follows(np.array([[1.7, 1.2]]), now) == kept


def test_only_three_goals_are_tried_straight() -> None:
    goals = [[1.5, 0.0], [1.6, 0.0], [1.7, 0.0], [0.0, 1.0]]  # the last takes longest, and is the only one in sight
    router, _ = world(Wall())
    route, _ = router.decide(Route.none(2), situation([0.5, 0.0], goals), np.random.default_rng(0))
    assert route.aim is Aim.NOTHING
    route, _ = router.decide(Route.none(2), situation([0.5, 0.0], goals[1:]), np.random.default_rng(0))
    np.testing.assert_allclose(route.points, [[0.0, 1.0]])


def test_a_route_is_kept_until_six_tenths_of_its_margin_are_lost() -> None:
    rng = np.random.default_rng(0)
    for top, kept in ((1.2 - 0.6 * MARGIN - 0.001, True), (1.2 - 0.6 * MARGIN + 0.001, False)):
        router, _ = world(Wall(top=top), resolution=0.01)
        now = situation([0.5, 1.2], [[1.7, 1.2]])
        route, _ = router.decide(Route(Aim.GOAL, np.array([[1.7, 1.2]])), now, rng)
        assert (route.aim is Aim.GOAL) == kept


def test_a_route_that_is_blocked_late_is_followed_for_want_of_a_better_one() -> None:
    rng = np.random.default_rng(0)
    for start, aim in ((0.1, Aim.GOAL), (0.3, Aim.NOTHING)):  # blocked 0.88 s and 0.68 s from now
        router, _ = world(Wall(top=9.0), resolution=0.01)
        now = situation([start, 0.0], [[1.7, 0.0]])
        route, wants = router.decide(Route(Aim.GOAL, np.array([[1.7, 0.0]])), now, rng)
        assert (route.aim, wants) == (aim, True)


def test_way_points_are_passed_where_they_are_near_or_needless() -> None:
    def shortened(q: Any, points: Any, wall: Wall | None = None, coarse: Array = MARGINS) -> Array:
        router, _ = world(wall or Wall())
        return router.shortcut(Route(Aim.GOAL, np.array(points)), situation(q, []), MARGINS, coarse).points

    around = [[0.5, 1.1], [1.7, 1.1], [1.7, 0.0]]
    np.testing.assert_allclose(shortened([0.5, 0.0], around), around)  # nothing is in sight but the next
    np.testing.assert_allclose(shortened([0.5, 1.1 - 0.049], around), around[1:])
    np.testing.assert_allclose(shortened([1.7, 0.9], around), around[-1:])  # the last is seen past the others
    np.testing.assert_allclose(shortened([0.5, 1.06], around), around[1:])  # the next but one is in sight
    np.testing.assert_allclose(shortened([1.7, 0.0], around[-1:]), around[-1:])  # the last stays
    # A way that keeps the coarse margins alone: passed from within 0.3 rad of the way point.
    low = [[0.5, 1.02], [1.7, 1.02], [1.7, 0.0]]
    for below, kept in ((0.29, 2), (0.31, 3)):
        q = [0.5 - below, 1.02]
        assert len(shortened(q, low, coarse=0.4 * MARGINS)) == kept
    assert len(shortened([0.5 - 0.29, 1.02], low)) == 3


def test_stations_of_a_straight_line_are_kept_until_they_are_passed() -> None:
    router, _ = world(Wall())
    line = np.array([[0.1, 0.05], [0.2, 0.1], [0.3, 0.15]])
    rng = np.random.default_rng(0)
    for q, left in (
        ([0.0, 0.0], 3),
        ([0.092, 0.041], 2),  # within 0.01 rad of the first
        ([0.088, 0.05], 3),
        ([0.13, -0.009], 2),  # beyond the first, if aside
        ([0.13, -0.011], 3),
        ([0.25, 0.1], 1),
        ([0.9, 0.5], 1),  # the last stays
    ):
        route, wants = router.decide(Route(Aim.LINE, line), situation(q, line[-1:]), rng)
        np.testing.assert_array_equal(route.points, line[3 - left :])
        assert route.aim is Aim.LINE and not wants
        # Way points of another route are dropped where the last is in sight.
        assert len(router.decide(Route(Aim.GOAL, line), situation(q, line[-1:]), rng)[0].points) == 1
    # Where it is blocked, it is given up like any other.
    router, _ = world(Wall(top=9.0), resolution=0.01)
    across = np.array([[0.9, 0.0], [1.7, 0.0]])
    route, wants = router.decide(Route(Aim.LINE, across), situation([0.3, 0.0], [[1.7, 0.0]]), rng)
    assert (route.aim, wants) == (Aim.NOTHING, True)


def test_a_line_is_travelled_gently_from_what_is_not_passed() -> None:
    router, _ = world(Wall())
    router.acceleration = np.array([4.0, 4.0])
    line = np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])
    q, v = np.array([0.15, 0.0]), np.zeros(2)
    gentle, quick = (router.travel(q, Route(aim, line[1:]), v) for aim in (Aim.LINE, Aim.GOAL))
    # Set off along with eight tenths of the acceleration, 3.2 rad/s², and braked on with three tenths of that.
    peak = np.sqrt(2 * 0.15 / (1 / 4.0 + 1 / 2.4))
    assert quick.duration == pytest.approx(peak / 4.0 + peak / 2.4), "others with six tenths"
    peak = np.sqrt(2 * 0.15 / (1 / 3.2 + 1 / 0.96))
    assert gentle.duration == pytest.approx(peak / 3.2 + peak / 0.96)
    np.testing.assert_allclose(gentle.at(np.array([peak / 3.2]))[0, 0], 0.15 + peak**2 / 6.4)
    # A way point that lies behind is no place to go to, even before that was decided.
    assert router.travel(q, Route(Aim.LINE, line), v).duration == pytest.approx(gentle.duration)
    assert router.travel(q, Route(Aim.GOAL, line), v).duration > quick.duration


@pytest.mark.parametrize(("turn", "share"), [(1.0, 0.6), (-1.0, 0.3)])
def test_a_line_up_is_braked_on_harder_than_one_down(turn: float, share: float) -> None:
    router, scene = world(Wall())
    router.acceleration = np.array([4.0, 4.0])
    height = np.array([turn, 0.0])  # of the tool [m/rad]

    def tool(q: Array) -> Array:
        X_WT = np.zeros((len(q), 4, 4))
        X_WT[:, 2, 3] = q @ height
        return X_WT

    scene.chain.tool = tool
    peak = np.sqrt(2 * 0.15 / (1 / 3.2 + 1 / (3.2 * share)))
    way = router.travel(np.zeros(2), Route(Aim.LINE, np.array([[0.15, 0.0]])), np.zeros(2))
    assert way.duration == pytest.approx(peak / 3.2 + peak / (3.2 * share))


def test_the_arm_steps_aside_from_what_comes_and_stays_where_nothing_does() -> None:
    wall = Wall(where=0.0, during=(0.5, 9.0))
    router, _ = world(wall)
    now = situation([0.0, 0.0], [], moving=True)
    route, _ = router.decide(Route.none(2), now, np.random.default_rng(0))
    assert route.aim is Aim.REFUGE
    assert abs(route.points[0][0]) >= 0.1 + MARGIN + 0.02 and route.points[0][0] < 1.0 - MARGIN
    # Of the refuges it takes one of the nearest; it stays with the one that it has.
    again, _ = router.decide(route, now, np.random.default_rng(5))
    np.testing.assert_array_equal(again.points, route.points)
    assert (np.abs(route.points[0]) / SPEED).max() < 0.6
    safe, _ = router.decide(route, situation([0.0, 0.5], [], moving=False), np.random.default_rng(0))
    assert safe.aim is Aim.NOTHING


def test_refuges_are_drawn_at_growing_distances_within_the_limits() -> None:
    wall = Wall(where=0.0, during=(0.5, 9.0))
    router, _ = world(wall)
    now = situation([0.0, 2.4], [], moving=True)
    wall.asked.clear()
    router._aside(Route.none(2), now, MARGINS, np.random.default_rng(3))
    tried = next(q for q, _ in wall.asked if len(q) == 48)
    scale = np.linspace(0.1, 0.7, 48)[:, None]
    drawn = [0.0, 2.4] + scale * np.random.default_rng(3).standard_normal((48, 2))
    np.testing.assert_allclose(tried, np.clip(drawn, router.scene.lower, router.scene.upper))


def test_what_moves_is_asked_at_the_times_and_after_them() -> None:
    """The search wants a configuration free when the arm comes at the earliest, and 0.4 and 0.8 s later."""
    wall = Wall(top=9.0)
    router, _ = world(wall, checks=40)
    now = situation([0.0, 0.0], [[1.7, 0.0]], moving=True)
    router._search(now, now.goals, MARGINS, np.random.default_rng(0))
    moving = [(q, times) for q, times in wall.asked if len(q) and (times != 0.0).any()]
    assert moving
    for q, times in moving:
        arrival = (np.abs(q - now.q) / SPEED).max(axis=1)
        np.testing.assert_allclose(
            (times - arrival).reshape(-1, 3), np.tile([0.0, 0.4, 0.8], (len(q) // 3, 1)), atol=1e-12
        )


def test_a_route_leads_to_the_goal_at_its_end() -> None:
    now = situation([0.0, 0.0], [[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]])
    assert now.goal_of(Route(Aim.GOAL, np.array([[0.0, 1.0], [0.9, 0.1]]))) == 2
    assert now.goal_of(Route(Aim.REFUGE, np.array([[0.9, 0.1]]))) == 0
    assert now.goal_of(Route.none(2)) == 0
    assert situation([0.0, 0.0], []).goal_of(Route.none(2)) is None


def test_what_is_not_kept_now_cannot_be_asked_of_the_way() -> None:
    """Less 3 mm; but 3 mm always, except of a guess that the arm is inside of, by no more than a guess may be off."""
    now = situation([0.0, 0.0], [[0.0, 1.0]])
    known = replace(now.forecast, unsure={0: Unsure(np.zeros((1, 2)), 0.0, 0.0, True, 0.0)})
    for forecast, here, kept in (
        (known, 0.004, 0.003),
        (known, -0.01, 0.003),
        (now.forecast, 0.004, 0.001),
        (now.forecast, -0.01, -0.013),
        (now.forecast, -0.05, -INSIDE),
    ):
        close = replace(now, forecast=forecast, here=np.array([0.02, here, 1.0]))
        np.testing.assert_allclose(close.allowed(MARGINS), [0.017, kept, 0.012])
        at_goal = replace(close, at_goals=np.array([[1.0, here, 1.0]]), still=np.ones(2, dtype=bool))
        floor = max(here - FOLLOWED, 0.01) if forecast is known else max(here - FOLLOWED, -INSIDE)
        assert at_goal.margins(0)[1] == pytest.approx(floor)


def test_roomy_goals_are_gone_to_first_where_there_is_a_way() -> None:
    """Of two goals behind the wall the one that nothing is near to, though it is farther."""
    router, _ = world(Wall())
    now = situation([0.5, 0.0], [[1.5, 0.0], [1.9, 0.0]])
    tight = now.at_goals.copy()
    tight[0, 0] = 0.5 * MARGIN
    for at_goals, there in ((tight, [1.9, 0.0]), (tight[::-1], [1.5, 0.0])):
        points = router.search(replace(now, at_goals=at_goals), np.random.default_rng(0))
        np.testing.assert_allclose(points[-1], there)
    # One that is in the wall is none, however roomy it is said to be.
    only = replace(situation([0.5, 0.0], [[1.5, 0.0], [1.1, 0.0]]), at_goals=tight)
    np.testing.assert_allclose(router.search(only, np.random.default_rng(0))[-1], [1.5, 0.0])


@pytest.fixture(scope="module")
def boxed() -> Any:
    """The Panda between two sides of a tall box."""
    from twin_diagram import scenario
    from twin_diagram.assets import Asset
    from twin_diagram.planning.collision.collision_scene import load_scene
    from twin_diagram.scenario.resources import models_dir

    library = {"sugar_box": Asset.load(models_dir() / "objects" / "sugar_box")}
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], library)


def test_a_box_between_is_passed_over_no_higher_than_need_be(boxed: Any) -> None:
    from twin_diagram.planning.paths.guide import Guide, GuideSettings
    from twin_diagram.signals.layouts import ObjectStatus, Track

    q, goal = np.array([-0.6, 0.3, 0.0, -2.2, 0.0, 2.5, 0.785]), np.array([0.6, 0.3, 0.0, -2.2, 0.0, 2.5, 0.785])
    tool = boxed.chain.tool(boxed.chain.place(np.stack([q, 0.5 * (q + goal)])))[:, :3, 3]
    pose = np.array([1.0, 0, 0, 0, tool[1, 0], 0.0, 0.0875])
    guide = Guide(boxed, GuideSettings(np.full(7, 1.0), 0.04, [], np.full(7, 5.0)))

    def decided(tracks: Array, fresh: bool) -> tuple[Route, bool]:
        now = guide.situation(q, boxed.forecast(tracks), goal[None])
        return guide.router.decide(Route.none(7), now, np.random.default_rng(0), fresh=fresh)

    box = Track(ObjectStatus.TRACKED, 0.0, pose, np.zeros(6), 1e-8 * np.eye(6)).pack()
    route, wants = decided(box, True)
    assert route.aim is Aim.GOAL and len(route.points) == 2 and not wants
    np.testing.assert_array_equal(route.points[1], goal)
    above = boxed.chain.tool(boxed.chain.place(route.points[:1]))[0, :3, 3]
    assert 0.05 < above[2] - tool[1, 2] < 0.35 and np.abs(above[:2] - tool[1, :2]).max() < 0.05
    lowest = min(height for height in guide.router.tuning.lifts if abs(above[2] - tool[1, 2] - height) < 0.03)
    now = guide.situation(q, boxed.forecast(box), goal[None])
    for height in guide.router.tuning.lifts:
        way = np.stack([guide.router.lifted(0.5 * (q + goal), height), goal])
        wanted = now.allowed(now.margins(0, guide.router.tuning.spare))
        assert (guide.router.first_blocked(now, way, wanted) is None) == (height >= lowest)
    # A goal that is not new is left to the search; nothing in between needs no way over it.
    assert decided(box, False)[0].aim is not Aim.GOAL
    far = Track(ObjectStatus.GONE, 0.0, pose, np.zeros(6), 1e-8 * np.eye(6)).pack()
    np.testing.assert_array_equal(decided(far, True)[0].points, goal[None])


@pytest.mark.parametrize("turned", [0.0, 4.0, -5.5])
def test_a_lift_goes_straight_up_however_far_joints_have_turned(turned: float) -> None:
    """A UR5e's joints turn by ±2π; from beyond half a turn a lift of 6 cm went 0.4 m aside, back to within it."""
    from twin_diagram import scenario
    from twin_diagram.planning.collision.collision_scene import load_scene

    scene = load_scene(scenario.ArmModel(model="arms/ur5e.urdf", tool_frame=""), [scenario.Fixture()], {})
    router, q = Router(scene, np.full(6, 1.0)), np.array([turned, -1.2, 1.5, -1.8, -1.57, turned])
    up = router.lifted(q, 0.06)
    before, after = scene.chain.tool(scene.chain.place(np.stack([q, up])))[:, :3, 3]
    np.testing.assert_allclose(after - before, [0.0, 0.0, 0.06], atol=2e-3)
    assert np.abs(up - q).max() < 0.1
    at_limit = router.lifted(np.where(np.arange(6) == 1, scene.lower, q), 0.06)
    assert (at_limit >= scene.lower).all() and (at_limit <= scene.upper).all()


def test_an_arm_whose_load_touches_its_support_rises_first_and_no_other(boxed: Any) -> None:
    """Planner and search alike: both know it from what the hand holds."""
    from twin_diagram import scenario
    from twin_diagram.planning.mpc.planner import MotionPlanner
    from twin_diagram.signals.hand import Hand

    block = np.array([[i, j, k] for i in (-0.02, 0.02) for j in (-0.02, 0.02) for k in (-0.02, 0.02)])
    planner = MotionPlanner(boxed, np.full(7, 2.0), scenario.Planner(), pieces_O=[(block,)])
    assert not planner.router.rises
    for on_support in (True, False):
        hand = Hand(held=0, on_support=on_support).pack().tobytes()
        assert planner.holding(hand).router.rises == on_support
        assert planner.guide.holding(hand).router.rises == on_support
