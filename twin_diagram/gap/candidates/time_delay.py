"""Logged torque that acts later: its candidates, a nuisance like it, and its record."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.residuals.regressors import Terms, rate_of
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.actuation import TimeDelay
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    held: float = 2.5e-4
    """A held command acts this much later on the average [s]."""

    within: float = 0.1
    """How far apart torque and position are usually stamped: a held command [s], and this share of a log's sample."""

    longest_delay: float = 0.05
    """Delay that is thought possible [s]."""

    stamped: float = 3e-4
    """Standard error of a delay for what the law leaves out: controllers hold a torque for a while, which looks like
    some of a delay [s]."""


TUNING = Tuning()


def on_arm(terms: Terms) -> list[Candidate]:
    """Return the one of all joints."""
    return [delay(terms, TUNING.longest_delay)]


def delay_columns(terms: Terms, about: float = 0.0) -> Array:
    """Return (ΣD, n, 1) rate of the transmitted torque.

    What a delay of a second would add, to first order about `about`/2.
    """
    parts = []
    for load, record in zip(terms.load, terms.records.records, strict=True):
        if about == 0.0:
            parts.append(rate_of(load, record))
        else:
            ahead = np.stack([np.interp(record.time + about, record.time, x) for x in load.T], axis=1)
            parts.append((ahead - load) / about)
    return terms.reduce(tuple(parts))[..., None]


def delay(terms: Terms, longest: float, about: float = 0.0) -> Candidate:
    """Return the logged torque that acts later: applied(t) = logged(t − d), so logged(t) = needed(t + d)."""
    period = max(record.period for record in terms.records.records)
    return Candidate(
        name=TimeDelay.name,
        joints=(),
        links=(),
        rows=tuple(range(terms.records.n)),
        columns=delay_columns(terms, about),
        spread=np.array([0.3 * longest]),
        lower=np.array([1.0 * period]),
        upper=np.array([longest * 2.0]),
        parameters=linear("delay"),
    )


def timing_nuisance(terms: Terms) -> Candidate:
    """Return a delay below a log sample: a held command and an integrator's step look like one, and it is no effect."""
    period = max(record.period for record in terms.records.records)
    return replace(
        delay(terms, TUNING.longest_delay),
        name="",
        spread=np.array([TUNING.held + TUNING.within * period]),
        lower=np.array([-np.inf]),
        upper=np.array([np.inf]),
    )


def recentred(terms: Terms, candidate: Candidate, coefficients: Array) -> Candidate | None:
    """Return it about half of a delay."""
    del candidate
    return delay(terms, TUNING.longest_delay, float(coefficients[0]))


def sentence(effect: Effect) -> str:
    """Return how much later the torque acts."""
    return f"the logged torque acts {1e3 * effect.delay:.3g} ms later"


register(
    EffectRecord(
        effect=TimeDelay,
        title="A delay",
        explanation="What is logged acts later than its time says.",
        sentence=sentence,
        on_arm=on_arm,
        recentred=recentred,
        once=True,
        merge=summed,
        motor=True,
        late=True,
        per_joint=False,
        left_out={"delay": (TUNING.stamped, 0.0)},
        wakes=frozenset({Wakes.ACCELERATION}),
    )
)
