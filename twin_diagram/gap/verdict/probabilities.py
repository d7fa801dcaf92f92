"""How probability is shared out between what is named, what else it could be, and what is neither.

A hypothesis is a set of claims: names with all joints and links that each sits on. Of a claim, the hypotheses that hold
it are its confidence. Every other one counts for a single rival, the one that stands in the claim's place, so that
confidence, alternatives and rest add up to 1 whatever is weighed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.findings import Finding, Rest

Claim = tuple[str, tuple[int, ...], tuple[str, ...]]
"""A name with all joints and links that it sits on."""

Hypothesis = frozenset[Claim]
"""All that is said at once."""


@dataclass(frozen=True)
class Shared:
    """What becomes of one claim's probability; all of it adds up to 1.

    Attributes:
        sure: of the claim.
        others: rivals with theirs, most probable first.
        rest: what neither has.
    """

    sure: float
    others: tuple[tuple[Claim, float], ...]
    rest: Rest


def normalised(values: Mapping[Hypothesis, float], temperature: float) -> dict[Hypothesis, float]:
    """Return probabilities of hypotheses.

    Args:
        values: log evidence of each, all that is asked of it taken off [nats].
        temperature: by which evidence is divided before it becomes a probability.
    """
    top = max(values.values())
    weights = {key: float(np.exp((value - top) / temperature)) for key, value in values.items()}
    total = sum(weights.values())
    return {key: weight / total for key, weight in weights.items()}


def stand_in(said: Claim, others: Iterable[Claim]) -> Claim | None:
    """Return which of a hypothesis's other claims stands in a claim's place; None: none does.

    The same name comes first, then what shares most joints and links, then what a list of names has first.
    """

    def kinship(other: Claim) -> tuple[bool, int]:
        shared = len(set(said[1]) & set(other[1])) + len(set(said[2]) & set(other[2]))
        return other[0] == said[0], shared

    return max(sorted(others), key=kinship, default=None)


def shared_out(
    said: Claim,
    mine: Hypothesis,
    probability: Mapping[Hypothesis, float],
    unseen: Callable[[Claim], float],
    most: int,
) -> Shared:
    """Share out the probability of all hypotheses from one claim's point of view.

    Args:
        said: the claim.
        mine: the hypothesis that it is part of.
        probability: of all hypotheses; adds up to 1.
        unseen: probability that a claim lacks a joint on which it could not be told.
        most: rivals that are told.
    """
    sure = nothing = hidden = 0.0
    rivals: dict[Claim, float] = {}
    for key, p in probability.items():
        if said in key:
            sure += p
            continue
        other = stand_in(said, key - mine)
        if other is None:
            nothing += p
        else:
            rivals[other] = rivals.get(other, 0.0) + p
    for claim, p in [(said, sure), *rivals.items()]:
        hidden += p * unseen(claim)
    seen = {claim: p * (1.0 - unseen(claim)) for claim, p in rivals.items()}
    ranked = sorted(seen.items(), key=lambda item: (-item[1], item[0]))
    told = tuple(ranked[:most])
    fewer = sum(p for _, p in ranked[most:])
    return Shared(sure * (1.0 - unseen(said)), told, Rest(others=fewer, nothing=nothing, unseen=hidden))


def less_sure(finding: Finding, factor: float) -> Finding:
    """Return a finding of which a share is believed; as much less are its alternatives, the rest may be nameless."""
    rest, kept = finding.rest, min(max(factor, 0.0), 1.0)
    return replace(
        finding,
        confidence=finding.confidence * kept,
        alternatives=tuple(replace(other, probability=other.probability * kept) for other in finding.alternatives),
        rest=Rest(
            others=rest.others * kept,
            nothing=rest.nothing * kept,
            unseen=rest.unseen * kept,
            nameless=rest.nameless * kept + 1.0 - kept,
        ),
    )


def surer(finding: Finding, confidence: float) -> Finding:
    """Return a finding of at least some confidence; all else gives way in proportion."""
    if confidence <= finding.confidence:
        return finding
    kept = (1.0 - confidence) / max(1.0 - finding.confidence, 1e-12)
    rest = finding.rest
    return replace(
        finding,
        confidence=confidence,
        alternatives=tuple(replace(other, probability=other.probability * kept) for other in finding.alternatives),
        rest=Rest(
            others=rest.others * kept,
            nothing=rest.nothing * kept,
            unseen=rest.unseen * kept,
            nameless=rest.nameless * kept,
        ),
    )


def outweighed(finding: Finding) -> bool:
    """Return whether an alternative is more probable than what is named, which then is no name."""
    return any(other.probability > finding.confidence for other in finding.alternatives)
