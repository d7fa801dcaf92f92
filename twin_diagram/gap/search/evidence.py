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

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, solve_triangular

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.normal_equations import (
    TUNING as NORMAL_EQUATIONS,
)
from twin_diagram.gap.search.normal_equations import (
    coefficients,
    increment,
    increments,
    smaller,
)
from twin_diagram.gap.search.prior_costs import compatible, price
from twin_diagram.signals.arrays import Array

Members = frozenset[int]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    passes: int = 3
    """Times that coefficients and variances of a hypothesis are solved in turn."""

    finest: float = 5e-4
    """Noise is at least this share of a joint's torque: what filters and sampling leave of a noise-free log."""


TUNING = Tuning()


@dataclass(frozen=True, eq=False)
class Fit:
    """A solved hypothesis.

    Attributes:
        members: indices of its candidates.
        evidence: log evidence over the empty hypothesis less all prices [nats]; −∞ where it is not physical.
        coefficients: of all members' columns, in the order of `order`.
        covariance: likewise.
        order: members as they were stacked.
        variance: (n,) of what it leaves, in units of the whitener's.
    """

    members: Members
    evidence: float
    coefficients: Array
    covariance: Array
    order: tuple[int, ...]
    variance: Array


class Bench:
    """Whitened data and candidates; solves hypotheses and scores what could be added to one.

    The nuisances are part of every hypothesis and bear no name.

    Attributes:
        finest: (n,) the least variance that is thought possible; every fit's `variance` holds it.
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
        self.candidates: list[Candidate] = []
        self.columns: list[Array] = []
        self._gram: dict[tuple[int, int], Array] = {}
        self._blocks: dict[tuple[int, int, int], Array] = {}
        self._zero = 0.0
        self.spent = 0
        self.counts = np.maximum(np.sum(self.weights > 0.0, axis=1), 1.0)
        self._right: list[Array] = []
        self._offered: list[bool] = []
        self.fits: dict[Members, Fit] = {}
        self.nuisances = tuple(self.add(candidate) for candidate in nuisances)
        for candidate in candidates:
            self.add(candidate)
        self._several: tuple[list[int], Array] | None = None
        self._groups: list[tuple[int, int, npt.NDArray[np.int64], Array]] | None = None

    def add(self, candidate: Candidate, *, offered: bool = True) -> int:
        """Take in one more candidate; answer its index.

        Args:
            candidate: reduced like the bench's residual.
            offered: whether `scores` counts it; otherwise it can only be put into a hypothesis by its index.
        """
        white = self.whiten(candidate)
        self.candidates.append(candidate)
        self.columns.append(white)
        self._right.append(np.einsum("jrk,jr->k", white, self.y[list(candidate.rows)]))
        self._offered.append(offered)
        if offered:
            self._groups = self._several = None
        return len(self.candidates) - 1

    def whiten(self, candidate: Candidate) -> Array:
        """Return (rows, R, k) whitened, weighted columns."""
        return np.stack(
            [
                self.whitener.joint(j, candidate.columns[:, k]) * self.weights[j][:, None]
                for k, j in enumerate(candidate.rows)
            ]
        )

    def is_offered(self, k: int) -> bool:
        """Return whether `scores` counts a candidate."""
        return self._offered[k]

    def offer(self, k: int) -> None:
        """Let `scores` count a candidate that was taken in without being offered."""
        self._offered[k] = True
        self._groups = self._several = None

    def score_once(
        self, candidate: Candidate, Q: Array, projected: Array, bounded: bool = False, white: Array | None = None
    ) -> float:
        """Return the rise of the evidence by a candidate that is not taken in; Q and Qᵀy as `basis` has them.

        −∞, where it is `bounded`, if it is not physical. `white`: what `whiten` gave, where it is known.
        """
        rows = list(candidate.rows)
        X = (self.whiten(candidate) if white is None else white).reshape(-1, candidate.size)
        C = Q[rows].reshape(len(X), Q.shape[2]).T @ X
        b = X.T @ self.y[rows].ravel() - C.T @ projected
        G = (X.T @ X - C.T @ C)[None]
        if bounded:
            return float(increment(G, b[None], candidate.spread[None], [candidate])[0])
        return float(increments(G, b[None], candidate.spread[None])[0])

    def find(self, name: str) -> list[int]:
        """Return the indices of all candidates of a name."""
        return [k for k, candidate in enumerate(self.candidates) if candidate.name == name]

    # Hypotheses.

    def gram(self, i: int, k: int) -> Array:
        """Inner products of two candidates' columns."""
        if (i, k) not in self._gram:
            a, b = self.candidates[i], self.candidates[k]
            shared = [(a.rows.index(j), b.rows.index(j)) for j in a.rows if j in b.rows]
            result = np.zeros((a.size, b.size))
            for x, y in shared:
                result += self.columns[i][x].T @ self.columns[k][y]
            self._gram[i, k] = result
            self._gram[k, i] = result.T
        return self._gram[i, k]

    def solve(self, members: Members) -> Fit:
        """Return the fit of a hypothesis; remembered."""
        known = self.fits.get(members)
        if known is None:
            known = self.fits[members] = self._solved(members)
        return known

    def _solved(self, members: Members) -> Fit:
        order = (*self.nuisances, *sorted(members))
        self.spent += len(order)
        spread = np.concatenate([self.candidates[k].spread for k in order]) if order else np.zeros(0)
        joints = [self._stacked(order, j) for j in range(self.n)]
        variance = np.ones(self.n)
        c: Array = np.zeros(len(spread))
        covariance: Array = np.zeros((0, 0))
        logdet = 0.0
        width, told = spread, 0
        for sweep in range(TUNING.passes):
            try:
                c, covariance, logdet = coefficients(joints, variance, width)
            except LinAlgError:
                return Fit(members, -np.inf, c, np.eye(len(spread)), order, variance)
            for j, (index, G) in enumerate(joints):
                d = np.concatenate([[1.0], -c[index]])
                variance[j] = max(float(d @ G @ d), 0.0) / self.counts[j] + self.finest[j]
            if sweep < TUNING.passes - 1:
                width, told = self._widths(order, c, np.diag(covariance), spread)
        likelihood = -0.5 * float(np.sum(self.counts * np.log(variance)))
        evidence = likelihood - 0.5 * float(np.sum((c / width) ** 2)) - 0.5 * logdet
        evidence -= self.price(members) + NORMAL_EQUATIONS.scale_price * told
        if members:
            self.solve(frozenset())
            evidence -= self._zero
        else:
            self._zero, evidence = evidence, 0.0
        if not self._physical(order, c):
            evidence = -np.inf
        return Fit(members, evidence, c, covariance, order, variance)

    def _widths(self, order: tuple[int, ...], c: Array, variance: Array, spread: Array) -> tuple[Array, int]:
        """Prior widths of all coefficients, and for how many members it is worth its price to say a smaller one."""
        result, told, start = spread.copy(), 0, 0
        for k in order:
            candidate = self.candidates[k]
            own = slice(start, start + candidate.size)
            start += candidate.size
            scale = float(smaller(c[own], variance[own], spread[own]))
            if candidate.name and -candidate.size * (np.log(scale) + 0.5) > NORMAL_EQUATIONS.scale_price:
                result[own] *= scale
                told += 1
        return result, told

    def _stacked(self, order: tuple[int, ...], j: int) -> tuple[npt.NDArray[np.int64], Array]:
        """Coefficients that matter on a joint, and inner products (1 + m, 1 + m) of the residual and their columns."""
        index: list[int] = []
        signals = [-1]
        start = 0
        for k in order:
            size = self.candidates[k].size
            if j in self.candidates[k].rows:
                signals.append(k)
                index += range(start, start + size)
            start += size
        starts = np.cumsum([0, 1, *(self.candidates[k].size for k in signals[1:])])
        G = np.empty((1 + len(index), 1 + len(index)))
        for x, a in enumerate(signals):
            for y in range(x, len(signals)):
                block = self._block(j, a, signals[y])
                G[starts[x] : starts[x + 1], starts[y] : starts[y + 1]] = block
                if x != y:
                    G[starts[y] : starts[y + 1], starts[x] : starts[x + 1]] = block.T
        return np.array(index, dtype=np.int64), G

    def _block(self, j: int, a: int, b: int) -> Array:
        key = (j, a, b)
        if key not in self._blocks:
            self._blocks[key] = self._signal(j, a).T @ self._signal(j, b)
        return self._blocks[key]

    def _signal(self, j: int, k: int) -> Array:
        """Return (R, m) a candidate's columns on a joint, or the residual (k = −1)."""
        return self.y[j][:, None] if k < 0 else self.columns[k][self.candidates[k].rows.index(j)]

    def _system(self, order: tuple[int, ...]) -> tuple[Array, Array, Array]:
        if not order:
            return np.zeros((0, 0)), np.zeros(0), np.zeros(0)
        S = np.block([[self.gram(i, k) for k in order] for i in order])
        spread = np.concatenate([self.candidates[k].spread for k in order])
        S = S + np.diag(spread**-2.0)
        return S, np.concatenate([self._right[k] for k in order]), spread

    def _physical(self, order: tuple[int, ...], coefficients: Array) -> bool:
        start = 0
        for k in order:
            candidate = self.candidates[k]
            own = coefficients[start : start + candidate.size]
            if candidate.name and not candidate.allows(own):
                return False
            start += candidate.size
        return True

    def part(self, fit: Fit, member: int) -> tuple[Array, Array]:
        """Coefficients and covariance of one member."""
        start = 0
        for k in fit.order:
            size = self.candidates[k].size
            if k == member:
                return fit.coefficients[start : start + size], fit.covariance[
                    start : start + size, start : start + size
                ]
            start += size
        raise KeyError(member)

    def price(self, members: Members) -> float:
        """Of names, joints and searched shapes [nats]."""
        return price([self.candidates[k] for k in members])

    def left(self, fit: Fit) -> Array:
        """Return (ΣD, n) residual of a fit [N·m]."""
        result = self._raw.copy()
        start = 0
        for k in fit.order:
            candidate = self.candidates[k]
            result[:, list(candidate.rows)] -= candidate.columns @ fit.coefficients[start : start + candidate.size]
            start += candidate.size
        return result

    def noise_of(self, fit: Fit) -> Whitener:
        """Of the noise that a fit leaves."""
        return Whitener(self.whitener.filters, self.whitener.sigma * np.sqrt(fit.variance), self.whitener.lengths)

    def gain(self, fit: Fit) -> float:
        """Return twice the rise of the log likelihood over the empty hypothesis.

        At most infinite where that fits as well.
        """
        return float(np.sum(self.counts * np.log(self.solve(frozenset()).variance / fit.variance)))

    def distance(self, fit: Fit, other: Fit) -> float:
        """Return how much worse another hypothesis fits, in standard deviations of the noise that `fit` leaves."""
        return float(np.sqrt(max(0.0, float(np.sum(self.counts * (other.variance / fit.variance - 1.0))))))

    def compatible(self, members: Members, k: int) -> bool:
        """Return whether a candidate may join a hypothesis."""
        return compatible([self.candidates[m] for m in members], self.candidates[k])

    # What could be added.

    def basis(self, members: Members) -> Array:
        """Return (n, R, K) whitened columns Q of a hypothesis: 1 − Q Qᵀ is the inverse of its covariance of y."""
        order = (*self.nuisances, *sorted(members))
        total = sum(self.candidates[k].size for k in order)
        stacked = np.zeros((self.n, self.rows, total))
        start = 0
        for k in order:
            candidate = self.candidates[k]
            stacked[list(candidate.rows), :, start : start + candidate.size] = self.columns[k]
            start += candidate.size
        if total == 0:
            return stacked
        S, _, _ = self._system(order)
        L = np.linalg.cholesky(S)
        flat = stacked.reshape(-1, total)
        return np.ascontiguousarray(solve_triangular(L, flat.T, lower=True).T.reshape(stacked.shape))

    def scores(self, members: Members) -> Array:
        """Return the rise of the evidence by each candidate alone, before the price of its name.

        −∞ where it is not physical.
        """
        Q = self.basis(members)
        projected = np.einsum("jrk,jr->k", Q, self.y) if Q.shape[2] else np.zeros(0)
        result = np.full(len(self.candidates), -np.inf)
        for j, size, indices, X in self._grouped():
            C = Q[j].T @ X
            result[indices] = self._increments(
                X.reshape(self.rows, len(indices), size),
                C.reshape(-1, len(indices), size),
                X.T @ self.y[j] - C.T @ projected,
                [self.candidates[k] for k in indices],
            )
        flat = Q.reshape(self.n * self.rows, Q.shape[2])
        several, wide = self._wide()
        C = flat.T @ wide
        start = 0
        for k in several:
            candidate = self.candidates[k]
            own = C[:, start : start + candidate.size]
            start += candidate.size
            G, b = self.gram(k, k) - own.T @ own, self._right[k] - own.T @ projected
            result[k] = increment(G[None], b[None], candidate.spread[None], [candidate])[0]
        costs = np.array([candidate.cost for candidate in self.candidates])
        return result - costs

    def _wide(self) -> tuple[list[int], Array]:
        """Return candidates of several rows, and their columns (n R, M) side by side."""
        if self._several is None:
            indices = [k for k, c in enumerate(self.candidates) if len(c.rows) > 1 and self._offered[k]]
            stacked = np.zeros((self.n, self.rows, sum(self.candidates[k].size for k in indices)))
            start = 0
            for k in indices:
                size = self.candidates[k].size
                stacked[list(self.candidates[k].rows), :, start : start + size] = self.columns[k]
                start += size
            self._several = indices, stacked.reshape(self.n * self.rows, stacked.shape[2])
        return self._several

    def _grouped(self) -> list[tuple[int, int, npt.NDArray[np.int64], Array]]:
        """Return candidates of one row, by joint and number of coefficients, side by side."""
        if self._groups is None:
            keys: dict[tuple[int, int], list[int]] = {}
            for k, candidate in enumerate(self.candidates):
                if len(candidate.rows) == 1 and self._offered[k]:
                    keys.setdefault((candidate.rows[0], candidate.size), []).append(k)
            self._groups = [
                (j, size, np.array(indices), np.concatenate([self.columns[k][0] for k in indices], axis=1))
                for (j, size), indices in keys.items()
            ]
        return self._groups

    def _increments(self, X: Array, C: Array, b: Array, candidates: list[Candidate]) -> Array:
        G = np.einsum("rmi,rmk->mik", X, X, optimize=True) - np.einsum("kmi,kmj->mij", C, C, optimize=True)
        spread = np.stack([candidate.spread for candidate in candidates])
        return increment(G, b.reshape(len(candidates), -1), spread, candidates)
