"""Takes the jitter out of stamps: late ones go back to the even times that they belong to, also across lost samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.logs.fingerprint import fingerprint
from twin_diagram.logs.measured_log import Log
from twin_diagram.logs.resampling import is_regular, is_silent, uniform
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    surely: float = 0.5
    """Periods by which stamps may be off where they surely belong to the even time that is next to them."""

    latest: float = 3.0
    """Periods by which stamps may be late at most, where their number alone says which is which."""

    looked_at: int = 4000
    """Stamps from which the period is found at first; further ones only sharpen it."""

    about: float = 0.15
    """Share by which the median step may be off: lost samples and late stamps move it."""

    fine: float = 0.25
    """Turns over the whole time by which neighbouring periods that are tried differ."""

    together: float = 0.3
    """Mean of the stamps' phases, as unit vectors, below which they belong to no even times: those that are evenly late
    by up to 0.4 periods either way come to that."""


TUNING = Tuning()


def dejittered(log: Log) -> Log:
    """Return the log with evenly spread times, where its positions are smoother that way.

    Times that jitter are either when the samples were taken, or late stamps on even ones; the wrong reading makes
    position noise of speed times jitter. Of a log that is silent for nearly all of its time, none are looked for.
    """
    if is_regular(log.time) or len(log) < 50 or is_silent(log):
        return log
    index = np.arange(len(log))
    straight: Array = np.polynomial.Polynomial.fit(index, log.time, 1)(index)
    late = float(np.max(np.abs(log.time - straight))) / log.period
    even = straight if late <= TUNING.surely else even_times(log.time)
    tried = [log]
    if late <= TUNING.latest:  # where no sample was lost, stamps may be later than the next one's time
        tried.append(replace(log, time=straight, identity=fingerprint(log)))
    if even is not None and even is not straight:
        tried.append(replace(log, time=even, identity=fingerprint(log)))
    return min(tried, key=lambda one: float(np.sum(np.diff(uniform(one).position, 4, axis=0) ** 2)))


def even_times(time: Array) -> Array | None:
    """Return even times (N,) with gaps, of which stamps (N,) are late versions; None where there are none.

    A period is found as the strongest line of the stamps' periodogram near the median step, on ever more of them; each
    stamp belongs to the time next to it, and no two to the same.
    """
    count = min(len(time), TUNING.looked_at)
    since = time - time[0]
    middle = 1.0 / float(np.median(np.diff(time)))
    span = TUNING.about * middle
    while True:
        step = TUNING.fine / float(since[count - 1])
        tried = np.arange(max(middle - span, 0.5 * middle), middle + span, step)
        lines = _lines(since[:count], tried)
        best = int(np.argmax(np.abs(lines)))
        if np.abs(lines[best]) < TUNING.together:
            return None
        middle, span = float(tried[best]), 4.0 * step
        if count == len(time):
            break
        count = min(len(time), 4 * count)
    offset = float(np.angle(lines[best])) / (2.0 * np.pi)
    index = np.round(since * middle - offset)
    if np.any(np.diff(index) < 1.0):
        return None
    line = np.polynomial.Polynomial.fit(index, time, 1)
    even = line(index)
    return even if float(np.max(np.abs(time - even))) * middle < 0.5 else None


def _lines(since: Array, frequencies: Array) -> Array:
    """Return mean of unit vectors that turn with each frequency (F,) [Hz], at stamps (N,) [s]."""
    step = frequencies[1] - frequencies[0] if len(frequencies) > 1 else 0.0
    turning, result = np.exp(2j * np.pi * frequencies[0] * since), np.empty(len(frequencies), dtype=complex)
    further = np.exp(2j * np.pi * step * since)
    for k in range(len(frequencies)):
        result[k] = np.mean(turning)
        turning *= further
    return result
