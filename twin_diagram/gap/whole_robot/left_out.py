"""Which links and joints earn their place: what leaving a kind of motion out says of each, on that motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.whole_robot.bounded_step import Chosen, bounded
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, fitted, solve
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
        if any(candidate.passing for candidate in problem.sums.further):
            start = solve(problem, None, start)
            problem = replace(problem, held=start)
        fits = np.stack([fitted(problem, form, start) for form in problem.forms_without])
        return LeftOut(problem, fits, rms_of(problem, fits))

    @cached_property
    def systems(self) -> list[tuple[Array, Array]]:
        """Normal matrix (Z, Z) and gradient (Z,) of each fit."""
        forms = self.problem.forms_without
        return [self.problem.system_of(z, form) for z, form in zip(self.fits, forms, strict=True)]

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
    squares = problem.squares_each(np.asarray(fits)[:, None], problem.sums.of_kinds)[:, 0]
    return np.asarray(np.sqrt(np.maximum(np.sum(squares, axis=0), 1e-30) / problem.sums.counted))


@dataclass(frozen=True)
class Linearised:
    """Fits of all motion but one kind, to first order about each: what is left where some coordinates stay described.

    Attributes:
        problem: what was fitted.
        fits: (F, Z) coordinates, which may be below their bounds where some were moved.
        covariances: (F, Z, Z) of each, 0 where a coordinate does not move.
    """

    problem: RobotProblem
    fits: Array
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
        return Linearised(problem, left_out.fits, np.stack(result))

    def likelihood(self) -> Array:
        """Return (n,) left-out log likelihood."""
        return self._likelihoods(self.fits[:, None])[0]

    def likelihoods(self, parts: Sequence[Chosen]) -> Array:
        """Return (U, n) left-out log likelihood where coordinates of one of parts (Z,) are as described each."""
        if not parts:  # of an arm of which nothing is free any more
            return np.zeros((0, self.problem.n))
        fits, C, mean = self.fits, self.covariances, self.problem.mean
        moved = np.repeat(fits[:, None], len(parts), axis=1)
        places = [np.flatnonzero(part) for part in parts]
        for size in {len(at) for at in places}:  # all of one size at once
            some = [k for k, at in enumerate(places) if len(at) == size]
            at = np.stack([places[k] for k in some])
            for fold in range(len(fits)):
                fall, goes = fall_of(fits[fold], C[fold], mean, at)
                gone = moved[fold, some] - fall
                np.put_along_axis(gone, at, np.where(goes, mean[at], fits[fold][at]), axis=1)
                moved[fold, some] = gone
        return self._likelihoods(moved)

    def described(self, part: Chosen) -> Linearised:
        """Return the same where coordinates of a part (Z,) are as described, the others settled anew."""
        at, fits, covariances = np.flatnonzero(part), self.fits.copy(), self.covariances.copy()
        for z, C in zip(fits, covariances, strict=True):
            fall, goes = fall_of(z, C, self.problem.mean, at[None])
            gone = at[goes[0]]
            C -= C[:, gone] @ np.linalg.solve(C[np.ix_(gone, gone)], C[gone])
            C[gone], C[:, gone] = 0.0, 0.0
            z -= fall[0]
            z[gone] = self.problem.mean[gone]
        return replace(self, fits=fits, covariances=covariances)

    def _likelihoods(self, fits: Array) -> Array:
        """Return (U, n) of U times one fit per kind (F, U, Z), within bounds."""
        problem = self.problem
        squares = problem.squares_each(np.maximum(fits, problem.lower), problem.sums.of_kinds)
        rms = np.sqrt(np.maximum(np.sum(squares, axis=0), 1e-30) / problem.sums.counted)
        return likelihood(problem, rms)


def fall_of(z: Array, C: Array, mean: Array, parts: npt.NDArray[np.int64]) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return by how much coordinates fall where some are as described and the others settle anew, to first order.

    Args:
        z: (Z,) coordinates.
        C: (Z, Z) their covariance, 0 where they do not move.
        mean: (Z,) of the description.
        parts: (U, P) which coordinates are as described, each of U times.

    Returns:
        (U, Z), and (U, P) which of the parts move at all.
    """
    inner = C[parts[:, :, None], parts[:, None]]
    goes = C[parts, parts] > 0.0
    inner[~goes, np.nonzero(~goes)[1]] = 1.0
    shift = np.linalg.solve(inner, np.where(goes, z[parts] - mean[parts], 0.0)[..., None])
    return np.sum(shift * C[parts], axis=1), goes


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
    while np.any(there):
        some = [int(k) for k in np.flatnonzero(there)]
        lost = linear.likelihood() - linear.likelihoods([parts[k] for k in some])
        margins = [margin(problem, k, gain) for k, gain in zip(some, lost, strict=True)]
        weakest = some[int(np.argmin(margins))]
        if min(margins) >= 0.0:
            break
        there[weakest] = False
        linear = linear.described(parts[weakest])
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
