"""Whether an arm that is told to stop now still stands before it touches something. Pure functions on arrays.

The stopping motion is followed from one distance query to the next: between two of them nothing can have been used up
of the distances found at the first, for no point of the arm and no obstacle is faster than a bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.braking.stopping_motion import pace, travelled
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    least_step: float = 0.01
    """Two queries are at least so far apart in time [s]: at 0.5 m/s the arm goes 5 mm meanwhile."""

    bend: float = 1.15
    """Links may be faster than at the motion's start by this factor: they turn while they go."""

    approach: float = 0.005
    """The arm counts as coming nearer to a thing above this [m/s]; slower, its own motion does no harm."""

    inside: float = 0.01
    """No real thing has the arm so deep inside [m]: what is guessed of it is wrong where the arm is …"""

    backing: float = 0.08
    """… and there the arm may go deeper at this speed, on its way out [m/s]: plans that back out go 0.05 m/s."""

    widest: float = 0.06
    """Distances are asked for up to this [m]: each pair costs time, and the rest is asked for later."""

    touching: float = 0.001
    """Distances closer to what is to be left than this count as used up [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Nearness:
    """Pairs of a part of the arm and something else, with the arm in one configuration at one time.

    Attributes:
        part: (P,) index of the arm's shape.
        body: (P,) index of the other thing.
        distance: (P,) [m].
        approach: (P,) how fast the arm's own motion takes the distance away, at its full speed [m/s].
        reach: (P,) how fast any point of the arm's shape moves, at full speed [m/s].
    """

    part: npt.NDArray[np.int64]
    body: npt.NDArray[np.int64]
    distance: Array
    approach: Array
    reach: Array


@dataclass(frozen=True)
class Allowances:
    """What is to be left to each of B other things.

    Attributes:
        margin: (B,) distance to be left at the beginning [m].
        growth: (B,) how fast that grows, for what is not known of their motion [m/s].
        speed: (B,) how fast any point of them moves, as far as that is known [m/s].
        guessed: (B,) whether part of its shape is a guess, which the arm itself may prove wrong; empty: of none.
    """

    margin: Array
    growth: Array
    speed: Array
    guessed: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))


@dataclass(frozen=True)
class Breach:
    """The first thing that a motion would come too near to.

    Attributes:
        part, body: which, as in `Nearness`.
        distance: between them then [m].
        time: from now [s].
    """

    part: int
    body: int
    distance: float
    time: float


Query = Callable[[float, float, float], Nearness]
"""Of the time from now [s], the time at full speed that was travelled [s], and how far it looks [m]."""


def breach(query: Query, others: Allowances, reach: float, delay: float, stop: float) -> tuple[Breach | None, int]:
    """Return the first breach of a stopping motion, None where there is none; and how many queries that took.

    Args:
        query: distances along the motion.
        others: what is to be left.
        reach: how fast any point of the arm moves at most, at full speed [m/s].
        delay: until the arm begins to slow down [s].
        stop: that it then takes to be at rest [s].
    """
    end = delay + stop
    margins = others.margin + others.growth * end
    widest = float(margins.max(initial=0.0))
    fastest = float(others.speed.max(initial=0.0))
    time, count = 0.0, 0
    wrong = _Wrong(others)
    while time < end:
        gone, share = travelled(time, delay, stop), pace(time, delay, stop)
        rest = travelled(end, delay, stop) - gone
        needed = widest + TUNING.bend * reach * rest + fastest * (end - time)
        within = min(needed, max(TUNING.widest, 2 * widest)) + TUNING.touching
        near = query(time, gone, within)
        count += 1
        slack = near.distance - (others.margin + others.growth * time)[near.body]
        comes = near.approach * share > np.where(wrong.there(near), TUNING.backing, TUNING.approach)
        bad = np.flatnonzero((slack < TUNING.touching) & comes)
        if len(bad):
            worst = int(bad[np.argmin(slack[bad])])
            return Breach(int(near.part[worst]), int(near.body[worst]), float(near.distance[worst]), time), count
        # Those used up that the arm does not come nearer to are looked at again after the least step.
        live = slack >= TUNING.touching
        rates = TUNING.bend * near.reach * share + (others.speed + others.growth)[near.body]
        steps = slack[live] / np.maximum(rates[live], 1e-9)
        # What was too far to be asked for is no nearer than that; where all was, none of it can come near.
        unseen = (within - widest) / max(TUNING.bend * reach * share + fastest, 1e-9) if within < needed else np.inf
        step = min(float(steps.min(initial=np.inf)), unseen) if live.all() else 0.0
        time += max(step, TUNING.least_step)
    return None, count


class _Wrong:
    """Where guesses are proved wrong by the arm: pairs of its parts and of things that they are deep inside of now."""

    def __init__(self, others: Allowances) -> None:
        self._guessed = others.guessed
        self._pairs: set[tuple[int, int]] | None = None if others.guessed.any() else set()

    def there(self, near: Nearness) -> npt.NDArray[np.bool_]:
        """Return (P,) bool; what is `near` first is what is near now."""
        if self._pairs is None:
            deep = (near.distance < -TUNING.inside) & self._guessed[near.body]
            self._pairs = set(zip(near.part[deep].tolist(), near.body[deep].tolist(), strict=True))
        pairs = zip(near.part.tolist(), near.body.tolist(), strict=True)
        return np.array([pair in self._pairs for pair in pairs], dtype=bool)
