"""Parts a log where it went silent: what lies between is known to nobody, and a spline through it is no motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import LogError
from twin_diagram.logs.fingerprint import fingerprint
from twin_diagram.logs.measured_log import SIGNALS, Log
from twin_diagram.signals.stretches import stretches


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    silence: float = 0.1
    """Longest time without a sample that motion can be carried across [s]: a period of what is compared at most."""

    periods: float = 4.0
    """The same in samples, of logs that are slow."""

    leap: float = 2.0
    """Times the largest step elsewhere in a log that positions leap where a driver that repeats itself goes on."""

    most: float = 0.5
    """Share of a log that its parts of some length must hold: one that is nothing but gaps stays as it is."""

    silent: float = 2.0 / 3.0
    """Share of its time for which a log that stays whole may be silent: beyond, a fit sees mostly what a spline makes
    up; a pause of 30 s between twice 2.5 s was told as a push and a spring."""


TUNING = Tuning()


def parted(log: Log, shortest: float) -> list[Log]:
    """Return the stretches of a log without silence between them, in order; the log itself where there is none.

    Each is of the same run, on the same clock. Where most of them would be too short, it stays whole.

    Args:
        log: checked.
        shortest: that a stretch may last [s].

    Raises:
        LogError: it would stay whole, and is silent for most of its time.
    """
    whole, log = log, unfrozen(log)
    silent = np.flatnonzero(np.diff(log.time) > max(TUNING.silence, TUNING.periods * log.period))
    if not len(silent):
        return [whole]
    edges = [0, *(silent + 1).tolist(), len(log)]
    kept = [slice(a, b) for a, b in pairwise(edges) if log.time[b - 1] - log.time[a] >= shortest]
    if sum(part.stop - part.start for part in kept) < TUNING.most * len(log):
        steps = np.diff(log.time)
        if np.sum(steps[silent]) > TUNING.silent * (log.time[-1] - log.time[0]):
            k = int(np.argmax(steps))
            raise LogError(
                f"{log.source}: is silent for most of its time, as from {log.time[k]:.13g} to "
                f"{log.time[k + 1]:.13g} s, and most of its stretches are shorter than {shortest:g} s; log longer ones"
            )
        return [whole]
    return [_stretch(log, part) for part in kept]


def unfrozen(log: Log) -> Log:
    """Return the log without what a driver repeated for a while instead of saying anything; itself where there is none.

    A joint at rest goes on smoothly; after a silence positions leap.
    """
    rows = np.concatenate([log.position, log.motor_torque], axis=1)
    same = np.all(rows[1:] == rows[:-1], axis=1)
    begins, ends = stretches(same).T  # samples that are said first, and last, of all that are alike
    long = log.time[ends] - log.time[begins] > max(TUNING.silence, TUNING.periods * log.period)
    begins, ends = begins[long & (ends < len(log) - 1)], ends[long & (ends < len(log) - 1)]
    steps = np.abs(np.diff(log.position, axis=0))
    others = np.delete(steps, ends, axis=0)
    if not len(ends) or not len(others):
        return log
    leaps = np.any(steps[ends] > TUNING.leap * np.max(others, axis=0), axis=1)
    kept = np.ones(len(log), dtype=bool)
    for begin, end in zip(begins[leaps], ends[leaps], strict=True):
        kept[begin + 1 : end + 1] = False
    return log if np.all(kept) else chosen(log, kept)


def longest(parts: list[Log]) -> Log:
    """Return the one of some stretches that lasts longest."""
    return max(parts, key=lambda one: float(one.time[-1] - one.time[0]))


def _stretch(log: Log, part: slice) -> Log:
    kept = np.zeros(len(log), dtype=bool)
    kept[part] = True
    return chosen(log, kept)


def chosen(log: Log, kept: npt.NDArray[np.bool_]) -> Log:
    """Return some samples of a log, as of the same run."""
    signals: dict[str, Any] = {
        name: values[kept] for name in SIGNALS.values() if (values := getattr(log, name)) is not None
    }
    return replace(log, time=log.time[kept], identity=fingerprint(log), **signals)
