"""What plans keep from what is around: more of what may come, less of what rests and is near anyway. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.paths.guide import TUNING as GUIDE
from twin_diagram.planning.paths.situation import FOLLOWED, Situation
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How near and how soon; chosen by hand, as `planner.Tuning` is."""

    approach: float = 0.1
    """How fast the margin grows to its full size away from a goal next to a thing [m/s of travel]."""

    at_goal: float = 0.15
    """Next to a goal margins are small from so long before it on [s]: a motion that is off by millimetres takes that
    long to be there."""

    surprise_time: float = 1.0
    """Plans keep `guide.Tuning.surprise` more from what lies so far ahead or farther [s], and less up to there."""


TUNING = Tuning()


def at_samples(now: Situation, samples: Array, duration: float, *, stays: bool = False) -> Array:
    """Return (M, B + 1) the distances to keep at the samples (M,), on a way that takes so long [s].

    Plans keep more the farther ahead, so that there is room left when something does what was not foreseen. What rests
    and is near now is left as gently as it would be come up to: nobody is to be jerked away from it. An arm that has no
    goal, and `stays`, leaves nothing that rests: it may hold what stands there.
    """
    extra = GUIDE.surprise * np.minimum(samples / TUNING.surprise_time, 1.0)
    away = TUNING.approach * np.maximum(duration - TUNING.at_goal - samples, 0.0)
    result = now.margins(0 if len(now.goals) else None, extra, away)
    # What overlaps is left from where it is on: to ask for all of the margin at once would be to leap.
    near = now.here[:-1]
    if stays:
        here, growth = near - FOLLOWED, 0.0
    else:
        here = np.where(near < 0.0, near, np.maximum(near - FOLLOWED, now.least))
        growth = TUNING.approach
    leaving = np.minimum(result[:, :-1], here + growth * samples[:, None])
    result[:, :-1] = np.where(now.still, leaving, result[:, :-1])
    return result


def as_near_as(near: Array, margins: Array, now: Situation, *, lagging: bool = False) -> Array:
    """Return margins (M, B + 1) by which what rests may be as near as it is to a way that was found free.

    Between things that stand close together the hand then keeps to its line, rather than to their middle. Where it may
    lag behind on the way, it may be as near to what it leaves as it is now, and is not jerked away from it.

    Args:
        near: (M, B + 1) distances at the samples of the way.
        margins: without that way.
        now: where the arm is.
        lagging: whether the arm may lag behind.
    """
    if lagging:
        near = np.minimum.accumulate(np.vstack([now.here, near]))[1:]
    result = margins.copy()
    wanted = np.minimum(margins[:, :-1], np.maximum(near[:, :-1] - FOLLOWED, now.floor(now.least)[:-1]))
    result[:, :-1] = np.where(now.still, wanted, margins[:, :-1])
    return result
