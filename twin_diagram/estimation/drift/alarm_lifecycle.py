"""How an alarm begins, goes on and ends, and what is kept of it as evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.drift import likelihood_ratio
from twin_diagram.estimation.drift.state import TUNING as STATE
from twin_diagram.estimation.drift.state import DriftState, Entry, Evidence
from twin_diagram.signals.layouts import AlarmKind


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    hold: float = 0.5
    """An alarm ends when its test has been quiet for this long [s]."""

    tenth: float = 0.1
    """Over this time the largest statistic is taken [s]."""

    stands_out: float = 4.0
    """A joint is named where its share of a change is this many standard deviations."""

    of_largest: float = 0.4
    """And this share of the largest."""

    naming: float = 0.1
    """A joint that was named keeps its name after this time: what comes later may be what a fault led to [s]."""


TUNING = Tuning()


def stands(state: DriftState) -> bool:
    """Return whether an alarm does."""
    return bool(state.header[Entry.TIME] < state.header[Entry.QUIET])


def note(state: DriftState, statistic: float) -> None:
    """Keep the largest statistic of each tenth of a second, from which an alarm's shape is told."""
    h = state.header
    h[Entry.TENTH] = max(h[Entry.TENTH], statistic)


def turn_over(state: DriftState, t: float) -> None:
    """Begin a new tenth of a second where one is over."""
    h = state.header
    if t - h[Entry.FROM] < TUNING.tenth:
        return
    state.tenths[:-1] = state.tenths[1:]
    state.tenths[-1] = h[Entry.TENTH]
    h[Entry.TENTHS] = min(h[Entry.TENTHS] + 1, len(state.tenths))
    h[Entry.TENTH], h[Entry.FROM] = 0.0, t


def raise_alarm(
    state: DriftState,
    kind: AlarmKind,
    t: float,
    statistic: float,
    *,
    dt: float = 0.0,
    longer: float = 0.0,
    sensor: int = -1,
    gained: tuple[int, float] | None = None,
) -> None:
    """Raise an alarm, or lets the one that stands go on.

    Args:
        state: of the monitor.
        kind: which test it was.
        t: of the message [s].
        statistic: over its threshold, more than 1.
        dt: how long the message stands for [s].
        longer: by how much the alarm outlasts `HOLD` [s].
        sensor: which further sensor it is about.
        gained: which joint, by index, gained which torque [N·m], where that is known.
    """
    h = state.header
    row = int(h[Entry.ALARMS] - 1) % STATE.ring
    share = state.sums[1] * np.sqrt(1.0 - likelihood_ratio.FORGETTING[1] ** 2)
    if t < h[Entry.QUIET] and h[Entry.ALARMS] > 0:  # the alarm that stands goes on
        worse = statistic > h[Entry.STATISTIC]
        h[Entry.STATISTIC] = max(h[Entry.STATISTIC], statistic)
        state.log[row, 2] = h[Entry.STATISTIC]
        h[Entry.ABOVE] += dt
        if sensor >= 0 and h[Entry.SENSOR] < 0.0:
            h[Entry.SENSOR] = sensor
    else:
        worse = True
        h[Entry.KIND], h[Entry.RAISED], h[Entry.STATISTIC] = float(kind), t, statistic
        grown = likelihood_ratio.grows(state.tenths[len(state.tenths) - int(h[Entry.TENTHS]) :])
        h[Entry.SHAPE] = float(likelihood_ratio.Shape.TREND if grown else likelihood_ratio.Shape.STEP)
        h[Entry.ABOVE], h[Entry.MOVED], h[Entry.SENSOR], h[Entry.JOINT] = dt, 0.0, sensor, -1.0
        row = int(h[Entry.ALARMS]) % STATE.ring
        state.log[row] = t, float(kind), statistic
        state.evidence[row] = 0.0
        h[Entry.ALARMS] += 1
    evidence = state.evidence[row]
    if worse:
        # Whitening by Cholesky's factor leaves what a joint's torque does in it and in those after it: the first
        # that stands out is the one.
        clear = np.abs(share) > max(TUNING.stands_out, TUNING.of_largest * float(np.abs(share).max()))
        if h[Entry.JOINT] < 0.0 or t - h[Entry.RAISED] <= TUNING.naming:
            h[Entry.JOINT] = float(np.argmax(clear)) if clear.any() else -1.0
        if gained is not None and h[Entry.JOINT] in (-1.0, gained[0]):
            h[Entry.JOINT], evidence[Evidence.TORQUE] = gained
        evidence[Evidence.JOINT] = h[Entry.JOINT]
        evidence[Evidence.NIS] = h[Entry.NIS] / (2.0 * len(share))
        evidence[Evidence.CHANGE] = h[Entry.CHANGE]
        evidence[Evidence.ROLLOUT] = h[Entry.ROLLOUT]
        evidence[Evidence.SUM] = h[Entry.SUM]
        evidence[Evidence.HAND] = h[Entry.HAND]
        evidence[len(Evidence) :] = share
    evidence[Evidence.SENSOR] = h[Entry.SENSOR]
    evidence[Evidence.SHAPE] = h[Entry.SHAPE]
    evidence[Evidence.ABOVE] = h[Entry.ABOVE]
    h[Entry.QUIET] = max(h[Entry.QUIET], t + TUNING.hold + longer)


def reshape(state: DriftState) -> None:
    """What had grown before it crossed the threshold stays a trend; of the rest, what is gone was a spike."""
    h = state.header
    row = int(h[Entry.ALARMS] - 1) % STATE.ring
    if h[Entry.SHAPE] != likelihood_ratio.Shape.TREND:
        brief = h[Entry.ABOVE] <= likelihood_ratio.TUNING.spike_time and h[Entry.TENTH] < 1.0 and h[Entry.MOVED] == 0.0
        h[Entry.SHAPE] = float(likelihood_ratio.Shape.SPIKE if brief else likelihood_ratio.Shape.STEP)
    state.evidence[row, Evidence.SHAPE] = h[Entry.SHAPE]
    state.evidence[row, Evidence.ABOVE] = h[Entry.ABOVE]
