"""Which links and joints earn their place: what leaving a kind of motion out says of each, on that motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin_diagram.gap.whole_robot.physical_fit import Chosen, RobotProblem, bounded, solve
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    own: float = 1.0
    """Rise of the left-out log likelihood that a joint's own term must bring [nats]."""

    stated: float = 0.25
    """The same where the description states some already: placeholders are many."""

    back: int = 30
    """Terms at most that are put back in place."""

    link: float = 3.0
    """The same of a link."""


TUNING = Tuning()


@dataclass(frozen=True)
class LeftOut:
    """Fits of all motion but one kind, each judged on that kind.

    What acts for a while, as a push does, is an event: other motion says nothing of it. It stays as all motion has it.

    Attributes:
        problem: what was fitted, events held.
        fits: (F, Z) coordinates per kind of motion left out.
        rms: (n,) what they leave on the motion left out [N·m].
    """

    problem: RobotProblem
    fits: Array
    rms: Array

    @staticmethod
    def of(problem: RobotProblem, start: Array) -> LeftOut:
        """Leave each kind of motion out in turn."""
        if any(candidate.onset is not None for candidate in problem.sums.further):
            start = solve(problem, None, start)
            problem = replace(problem, held=start)
        fits = np.stack([solve(problem, problem.sums.whole - own, start) for own in problem.sums.of_kinds])
        return LeftOut(problem, fits, rms_of(problem, fits))

    @cached_property
    def systems(self) -> list[tuple[Array, Array]]:
        """Normal matrix (Z, Z) and gradient (Z,) of each fit."""
        sums = self.problem.sums
        return [self.problem.system(z, sums.whole - own) for z, own in zip(self.fits, sums.of_kinds, strict=True)]

    def likelihood(self) -> Array:
        """Return (n,) left-out log likelihood, but for a constant [nats]."""
        return likelihood(self.problem, self.rms)

    def likelihood_with(self, part: Chosen) -> Array:
        """Return (n,) of the same where coordinates `part` (Z,) may move, too, to first order about each fit."""
        free, lower = self.problem.free | part, self.problem.lower
        moved = [z + bounded(*both, lower - z, free) for z, both in zip(self.fits, self.systems, strict=True)]
        return likelihood(self.problem, rms_of(self.problem, moved))

    def score(self) -> float:
        """Return the left-out log likelihood, but for a constant [nats]."""
        return float(np.sum(self.likelihood()))


def rms_of(problem: RobotProblem, fits: Array | Sequence[Array]) -> Array:
    """Return (n,) what fits leave on the kinds of motion that they have not seen, one per kind [N·m]."""
    squares = problem.squares_each(np.asarray(fits), problem.sums.of_kinds)
    return np.asarray(np.sqrt(np.maximum(np.sum(squares, axis=0), 1e-30) / problem.sums.counted))


@dataclass(frozen=True)
class Linearised:
    """Fits of all motion but one kind, to first order about each: what is left where some coordinates stay described.

    Attributes:
        left_out: the fits.
        covariances: (F, Z, Z) of each, 0 where a coordinate does not move.
    """

    left_out: LeftOut
    covariances: Array

    @staticmethod
    def of(left_out: LeftOut) -> Linearised:
        """Work out each fit's covariance."""
        problem, result = left_out.problem, []
        for z, (H, _) in zip(left_out.fits, left_out.systems, strict=True):
            moving = np.flatnonzero(problem.free & (z != problem.mean))
            C = np.zeros_like(H)
            C[np.ix_(moving, moving)] = np.linalg.inv(H[np.ix_(moving, moving)])
            result.append(C)
        return Linearised(left_out, np.stack(result))

    def likelihood(self, described: Chosen) -> Array:
        """Return (n,) left-out log likelihood where coordinates `described` (Z,) are, the others settled anew."""
        problem, both = self.left_out.problem, zip(self.left_out.fits, self.covariances, strict=True)
        return likelihood(problem, rms_of(problem, [without(problem, z, C, described) for z, C in both]))


def without(problem: RobotProblem, z: Array, C: Array, described: Chosen) -> Array:
    """Return coordinates with some as described and the others settled anew, to first order."""
    gone = np.flatnonzero(described & (np.diag(C) > 0.0))
    if not len(gone):
        return z
    shift = np.linalg.solve(C[np.ix_(gone, gone)], z[gone] - problem.mean[gone])
    moved = np.maximum(z - C[:, gone] @ shift, problem.lower)
    moved[gone] = problem.mean[gone]
    return moved


def units(problem: RobotProblem) -> list[Chosen]:
    """Return which coordinates (Z,) belong together: each link's, then each joint's own terms one by one."""
    n = problem.n
    owner = np.concatenate([np.repeat(np.arange(n), 10), n + np.arange(n * len(OWN))])
    rest = np.full(len(problem.mean) - len(owner), -1)
    return [np.concatenate([owner, rest]) == k for k in range(n + n * len(OWN))]


def earning(problem: RobotProblem, left_out: LeftOut) -> RobotProblem:
    """Return the problem without the links and joints' terms that do not earn their place, weakest first.

    A link must make left-out motion of all joints likelier, a joint's own term that of the joint.
    """
    linear, there = Linearised.of(left_out), free_units(problem)
    parts = units(problem)
    described = np.zeros(len(problem.mean), dtype=bool)
    while np.any(there):
        now = linear.likelihood(described)
        margins = np.full(len(parts), np.inf)
        for k in map(int, np.flatnonzero(there)):
            margins[k] = margin(problem, k, now - linear.likelihood(described | parts[k]))
        weakest = int(np.argmin(margins))
        if margins[weakest] >= 0.0:
            break
        there[weakest] = False
        described |= parts[weakest]
    return restricted(problem, there)


def missed(problem: RobotProblem, whole: RobotProblem, start: Array) -> tuple[RobotProblem, LeftOut]:
    """Return the problem with what was taken out too early back in place, and its left-out fits.

    While others may still stand in for a term, it earns little; once they are gone it may be missed.

    Args:
        problem: without what was taken out.
        whole: with all that may be there.
        start: coordinates (Z,) to begin from.
    """
    allowed, parts = free_units(whole), units(problem)
    left_out = LeftOut.of(problem, start)
    for _ in range(TUNING.back):
        there, now = free_units(problem), left_out.likelihood()
        margins = np.full(len(parts), -np.inf)
        for k in map(int, np.flatnonzero(allowed & ~there)):
            margins[k] = margin(problem, k, left_out.likelihood_with(parts[k]) - now)
        best = int(np.argmax(margins))
        if margins[best] < 0.0:
            break
        there[best], allowed[best] = True, False
        more = restricted(problem, there)
        tried = LeftOut.of(more, start)
        if margin(problem, best, tried.likelihood() - now) >= 0.0:
            problem, left_out = more, tried
    return problem, left_out


def free_units(problem: RobotProblem) -> Chosen:
    """Return which of `units` are free."""
    return np.concatenate([problem.links_free, problem.own_free.ravel()])


def restricted(problem: RobotProblem, there: Chosen) -> RobotProblem:
    """Return the problem with these of `units` free alone."""
    n = problem.n
    return replace(problem, links_free=there[:n].copy(), own_free=there[n:].reshape(n, len(OWN)).copy())


def margin(problem: RobotProblem, unit: int, gain: Array) -> float:
    """Return by how much one of `units` brings more than it must.

    Args:
        problem: of which it is a part.
        unit: which.
        gain: (n,) in left-out log likelihood [nats].
    """
    if unit < problem.n:
        return float(np.sum(gain)) - TUNING.link
    joint, term = divmod(unit - problem.n, len(OWN))
    return float(gain[joint]) - (TUNING.stated if problem.stated[joint, term] else TUNING.own)


def likelihood(problem: RobotProblem, rms: Array) -> Array:
    """Return (…, n) log likelihood of residuals of this size, but for a constant: independent samples count [nats]."""
    return np.asarray(-problem.share * problem.sums.counted * np.log(np.maximum(rms, 1e-12)))


def best_spread(problem: RobotProblem, start: Array) -> tuple[RobotProblem, LeftOut]:
    """Return the problem with the spread of links that left-out motion likes best."""
    problems = [replace(problem, spread=spread) for spread in problem.spreads]
    tried = [LeftOut.of(one, start) for one in problems]
    best = int(np.argmax([left_out.score() for left_out in tried]))
    return problems[best], tried[best]
