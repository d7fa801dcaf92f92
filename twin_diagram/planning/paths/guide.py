"""What is searched for beside the tick: joint goals, and a way to one of them; a pure function of a question."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from twin_diagram.planning.collision.collision_scene import Forecast, Packed, Scene
from twin_diagram.planning.collision.held_shape import holding
from twin_diagram.planning.paths import inverse_kinematics, straight_line
from twin_diagram.planning.paths.no_way import Hindrance, distances_at_ends, why_no_way
from twin_diagram.planning.paths.route import Router
from twin_diagram.planning.paths.situation import Situation
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.pose_vectors import as_matrix


@dataclass(frozen=True)
class Tuning:
    """How near things may be and how much is kept at hand; chosen by hand."""

    least: float = 0.25
    """Share of the clearance that is always wanted, however near to a thing the goal is."""

    least_at_rest: float = 0.6
    """The same where there is no goal: nobody asked to be so near."""

    own_clearance: float = 0.01
    """The arm keeps from itself [m]."""

    surprise: float = 0.02
    """How much more than the clearance plans keep from what lies ahead [m]."""

    goals: int = 8
    """Joint goals that are kept of those found."""

    grips: int = 8
    """Shapes of an arm with something in its hand that are kept at hand: a few for each Context."""


TUNING = Tuning()


@dataclass(frozen=True)
class Question:
    """All that a search depends on; immutable, so that copies are shared.

    Attributes:
        seed: of the random numbers, with what tells this question from others.
        q: (n,) where the arm is [rad].
        goal: (7,) X_WG of the tool frame; an all-zero quaternion: none.
        goals: (G, n) joint goals that are known.
        more_goals: whether to look for joint goals.
        tracks, further, things: as `Scene.forecast` takes them.
        hand: what is held, a packed `Hand`; empty: nothing.
        added: shapes of assets that came later, see `Scene`: a guide in another process does not know them.
        later: the arm sets off so much later than `tracks` are of [s].
    """

    seed: tuple[int, ...]
    q: Array
    goal: Array
    goals: Array
    more_goals: bool
    tracks: Array
    further: Array | None = None
    things: Array | None = None
    hand: bytes = b""
    added: tuple[Packed, ...] = ()
    later: float = 0.0

    def __deepcopy__(self, memo: dict[int, Any]) -> Question:
        return self


@dataclass(frozen=True)
class Answer:
    """What a search found.

    Attributes:
        goals: (G, n) joint goals: those that were known and those found.
        points: (W, n) way points to one of them; W = 0 where none was found.
    """

    goals: Array
    points: Array


@dataclass(frozen=True)
class GuideSettings:
    """What a guide is made of beside shapes.

    Attributes:
        speed: (n,) at which routes are travelled [rad/s].
        clearance: to keep from everything [m].
        pieces_O: corners (m, 3) of the convex pieces of each of the library's objects [m].
        acceleration: (n,) with which routes are travelled [rad/s²]; None: no limit.
        rises: whether what is held rests on something: it is lifted off before it goes anywhere.
    """

    speed: Array
    clearance: float
    pieces_O: Sequence[Sequence[Array]] = field(default_factory=list)
    acceleration: Array | None = None
    rises: bool = False


class Guide:
    """Finds joint goals and ways. Holds constants alone.

    Args:
        scene: shapes and limits, with an empty hand.
        settings: see there.
    """

    def __init__(self, scene: Scene, settings: GuideSettings) -> None:
        self.scene, self.settings = scene, settings
        self.router = Router(scene, settings.speed, acceleration=settings.acceleration, rises=settings.rises)
        self._holding = lru_cache(maxsize=TUNING.grips)(self._made)

    def __reduce__(self) -> tuple[Any, ...]:
        return Guide, (self.scene, self.settings)

    def holding(self, hand: bytes) -> Guide:
        """Return the guide of an arm that holds something, a packed `Hand`; this one where that is empty."""
        return self._holding(hand) if hand else self

    def _made(self, hand: bytes) -> Guide:
        held = Hand.unpack(np.frombuffer(hand))
        scene = holding(self.scene, self.settings.pieces_O[held.held], held)
        return Guide(scene, replace(self.settings, rises=held.on_support))

    def situation(self, q: Array, forecast: Forecast, goals: Array, *, at_rest: bool = False) -> Situation:
        """Return what is near (n,) and at the goals (G, n) of an arm, which may be there without having been asked."""
        q_all = np.vstack([q[None], goals])
        around = self.scene.around(forecast, np.zeros(len(q_all)))
        distance = self.scene.clearance.distances(q_all, around, self._reach)
        return self._situation_of(q, forecast, goals, distance[0], distance[1:], at_rest=at_rest)

    @property
    def _reach(self) -> float:
        """Distances are told apart up to this [m]."""
        return self.settings.clearance + max(self.router.tuning.spare, TUNING.surprise) + 0.01

    def _situation_of(
        self, q: Array, forecast: Forecast, goals: Array, here: Array, at_goals: Array, *, at_rest: bool
    ) -> Situation:
        clearance, fixtures = self.settings.clearance, self.scene.fixture_count
        least = TUNING.least_at_rest if at_rest else TUNING.least
        still = np.concatenate([np.ones(fixtures, dtype=bool), ~forecast.moving])
        own = TUNING.own_clearance
        return Situation(q, forecast, goals, here, at_goals, still, clearance, least * clearance, own)

    def margins_at(self, q: Array, forecast: Forecast, goal: Array, *, at_rest: bool = False) -> Situation:
        """Return a situation that tells margins (n,) and at goals (G, n), G <= 1; not the arm's distance to itself."""
        q_all = np.vstack([q[None], goal])
        around = self.scene.around(forecast, np.zeros(len(q_all)))
        distance = self.scene.clearance.distances(q_all, around, self._reach, own=False)
        return self._situation_of(q, forecast, goal, distance[0], distance[1:], at_rest=at_rest)

    def joint_goals(
        self, q: Array, goal: Array, forecast: Forecast, rng: np.random.Generator, tuning: Any = None
    ) -> Array:
        """Return joint positions (G, n) that put the tool at a goal (7,).

        Those that are clear of everything come first, the nearest first among them.
        """
        found = self.reaching(q, goal, rng, tuning)
        if not len(found):
            return found
        now = self.situation(q, forecast, found)
        clear = (now.at_goals >= np.append(now.floor(now.least)[:-1], now.own)).all(axis=1)
        return found[np.argsort(~clear, kind="stable")][: TUNING.goals]

    def reaching(self, q: Array, goal: Array, rng: np.random.Generator, tuning: Any = None) -> Array:
        """Return joint positions (G, n) that put the tool at a goal (7,), the nearest first, whatever is about."""
        scene = self.scene
        return inverse_kinematics.solve(scene.chain, _pose(goal), q, scene.lower, scene.upper, rng, tuning)

    def straight_way(self, q: Array, goal: Array) -> Array:
        """Return way points (W, n) that take the tool straight to a goal (7,) near by; W = 0: see `straight_line`."""
        return straight_line.straight_way(self.scene.chain, q, _pose(goal), self.scene.lower, self.scene.upper)

    def line(self, q: Array, goal: Array, forecast: Forecast, *, waited: bool = False) -> tuple[Array, bool, bool]:
        """Return way points (W, n) as `straight_way` does, whether they are free, and whether what bars them passes.

        It does where they are free of all that does not move. A way that was waited for keeps whole margins: by those
        that it is followed with it would be given up again half way, beside what the fingers go around.
        """
        points = self.straight_way(q, goal)
        if not len(points):
            return points, False, False
        now = self.situation(q, forecast, points[-1:])
        whole = not waited or self.router.first_blocked(now, points, now.allowed(now.margins(0))) is None
        if whole and self.router.follows(points, now):
            return points, True, False
        still = replace(forecast, present=forecast.present & ~forecast.moving)
        return points, False, self.router.follows(points, self.situation(q, still, points[-1:]))

    def why_no_way(self, q: Array, forecast: Forecast, goals: Array) -> Hindrance:
        """Return why no way leads from an arm that is at (n,) to joint goals (G, n), when none does; G may be zero."""
        now = self.situation(q, forecast, goals)
        return why_no_way(distances_at_ends(self.router, now), self.router.wanted_at(now))

    def answer(self, question: Question) -> Answer:
        """Return what a search finds."""
        guide = self.holding(question.hand)
        rng = np.random.default_rng(list(question.seed))
        forecast = guide.scene.forecast(question.tracks, question.further, question.things, question.added)
        forecast = replace(forecast, later=question.later)
        goals = question.goals
        if question.more_goals:
            goals = together(goals, guide.joint_goals(question.q, question.goal, forecast, rng))
        now = guide.situation(question.q, forecast, goals, at_rest=not np.any(question.goal))
        return Answer(goals, guide.router.search(now, rng))


def together(known: Array, found: Array) -> Array:
    """Return joint goals (G, n) that are known and those found that are others, `Tuning.goals` at most."""
    distinct = inverse_kinematics.IkTuning().distinct
    others = [q for q in found if not len(known) or np.abs(known - q).max(axis=1).min() >= distinct]
    result: Array = np.concatenate([known, np.array(others).reshape(-1, found.shape[1])])
    return result[: TUNING.goals]


def _pose(goal: Array) -> Array:
    """Return a goal (7,) as a matrix (4, 4), whatever the norm of its quaternion."""
    return as_matrix(np.concatenate([goal[:4] / np.linalg.norm(goal[:4]), goal[4:]]))
