"""When effects start and end: times that explain a run best, given what the effects do while they act.

An effect switches from one sample to the next, so that the torque that a model needs is that of the model with it at
some samples and that of the model without it at the others. Both are worked out once; each time that is tried costs no
more than filtering and whitening.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search import golden_section
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    reach: float = 0.5
    """How far from a rough time the true one is looked for [s]."""

    roughly: float = 0.25
    """Standard error of a rough time [s]: where the data do not care, it stays near what it was."""

    coarse: float = 0.025
    """Between the times that are tried first [s]."""

    sections: int = 7
    """Of the golden section, after which a time is known to 2 · 25 ms · 0.618⁷, under two milliseconds."""

    least_std: float = 0.005
    """Filters blur what is sharper than this [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class When:
    """Times of one effect on its run's own clock [s], with standard errors; None where it has none."""

    onset: float | None
    end: float | None
    onset_std: float = 0.0
    end_std: float = 0.0


ALWAYS = When(None, None)
"""Of an effect that is there throughout."""


def retimed(
    when: When, present: Model, absent: Model, record: Record, records: Records, whitener: Whitener, weights: Array
) -> When:
    """Return the times at which switching an effect on and off leaves least.

    Args:
        when: rough.
        present: the model of this run with the effect at all times.
        absent: without it.
        record: of the run.
        records: of all runs.
        whitener: of the noise.
        weights: (n, R) of whitened samples.
    """
    on, off = (
        model.inverse_dynamics(record.q, record.v, record.a, time=record.time, seen=record.torque)
        for model in (present, absent)
    )
    joints = np.flatnonzero(np.max(np.abs(on - off), axis=0) > 1e-9)
    if not len(joints):
        return when
    before = sum(records.lengths[: record.index])
    own = slice(before, before + records.lengths[record.index])
    rows = (whitener.rows >= own.start) & (whitener.rows < own.stop)
    total = sum(records.lengths)

    def cost(onset: float | None, end: float | None) -> float:
        acts = np.ones(len(record.time), dtype=bool)
        if onset is not None:
            acts &= record.time >= onset
        if end is not None:
            acts &= record.time < end
        left = record.reduce((record.torque - np.where(acts[:, None], on, off))[:, joints])
        result = 0.0
        for k, j in enumerate(joints):
            signal = np.zeros(total)
            signal[own] = left[:, k]
            result += 0.5 * float(np.sum((whitener.joint(int(j), signal) * weights[j])[rows] ** 2))
        return result

    onset, end = when.onset, when.end
    stds = [when.onset_std, when.end_std]

    def starting(t: float) -> float:
        return cost(t, end)

    def ending(t: float) -> float:
        return cost(onset, t)

    for _ in range(2 if onset is not None and end is not None else 1):
        if onset is not None:
            last = record.time[-1] if end is None else end - 2.0 * TUNING.coarse
            onset, stds[0] = _least(starting, onset, record.time[0], last)
        if end is not None:
            first = record.time[0] if onset is None else onset + 2.0 * TUNING.coarse
            end, stds[1] = _least(ending, end, first, record.time[-1])
    return replace(when, onset=onset, end=end, onset_std=stds[0], end_std=stds[1])


def _least(law: Callable[[float], float], rough: float, first: float, last: float) -> tuple[float, float]:
    """Return where a cost, half of a sum of squares over the noise, is least near a rough time, and how surely."""
    tries: Array = rough + np.arange(-TUNING.reach, TUNING.reach + 0.5 * TUNING.coarse, TUNING.coarse, dtype=np.float64)
    tries = tries[(tries > first) & (tries < last)]
    if not len(tries):
        return rough, TUNING.reach

    def cost(time: float) -> float:
        return law(time) + 0.5 * ((time - rough) / TUNING.roughly) ** 2

    costs = [cost(float(t)) for t in tries]
    best = int(np.argmin(costs))
    found = golden_section.least(cost, tries[best] - TUNING.coarse, tries[best] + TUNING.coarse, TUNING.sections)
    found = min((costs[best], float(tries[best])), found)
    return found[1], _spread(tries, np.array(costs), *found)


def _spread(tries: Array, costs: Sequence[float] | Array, least: float, at: float) -> float:
    """Return the standard deviation of the times when each is as likely as its cost says."""
    times = np.append(tries, at)
    likelihood = np.exp(least - np.append(costs, least))
    order = np.argsort(times)
    times, likelihood = times[order], likelihood[order]
    width = np.gradient(times)
    weight = likelihood * np.maximum(width, 1e-9)
    mean = float(np.sum(weight * times) / np.sum(weight))
    return float(max(TUNING.least_std, np.sqrt(np.sum(weight * (times - mean) ** 2) / np.sum(weight))))
