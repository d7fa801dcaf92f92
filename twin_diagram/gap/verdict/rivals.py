"""Other explanations, given the same care as the best one before they are weighed against it.

Shapes are searched on grids and then moved to where the data want them, but only those of the hypothesis that leads: a
rival that is a step of its grid off would seem hopeless beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search import shape_refinement
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import HypothesisFit, Members
from twin_diagram.gap.search.greedy_search import additions
from twin_diagram.gap.verdict.posterior import TUNING as POSTERIOR
from twin_diagram.gap.verdict.posterior import groups


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    within: float = 40.0
    """Rivals with less evidence by more than this are left as they are [nats]."""

    gears: int = 2
    """Of gears that swing, whose shapes take long to work out, so many rivals are looked at."""


TUNING = Tuning()


def refined(bench: Bench, terms: Terms, fit: HypothesisFit) -> HypothesisFit:
    """Move the shapes of what could stand in the place of each member, or of all of one name; answer the best fit.

    What was worked out stays on the bench, where `posterior` meets it.
    """
    best, gears = fit, 0
    named = [frozenset(group) for group in groups(bench, fit.members).values()]
    for group in dict.fromkeys([*named, *(frozenset({k}) for k in fit.members)]):
        for rival, new in rivals_of(bench, terms, fit, group):
            swinging = bench.candidates[new].variant == "swinging"
            gears += swinging
            if swinging and gears > TUNING.gears:
                continue
            found = shape_refinement.moved(bench, terms, rival, new)
            best = found if found.evidence > best.evidence else best
    return best


def rivals_of(bench: Bench, terms: Terms, fit: HypothesisFit, group: Members) -> list[tuple[HypothesisFit, int]]:
    """Return fits with another candidate that has shapes in a group's place, the best of each place, and its index."""
    result: list[tuple[HypothesisFit, int]] = []
    seen = {bench.candidates[k].place for k in group}
    for rival in additions(bench, fit.members - group, POSTERIOR.rivals):
        (new,) = rival.members - (fit.members - group)
        candidate = bench.candidates[new]
        if fit.evidence - rival.evidence > TUNING.within or candidate.place in seen:
            continue
        seen.add(candidate.place)
        if shape_refinement.shapes(terms, candidate):
            result.append((rival, new))
    return result
