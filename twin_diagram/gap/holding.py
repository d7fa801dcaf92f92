"""What a joint that sticks tells: friction holds it, so the level at rest is at least the torque that it takes.

No law of speed explains the samples at which a joint sticks, and they are left out of the regression. Where friction
held more than its sliding level, though, that level rises at rest: Coulomb's law is refuted, and Stribeck's is offered.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.gap import joint_candidates, rest
from twin_diagram.gap.candidate import Candidate, transformed
from twin_diagram.gap.evidence import Bench, Fit
from twin_diagram.gap.terms import Terms

Array = npt.NDArray[np.float64]

MORE = 1.25
"""A hold must exceed the sliding level by this factor, and by `CLEARLY` times the noise, to count."""

CLEARLY = 2.5
FEWEST = 8
SHARE = 0.05
"""So many samples, and this share of those held, must say so."""

USUAL_SPEED = 0.05
"""Stribeck speed where nothing but the hold tells of one [rad/s]."""

STRONGEST = 60.0
"""Evidence that a hold brings at most [nats]."""

EDGE = 2
"""Thinned samples at each end of a hold that the low-pass mixes with the motion before and after."""


def propose(bench: Bench, terms: Terms, fit: Fit) -> list[int]:
    """Offers, for every Coulomb friction of a fit whose joint was held by more, friction that rises at rest."""
    made = []
    for k in fit.members:
        candidate = bench.candidates[k]
        if candidate.name != "coulomb_friction" or candidate.onset is not None:
            continue
        j = candidate.joints[0]
        coefficients, _ = bench.part(fit, k)
        level = float(np.mean(coefficients))
        held = holding(bench, terms, fit, k)
        noise = float(np.std(bench.left(fit)[bench.whitener.rows, j][bench.weights[j] > 0.0]))
        if level <= 0.0 or held is None:
            continue
        over = held - level
        many = int(np.sum((over > CLEARLY * noise) & (held > MORE * level)))
        if many < max(FEWEST, SHARE * len(held)):
            continue
        static = float(np.quantile(held, 0.97))
        evidence = 0.5 * float(np.sum((np.maximum(over, 0.0) / noise) ** 2)) / 4.0
        made.append(bench.add(rising(terms, candidate, static / level, min(STRONGEST, evidence))))
    return made


def holding(bench: Bench, terms: Terms, fit: Fit, k: int) -> Array | None:
    """(m,) torque that friction took while joint sticks, in the direction of the push [N·m]."""
    candidate = bench.candidates[k]
    j = candidate.joints[0]
    stuck = rest.stuck(terms.records, terms, j)
    for _ in range(EDGE):
        inner = stuck.copy()
        inner[1:] &= stuck[:-1]
        inner[:-1] &= stuck[1:]
        stuck = inner
    if not np.any(stuck):
        return None
    row = candidate.rows.index(j)
    coefficients, _ = bench.part(fit, k)
    friction = bench.left(fit)[:, j] + candidate.columns[:, row] @ coefficients
    return np.abs(friction[stuck])


def rising(terms: Terms, coulomb: Candidate, ratio: float, evidence: float) -> Candidate:
    """Coulomb's torque under Stribeck's name: what tells them apart is how much held, worth so many nats."""
    j = coulomb.joints[0]

    def values(c: Array) -> dict[str, Array]:
        return {"coulomb": c[0:1], "static": ratio * c[0:1], "stribeck_velocity": np.array([USUAL_SPEED])}

    made = joint_candidates.single(
        terms,
        "stribeck_friction",
        j,
        [terms.reduced_signs[:, j]],
        transformed(values),
        [0.0],
        cost=-evidence,
        variant="held",
    )
    assert made is not None
    return made
