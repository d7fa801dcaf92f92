"""Samples about the moments at which a push comes or goes: its law switches there, and no arm's hand does.

A push of 20 N that is told to end 20 ms late leaves as much of its joint, for three samples, as friction and rotor do
everywhere; counted as noise, that hides them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate, Moment
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    periods: float = 1.5
    """Of the band's edge over which the low-pass spreads a step, and moments are rough, either way."""


TUNING = Tuning()


def without_edges(problem: RobotProblem) -> RobotProblem | None:
    """Return the problem without samples about the moments of what acts for a while; None where nothing does.

    Args:
        problem: with it.
    """
    near = edges(problem)
    if not np.any(near):
        return None
    return replace(problem, sums=problem.sums.weighted(np.where(near[:, None], 0.0, problem.sums.weights)))


def moments_of(candidate: Candidate) -> list[Moment | None]:
    """Return all begins and ends of a candidate, in turn; None for what is the logs' own, or where it acts always."""
    return list(itertools.chain(*(candidate.spans or [(candidate.onset, candidate.end)])))


def edges(problem: RobotProblem) -> npt.NDArray[np.bool_]:
    """Return (N,) which samples are about a moment at which something begins or ends."""
    records = problem.sums.records
    near = np.zeros(len(problem.sums.columns), dtype=bool)
    for candidate in problem.sums.further:
        for moment in moments_of(candidate):
            if moment is not None:
                log, time = moment
                band = min(DIFFERENTIATION.residual_cutoff, records.records[log].band)
                near |= (records.owner == log) & (np.abs(records.times - time) < TUNING.periods / band)
    return near
