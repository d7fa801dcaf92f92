"""The whitened data of a search and the candidates that may explain them, with all hypotheses solved so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.evidence import HypothesisFit, HypothesisSolver, Members
from twin_diagram.gap.search.inner_products import InnerProducts
from twin_diagram.gap.search.offered_columns import OfferedColumns
from twin_diagram.gap.search.prior_costs import compatible
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    finest: float = 5e-4
    """Noise is at least this share of a joint's torque: what filters and sampling leave of a noise-free log."""

    least_heard: float = 0.04
    """Share of the samples that are weighed whose torque must count for a law."""


TUNING = Tuning()


class Bench:
    """Whitened data and candidates.

    The nuisances are part of every hypothesis and bear no name.

    Attributes:
        n: number of joints.
        rows: number R of whitened samples.
        whitener: of the noise.
        weights: (n, R) of the whitened samples.
        y: (n, R) whitened, weighted residual.
        counts: (n,) samples that count.
        finest: (n,) the least variance that is thought possible; every fit's `variance` holds it.
        candidates: all that were taken in; their places here are their indices.
        columns: (rows, R, k) of each, whitened and weighted.
        right: (k,) inner products of each one's columns with y.
        prices: of each, see `Candidate.price`.
        products: of columns and residual, remembered.
        offered: which of them a search may choose from.
        solver: of hypotheses.
        reshaped: indices of what was taken in for other values of a candidate's shape, by what says which it was.
    """

    def __init__(
        self,
        residual: Array,
        whitener: Whitener,
        candidates: Sequence[Candidate],
        nuisances: Sequence[Candidate],
        weights: Array | None = None,
        size: Array | None = None,
    ) -> None:
        """Whiten.

        Args:
            residual: (ΣD, n) [N·m].
            whitener: of the noise.
            candidates: to choose from.
            nuisances: always there.
            weights: (n, R) of the whitened samples; None: all count.
            size: (n,) of the joints' torques, for the least noise that is thought possible [N·m]; None: the residual's.
        """
        self.whitener = whitener
        self.n = residual.shape[1]
        white = whitener.all(residual)
        self._raw = residual
        size = np.sqrt(np.mean(residual**2, axis=0)) if size is None else size
        self.finest = (TUNING.finest * size / whitener.sigma) ** 2 + 1e-12
        self.weights = np.ones_like(white) if weights is None else weights
        self.y = white * self.weights
        self.rows = white.shape[1]
        self.counts = np.maximum(np.sum(self.weights > 0.0, axis=1), 1.0)
        self.candidates: list[Candidate] = []
        self.columns: list[Array] = []
        self.right: list[Array] = []
        self.prices: list[float] = []
        self.products = InnerProducts(self.y, self.candidates, self.columns)
        self.offered = OfferedColumns((self.n, self.rows), self.candidates, self.columns, self.right)
        self.solver = HypothesisSolver(self.candidates, self.products, self.counts, self.finest)
        self.reshaped: dict[tuple[object, ...], dict[float, int | None]] = {}
        self.solver.nuisances = tuple(self.add(candidate) for candidate in nuisances)
        for candidate in candidates:
            self.add(candidate)

    def add(self, candidate: Candidate, *, offered: bool = True) -> int:
        """Take in one more candidate and return its index.

        Args:
            candidate: reduced like the bench's residual.
            offered: whether a search may choose it; otherwise it can only be put into a hypothesis by its index.
        """
        white = self.whiten(candidate)
        if candidate.unheard is not None:
            heard = 1.0 - candidate.unheard[self.whitener.rows]
            costs = (unheard_price(heard[self.weights[j] > 0.0]) for j in candidate.rows)
            candidate = replace(candidate, unheard_cost=float(sum(costs)))
        self.candidates.append(candidate)
        self.columns.append(white)
        self.right.append(np.einsum("jrk,jr->k", white, self.y[list(candidate.rows)]))
        self.prices.append(candidate.price)
        self.offered.add(offered)
        return len(self.candidates) - 1

    def whiten(self, candidate: Candidate) -> Array:
        """Return (rows, R, k) whitened, weighted columns."""
        rows = list(candidate.rows)
        white = self.whitener.joints(rows, candidate.columns)
        white *= self.weights[rows][:, :, None]
        return white

    def find(self, name: str) -> list[int]:
        """Return the indices of all candidates of a name."""
        return [k for k, candidate in enumerate(self.candidates) if candidate.name == name]

    def compatible(self, members: Members, k: int) -> bool:
        """Return whether a candidate may join a hypothesis."""
        new = self.candidates[k]
        return self.solver.told(new) and compatible([self.candidates[m] for m in members], new)

    def solve(self, members: Members) -> HypothesisFit:
        """Return the fit of a hypothesis; remembered."""
        return self.solver.solve(members)

    def part(self, fit: HypothesisFit, member: int) -> tuple[Array, Array]:
        """Return the coefficients (k,) and covariance (k, k) of one member."""
        start = 0
        for k in fit.order:
            size = self.candidates[k].size
            if k == member:
                return fit.coefficients[start : start + size], fit.covariance[
                    start : start + size, start : start + size
                ]
            start += size
        raise KeyError(member)

    def left(self, fit: HypothesisFit) -> Array:
        """Return (ΣD, n) residual of a fit [N·m]."""
        result = self._raw.copy()
        start = 0
        for k in fit.order:
            candidate = self.candidates[k]
            result[:, list(candidate.rows)] -= candidate.columns @ fit.coefficients[start : start + candidate.size]
            start += candidate.size
        return result


def unheard_price(heard: Array) -> float:
    """Return the price of a law for which the logged torque of some samples does not count [nats].

    Noise that does not count is explained as well: such samples seem to fit better than any can. The price is what
    that brings where the law is nothing else: half the logarithm, per sample, of the share of noise that is left.
    Where next to nothing is left, the law says of everything that it was not so, and cannot be told.

    Args:
        heard: (R,) how much each sample that is weighed counts, 0 to 1.
    """
    left = float(np.mean(heard)) if len(heard) else 0.0
    return np.inf if left < TUNING.least_heard else -0.5 * len(heard) * float(np.log(left))


def noise_of(bench: Bench, fit: HypothesisFit) -> Whitener:
    """Return the whitener of the noise that a fit leaves."""
    noise = bench.whitener
    return Whitener(noise.filters, noise.sigma * np.sqrt(fit.variance), noise.lengths)


def likelihood_gain(bench: Bench, fit: HypothesisFit) -> float:
    """Return twice the rise of the log likelihood over the empty hypothesis."""
    return float(np.sum(bench.counts * np.log(bench.solve(frozenset()).variance / fit.variance)))


def noise_distance(bench: Bench, fit: HypothesisFit, other: HypothesisFit) -> float:
    """Return how much worse another hypothesis fits, in standard deviations of the noise that `fit` leaves."""
    return float(np.sqrt(max(0.0, float(np.sum(bench.counts * (other.variance / fit.variance - 1.0))))))
