"""How an alarm begins, goes on and ends, and what is kept of it as evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.drift import likelihood_ratio
from twin_diagram.estimation.drift.state import TUNING as STATE
from twin_diagram.estimation.drift.state import DriftEntry, DriftState, Evidence
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import AlarmKind


@dataclass(frozen=True)
class Tuning:
    """How long an alarm lasts and when a joint is named: chosen by hand.

    The tables of `make hrt-tables` show how often the joint named is the right one.
    """

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
    return bool(state.header[DriftEntry.TIME] < state.header[DriftEntry.QUIET])


def note(state: DriftState, statistic: float) -> None:
    """Keep the largest statistic of each tenth of a second, from which an alarm's shape is told."""
    h = state.header
    h[DriftEntry.TENTH] = max(h[DriftEntry.TENTH], statistic)


def turn_over(state: DriftState, t: float) -> None:
    """Begin a new tenth of a second where one is over."""
    h = state.header
    if 0.0 <= t - h[DriftEntry.FROM] < TUNING.tenth:
        return
    state.tenths[:-1] = state.tenths[1:]
    state.tenths[-1] = h[DriftEntry.TENTH]
    h[DriftEntry.TENTHS] = min(h[DriftEntry.TENTHS] + 1, len(state.tenths))
    h[DriftEntry.TENTH], h[DriftEntry.FROM] = 0.0, t


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
    """Raise an alarm, or let the one that stands go on.

    Args:
        state: of the monitor.
        kind: which test it was.
        t: of the message [s].
        statistic: over its threshold, more than 1.
        dt: how long the message stands for [s].
        longer: by how much the alarm outlasts `hold` [s].
        sensor: which further sensor it is about.
        gained: which joint, by index, gained which torque [N·m], where that is known.
    """
    h = state.header
    goes_on = t < h[DriftEntry.QUIET] and h[DriftEntry.ALARMS] > 0
    worse = not goes_on or statistic > h[DriftEntry.STATISTIC]
    if goes_on:
        _go_on(state, statistic, dt, sensor)
    else:
        _begin(state, kind, t, statistic, dt, sensor)
    evidence = state.evidence[int(h[DriftEntry.ALARMS] - 1) % STATE.ring]
    if worse:
        _give_evidence(state, evidence, t, gained)
    evidence[Evidence.SENSOR] = h[DriftEntry.SENSOR]
    evidence[Evidence.SHAPE] = h[DriftEntry.SHAPE]
    evidence[Evidence.ABOVE] = h[DriftEntry.ABOVE]
    h[DriftEntry.QUIET] = max(h[DriftEntry.QUIET], t + TUNING.hold + longer)


def _go_on(state: DriftState, statistic: float, dt: float, sensor: int) -> None:
    h = state.header
    h[DriftEntry.STATISTIC] = max(h[DriftEntry.STATISTIC], statistic)
    state.log[int(h[DriftEntry.ALARMS] - 1) % STATE.ring, 2] = h[DriftEntry.STATISTIC]
    h[DriftEntry.ABOVE] += dt
    if sensor >= 0 and h[DriftEntry.SENSOR] < 0.0:
        h[DriftEntry.SENSOR] = sensor


def _begin(state: DriftState, kind: AlarmKind, t: float, statistic: float, dt: float, sensor: int) -> None:
    h = state.header
    h[DriftEntry.KIND], h[DriftEntry.RAISED], h[DriftEntry.STATISTIC] = float(kind), t, statistic
    grown = likelihood_ratio.grows(state.tenths[len(state.tenths) - int(h[DriftEntry.TENTHS]) :])
    h[DriftEntry.SHAPE] = float(likelihood_ratio.AlarmShape.TREND if grown else likelihood_ratio.AlarmShape.STEP)
    h[[DriftEntry.ABOVE, DriftEntry.MOVED, DriftEntry.SENSOR, DriftEntry.JOINT]] = dt, 0.0, sensor, -1.0
    row = int(h[DriftEntry.ALARMS]) % STATE.ring
    state.log[row] = t, float(kind), statistic
    state.evidence[row] = 0.0
    h[DriftEntry.ALARMS] += 1


def _give_evidence(state: DriftState, evidence: Array, t: float, gained: tuple[int, float] | None) -> None:
    """Enter what an alarm stands on in its row of evidence, and name the joint."""
    h = state.header
    share = state.sums[1] * np.sqrt(1.0 - likelihood_ratio.FORGETTING[1] ** 2)
    # Whitening by Cholesky's factor leaves what a joint's torque does in it and in those after it: the first
    # that stands out is the one.
    clear = np.abs(share) > max(TUNING.stands_out, TUNING.of_largest * float(np.abs(share).max()))
    if h[DriftEntry.JOINT] < 0.0 or t - h[DriftEntry.RAISED] <= TUNING.naming:
        h[DriftEntry.JOINT] = float(np.argmax(clear)) if clear.any() else -1.0
    if gained is not None and h[DriftEntry.JOINT] in (-1.0, gained[0]):
        h[DriftEntry.JOINT], evidence[Evidence.TORQUE] = gained
    evidence[Evidence.JOINT] = h[DriftEntry.JOINT]
    evidence[Evidence.NIS] = h[DriftEntry.NIS] / (2.0 * len(share))
    evidence[Evidence.CHANGE] = h[DriftEntry.CHANGE]
    evidence[Evidence.ROLLOUT] = h[DriftEntry.ROLLOUT]
    evidence[Evidence.SUM] = h[DriftEntry.SUM]
    evidence[Evidence.HAND] = h[DriftEntry.HAND]
    evidence[len(Evidence) :] = share


def reshape(state: DriftState) -> None:
    """Tell the newest alarm's shape anew: what had grown before it stays a trend; what is gone already was a spike."""
    h = state.header
    row = int(h[DriftEntry.ALARMS] - 1) % STATE.ring
    if h[DriftEntry.SHAPE] != likelihood_ratio.AlarmShape.TREND:
        brief = (
            h[DriftEntry.ABOVE] <= likelihood_ratio.TUNING.spike_time
            and h[DriftEntry.TENTH] < 1.0
            and h[DriftEntry.MOVED] == 0.0
        )
        h[DriftEntry.SHAPE] = float(likelihood_ratio.AlarmShape.SPIKE if brief else likelihood_ratio.AlarmShape.STEP)
    state.evidence[row, Evidence.SHAPE] = h[DriftEntry.SHAPE]
    state.evidence[row, Evidence.ABOVE] = h[DriftEntry.ABOVE]
