"""Forces at whatever point of a link suits them best, over the span of a push that was found at links' origins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.external_force import TUNING, force_at, near, placed, turned, with_its_point
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.scoring import score_candidate
from twin_diagram.signals.arrays import Array


def at_their_points(
    bench: Bench, terms: Terms, Q: Array, projected: Array, wrenches: Sequence[Candidate], push: Candidate, acts: Array
) -> list[Candidate]:
    """Return one force per link, at its point; none for a link near which there is no such point.

    Where the point may be anywhere costs what evidence loses by it.

    Args:
        bench: with the data.
        terms: of the logs.
        Q: (n, R, K) of the hypothesis that they would join, see `scoring.basis`.
        projected: (K,) Qᵀy.
        wrenches: at links' origins, always.
        push: as it was found; its span counts.
        acts: (N,) 1 while it acts.
    """
    far, result = near(terms), []
    for wrench in wrenches:
        R_WL = turned(terms, terms.records.model.tree.link.index(wrench.links[0]))
        at, force = np.zeros(3), np.zeros(3)
        for _ in range(TUNING.steps):
            both = with_its_point(wrench, R_WL, at, force, far).during(acts, push.onset, push.end)
            found, covariance = _solved(bench, both, Q, projected)
            force, step = np.split(found, 2)
            at = at + step
            if np.linalg.norm(at) > far:
                break
        else:
            made = force_at(wrench, R_WL, at).during(acts, push.onset, push.end)
            scores = [score_candidate(bench, one, Q, projected) for one in (made, both)]
            made = placed(made, np.sqrt(np.diag(covariance)))
            result.append(replace(made, cost=push.cost + max(scores[0] - scores[1], 0.0), variant="spanned"))
    return result


def _solved(bench: Bench, candidate: Candidate, Q: Array, projected: Array) -> tuple[Array, Array]:
    """Return a candidate's coefficients (k,) beside a hypothesis, drawn to 0 by their spread, and their covariance.

    Of logs that are all but exact, what the hypothesis leaves of a direction may be no more than rounding, below 0
    even: that says nothing of it.
    """
    rows = list(candidate.rows)
    X = bench.whiten(candidate).reshape(-1, candidate.size) * candidate.spread
    C = Q[rows].reshape(len(X), Q.shape[2]).T @ X
    whole = X.T @ X
    told, directions = np.linalg.eigh(whole - C.T @ C)
    told[told < np.trace(whole) * np.finfo(float).eps] = 0.0
    root = candidate.spread[:, None] * directions / np.sqrt(1.0 + told)
    covariance = root @ root.T
    found = covariance @ ((X.T @ bench.y[rows].ravel() - C.T @ projected) / candidate.spread)
    return np.asarray(found), np.asarray(covariance)
