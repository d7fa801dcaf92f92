"""What acts for a while beside a whole robot's fit: which span of time suits it best, and what it brings."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate, Moment
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.normal_equations import increments
from twin_diagram.gap.search.proposals import active
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, coupling, solve, with_noise
from twin_diagram.gap.whole_robot.physical_links import slopes
from twin_diagram.gap.whole_robot.well_told import TUNING as WELL_TOLD
from twin_diagram.gap.whole_robot.well_told import share_along
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    blocks: int = 40
    """Equal parts of the logs at whose bounds an event may begin and end, at first."""

    longest: float = 0.6
    """Share of the logs that it may last: what goes on for most of them is no event."""

    fine: int = 24
    """Samples at most, either side of such a bound, among which the moment is then looked for."""

    force: float = 1.0
    """What a coefficient of a force costs, as far as the motion tells it [nats]: Akaike's criterion."""

    moment: float = 3.0
    """The same of a moment: most pushes are forces, and where they act the motion tells but roughly."""

    told: float = 1e-3
    """Share of the largest singular value of an event's columns from which on the motion tells a direction of it."""

    most: int = 3
    """That are looked at in each round."""

    nothing: float = 1e-30
    """Sum of squares below which a joint has nothing left: one that never moves, say [N²·m²]."""


TUNING = Tuning()

Pairs = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Tried:
    """A push, fitted beside all else.

    Attributes:
        candidate: the push.
        score: rise of the log likelihood less what its coefficients cost [nats].
        joints: number of joints that it drives.
        rises: (n,) of each joint's log likelihood [nats].
        variance: (n,) of what is left beside it [N²·m²].
        share: (n,) of samples that are independent, without it or beside it.
        told: whether force or moment are known well enough to be named.
    """

    candidate: Candidate
    score: float
    joints: int
    rises: Array
    variance: Array
    share: Array
    told: bool

    @staticmethod
    def of(problem: RobotProblem, z: Array, candidate: Candidate) -> Tried:
        """Fit it."""
        tried = replace(problem, sums=problem.sums.with_further([*problem.sums.further, candidate]))
        fitted = solve(tried, None, np.concatenate([z, np.zeros(candidate.size)]))
        tried = with_noise(tried, fitted)
        fitted = solve(tried, None, fitted)
        tried = with_noise(tried, fitted)
        share = np.maximum(problem.share, tried.share)
        before, after = (one.squares(x, one.sums.whole) for one, x in ((problem, z), (tried, fitted)))
        ratio = np.maximum(before, TUNING.nothing) / np.maximum(after, TUNING.nothing)
        rises = 0.5 * share * problem.sums.counted * np.log(ratio)
        size = np.sqrt(np.mean(candidate.columns**2, axis=(0, 2)))
        forces, both = numbers_told(candidate.columns[..., :3]), numbers_told(candidate.columns)
        score = float(np.sum(rises)) - TUNING.force * forces - TUNING.moment * (both - forces)
        drives = int(np.sum(size > TUNING.told * np.max(size)))
        spread = np.sqrt(np.diag(estimates.covariance(tried, fitted))[-candidate.size :])
        told = share_along(fitted[-candidate.size :], spread) < WELL_TOLD.third
        return Tried(candidate, score, drives, rises, tried.variance, share, told)


def counted(candidate: Candidate) -> int:
    """Return how many numbers a candidate says: of what acts for a while those that the motion tells, at least one."""
    return max(numbers_told(candidate.columns), 1) if candidate.passing else candidate.size


def numbers_told(columns: Array) -> int:
    """Return how many of its k numbers a push's columns (N, r, k) tell: of a wrench on the first link only one.

    The other directions of its coefficients turn no joint, stay at zero and are no freedom to fit noise with.
    """
    sizes = np.linalg.svd(np.einsum("njk,njl->kl", columns, columns), compute_uv=False)
    return int(np.sum(sizes > TUNING.told**2 * sizes[0])) if sizes[0] > 0.0 else 0


Placed = tuple[float, Candidate, int, int]
"""Rise of the evidence, wrench, and samples from which and until which it acts."""


def likeliest_spans(beside: SpansBeside, wrenches: list[Candidate]) -> list[Placed]:
    """Return the likeliest wrenches, each with the span that suits it best."""
    count = beside.seen.shape[1]
    edges = np.unique(np.round(np.linspace(0, count, TUNING.blocks + 1)).astype(np.int64))
    ends, longest = len(edges), int(TUNING.longest * (len(edges) - 1))
    pairs = np.array([(i, k) for i in range(1, ends - 1) for k in range(i + 1, min(i + longest, ends - 1) + 1)])
    coarse: list[Placed] = []
    for wrench in wrenches:
        if np.any(wrench.columns):
            scores = beside.scores(wrench, edges, pairs)
            at, to = edges[pairs[int(np.argmax(scores))]]
            coarse.append((float(np.max(scores)), wrench, int(at), int(to)))
    coarse = sorted(coarse, key=lambda one: -one[0])[: TUNING.most]
    return [_refined(beside, wrench, at, to, max(1, int(edges[1]))) for _, wrench, at, to in coarse]


def _refined(beside: SpansBeside, wrench: Candidate, at: int, to: int, step: int) -> Placed:
    """Return a wrench with the best samples at which it begins and ends, near those given, and its score."""
    count = beside.seen.shape[1]
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


def spanned(terms: Terms, wrench: Candidate, at: int, to: int) -> Candidate:
    """Return a wrench from one sample until another; of several logs, within the one in which it begins."""
    records = terms.records
    log = int(records.owner[at])
    last = int(np.flatnonzero(records.owner == log)[-1])
    onset = (log, float(records.times[at]))
    end = (log, float(records.times[to])) if to < last else None
    if end is None and log < len(records.records) - 1:
        end = (log, float(records.times[last]))
    return during(terms, wrench, onset, end)


def during(terms: Terms, wrench: Candidate, onset: Moment | None, end: Moment | None) -> Candidate:
    """Return a wrench from one moment until another."""
    made = wrench.during(active(terms, onset, end), onset, end)
    return replace(made, cost=2.0 * float(np.log(TUNING.blocks)), variant="spanned")


@dataclass(frozen=True)
class SpansBeside:
    """A fit, ready for what may be added over a span of time.

    Attributes:
        problem: that was fitted.
        seen: (n, N, M + 1) what joints' equations are in the M coordinates that move, by the inverse of the triangular
            factor of their normal matrix; then what the fit leaves [N·m].
        pull: what of the gradient is left where the fit has not quite settled, by that factor: along directions that
            the motion hardly tells, a little of it would pass for a push.
    """

    problem: RobotProblem
    seen: Array
    pull: Array

    @staticmethod
    def of(problem: RobotProblem, z: Array) -> SpansBeside:
        """Make a fit (Z,) ready."""
        H, gradient = problem.system(z, problem.sums.whole)
        moving = np.flatnonzero(problem.free & (z > problem.lower))
        inner = H[np.ix_(moving, moving)]
        scale = 1.0 / np.sqrt(np.diag(inner))
        factor = np.linalg.inv(np.linalg.cholesky(inner * np.outer(scale, scale))) * scale
        sums, blocks = problem.sums, slopes(z[: 10 * problem.n].reshape(-1, 10))
        left, each = sums.left(problem.difference(z)), np.eye(sums.columns.shape[2])[None]
        seen = np.empty((*left.T.shape, len(moving) + 1))
        for j in range(problem.n):
            seen[j, :, :-1] = sums.columns[:, j] @ (factor @ coupling(problem, [j], blocks, each)[moving]).T
        seen[:, :, -1] = left.T
        return SpansBeside(problem, seen, factor @ gradient[moving])

    def scores(self, candidate: Candidate, edges: npt.NDArray[np.int64], pairs: Pairs) -> Array:
        """Return (P,) rises of the evidence of a candidate that acts between pairs of edges alone, to first order.

        Samples before the first of these and after the last, and joints that it does not drive, are not looked at.
        """
        problem, size, count = self.problem, candidate.size, self.seen.shape[2]
        products = np.zeros((len(edges), count + size, size))
        used = slice(int(np.min(pairs)), int(np.max(pairs)) + 1)
        spans = list(itertools.pairwise(map(int, edges[used])))
        for row, j in enumerate(candidate.rows):
            columns = candidate.columns[:, row] * problem.sums.weights[:, j, None]
            if not np.any(columns):
                continue
            weighted = columns * (problem.share[j] / problem.variance[j])
            for at, (begin, end) in enumerate(spans, used.start + 1):
                mine = weighted[begin:end]
                products[at, :count] += self.seen[j, begin:end].T @ mine
                products[at, count:] += columns[begin:end].T @ mine
        products = np.cumsum(products, axis=0)
        between = products[pairs[:, 1]] - products[pairs[:, 0]]
        U, G = between[:, : -size - 1], between[:, -size:]
        b = between[:, -size - 1] + np.einsum("pzk,z->pk", U, self.pull)
        return increments(G - U.transpose(0, 2, 1) @ U, b, np.broadcast_to(candidate.spread, b.shape))
