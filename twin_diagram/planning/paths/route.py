"""Finds the way: which joint goal, by which way points, and where to stand aside when there is none.

A route is a list of way points still ahead, the last being where it ends. It is followed from wherever the arm is, so
a route stays good while the optimiser bends the motion around what comes near.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.chain import drawn_range
from twin_diagram.planning.collision.collision_scene import Scene
from twin_diagram.planning.paths import lifting, rrt_connect
from twin_diagram.planning.paths.route_tuning import RouteTuning
from twin_diagram.planning.paths.situation import Aim, Route, Situation
from twin_diagram.planning.paths.time_optimal import SpeedProfile, profile
from twin_diagram.signals.arrays import Array, Ints

STEEP: Final = ((True, False), (True, True))
"""Shapes of ways over things: straight up at first, and straight down at the end as well."""


class Router:
    """Finds routes. Holds constants alone.

    Args:
        scene: shapes and limits.
        speed: (n,) the speed at which routes are travelled [rad/s].
        tuning: None for the defaults.
        acceleration: (n,) with which [rad/s²]; None: no limit.
        rises: whether what is held rests on something: it is lifted off before it goes anywhere.
    """

    def __init__(
        self,
        scene: Scene,
        speed: Array,
        tuning: RouteTuning | None = None,
        acceleration: Array | None = None,
        *,
        rises: bool = False,
    ) -> None:
        self.scene, self.speed, self.rises = scene, speed, rises
        self.acceleration = np.full(len(speed), np.inf) if acceleration is None else acceleration
        self.tuning = tuning or RouteTuning()
        self._drawn: Final = drawn_range(scene.lower, scene.upper)

    def timed(self, points: Array) -> tuple[Array, Array]:
        """Return the configurations along straight lines between points (W, n), and the times of arrival [s]."""
        pieces: list[Array] = [points[:1]]
        times: list[Array] = [np.zeros(1)]
        now = 0.0
        for a, b in pairwise(points):
            line = rrt_connect.interpolate(a, b, self.tuning.resolution)
            took = float((np.abs(b - a) / self.speed).max())
            pieces.append(line)
            times.append(now + took * np.arange(1, len(line) + 1) / len(line))
            now += took
        return np.concatenate(pieces), np.concatenate(times)

    def travel(self, q: Array, route: Route, v: Array | None = None) -> SpeedProfile:
        """Return the quickest way along a route from where the arm is, (n,), at velocity v; None: at rest.

        All end gently, straight lines down the most: up there is nothing to run into.
        """
        tuning, line = self.tuning, route.aim is Aim.LINE
        down = line and lifting.higher(self.scene.chain, q, route.points[-1]) <= 0.0
        share, gentle = tuning.line_acceleration if line else 1.0, tuning.line_braking if down else tuning.braking
        return profile(np.vstack([q, self._ahead(q, route)]), self.speed, share * self.acceleration, v, gentle)

    def _ahead(self, q: Array, route: Route) -> Array:
        """Return the way points (W, n) of a route that are ahead: of a line those that are not passed."""
        points = route.points
        if route.aim is Aim.LINE:
            while len(points) > 1 and self._passed(q, points):
                points = points[1:]
        return points

    def first_blocked(self, now: Situation, points: Array, margins: Array) -> float | None:
        """Tell when the way from where the arm is along `points` (W, n) is blocked first [s]; None if never."""
        q, times = self.timed(np.vstack([now.q, points]))
        stay = np.arange(times[-1] + 0.4, self.tuning.horizon + 0.2, 0.4)
        q = np.vstack([q[1:], np.repeat(q[-1:], len(stay), axis=0)])
        times = np.concatenate([times[1:], stay])
        reach, own = float(margins.max()) + 1e-6, float(margins[-1]) + 1e-6
        distance = self.scene.clearance.distances(q, self.scene.around(now.forecast, times), reach, own_reach=own)
        bad = (distance < margins).any(axis=1)
        return float(times[np.argmax(bad)]) if bad.any() else None

    def ends_free(self, now: Situation, ends: Array, margins: Array) -> npt.NDArray[np.bool_]:
        """Return (G,) bool: where the arm may stay from its earliest arrival to the horizon."""
        arrival = (np.abs(ends - now.q) / self.speed).max(axis=1)
        return self._free_at(now, ends, np.stack([arrival, np.maximum(arrival, self.tuning.horizon)], axis=1), margins)

    def decide(
        self, route: Route, now: Situation, rng: np.random.Generator, *, fresh: bool = False
    ) -> tuple[Route, bool]:
        """Choose the route from here on, among those that need no search.

        Args:
            route: the present one.
            now: the situation.
            rng: of this tick.
            fresh: whether the goal is new, so that a little more is tried.

        Returns:
            The route, and whether a search might find a better one.
        """
        spare, share = self.tuning.spare, self.tuning.blocked
        coarse = now.allowed(now.margins(now.goal_of(route)), share)
        blocked_at: float | None = None
        if route.to_goal and len(route.points):
            route = self.shortcut(route, now, now.allowed(now.margins(now.goal_of(route), spare)), coarse)
            blocked_at = self.first_blocked(now, route.points, coarse)
            if blocked_at is None:
                return route, False
        free, wanted = self._free_goals(now)
        found = None if self.rises else self._plain(now, free, wanted) if fresh else self._direct(now, free, wanted)
        if found is not None:
            return Route(Aim.GOAL, found), False
        if blocked_at is not None and blocked_at > self.tuning.near_future:
            return route, bool(len(free))
        return self._aside(route, now, coarse, rng), bool(len(free))

    def search(self, now: Situation, rng: np.random.Generator) -> Array:
        """Return way points (W, n) to one of the goals: plain ones, else the quickest found; W = 0: none."""
        free, wanted = self._free_goals(now)
        if self.rises:
            return self._risen(now, free, wanted, rng)
        found = self._plain(now, free, wanted)
        plain = found is not None
        roomy = free[now.at_goals[free, :-1].min(axis=1, initial=np.inf) >= now.clearance]
        for goals in (roomy, free) if len(roomy) < len(free) else (free,):
            if found is None and len(goals):
                least: Array = wanted[goals].min(axis=0)
                found = self._search(now, now.goals[goals], least, rng)
        if not plain:
            found = self._quickest(now, found, self._over(now, free, wanted, STEEP))
        return np.zeros((0, len(now.q))) if found is None else found

    def follows(self, points: Array, now: Situation) -> bool:
        """Return whether way points (W, n) that were found a while ago are still good enough to be followed."""
        route = Route(Aim.GOAL, points)
        coarse = now.allowed(now.margins(now.goal_of(route)), self.tuning.blocked)
        return self.first_blocked(now, points, coarse) is None

    def wanted_at(self, now: Situation) -> Array:
        """Return the margins (G, B + 1) that must be kept at each of the goals, for a way to lead there [m]."""
        rows = [now.allowed(now.margins(g, self.tuning.spare)) for g in range(len(now.goals))]
        return np.array(rows).reshape(-1, len(now.here))

    def _free_goals(self, now: Situation) -> tuple[Ints, Array]:
        """Return which goals are free, the nearest first, and the margins (G, B + 1) that are wanted at each."""
        count = len(now.goals)
        if not count:
            return np.zeros(0, dtype=int), np.zeros((0, len(now.here)))
        wanted = self.wanted_at(now)
        free = np.flatnonzero(self.ends_free(now, now.goals, wanted))
        takes = np.abs(now.goals[free] - now.q) / self.speed
        far = takes.max(axis=1) + self.tuning.swing * takes.mean(axis=1)
        tight = 1.0 - now.at_goals[free, :-1].min(axis=1, initial=now.clearance) / now.clearance
        return free[np.argsort(far + self.tuning.roomier * tight, kind="stable")], wanted

    def _direct(self, now: Situation, free: Ints, wanted: Array) -> Array | None:
        """Return the first of the nearest free goals, (1, n), that a straight line leads to."""
        for g in free[: self.tuning.direct]:
            if self.first_blocked(now, now.goals[g][None], wanted[g]) is None:
                return np.asarray(now.goals[g][None])
        return None

    def _plain(self, now: Situation, free: Ints, wanted: Array) -> Array | None:
        """Return the quicker way (W, n) of one straight to a goal and one over what is in between; None: neither."""
        direct = self._direct(now, free, wanted)
        if direct is not None and np.array_equal(direct[0], now.goals[free[0]]):
            return direct
        over = self._over(now, free, wanted)
        if over is None and direct is not None:  # straight to a goal farther off: perhaps around the arm's own back
            over = self._over(now, free, wanted, STEEP)
        return self._quickest(now, direct, over)

    def _quickest(self, now: Situation, *ways: Array | None) -> Array | None:
        every = [way for way in ways if way is not None]
        return min(every, key=lambda way: self.travel(now.q, Route(Aim.GOAL, way)).duration, default=None)

    def _over(
        self, now: Situation, free: Ints, wanted: Array, shapes: tuple[tuple[bool, bool], ...] = ((False, False),)
    ) -> Array | None:
        """Return a way (W, n) to one of the nearest free goals that lifts the tool, no more than need be; else None.

        Over a lifted middle; of `shapes` those that rise go straight up at first, to the nearest goal alone, as a hand
        that turns between things that stand close to it would come nearer to them; those that fall end straight down.
        """
        goals = free[: self.tuning.over]
        for rises, falls in shapes if len(goals) else ():
            for height in self.tuning.lifts:
                up = self.lifted(now.q, height) if rises else now.q
                for g in goals[:1] if rises else goals:
                    goal = now.goals[g]
                    middle = self.lifted(goal if falls else 0.5 * (now.q + goal), height)
                    way = np.stack([up, middle, goal] if rises else [middle, goal])
                    if self.first_blocked(now, way, wanted[g]) is None:
                        return way
        return None

    def _risen(self, now: Situation, free: Ints, wanted: Array, rng: np.random.Generator) -> Array:
        """Return way points (W, n) to a goal that begin straight up: nothing is dragged along what it stands on."""
        found = self._over(now, free, wanted, STEEP)
        if found is None and len(free):
            least: Array = wanted[free].min(axis=0)
            up = self.lifted(now.q, self.tuning.lifts[0])
            if self.first_blocked(now, up[None], least) is None:
                beyond = self._search(replace(now, q=up), now.goals[free], least, rng)
                found = None if beyond is None else np.vstack([up, beyond])
        return np.zeros((0, len(now.q))) if found is None else found

    def lifted(self, q: Array, height: float) -> Array:
        """Return joint angles (n,) near `q` with the tool so much higher [m], within the range that is drawn from.

        A joint that is beyond it goes no further, and is not taken back to it either.
        """
        limits = np.minimum(self._drawn[0], q), np.maximum(self._drawn[1], q)
        return lifting.lifted(self.scene.chain, q, height, limits, self.tuning.lift_steps)

    def shortcut(self, route: Route, now: Situation, margins: Array, coarse: Array) -> Route:
        """Drop way points that are reached, or needless from here.

        The motion rounds off a sharp corner and may never come up to its way point, so near one it is enough that the
        way beyond is free by the `coarse` margins, by which the route itself is kept.
        """
        points = self._ahead(now.q, route)
        if route.aim is Aim.LINE:
            return replace(route, points=points)
        while len(points) > 1 and self._reached(now.q, points[0]):
            points = points[1:]
        if len(points) > 1 and not self.rises:
            if self.first_blocked(now, points[-1:], margins) is None:
                points = points[-1:]
            else:
                near = np.abs(points[0] - now.q).max() < self.tuning.way_point_near
                if self.first_blocked(now, points[1:2], coarse if near else margins) is None:
                    points = points[1:]
        return replace(route, points=points)

    def _reached(self, q: Array, point: Array) -> bool:
        """Tell whether a way point (n,) is near enough to `q`; where it rises, by height, too."""
        off = np.abs(point - q).max()
        if not self.rises:
            return bool(off < self.tuning.way_point_reached)
        if off >= self.tuning.risen * self.tuning.way_point_reached:
            return False
        return lifting.higher(self.scene.chain, q, point) < self.tuning.lacking * self.tuning.lifts[0]

    def _passed(self, q: Array, points: Array) -> bool:
        """Tell whether the first way point of a line lies behind `q` (n,), or is reached."""
        near = np.abs(points[0] - q).max() < self.tuning.station_reached
        return bool(near or (q - points[0]) @ (points[1] - points[0]) > 0.0)

    def _search(self, now: Situation, goals: Array, margins: Array, rng: np.random.Generator) -> Array | None:
        def is_free(q: Array) -> npt.NDArray[np.bool_]:
            arrival = (np.abs(q - now.q) / self.speed).max(axis=1)
            return self._free_at(now, q, arrival[:, None] + np.array(self.tuning.dwell), margins)

        found = rrt_connect.plan(
            now.q,
            goals,
            is_free,
            *self._drawn,
            rng,
            self.tuning.checks,
            weights=1.0 / self.speed,
        )
        return None if found is None else found[1:]

    def _aside(self, route: Route, now: Situation, margins: Array, rng: np.random.Generator) -> Route:
        """Stay where that is safe, else go where it is."""
        n = len(now.q)
        if self.ends_free(now, now.q[None], margins)[0]:
            return Route.none(n)
        if route.aim is Aim.REFUGE and len(route.points) and self.first_blocked(now, route.points, margins) is None:
            return route
        tries = self.tuning.refuge_tries
        scale = np.linspace(0.1, 0.7, tries)[:, None]
        q = np.clip(now.q + scale * rng.standard_normal((tries, n)), self.scene.lower, self.scene.upper)
        q = q[self.ends_free(now, q, now.allowed(now.margins(None, self.tuning.spare)))]
        for candidate in q[np.argsort((np.abs(q - now.q) / self.speed).max(axis=1), kind="stable")][:4]:
            if self.first_blocked(now, candidate[None], margins) is None:
                return Route(Aim.REFUGE, candidate[None])
        return Route.none(n)

    def _free_at(self, now: Situation, q: Array, times: Array, margins: Array) -> npt.NDArray[np.bool_]:
        """Return (M,) bool: configurations (M, n) that keep the margins at each of their times (M, T).

        Margins are (B + 1,), the same for all, or (M, B + 1).
        """
        scene = self.scene
        reach = float(margins.max()) + 1e-6
        count = len(q)
        still = replace(now.forecast, present=now.forecast.present & ~now.forecast.moving)
        own_reach = float(margins[..., -1].max()) + 1e-6
        distance = scene.clearance.distances(q, scene.around(still, np.zeros(count)), reach, own_reach=own_reach)
        free: npt.NDArray[np.bool_] = np.all(distance >= margins, axis=1)
        rows = np.flatnonzero(free)
        if now.forecast.moving.any() and len(rows):
            moving = scene.around(
                replace(now.forecast, present=now.forecast.moving), times[rows].ravel(), fixtures=False
            )
            again = np.repeat(q[rows], times.shape[1], axis=0)
            near = scene.clearance.distances(again, moving, reach, own=False)
            kept = margins if margins.ndim == 1 else np.repeat(margins[rows], times.shape[1], axis=0)
            free[rows] = (near >= kept).all(axis=1).reshape(len(rows), -1).all(axis=1)
        return free
