"""All links and joints fitted at once: physical, drawn to the description, on some stretches of motion or all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.whole_robot.physical_links import Links, parameters, slopes
from twin_diagram.gap.whole_robot.torque_equations import OWN, TorqueEquations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    spreads: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4)
    """Of links about their description, from which left-out motion chooses: machined parts to a cover left out."""

    known: tuple[float, ...] = (0.025, 0.05)
    """The same of an arm whose links were found before: what changed since is no link's."""

    beyond: tuple[float, ...] = (0.005, 0.025)
    """The same where it is known how well they were found: beyond that, for what friction's laws leave."""

    own: float = 10.0
    """Prior deviation of a joint's own terms: so many times the residual's size."""

    together: float = 0.5
    """Residuals hang together over this long at most [s]: a joint that fits badly must not count ever less for it."""

    rounds: int = 12
    """Gauss-Newton steps at most."""

    settled: float = 1e-3
    """A step this small, in prior deviations, is the last."""

    halvings: int = 6
    """Of a step that makes things worse, at most."""

    longest: float = 1.0
    """A step's largest part, in scales of a link's coordinates."""


TUNING = Tuning()

Chosen = npt.NDArray[np.bool_]


def known_spreads(told: Array | None) -> tuple[float, ...]:
    """Return the spreads of links that were found before, with some covariance, or one that is not known."""
    return TUNING.known if told is None else TUNING.beyond


@dataclass(frozen=True)
class RobotProblem:
    """What is fitted.

    Attributes:
        sums: of the fit logs.
        links: of the given arm.
        least: (n, 4) what joints' own terms may not fall below: no more is taken away than there is.
        spread: prior deviation of links, in their scales.
        variance: (n,) of what is left [N²·m²].
        share: (n,) of a sample that is independent of its neighbours.
        links_free: (n,) whose inertia may differ.
        own_free: (n, 4) which of joints' own terms may be there.
        spreads: that it may be.
        gone: (n, 4) which of those that the description states are taken to be none at all.
        told: (10 n, 10 n) covariance that links' coordinates were found with before, which the spread comes on top of;
            None: they were not, or it is not known.
        known: whether they were found before: they are then rather as they were.
        held: (Z,) coordinates at which what acts for a while is held; None: it is fitted like all else.

    Coordinates are Z = 14 n + E numbers: links' ten each, joints' own four each, the sums' further coefficients.
    """

    sums: TorqueEquations
    links: Links
    least: Array
    spread: float
    variance: Array
    share: Array
    links_free: Chosen
    own_free: Chosen
    gone: Chosen
    spreads: tuple[float, ...] = TUNING.spreads
    told: Array | None = None
    known: bool = False
    held: Array | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.sums.n

    @cached_property
    def free(self) -> Chosen:
        """(Z,) which coordinates may move."""
        return np.concatenate([np.repeat(self.links_free, 10), self.own_free.ravel(), ~self._still])

    @cached_property
    def mean(self) -> Array:
        """(Z,) of the description, without what is gone."""
        own = np.where(self.gone, self.least, 0.0)
        further = np.zeros(len(self._still)) if self.held is None else self.held[14 * self.n :] * self._still
        return np.concatenate([self.links.mean.ravel(), own.ravel(), further])

    @cached_property
    def _still(self) -> Chosen:
        """(E,) which coefficients of further candidates are held."""
        sizes = [c.size for c in self.sums.further]
        brief = [self.held is not None and c.onset is not None for c in self.sums.further]
        return np.repeat(np.array(brief, dtype=bool), sizes)

    @property
    def stated(self) -> Chosen:
        """(n, 4) whether the description states some of a term already."""
        return np.asarray(np.isfinite(self.least) & (self.least < 0.0))

    @property
    def said(self) -> Chosen:
        """(n, 4) which of joints' own terms differ from the description."""
        return self.own_free | self.gone

    @cached_property
    def deviation(self) -> Array:
        """(Z,) of the prior: of links, what the spread alone allows."""
        size = np.maximum(self.sums.own_size, 1e-9)
        own = TUNING.own * self.sums.residual_rms[:, None] / size
        further = [c.spread for c in self.sums.further]
        return np.concatenate([self.spread * self.links.scale.ravel(), np.maximum(own, 1e-9).ravel(), *further])

    @cached_property
    def precision(self) -> Array:
        """(Z, Z) of the prior: what was found of links before hangs together."""
        deviation, links = self.deviation, 10 * self.n
        result = np.diag(deviation**-2.0)
        if self.told is not None:
            result[:links, :links] = np.linalg.inv(self.told + np.diag(deviation[:links] ** 2))
        return result

    @cached_property
    def lower(self) -> Array:
        """(Z,) bounds."""
        further = [c.lower for c in self.sums.further]
        return np.concatenate([np.full(10 * self.n, -np.inf), self.least.ravel(), *further])

    def place(self, candidate: int) -> slice:
        """Return where the coordinates of one of the sums' further candidates are."""
        ends = np.cumsum([14 * self.n, *(c.size for c in self.sums.further)])
        return slice(int(ends[candidate]), int(ends[candidate + 1]))

    def difference(self, z: Array) -> Array:
        """Return (n, K) by which parameters differ from the given model's, per joint's equations."""
        return self._differences(z[None])[0]

    def _differences(self, z: Array) -> Array:
        """Return (F, n, K) of coordinates (F, Z)."""
        n, count = self.n, len(z)
        links = parameters(z[:, : 10 * n].reshape(-1, 10)).reshape(count, -1) - self.links.described.ravel()
        own = z[:, 10 * n : 14 * n].reshape(count, n, len(OWN))
        shared = [np.broadcast_to(x[:, None], (count, n, x.shape[1])) for x in (links, z[:, 14 * n :])]
        return np.concatenate([shared[0], own, shared[1]], axis=2)

    def squares(self, z: Array, total: Array) -> Array:
        """Return (n,) sums of squares that coordinates leave, of sums (n, K + 1, K + 1)."""
        return self.squares_each(z[None], total[None])[0]

    def squares_each(self, z: Array, totals: Array) -> Array:
        """Return (F, n) of the same of each of coordinates (F, Z) on its own sums (F, n, K + 1, K + 1)."""
        full = np.concatenate([-self._differences(z), np.ones((len(z), self.n, 1))], axis=2)
        return np.asarray(np.sum((full[:, :, None] @ totals)[:, :, 0] * full, axis=2))

    def cost(self, z: Array, total: Array) -> float:
        """Return half the squares over their variance, the prior's counted, of sums (n, K + 1, K + 1)."""
        squares = float(np.sum(self.share / self.variance * self.squares(z, total)))
        off = z - self.mean
        return 0.5 * (squares + float(off @ self.precision @ off))

    def slope(self, z: Array) -> Array:
        """Return (10 n, 10 n) derivative of the links' parameters by their coordinates."""
        n = self.n
        result = np.zeros((10 * n, 10 * n))
        for body, block in enumerate(slopes(z[: 10 * n].reshape(n, 10))):
            result[10 * body : 10 * body + 10, 10 * body : 10 * body + 10] = block
        return result

    def pulls(self, z: Array, total: Array) -> Array:
        """Return (Z,) the part of the gradient that residuals in sums (n, K + 1, K + 1) have."""
        return self.pulls_each(z, total[None])[0]

    def pulls_each(self, z: Array, totals: Array) -> Array:
        """Return (S, Z) of the same of each of sums (S, n, K + 1, K + 1)."""
        weight, links, own = self.share / self.variance, 10 * self.n, len(OWN)
        left = totals[:, :, :-1, -1] - (totals[:, :, :-1, :-1] @ self.difference(z)[:, :, None])[..., 0]
        left = weight[:, None] * left
        shared, own_left = np.sum(left, axis=1), left[:, :, links : links + own].reshape(len(left), -1)
        return -np.concatenate([shared[:, :links] @ self.slope(z), own_left, shared[:, links + own :]], axis=1)

    def system(self, z: Array, total: Array) -> tuple[Array, Array]:
        """Return the normal matrix (Z, Z) and gradient (Z,) of half the squares, the prior's counted."""
        weight, links, own = self.share / self.variance, 10 * self.n, len(OWN)
        slope = self.slope(z)
        H = np.zeros((len(z), len(z)))
        weighted = weight[:, None, None] * total[:, :-1, :-1]
        shared = np.sum(weighted, axis=0)
        more = slice(14 * self.n, None)
        H[:links, :links] = slope.T @ shared[:links, :links] @ slope
        H[:links, more] = slope.T @ shared[:links, links + own :]
        H[more, :links] = H[:links, more].T
        H[more, more] = shared[links + own :, links + own :]
        for j in range(self.n):
            s, mine = slice(links + own * j, links + own * (j + 1)), slice(links, links + own)
            H[:links, s] = slope.T @ weighted[j, :links, mine]
            H[s, :links] = H[:links, s].T
            H[s, s] = weighted[j, mine, mine]
            H[s, more] = weighted[j, mine, links + own :]
            H[more, s] = H[s, more].T
        return H + self.precision, self.pulls(z, total) + self.precision @ (z - self.mean)


def solve(problem: RobotProblem, total: Array | None = None, start: Array | None = None) -> Array:
    """Return the coordinates (Z,) that fit best.

    Args:
        problem: what is fitted.
        total: (n, K + 1, K + 1) sums that count; None: all.
        start: where to begin; None: as described.
    """
    total = problem.sums.whole if total is None else total
    z = problem.mean if start is None else np.where(problem.free, start, problem.mean)
    deviation, cost = problem.deviation, problem.cost(z, total)
    for _ in range(TUNING.rounds):
        H, gradient = problem.system(z, total)
        step = bounded(H, gradient, problem.lower - z, problem.free)
        long = float(np.max(np.abs(step[: 10 * problem.n]) / problem.links.scale.ravel(), initial=0.0))
        step = step * min(1.0, TUNING.longest / max(long, 1e-12))
        halved, after = 0, problem.cost(z + step, total)
        while after > cost and halved < TUNING.halvings:
            step, halved = 0.5 * step, halved + 1
            after = problem.cost(z + step, total)
        z, cost = z + step, after
        if np.max(np.abs(step) / deviation) < TUNING.settled:
            break
    return z


def bounded(H: Array, gradient: Array, lower: Array, free: Chosen) -> Array:
    """Return the step of least squares that keeps to lower bounds."""
    moving = free.copy()
    step = np.zeros(len(gradient))
    for _ in range(8):
        fixed = ~moving
        rest = gradient[moving] + H[np.ix_(moving, fixed)] @ step[fixed]
        scale = np.sqrt(np.diag(H)[moving])
        inner = H[np.ix_(moving, moving)] / np.outer(scale, scale)
        step[moving] = -np.linalg.solve(inner, rest / scale) / scale
        below = moving & (step < lower)
        if not np.any(below):
            break
        step[below] = lower[below]
        moving &= ~below
    return np.maximum(step, lower)


def coupling(problem: RobotProblem, rows: list[int], slope: Array, cross: Array) -> Array:
    """Return (Z, k) of the normal matrix between coordinates and a candidate that is not among them.

    Args:
        problem: of the coordinates.
        rows: joints that the candidate touches.
        slope: (10 n, 10 n) of links' parameters.
        cross: (r, K + 1, k) weighted products with all columns, one per joint that the candidate touches.
    """
    links, own = 10 * problem.n, len(OWN)
    B = np.zeros((len(problem.mean), cross.shape[2]))
    shared = np.sum(cross, axis=0)
    B[:links] = slope.T @ shared[:links]
    for j, block in zip(rows, cross, strict=True):
        B[links + own * j : links + own * (j + 1)] = block[links : links + own]
    B[links + own * problem.n :] = shared[links + own : -1]
    return B


def with_noise(problem: RobotProblem, z: Array) -> RobotProblem:
    """Return the same with variance and colour of what coordinates leave."""
    left = problem.sums.left(problem.difference(z))
    variance = np.sum(left**2, axis=0) / problem.sums.counted
    least = min(1.0, problem.sums.seconds / TUNING.together / len(left))
    share = np.maximum(independent(left, problem.sums.gaps), least)
    return replace(problem, variance=np.maximum(variance, 1e-18), share=share)


def independent(left: Array, gaps: npt.NDArray[np.bool_]) -> Array:
    """Return (n,) share of samples (N, n) that are independent: one over the sum of their autocorrelation.

    Args:
        left: what a fit leaves.
        gaps: (N,) whether a sample is the first of its log.
    """
    lags, n = max(2, len(left) // 4), left.shape[1]
    products, pairs = np.zeros((lags, n)), np.zeros((lags, 1))
    for part in np.split(left, np.flatnonzero(gaps)[1:]):
        spectrum = np.fft.rfft(part, 2 * len(part), axis=0)  # as long again in zeros, or ends would meet
        some = min(lags, len(part))
        products[:some] += np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:some]
        pairs[:some, 0] += len(part) - np.arange(some)
    rho = products[1:] / np.maximum(pairs[1:], 1.0) / np.maximum(np.mean(left**2, axis=0), 1e-30)
    total = 1.0 + 2.0 * np.sum(np.where(np.logical_and.accumulate(rho > 0.0), rho, 0.0), axis=0)
    return 1.0 / total
