"""Pushes from outside that a whole robot may have felt: link, wrench and span of time, from what its fit leaves."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.external_force import external_forces
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.normal_equations import increments
from twin_diagram.gap.search.proposals import active
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, coupling, solve, with_noise
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    blocks: int = 40
    """Equal parts of the logs at whose bounds a push may begin and end, at first."""

    longest: float = 0.6
    """Share of the logs that a push may last: what goes on for most of them is no event."""

    fine: int = 24
    """Samples at most, either side of such a bound, among which the moment is then looked for."""

    worth: float = 10.0
    """Rise of the evidence to first order from which on a push is looked at [nats]."""

    alike: float = 4.0
    """A push on an inner link suffices where it explains as much, but for this [nats]."""

    near: float = 0.8
    """Share of the best one's evidence from which on a push on another link is looked at, too: first-order evidence,
    with the noise that the best one leaves, does not yet tell links apart."""

    most: int = 3
    """Links that are looked at."""


TUNING = Tuning()

Pairs = npt.NDArray[np.int64]


def pushes(problem: RobotProblem, z: Array, terms: Terms) -> list[Candidate]:
    """Return wrenches over the spans of time that they suit best: on the innermost link that suffices, then on others.

    Those cost more, or links further out, which may follow anything, would suit best as a rule.

    Args:
        problem: of what is there beside them.
        z: (Z,) its coordinates.
        terms: of the same samples.
    """
    wrenches = [c for c in external_forces(terms) if c.size == 6]
    found = _best(_Beside.of(problem, z), wrenches)
    _, wrench, at, to = max(found, key=lambda one: one[0])
    # What a push explains is no noise: what is left beside the best one is.
    tried = replace(problem, sums=problem.sums.with_further([*problem.sums.further, _spanned(terms, wrench, at, to)]))
    noise = with_noise(tried, solve(tried, None, np.concatenate([z, np.zeros(wrench.size)])))
    quiet = replace(problem, variance=noise.variance, share=noise.share)
    found = _best(_Beside.of(quiet, solve(quiet, None, z)), wrenches)
    top = max(found, key=lambda one: one[0])
    if top[0] < TUNING.worth:
        return []
    inner = next(one for one in found if one[0] >= top[0] - TUNING.alike)  # inner links come first
    rest = sorted((one for one in found if one is not inner), key=lambda one: -one[0])
    likely = [inner, *(one for one in rest if one[0] >= TUNING.near * top[0])][: TUNING.most]
    made = [_spanned(terms, wrench, at, to) for _, wrench, at, to in likely]
    return [replace(one, cost=one.cost + TUNING.alike * bool(k)) for k, one in enumerate(made)]


Span = tuple[float, Candidate, int, int]
"""Rise of the evidence, wrench, and samples from which and until which it acts."""


def _best(beside: _Beside, wrenches: list[Candidate]) -> list[Span]:
    """Return each wrench with the span that suits it best."""
    count = len(beside.left)
    edges = np.unique(np.round(np.linspace(0, count, TUNING.blocks + 1)).astype(np.int64))
    ends, longest = len(edges), int(TUNING.longest * (len(edges) - 1))
    pairs = np.array([(i, k) for i in range(1, ends - 1) for k in range(i + 1, min(i + longest, ends - 1) + 1)])
    result = []
    for wrench in wrenches:
        best = pairs[int(np.argmax(beside.scores(wrench, edges, pairs)))]
        result.append(_refined(beside, wrench, int(edges[best[0]]), int(edges[best[1]]), max(1, int(edges[1]))))
    return result


def _refined(beside: _Beside, wrench: Candidate, at: int, to: int, step: int) -> Span:
    """Return a wrench with the best samples at which it begins and ends, near those given, and its score."""
    count = len(beside.left)
    stride = max(1, step // TUNING.fine)
    middle = (at + to) // 2
    first = np.arange(max(at - step, 1), min(at + step, middle) + 1, stride)
    last = np.arange(max(to - step, middle + 1), min(to + step, count) + 1, stride)
    edges = np.unique(np.concatenate([[0], first, last, [count]]))
    pairs = np.array(
        [(i, k) for i, k in itertools.product(np.searchsorted(edges, first), np.searchsorted(edges, last))]
    )
    scores = beside.scores(wrench, edges, pairs)
    best = pairs[int(np.argmax(scores))]
    return float(np.max(scores)), wrench, int(edges[best[0]]), int(edges[best[1]])


def _spanned(terms: Terms, wrench: Candidate, at: int, to: int) -> Candidate:
    """Return a wrench from one sample until another; of several logs, within the one in which it begins."""
    records = terms.records
    log = int(records.owner[at])
    last = int(np.flatnonzero(records.owner == log)[-1])
    onset = (log, float(records.times[at]))
    end = (log, float(records.times[to])) if to < last else None
    if end is None and log < len(records.records) - 1:
        end = (log, float(records.times[last]))
    made = wrench.during(active(terms, onset, end), onset, end)
    return replace(made, cost=2.0 * float(np.log(TUNING.blocks)), variant="spanned")


@dataclass(frozen=True)
class _Beside:
    """A fit, ready for what may be added over a span of time.

    Attributes:
        problem: that was fitted.
        left: (N, n) what it leaves [N·m].
        slope: (10 n, 10 n) of links' parameters.
        moving: coordinates that move.
        factor: inverse of the triangular factor of their normal matrix.
        pull: what of the gradient is left where the fit has not quite settled, by that factor: along directions that
            the motion hardly tells, a little of it would pass for a push.
    """

    problem: RobotProblem
    left: Array
    slope: Array
    moving: npt.NDArray[np.int64]
    factor: Array
    pull: Array

    @staticmethod
    def of(problem: RobotProblem, z: Array) -> _Beside:
        H, gradient = problem.system(z, problem.sums.whole)
        moving = np.flatnonzero(problem.free & (z > problem.lower))
        inner = H[np.ix_(moving, moving)]
        scale = 1.0 / np.sqrt(np.diag(inner))
        factor = np.linalg.inv(np.linalg.cholesky(inner * np.outer(scale, scale))) * scale
        left = problem.sums.left(problem.difference(z))
        return _Beside(problem, left, problem.slope(z), moving, factor, factor @ gradient[moving])

    def scores(self, candidate: Candidate, edges: npt.NDArray[np.int64], pairs: Pairs) -> Array:
        """Return (P,) rises of the evidence of a candidate that acts between pairs of edges alone, to first order."""
        problem, rows = self.problem, list(candidate.rows)
        weight = (problem.share / problem.variance)[rows]
        columns = candidate.columns * problem.sums.weights[:, rows, None]
        weighted = columns * weight[None, :, None]
        blocks = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
        own, right, shared = [], [], []
        for block in blocks:
            mine = weighted[block].transpose(1, 0, 2)
            own.append(np.sum(columns[block].transpose(1, 2, 0) @ mine, axis=0))
            right.append(np.einsum("njk,nj->k", weighted[block], self.left[block][:, rows]))
            cross = problem.sums.columns[block][:, rows].transpose(1, 2, 0) @ mine
            shared.append(self.factor @ coupling(problem, rows, self.slope, cross)[self.moving])
        sums = [
            np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)]) for x in map(np.stack, (own, right, shared))
        ]
        G, b, U = (x[pairs[:, 1]] - x[pairs[:, 0]] for x in sums)
        b = b + np.einsum("pzk,z->pk", U, self.pull)
        return increments(G - U.transpose(0, 2, 1) @ U, b, np.broadcast_to(candidate.spread, b.shape))
