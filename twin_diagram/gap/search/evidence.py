"""Evidence of hypotheses on whitened data.

A set of candidates X, with independent Gaussian priors on its coefficients, leaves a residual on each joint; its colour
is taken as known, and its variance σ² is the hypothesis's own:

    log p(y | X) − log p(y | ∅) = −½ Σ_j N_j log(σ_j² / σ_j²(∅)) − ½ cᵀ Λ c − ½ log det(S Λ⁻¹),
    S = Σ_j X_jᵀ X_j / σ_j² + Λ

with y and X whitened, and Λ the priors' precision (MacKay 1992). What a hypothesis fails to explain makes its own noise
larger, so that no guess of the noise's level beforehand can be too low. The last term is the price of each
coefficient; searched shapes, new names and further joints have theirs in nats. How much smaller an effect is than its
prior speaks of may be said, too, for a price: else a small one would pay for all the sizes that it does not have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.search.inner_products import InnerProducts
from twin_diagram.gap.search.normal_equations import TUNING as NORMAL_EQUATIONS
from twin_diagram.gap.search.normal_equations import coefficients, covariance_of, smaller_each, variances_of
from twin_diagram.gap.search.prior_costs import price
from twin_diagram.signals.arrays import Array

Members = frozenset[int]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    passes: int = 3
    """Times that coefficients and variances of a hypothesis are solved in turn."""


TUNING = Tuning()


@dataclass(frozen=True, eq=False)
class HypothesisFit:
    """A solved hypothesis.

    Attributes:
        members: indices of its candidates.
        evidence: log evidence over the empty hypothesis less all prices [nats]; −∞ where it is not physical.
        coefficients: of all members' columns, in the order of `order`.
        factor: (K, K) lower Cholesky factor of the coefficients' precision, likewise.
        order: members as they were stacked.
        variance: (n,) of what it leaves, in units of the whitener's.
    """

    members: Members
    evidence: float
    coefficients: Array
    factor: Array
    order: tuple[int, ...]
    variance: Array

    @cached_property
    def covariance(self) -> Array:
        """(K, K) of the coefficients; few of all fits are asked for it."""
        return covariance_of(self.factor)


class HypothesisSolver:
    """Solves hypotheses about whitened data, and remembers them.

    Attributes:
        nuisances: indices of the candidates that are part of every hypothesis.
        fits: all that were solved.
        spent: members that were solved for, all fits together: the work done.
    """

    def __init__(self, candidates: list[Candidate], products: InnerProducts, counts: Array, finest: Array) -> None:
        """Start without nuisances.

        Args:
            candidates: may grow.
            products: of their whitened columns and the residual.
            counts: (n,) samples that count.
            finest: (n,) the least variance that is thought possible, in units of the whitener's.
        """
        self._candidates = candidates
        self._products = products
        self._counts = counts
        self._finest = finest
        self._heard = (counts > 1.0).tolist()
        self._zero = 0.0
        self.nuisances: tuple[int, ...] = ()
        self.fits: dict[Members, HypothesisFit] = {}
        self.spent = 0

    def order(self, members: Members) -> tuple[int, ...]:
        """Return the candidates of a hypothesis as they are stacked: nuisances first."""
        return (*self.nuisances, *sorted(members))

    def solve(self, members: Members) -> HypothesisFit:
        """Return the fit of a hypothesis; remembered."""
        known = self.fits.get(members)
        if known is None:
            known = self.fits[members] = self._solved(members)
        return known

    def _solved(self, members: Members) -> HypothesisFit:
        order, n = self.order(members), len(self._counts)
        self.spent += len(order)
        spread = np.concatenate([self._candidates[k].spread for k in order]) if order else np.zeros(0)
        square, right, between = self._products.stacked(order)
        sizes = np.array([self._candidates[k].size for k in order], dtype=np.int64)
        named = np.array([bool(self._candidates[k].name) for k in order], dtype=bool)
        variance = np.ones(n)
        c: Array = np.zeros(len(spread))
        factor: Array = np.zeros((0, 0))
        logdet = 0.0
        width, told = spread, 0
        for sweep in range(TUNING.passes):
            try:
                c, factor, logdet = coefficients(right, between, variance, width)
            except LinAlgError:
                return HypothesisFit(members, -np.inf, c, np.eye(len(spread)), order, variance)
            left = square - (2.0 * right - between @ c) @ c
            variance = np.maximum(left, 0.0) / self._counts + self._finest
            if sweep < TUNING.passes - 1:
                width, told = _widths(sizes, named, c, variances_of(factor), spread)
        likelihood = -0.5 * float(np.sum(self._counts * np.log(variance)))
        evidence = likelihood - 0.5 * float(np.sum((c / width) ** 2)) - 0.5 * logdet
        evidence -= price([self._candidates[k] for k in members], n) + NORMAL_EQUATIONS.scale_price * told
        if members:
            self.solve(frozenset())
            evidence -= self._zero
        else:
            self._zero, evidence = evidence, 0.0
        if not (_physical(self._candidates, order, c) and all(self.told(self._candidates[k]) for k in members)):
            evidence = -np.inf
        return HypothesisFit(members, evidence, c, factor, order, variance)

    def told(self, candidate: Candidate) -> bool:
        """Return whether each joint that a candidate names has samples that count."""
        return all(self._heard[j] for j in candidate.joints)


def _widths(
    sizes: npt.NDArray[np.int64], named: npt.NDArray[np.bool_], c: Array, variance: Array, spread: Array
) -> tuple[Array, int]:
    """Return the prior widths of all coefficients, and how many members have one that is worth its price.

    Args:
        sizes: (m,) coefficients of each member.
        named: (m,) whether it has a name.
        c: (K,) coefficients.
        variance: (K,) of what is left to know of them.
        spread: (K,) of the prior.
    """
    if not len(sizes):
        return spread.copy(), 0
    scale = smaller_each(sizes, c, variance, spread)
    told = named & (-sizes * (np.log(scale) + 0.5) > NORMAL_EQUATIONS.scale_price)
    return spread * np.repeat(np.where(told, scale, 1.0), sizes), int(np.sum(told))


def _physical(candidates: Sequence[Candidate], order: Sequence[int], coefficients: Array) -> bool:
    """Return whether all named candidates allow their coefficients."""
    start = 0
    for k in order:
        candidate = candidates[k]
        own = coefficients[start : start + candidate.size]
        if candidate.name and not candidate.allows(own):
            return False
        start += candidate.size
    return True
