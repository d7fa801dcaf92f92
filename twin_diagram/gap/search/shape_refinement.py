"""Shapes and working points of a hypothesis, brought to where the data want them.

A candidate that is not linear in its parameters is linearised about half its estimate: the midpoint rule makes the
product of Jacobian and estimate right to third order. Searched shapes move off their grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search import golden_section, proposals
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import HypothesisFit
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    rounds: int = 3
    """Over all members, at most; `settled` mostly ends them before."""

    sections: int = 7
    """Of the golden section, which leave a thirtieth of a shape's range: each takes a candidate and a fit."""

    settled: float = 0.02
    """Evidence that a round must change for another to be worth it [nats]."""


TUNING = Tuning()


def refine(
    bench: Bench, terms: Terms, fit: HypothesisFit, rounds: int = TUNING.rounds, *, slow: bool = True
) -> HypothesisFit:
    """Improve one member at a time, all others free, and return the best fit.

    Its members may be new candidates of the bench.

    Args:
        bench: of the fit.
        terms: of the logs.
        fit: to start from.
        rounds: at most.
        slow: whether shapes are moved that take long to work out.
    """
    for _ in range(rounds):
        before = fit.evidence
        for member in sorted(fit.members):
            fit = moved(bench, terms, fit, member, slow=slow)
        if abs(fit.evidence - before) < TUNING.settled:
            break
    return fit


def moved(bench: Bench, terms: Terms, fit: HypothesisFit, member: int, *, slow: bool = True) -> HypothesisFit:
    """Return the best fit that differs in one member's shapes or working point; see `refine`."""
    candidate = bench.candidates[member]
    own, _ = bench.part(fit, member)
    if candidate.variant != "held":
        made = recentred(terms, candidate, own)
        if made is not None:
            if candidate.onset is not None:
                made = replace(
                    made.during(
                        proposals.active(terms, candidate.onset, candidate.end), candidate.onset, candidate.end
                    ),
                    cost=candidate.cost,
                    variant=candidate.variant,
                )
            again = bench.solve(fit.members - {member} | {bench.add(made, offered=False)})
            return again if np.isfinite(again.evidence) else fit
    if candidate.variant == "swinging" and not slow:
        return fit
    for key, low, high in shapes(terms, candidate):
        rebuild = _rebuild(bench, terms, bench.candidates[member], key)
        fit, member = _line_search(bench, fit, member, key, rebuild, low, high)
    return fit


def recentred(terms: Terms, candidate: Candidate, coefficients: Array) -> Candidate | None:
    """Return the candidate linearised about half of the coefficients; none where it is linear."""
    again = record_of(candidate.name).recentred
    return None if again is None else again(terms, candidate, coefficients)


Rebuild = Callable[[float], int | None]


def shapes(terms: Terms, candidate: Candidate) -> list[tuple[str, float, float]]:
    """Return the shapes of a candidate: key, and the ratio bounds of the search about its value."""
    own = record_of(candidate.name).shapes
    if own is None or candidate.onset is not None or candidate.variant == "held":
        return []
    return own(terms, candidate)


def _rebuild(bench: Bench, terms: Terms, candidate: Candidate, key: str) -> Rebuild:
    """Return what takes a candidate in anew for another value of one of its shapes, and answers its index.

    Beside one hypothesis after the other the same shape is looked for about the same value: it is worked out once.
    """
    rebuilt = record_of(candidate.name).rebuilt
    assert rebuilt is not None, candidate.name
    known = bench.reshaped.setdefault((candidate.place, candidate.variant, key, *candidate.shape.items()), {})

    def index(value: float) -> int | None:
        if value not in known:
            made = rebuilt(terms, candidate, key, value)
            known[value] = None if made is None else bench.add(made, offered=False)
        return known[value]

    return index


def _line_search(
    bench: Bench, fit: HypothesisFit, member: int, key: str, rebuild: Rebuild, low: float, high: float
) -> tuple[HypothesisFit, int]:
    """Return the best fit along one shape, by golden sections on its logarithm, and the member that has it."""
    start = np.log(bench.candidates[member].shape[key])
    others = fit.members - {member}
    a, b = start + np.log(low), start + np.log(high)
    best, at = fit, member

    def cost(x: float) -> float:
        nonlocal best, at
        index = rebuild(float(np.exp(x)))
        if index is None:
            return np.inf
        found = bench.solve(others | {index})
        if found.evidence > best.evidence:
            best, at = found, index
        return -found.evidence

    golden_section.least(cost, a, b, TUNING.sections, ties_low=True)
    return best, at
