"""All links and joints fitted at once: physical, drawn to the description, on some stretches of motion or all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.whole_robot.bounded_step import Chosen, bounded
from twin_diagram.gap.whole_robot.independent_samples import independent
from twin_diagram.gap.whole_robot.physical_links import Links, by_coordinates, parameters, slopes
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

    drift: float = 0.005
    """Share of the largest torque that a joint logs by which its offset drifts from day to day, one standard
    deviation: a current's or a torque sensor's zero drifts by tenths of a percent of its range."""

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
        told: (14 n, 14 n) covariance that links' coordinates, then joints' own terms were found with before, or
            (10 n, 10 n) of links alone; what may have changed since comes on top. None: they were not, or not known.
        known: whether they were found before: they are then rather as they were.
        rotors: share of itself by which a rotor that the description states may be off, one standard deviation.
        held: (Z,) coordinates at which what acts for a while is held; None: it is fitted like all else.
        rubs: dry friction that an arm's drives have, one like another, to within itself, see `beside_dry`; 0: nothing
            is known of it.
        zeros: share of the largest force that a joint which slides logs by which its offset may be, one standard
            deviation: what a load weighs there would be one, else.

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
    rotors: float = np.inf
    held: Array | None = None
    rubs: float = 0.0
    zeros: float = np.inf

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
    def drawn_to(self) -> Array:
        """(Z,) of the prior: the description, but for dry friction that drives have."""
        result, dry = self.mean.copy(), 10 * self.n + OWN.index("coulomb")
        place = slice(dry, 14 * self.n, len(OWN))
        result[place] = np.where(self._rubbing, self.rubs, result[place])
        return result

    @property
    def _rubbing(self) -> Chosen:
        """(n,) on which joints dry friction is drawn to that of others: where none is stated, nor was found before."""
        own, fresh = OWN.index("coulomb"), self.rubs > 0.0 and self.told is None
        return np.asarray(self.own_free[:, own] & ~self.stated[:, own] & fresh)

    @cached_property
    def _still(self) -> Chosen:
        """(E,) which coefficients of further candidates are held."""
        sizes = [c.size for c in self.sums.further]
        brief = [self.held is not None and c.passing for c in self.sums.further]
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
        further = [c.spread for c in self.sums.further]
        return np.concatenate([self.spread * self.links.scale.ravel(), self.own_deviation.ravel(), *further])

    @property
    def own_deviation(self) -> Array:
        """(n, 4) of joints' own terms, next to free, but for rotors that are stated, and what was found before.

        Friction changes with warmth and wear, a rotor as little as a link, and an offset drifts.
        """
        own = TUNING.own * self.sums.residual_rms[:, None] / np.maximum(self.sums.own_size, 1e-9)
        rotor, bias = OWN.index("rotor"), OWN.index("bias")
        if self.told is not None and len(self.told) == 14 * self.n:
            own[:, rotor] = self.spread * np.where(self.stated[:, rotor], -self.least[:, rotor], own[:, rotor])
            own[:, bias] = np.minimum(own[:, bias], TUNING.drift * self.sums.largest)
        elif np.isfinite(self.rotors):
            stated = np.where(self.stated[:, rotor], -self.rotors * self.least[:, rotor], np.inf)
            own[:, rotor] = np.minimum(own[:, rotor], stated)
        rails = [joint in self.sums.records.model.prismatic for joint in self.sums.records.model.joints]
        own[rails, bias] = np.minimum(own[rails, bias], self.zeros * self.sums.largest[rails])
        dry = OWN.index("coulomb")
        own[:, dry] = np.where(self._rubbing, np.minimum(own[:, dry], self.rubs), own[:, dry])
        return np.maximum(own, 1e-9)

    @cached_property
    def precision(self) -> Array:
        """(Z, Z) of the prior: what was found before hangs together."""
        deviation = self.deviation
        result = np.diag(deviation**-2.0)
        if self.told is not None:
            size = len(self.told)
            result[:size, :size] = np.linalg.inv(self.told + np.diag(deviation[:size] ** 2))
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

    def moved(self, z: Array) -> Array:
        """Return (Z + 1,) of what coordinates change in the residual, per parameter, and 1 for the residual itself."""
        links = 10 * self.n
        off = (parameters(z[:links].reshape(-1, 10)) - self.links.described).ravel()
        return np.concatenate([-off, -z[links:], [1.0]])

    def form(self, total: Array) -> Array:
        """Return (Z + 1, Z + 1) sums of squares and products of all joints over their variance, one row per parameter.

        Links and what is further there are in all joints' equations, what is a joint's own in its alone. Squares of
        what is left are then one quadratic form in `moved`, however many joints there are.

        Args:
            total: (n, K + 1, K + 1) sums.
        """
        return self._forms(total[None])[0]

    def _forms(self, totals: Array) -> Array:
        """Return (F, Z + 1, Z + 1) of sums (F, n, K + 1, K + 1)."""
        n, links, size = self.n, 10 * self.n, len(self.mean) + 1
        mine = slice(links, links + len(OWN))
        weighted = (self.share / self.variance)[:, None, None] * totals
        shared = np.delete(np.arange(totals.shape[2]), mine)
        places = np.concatenate([np.arange(links), np.arange(14 * n, size)])
        own = links + np.arange(n * len(OWN)).reshape(n, len(OWN))
        result = np.zeros((len(totals), size, size))
        result[:, places[:, None], places] = np.sum(weighted, axis=1)[:, shared[:, None], shared]
        result[:, own[:, :, None], own[:, None]] = weighted[:, :, mine, mine]
        across = weighted[:, :, mine][..., shared]
        result[:, own[:, :, None], places] = across
        result[:, places[:, None], own.ravel()] = across.reshape(len(totals), own.size, -1).transpose(0, 2, 1)
        return result

    @cached_property
    def forms_without(self) -> Array:
        """(F, Z + 1, Z + 1) `form` of all motion but each kind of it."""
        of_kinds = self._forms(self.sums.of_kinds)
        return np.asarray(np.sum(of_kinds, axis=0) - of_kinds)

    def squares(self, z: Array, total: Array) -> Array:
        """Return (n,) sums of squares that coordinates leave, of sums (n, K + 1, K + 1)."""
        return self.squares_each(z[None, None], total[None])[0, 0]

    def squares_each(self, z: Array, totals: Array) -> Array:
        """Return (F, U, n) of the same of each of coordinates (F, U, Z) on sums (F, n, K + 1, K + 1)."""
        difference = self._differences(z.reshape(-1, z.shape[-1])).reshape(*z.shape[:2], self.n, -1)
        full = np.concatenate([-difference, np.ones((*z.shape[:2], self.n, 1))], axis=3).transpose(0, 2, 1, 3)
        return np.asarray(np.sum((full @ totals) * full, axis=3).transpose(0, 2, 1))

    def cost(self, z: Array, total: Array) -> float:
        """Return half the squares over their variance, the prior's counted, of sums (n, K + 1, K + 1)."""
        moved, off = self.moved(z), z - self.drawn_to
        return 0.5 * float(moved @ self.form(total) @ moved + off @ self.precision @ off)

    def pulls(self, z: Array) -> Array:
        """Return (S, Z) the part of the gradient that residuals in each stretch of motion have."""
        sums, links, own = self.sums, 10 * self.n, len(OWN)
        left = sums.left(self.difference(z)) * (self.share / self.variance)
        by_parameters = np.zeros((len(z), len(sums.fold)))
        for s in range(len(sums.fold)):
            here = np.flatnonzero(sums.stretch == s)
            some, columns = left[here], sums.columns[here, :, :-1]
            shared = some.ravel() @ columns.reshape(some.size, -1)
            mine = np.einsum("tj,tjk->jk", some, columns[:, :, links : links + own])
            by_parameters[:, s] = np.concatenate([shared[:links], mine.ravel(), shared[links + own :]])
        return -by_coordinates(by_parameters, slopes(z[:links].reshape(-1, 10))).T

    def system(self, z: Array, total: Array) -> tuple[Array, Array]:
        """Return the normal matrix (Z, Z) and gradient (Z,) of half the squares, the prior's counted."""
        return self.system_of(z, self.form(total))

    def system_of(self, z: Array, form: Array) -> tuple[Array, Array]:
        """Return the same of a `form` (Z + 1, Z + 1)."""
        blocks = slopes(z[: 10 * self.n].reshape(-1, 10))
        gradient = -by_coordinates(form[:-1] @ self.moved(z), blocks)
        H = by_coordinates(by_coordinates(form[:-1, :-1], blocks).T, blocks)
        return H + self.precision, gradient + self.precision @ (z - self.drawn_to)


@dataclass(frozen=True)
class MovingPart:
    """A problem's coordinates that may move, the others where the description has them: all that is fitted.

    What does not move is a constant, and is in the residual from the start.

    Attributes:
        problem: that is fitted.
        at: (M,) which coordinates move.
        links: which links are among them.
        form: (M + 1, M + 1) of what moves and the residual that the rest leaves, see `RobotProblem.form`.
        precision: (M, M) of the prior.
    """

    problem: RobotProblem
    at: npt.NDArray[np.int64]
    links: npt.NDArray[np.int64]
    form: Array
    precision: Array

    @staticmethod
    def of(problem: RobotProblem, whole: Array) -> MovingPart:
        """Take it out of a problem, of a `form` (Z + 1, Z + 1)."""
        at = np.flatnonzero(problem.free)
        rest = problem.moved(problem.mean)
        rest[at] = 0.0
        form = np.empty((len(at) + 1, len(at) + 1))
        form[:-1, :-1] = whole[np.ix_(at, at)]
        left = whole @ rest
        form[-1, :-1] = form[:-1, -1] = left[at]
        form[-1, -1] = rest @ left
        return MovingPart(problem, at, np.flatnonzero(problem.links_free), form, problem.precision[np.ix_(at, at)])

    def cost(self, x: Array) -> float:
        """Return half the squares over their variance, the prior's counted, at coordinates (M,)."""
        moved, off = self._moved(x), x - self.problem.drawn_to[self.at]
        return 0.5 * float(moved @ self.form @ moved + off @ self.precision @ off)

    def system(self, x: Array) -> tuple[Array, Array]:
        """Return normal matrix (M, M) and gradient (M,) of `cost` at coordinates (M,)."""
        blocks = slopes(x[: 10 * len(self.links)].reshape(-1, 10))
        gradient = -by_coordinates(self.form[:-1] @ self._moved(x), blocks)
        H = by_coordinates(by_coordinates(self.form[:-1, :-1], blocks).T, blocks)
        return H + self.precision, gradient + self.precision @ (x - self.problem.drawn_to[self.at])

    def _moved(self, x: Array) -> Array:
        links = 10 * len(self.links)
        off = parameters(x[:links].reshape(-1, 10)) - self.problem.links.described[self.links]
        return np.concatenate([-off.ravel(), -x[links:], [1.0]])


def solve(problem: RobotProblem, total: Array | None = None, start: Array | None = None) -> Array:
    """Return the coordinates (Z,) that fit best.

    Args:
        problem: what is fitted.
        total: (n, K + 1, K + 1) sums that count; None: all.
        start: where to begin; None: as described.
    """
    return fitted(problem, problem.form(problem.sums.whole if total is None else total), start)


def fitted(problem: RobotProblem, form: Array, start: Array | None = None) -> Array:
    """Return the same of a `RobotProblem.form` (Z + 1, Z + 1)."""
    part = MovingPart.of(problem, form)
    at, z = part.at, problem.mean.copy()
    x = (z if start is None else start)[at]
    deviation, lower, cost = problem.deviation[at], problem.lower[at], part.cost(x)
    scale, every = problem.links.scale[part.links].ravel(), np.ones(len(at), dtype=bool)
    for _ in range(TUNING.rounds):
        step = bounded(*part.system(x), lower - x, every)
        long = float(np.max(np.abs(step[: len(scale)]) / scale, initial=0.0))
        step = step * min(1.0, TUNING.longest / max(long, 1e-12))
        halved, after = 0, part.cost(x + step)
        while after > cost and halved < TUNING.halvings:
            step, halved = 0.5 * step, halved + 1
            after = part.cost(x + step)
        x, cost = x + step, after
        if np.max(np.abs(step) / deviation, initial=0.0) < TUNING.settled:
            break
    z[at] = x
    return z


def coupling(problem: RobotProblem, rows: list[int], blocks: Array, cross: Array) -> Array:
    """Return (Z, k) of the normal matrix between coordinates and a candidate that is not among them.

    Args:
        problem: of the coordinates.
        rows: joints that the candidate touches.
        blocks: (n, 10, 10) of links' parameters by their coordinates.
        cross: (r, K + 1, k) weighted products with all columns, one per joint that the candidate touches.
    """
    links, own = 10 * problem.n, len(OWN)
    B = np.zeros((len(problem.mean), cross.shape[2]))
    shared, mine = np.sum(cross, axis=0), slice(links, links + own)
    B[:links], B[links + own * problem.n :] = shared[:links], shared[links + own : -1]
    B[mine.start : links + own * problem.n].reshape(problem.n, own, -1)[rows] = cross[:, mine]
    return by_coordinates(B, blocks)


def with_noise(problem: RobotProblem, z: Array) -> RobotProblem:
    """Return the same with variance and colour of what coordinates leave."""
    left = problem.sums.left(problem.difference(z))
    variance = np.sum(left**2, axis=0) / problem.sums.counted
    least = min(1.0, problem.sums.seconds / TUNING.together / len(left))
    share = np.maximum(independent(left, problem.sums.gaps), least)
    return replace(problem, variance=np.maximum(variance, 1e-18), share=share)
