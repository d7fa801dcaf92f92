"""Says why no way leads to a goal: out of reach, something stands there, the arm itself, or no way found between.

Asked of a planner that stands still, beside its ticks: nothing here is on the way of a command.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from twin_diagram.planning.paths.route import Router
from twin_diagram.planning.paths.situation import Situation
from twin_diagram.signals.arrays import Array


class HindranceKind(Enum):
    """Why no way leads to a goal, by the words of ``events.jsonl``."""

    OUT_OF_REACH = "out_of_reach"
    """No joint position puts the tool there."""
    BLOCKED = "blocked"
    """A body is too near at every joint position that does."""
    ITSELF = "itself"
    """The arm is too near to itself there."""
    NOT_FOUND = "not_found"
    """A joint position is free, but no way to it was found."""


@dataclass(frozen=True)
class Hindrance:
    """Why no way leads to a goal, told of the joint goal that lacks least.

    Attributes:
        reason: see there.
        body: column of what is in the way, as in `Situation.at_goals`; None where nothing is.
        near: how near the arm would come to it; negative: so deep [m].
        kept: how much is always kept from it [m].
        name: of the body, for people.
        holding: whether what the hand holds counts as the arm.
    """

    reason: HindranceKind
    body: int | None = None
    near: float = np.nan
    kept: float = np.nan
    name: str = ""
    holding: bool = False

    def sentence(self) -> str:
        """Return it for people."""
        arm = "the arm with what it holds" if self.holding else "the arm"
        if self.reason is HindranceKind.OUT_OF_REACH:
            return "no joint positions found that reach it"
        if self.reason is HindranceKind.NOT_FOUND:
            return f"{arm} would be free at the goal, but no way there was found"
        whom = "itself" if self.reason is HindranceKind.ITSELF else self.name
        kept = f"and keeps {1e3 * self.kept:.0f} mm"
        if self.near < 0.0:
            return f"at the goal {arm} would reach {-1e3 * self.near:.0f} mm into {whom} {kept}"
        # Rounded down: what keeps 10 mm is not to be told of as being 10 mm away.
        return f"at the goal {arm} would come within {np.floor(1e3 * self.near + 1e-6):.0f} mm of {whom} {kept}"


def why_no_way(at_goals: Array, wanted: Array) -> Hindrance:
    """Return why no way leads to joint goals, when none does.

    Args:
        at_goals: (G, B + 1) distances at them, to each body and, last, of the arm to itself [m]; G may be zero.
        wanted: (G, B + 1) what must be kept there [m].
    """
    if not len(at_goals):
        return Hindrance(HindranceKind.OUT_OF_REACH)
    lack = wanted - at_goals
    worst = lack.max(axis=1)
    goal = int(worst.argmin())
    if worst[goal] <= 0.0:
        return Hindrance(HindranceKind.NOT_FOUND)
    body = int(lack[goal].argmax())
    reason = HindranceKind.ITSELF if body == lack.shape[1] - 1 else HindranceKind.BLOCKED
    return Hindrance(reason, body, float(at_goals[goal, body]), float(wanted[goal, body]))


def distances_at_ends(router: Router, now: Situation) -> Array:
    """Return distances at the goals (G, B + 1) [m]: of what moves the least from the earliest arrival to the horizon.

    As `Router.ends_free` looks at them.
    """
    result, moving = now.at_goals.copy(), now.forecast.moving
    if not moving.any() or not len(now.goals):
        return result
    arrival = (np.abs(now.goals - now.q) / router.speed).max(axis=1)
    times = np.stack([arrival, np.maximum(arrival, router.tuning.horizon)], axis=1)
    around = router.scene.around(replace(now.forecast, present=moving), times.ravel(), fixtures=False)
    q = np.repeat(now.goals, times.shape[1], axis=0)
    reach = now.clearance + router.tuning.spare + 1e-6
    near = router.scene.clearance.distances(q, around, reach, own=False)
    least = near.reshape(*times.shape, -1).min(axis=1)
    result[:, :-1] = np.where(now.still, result[:, :-1], least[:, :-1])
    return result
