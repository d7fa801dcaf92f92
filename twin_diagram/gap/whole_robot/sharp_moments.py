"""Moments at which a push comes and goes, between kept samples: what is told 20 ms late leaves as much as friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, Moment, Span
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.golden_section import least
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    apart: float = 1.5
    """Kept samples by which a moment may be off that was found among them."""

    sections: int = 8
    """Times that what lies between shrinks to 0.62 of itself: to a fifteenth of a kept sample's period."""


TUNING = Tuning()


def sharpened(
    problem: RobotProblem,
    z: Array,
    terms: Terms,
    span: Span,
    during: Callable[[Moment | None, Moment | None], Candidate],
) -> Span:
    """Return the span over which a push suits a fit best, near the one that was found among kept samples.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        span: when it begins and ends; None, and what is a log's begin or end, stays.
        during: the push over a span.
    """
    found = list(span)

    def cost(k: int, log: int, time: float) -> float:
        push = during(*((log, time) if i == k else found[i] for i in range(2)))
        tried = replace(problem, sums=problem.sums.with_further([*problem.sums.further, push]))
        return tried.cost(solve(tried, None, np.concatenate([z, np.zeros(push.size)])), tried.sums.whole)

    for k in (1, 0):
        found[k] = between_samples(terms, found[k], partial(cost, k))
    return found[0], found[1]


def between_samples(terms: Terms, moment: Moment | None, cost: Callable[[int, float], float]) -> Moment | None:
    """Return the moment of least cost near one that was found among kept samples; None and a log's ends stay.

    Args:
        terms: of the samples.
        moment: as it was found.
        cost: of a log and time [s].
    """
    if moment is None:
        return None
    log, time = moment
    times = terms.records.records[log].times
    off = TUNING.apart * float(np.median(np.diff(times)))
    if time - off <= times[0] or time + off >= times[-1]:
        return moment
    return log, least(partial(cost, log), time - off, time + off, TUNING.sections)[1]
