"""How far a piece of work is that goes through known stages or many frames, and how much time is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    least_share: float = 0.2
    """Share of the work that must be done before anything is said of the time left: of three runs of `gap`, what
    came before the search took 0.09 to 0.24 of the time."""

    least_time: float = 2.0
    """Nor is anything said before this [s], or where less is left."""

    period: float = 10.0
    """Of many frames something is said this often [s]."""


TUNING = Tuning()


class Stages:
    """Tells each stage with the time left, as estimated from how long the work before it took."""

    def __init__(
        self, done: Mapping[str, float], say: Callable[[str], None], clock: Callable[[], float] = time.perf_counter
    ) -> None:
        """Start the clock.

        Args:
            done: the share of the work, of 1, that is usually done when the stage of that name begins.
            say: is told.
            clock: [s]
        """
        self._done, self._say, self._clock = done, say, clock
        self._begin, self._share = clock(), 0.0

    def __call__(self, stage: str) -> None:
        """Tell that a stage begins; one that is not known is told as it is."""
        self._share = max(self._share, self._done.get(stage, 0.0))
        elapsed = self._clock() - self._begin
        left = elapsed * (1.0 / self._share - 1.0) if self._share >= TUNING.least_share else 0.0
        if stage not in self._done or min(elapsed, left) < TUNING.least_time:
            self._say(stage)
        else:
            self._say(f"{stage} ({spoken(elapsed)} so far, about {spoken(left)} left)")


class Pace:
    """Tells now and then how many frames are done, with the time left; the first one may be a slow one."""

    def __init__(self, frames: int, say: Callable[[str], None], clock: Callable[[], float] = time.perf_counter) -> None:
        """Start the clock.

        Args:
            frames: how many there are.
            say: is told.
            clock: [s]
        """
        self._frames, self._say, self._clock = frames, say, clock
        self._told, self._second = clock(), 0.0

    def __call__(self, done: int) -> None:
        """Tell that so many frames are done, from 1 on, once the last word is a while ago."""
        now = self._clock()
        if done == 1:
            self._second = now
        if now - self._told < TUNING.period or done == self._frames:
            return
        self._told = now
        left = (now - self._second) / (done - 1) * (self._frames - done) if done > 1 else 0.0
        more = f", about {spoken(left)} left" if left >= TUNING.least_time else ""
        self._say(f"{done} of {self._frames} frames{more}")


def spoken(seconds: float) -> str:
    """Return a time as people say it: 40 s, 3 min."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
