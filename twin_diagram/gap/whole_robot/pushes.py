"""Pushes from outside that a whole robot may have felt: link, wrench and span of time, from what its fit leaves."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.external_force import TUNING as EXTERNAL
from twin_diagram.gap.candidates.external_force import external_forces, force_at, near, placed, turned, with_its_point
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.normal_equations import increments
from twin_diagram.gap.search.proposals import active
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.held_by_friction import mostly_resting, shares_of_friction, without_held
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, coupling, solve, with_noise
from twin_diagram.gap.whole_robot.physical_links import slopes
from twin_diagram.gap.whole_robot.rough_friction import rough_friction
from twin_diagram.gap.whole_robot.setting_off import with_the_log
from twin_diagram.gap.whole_robot.sharp_moments import sharpened
from twin_diagram.gap.whole_robot.well_told import TUNING as WELL_TOLD
from twin_diagram.gap.whole_robot.well_told import share_along
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    blocks: int = 40
    """Equal parts of the logs at whose bounds a push may begin and end, at first."""

    longest: float = 0.6
    """Share of the logs that a push may last: what goes on for most of them is no event."""

    shortest: float = 0.4
    """That a push lasts [s]: what a fit leaves hangs together about as long wherever motion is hard, and what is over
    sooner has little more in it than a wrench has coefficients."""

    fine: int = 24
    """Samples at most, either side of such a bound, among which the moment is then looked for."""

    worth: float = 10.0
    """Rise of the log likelihood, less what coefficients cost, from which on a push is looked at [nats]."""

    force: float = 1.0
    """What a coefficient of a force costs, as far as the motion tells it [nats]: Akaike's criterion."""

    moment: float = 3.0
    """The same of a moment: most pushes are forces, and where they act the motion tells but roughly."""

    alike: float = 2.0
    """A push on an inner link suffices where it explains as much, but for this [nats]."""

    rather: float = 0.8
    """Share of what the best push explains from which on one whose wrench the motion tells is taken for it: the best
    would have no name."""

    alone: float = 4.0
    """By how much more than others a push must explain that drives one joint alone [nats]: that is rather the joint's
    own doing."""

    told: float = 1e-3
    """Share of the largest singular value of a push's columns from which on the motion tells a direction of it."""

    most: int = 3
    """Links that are looked at in each round."""

    held: float = 3.2
    """Times a joint's dry friction by which what holds it may change while it rests: from one direction to the other,
    and before it slides it is up to 1.6 times what it is then."""

    drifts: float = 0.1
    """The same by which friction changes as joints warm, or with the angle: what brings no joint more is no push."""

    nothing: float = 1e-30
    """Sum of squares below which a joint has nothing left: one that never moves, say [N²·m²]."""

    point: float = 6.0
    """What a force's point on a link costs [nats]: two numbers, each as dear as a moment."""

    rounds: int = 2
    """Times that the span is looked for: with the noise that is left without, then with that beside the best one."""


TUNING = Tuning()

Pairs = npt.NDArray[np.int64]

Moment = tuple[int, float] | None
"""Log and time [s]; None: its begin or end."""

Moments = tuple[Moment, Moment]


def pushes(problem: RobotProblem, z: Array, terms: Terms) -> list[Candidate]:
    """Return the push, over the span of time that suits it best, on the innermost link that suffices; or none.

    Forces at links' origins are tried, and wrenches. A push is an event, so the fit of all motion judges it, also
    one in which friction is only roughly its law's.

    Args:
        problem: of what is there beside it.
        z: (Z,) its coordinates.
        terms: of the same samples.
    """
    wrenches = external_forces(terms)
    # A push alone lets the joints that it drives hang together over all of its span.
    quiet = replace(problem, share=np.maximum(problem.share, np.median(problem.share)))
    for _ in range(TUNING.rounds):
        found = _best(_Beside.of(quiet, solve(quiet, None, z)), wrenches)
        if not found:
            return []
        tried = [_Tried.of(problem, z, _spanned(terms, *one[1:])) for one in found]
        best, (_, wrench, _, _) = max(zip(tried, found, strict=True), key=lambda both: both[0].score)
        quiet = replace(problem, variance=best.variance, share=best.share)
    if (
        brief(best.candidate)
        or with_the_log(best.candidate, problem.sums.records)
        or np.all(shares_of_friction(problem, z, best.candidate) < TUNING.drifts)
    ):
        return []
    problem, z = while_sliding(problem, z, terms, best.candidate)
    best = _Tried.of(problem, z, best.candidate)
    if best.score < TUNING.worth or beside_rough_friction(problem, z, best) < TUNING.worth:
        return []
    span = best.candidate.onset, best.candidate.end
    span = sharpened(problem, z, terms, span, lambda *moments: _during(terms, wrench, *moments))
    return [on_the_innermost(problem, z, terms, _during(terms, wrench, *span))]


def brief(push: Candidate) -> bool:
    """Return whether what suits a push best is over too soon to be told from a burst of what any fit leaves."""
    return push.onset is not None and push.end is not None and push.end[1] - push.onset[1] < TUNING.shortest


def while_sliding(problem: RobotProblem, z: Array, terms: Terms, push: Candidate) -> tuple[RobotProblem, Array]:
    """Return the problem without samples at which dry friction can hold what a push brings to a joint, and its fit.

    A joint that mostly rests hardly tells how much its friction can hold: its rests say nothing, whatever was found.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        push: as it was found.
    """
    shares, rests = shares_of_friction(problem, z, push), mostly_resting(problem, terms)
    held = [j for j, share in zip(push.rows, shares, strict=True) if share < TUNING.held or rests[j]]
    return without_held(problem, z, terms, held)


def beside_rough_friction(problem: RobotProblem, z: Array, push: _Tried) -> float:
    """Return a push's score where the joints that it explains may have rough friction [nats], see `rough_friction`.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        push: as it was found.
    """
    joints = np.flatnonzero(push.rises > TUNING.force)
    rough = rough_friction(problem, z, [int(j) for j in joints])
    beside = replace(problem, sums=problem.sums.with_further([*problem.sums.further, *rough]))
    start = np.concatenate([z, np.zeros(sum(one.size for one in rough))])
    beside = with_noise(beside, solve(beside, None, start))
    return _Tried.of(beside, solve(beside, None, start), push.candidate).score


def on_the_innermost(problem: RobotProblem, z: Array, terms: Terms, push: Candidate) -> Candidate:
    """Return a push over the same span of time on the innermost link that suffices.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        push: as it was found.
    """
    span = push.onset, push.end
    wrenches = external_forces(terms)
    tried = [_Tried.of(problem, z, _during(terms, wrench, *span)) for wrench in wrenches]
    plain = _innermost(tried)
    points = [_at_its_point(problem, z, terms, wrench, span) for wrench in wrenches if wrench.size == 6]
    there = [one for one in points if one is not None and one.told]
    if not there or max(one.score for one in there) <= max(one.score for one in tried) + TUNING.alike:
        return plain.candidate
    return _innermost(there).candidate


def _at_its_point(problem: RobotProblem, z: Array, terms: Terms, wrench: Candidate, span: Moments) -> _Tried | None:
    """Return a force over a span at the point of a link that suits it best; None where that is not near the link.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        wrench: at the link's origin, always.
        span: when it acts.
    """
    R_WL, far = turned(terms, terms.records.model.tree.link.index(wrench.links[0])), near(terms)
    at, force = np.zeros(3), np.zeros(3)
    for _ in range(EXTERNAL.steps):
        both = _during(terms, with_its_point(wrench, R_WL, at, force, far), *span)
        beside = replace(problem, sums=problem.sums.with_further([*problem.sums.further, both]))
        fitted = solve(beside, None, np.concatenate([z, np.zeros(6)]))
        force, step = np.split(fitted[-6:], 2)
        at = at + step
        if np.linalg.norm(at) > far:
            return None
    errors = np.sqrt(np.diag(estimates.covariance(with_noise(beside, fitted), fitted))[-6:])
    made = placed(_during(terms, force_at(wrench, R_WL, at), *span), errors)
    one = _Tried.of(problem, z, replace(made, cost=made.cost + TUNING.point))
    return replace(one, score=one.score - TUNING.point)


@dataclass(frozen=True)
class _Tried:
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
    def of(problem: RobotProblem, z: Array, candidate: Candidate) -> _Tried:
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
        return _Tried(candidate, score, drives, rises, tried.variance, share, told)


def counted(candidate: Candidate) -> int:
    """Return how many numbers a candidate says: of what acts for a while those that the motion tells, at least one."""
    return candidate.size if candidate.onset is None else max(numbers_told(candidate.columns), 1)


def numbers_told(columns: Array) -> int:
    """Return how many of its k numbers a push's columns (N, r, k) tell: of a wrench on the first link only one.

    The other directions of its coefficients turn no joint, stay at zero and are no freedom to fit noise with.
    """
    sizes = np.linalg.svd(np.einsum("njk,njl->kl", columns, columns), compute_uv=False)
    return int(np.sum(sizes > TUNING.told**2 * sizes[0])) if sizes[0] > 0.0 else 0


def _innermost(tried: Sequence[_Tried]) -> _Tried:
    """Return the push on the innermost link that explains as much as any, but for little; inner links come first."""
    top = max(one.score for one in tried)
    told = [one for one in tried if one.told and one.score > TUNING.rather * top]
    if told:
        tried, top = told, max(one.score for one in told)
    several = [one for one in tried if one.joints > 1]
    if several and max(one.score for one in several) > top - TUNING.alone:
        tried, top = several, max(one.score for one in several)
    return next(one for one in tried if one.score >= top - TUNING.alike)


Span = tuple[float, Candidate, int, int]
"""Rise of the evidence, wrench, and samples from which and until which it acts."""


def _best(beside: _Beside, wrenches: list[Candidate]) -> list[Span]:
    """Return the likeliest wrenches, each with the span that suits it best."""
    count = beside.seen.shape[1]
    edges = np.unique(np.round(np.linspace(0, count, TUNING.blocks + 1)).astype(np.int64))
    ends, longest = len(edges), int(TUNING.longest * (len(edges) - 1))
    pairs = np.array([(i, k) for i in range(1, ends - 1) for k in range(i + 1, min(i + longest, ends - 1) + 1)])
    coarse: list[Span] = []
    for wrench in wrenches:
        if np.any(wrench.columns):
            scores = beside.scores(wrench, edges, pairs)
            at, to = edges[pairs[int(np.argmax(scores))]]
            coarse.append((float(np.max(scores)), wrench, int(at), int(to)))
    coarse = sorted(coarse, key=lambda one: -one[0])[: TUNING.most]
    return [_refined(beside, wrench, at, to, max(1, int(edges[1]))) for _, wrench, at, to in coarse]


def _refined(beside: _Beside, wrench: Candidate, at: int, to: int, step: int) -> Span:
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


def _spanned(terms: Terms, wrench: Candidate, at: int, to: int) -> Candidate:
    """Return a wrench from one sample until another; of several logs, within the one in which it begins."""
    records = terms.records
    log = int(records.owner[at])
    last = int(np.flatnonzero(records.owner == log)[-1])
    onset = (log, float(records.times[at]))
    end = (log, float(records.times[to])) if to < last else None
    if end is None and log < len(records.records) - 1:
        end = (log, float(records.times[last]))
    return _during(terms, wrench, onset, end)


def _during(terms: Terms, wrench: Candidate, onset: Moment, end: Moment) -> Candidate:
    """Return a wrench from one moment until another."""
    made = wrench.during(active(terms, onset, end), onset, end)
    return replace(made, cost=2.0 * float(np.log(TUNING.blocks)), variant="spanned")


@dataclass(frozen=True)
class _Beside:
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
    def of(problem: RobotProblem, z: Array) -> _Beside:
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
        return _Beside(problem, seen, factor @ gradient[moving])

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
