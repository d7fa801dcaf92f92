"""When an effect acts: from its onset to its end, on the clock of one log, and what is known of other runs."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Interval:
    """The time between an onset and an end, either of which may be missing.

    Attributes:
        onset: when it begins, on the log's own clock [s]; None: it was there before.
        end: when it ends; None: it stays.
        log: which log the two are about (`logs.fingerprint`); later ones come after it. Empty: any log.
        elsewhere: when the onset or end came in other runs, by their fingerprints; see `EffectSpec.elsewhere`.
    """

    onset: float | None = None
    end: float | None = None
    log: str = ""
    elsewhere: Mapping[str, float] = field(default_factory=dict)

    @property
    def timed(self) -> bool:
        """Return whether it begins or ends within a log."""
        return self.onset is not None or self.end is not None

    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """Return which times (…) lie within it [s]."""
        after = -math.inf if self.onset is None else self.onset
        before = math.inf if self.end is None else self.end
        return np.asarray((time >= after) & (time < before))

    def in_run(self, mark: str) -> Interval | None:
        """Return its part in the run of a fingerprint; None: it has none.

        What began in another run is there from then on, what ended is over, unless `elsewhere` says otherwise.
        """
        if self.log in ("", mark):
            return self
        moment = self.elsewhere.get(mark, -math.inf)
        if self.end is not None and self.onset is not None:
            return None
        if not math.isfinite(moment):
            return ALWAYS if (moment < 0.0) == (self.end is None) else None
        return Interval(onset=moment, log=mark) if self.end is None else Interval(end=moment, log=mark)


ALWAYS = Interval()
"""All the time, in every run."""


class Timed(Protocol):
    """What acts during an interval."""

    when: Interval


T_ = TypeVar("T_", bound=Timed)
"""An effect, of whatever class."""


def at(effect: T_, when: Interval) -> T_:
    """Return the same effect during another interval."""
    result = copy.copy(effect)
    result.when = when
    return result


def always(effect: T_) -> T_:
    """Return the same effect without onset and end."""
    return at(effect, ALWAYS)


def in_run(effect: T_, mark: str) -> T_ | None:
    """Return an effect as it is in the run of a fingerprint (`Interval.in_run`); None: it is not there."""
    when = effect.when.in_run(mark)
    return None if when is None else effect if when is effect.when else at(effect, when)


def settled(effects: Iterable[T_], marks: Collection[str]) -> list[T_]:
    """Return effects as they are after all runs, without onsets and ends in others than those of some fingerprints."""
    here = (each if each.when.log in ("", *marks) else in_run(each, "") for each in effects)
    return [each for each in here if each is not None]


def told(effect: T_, moments: Mapping[str, float]) -> T_:
    """Return the same effect, told when its onset or end came in other runs [s]; see `Interval.elsewhere`."""
    return at(effect, replace(effect.when, elsewhere={**effect.when.elsewhere, **moments}))
