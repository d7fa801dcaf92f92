"""What a decision about ways is made from: where the arm is, what is around, where it could go, and along what."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.collision_scene import Forecast
from twin_diagram.signals.arrays import Array

INSIDE: Final = 0.02
"""An arm so deep in a thing whose shape is a guess proves it wrong [m]: what the cover of balls adds to the arm (1 cm),
and the centimetre that the stop monitor asks for. Up to there it may be as near as it is."""
FOLLOWED: Final = 0.003
"""What is so near now may come nearer by this [m]: ways are followed to a millimetre or two."""


class Aim(IntEnum):
    """What a route is for."""

    NOTHING = 0
    """No way is known: wait."""
    GOAL = 1
    REFUGE = 2
    """Out of the way of something that comes."""
    LINE = 3
    """To a goal near by, straight in space: its way points are kept until they are passed."""


@dataclass(frozen=True)
class Route:
    """Way points (W, n) ahead, W >= 0, and what for."""

    aim: Aim
    points: Array

    @property
    def to_goal(self) -> bool:
        """Whether it leads to a goal."""
        return self.aim in (Aim.GOAL, Aim.LINE)

    @staticmethod
    def none(n: int) -> Route:
        """Return the route of an arm that has nowhere to go."""
        return Route(Aim.NOTHING, np.zeros((0, n)))


@dataclass(frozen=True)
class Situation:
    """What a decision is made from.

    Attributes:
        q: (n,) where the arm is [rad].
        forecast: where objects are going.
        goals: (G, n) joint goals that would do; G may be zero.
        here: (B + 1,) distances now, to each body and of the arm to itself [m].
        at_goals: (G, B + 1) the same at the goals, of the objects as they are now.
        still: (B,) bool: bodies that do not move.
        clearance: to keep from bodies [m].
        least: to keep from a body that stands still next to the goal [m].
        own: the arm keeps from itself [m].
    """

    q: Array
    forecast: Forecast
    goals: Array
    here: Array
    at_goals: Array
    still: npt.NDArray[np.bool_]
    clearance: float
    least: float
    own: float

    def margins(self, goal: int | None = None, extra: Array | float = 0.0, away: Array | float = 0.0) -> Array:
        """Return distances to keep on the way to a goal: less of what rests near it, `away` more [m].

        (B + 1,); with `extra` and `away` of M samples (M, B + 1).
        """
        most = self.clearance + np.asarray(extra)[..., None]
        result = np.repeat(most, len(self.here), axis=-1)
        if goal is not None:
            wanted = self.at_goals[goal, :-1] - FOLLOWED + np.asarray(away)[..., None]
            near = np.minimum(np.maximum(wanted, self.floor(self.least)[:-1]), most)
            result[..., :-1] = np.where(self.still, near, result[..., :-1])
        result[..., -1] = self.own
        return result

    def allowed(self, margins: Array, share: float = 1.0) -> Array:
        """Loosen margins for a check: what is not kept now cannot be asked of the way from here."""
        return np.maximum(np.minimum(share * margins, self.here - FOLLOWED), self.floor(FOLLOWED))

    @cached_property
    def guessed(self) -> npt.NDArray[np.bool_]:
        """(B,) bodies whose shapes are guesses: unknown things that rest."""
        guesses = self.forecast.present.copy()
        guesses[list(self.forecast.unsure)] = False
        return np.concatenate([np.zeros(len(self.still) - len(guesses), dtype=bool), guesses])

    def floor(self, least: float) -> Array:
        """Return the distances (B + 1,) asked for in any case [m]: `least`, but of a guess no more than there is.

        What is lifted beside an unknown thing is within what the guess and the cover of balls add to both; straight up
        it comes no nearer, where to get clear first it would be dragged aside.
        """
        result = np.full(len(self.here), least)
        nearer = np.maximum(self.here[:-1] - FOLLOWED, -INSIDE)
        result[:-1] = np.where(self.guessed, np.minimum(nearer, least), least)
        return result

    def goal_of(self, route: Route) -> int | None:
        """Return which goal a route leads to; without a route to one, the first."""
        if not len(self.goals):
            return None
        if route.to_goal and len(route.points):
            return int(np.abs(self.goals - route.points[-1]).max(axis=1).argmin())
        return 0
