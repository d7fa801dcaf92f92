"""Evidence of hypotheses on whitened data.

With white noise of variance 1 and independent Gaussian priors on the coefficients, a set of candidates X has

    log p(y | X) − log p(y | ∅) = ½ bᵀ S⁻¹ b − ½ log det(S Λ⁻¹),   S = XᵀX + Λ,  b = Xᵀ y,

Λ the priors' precision (MacKay 1992). The second term is the price of each coefficient; searched shapes, new names and
further joints have theirs in nats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from twin_diagram.gap.candidate import Candidate
from twin_diagram.gap.whitening import Whitener

Array = npt.NDArray[np.float64]
Members = frozenset[int]

NEW_NAME = 6.0
"""Price of naming one more effect [nats]: some twenty names, some seven places."""

FURTHER_JOINT = 3.0
"""Price of naming it on one more joint."""

EXCLUSIVE = (
    frozenset({"coulomb_friction", "stribeck_friction"}),
    frozenset({"torque_bias", "joint_spring"}),
    frozenset({"reflected_inertia", "joint_elasticity"}),
    frozenset({"reflected_inertia", "backlash"}),
    frozenset({"joint_elasticity", "backlash"}),
)
"""Names of which only one is said of a joint."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A solved hypothesis.

    Attributes:
        members: indices of its candidates.
        evidence: log evidence over the empty hypothesis less all prices [nats]; −∞ where it is not physical.
        coefficients: of all members' columns, in the order of `order`.
        covariance: likewise.
        order: members as they were stacked.
        gain: fall of the squared, whitened residual.
    """

    members: Members
    evidence: float
    coefficients: Array
    covariance: Array
    order: tuple[int, ...]
    gain: float


ONCE = frozenset({"external_force", "payload", "gravity_tilt", "time_delay"})
"""Names that are said once; several forces in a row follow any curve of time."""


class Bench:
    """Whitened data and candidates; solves hypotheses and scores what could be added to one.

    The nuisances are part of every hypothesis and bear no name.
    """

    def __init__(
        self,
        residual: Array,
        whitener: Whitener,
        candidates: Sequence[Candidate],
        nuisances: Sequence[Candidate],
        weights: Array | None = None,
    ) -> None:
        """Whitens.

        Args:
            residual: (ΣD, n) [N·m].
            whitener: of the noise.
            candidates: to choose from.
            nuisances: always there.
            weights: (n, R) of the whitened samples; None: all count.
        """
        self.whitener = whitener
        self.n = residual.shape[1]
        white = whitener.all(residual)
        self.weights = np.ones_like(white) if weights is None else weights
        self.y = white * self.weights
        self.rows = white.shape[1]
        self.candidates: list[Candidate] = []
        self.columns: list[Array] = []
        self._gram: dict[tuple[int, int], Array] = {}
        self._right: list[Array] = []
        self._offered: list[bool] = []
        self.fits: dict[Members, Fit] = {}
        self.nuisances = tuple(self.add(candidate) for candidate in nuisances)
        for candidate in candidates:
            self.add(candidate)
        self._groups: list[tuple[int, int, npt.NDArray[np.int64], Array]] | None = None

    def add(self, candidate: Candidate, *, offered: bool = True) -> int:
        """Takes in one more candidate; answers its index.

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
            self._groups = None
        return len(self.candidates) - 1

    def whiten(self, candidate: Candidate) -> Array:
        """(rows, R, k) whitened, weighted columns."""
        return np.stack(
            [
                self.whitener.joint(j, candidate.columns[:, k]) * self.weights[j][:, None]
                for k, j in enumerate(candidate.rows)
            ]
        )

    def is_offered(self, k: int) -> bool:
        """Whether `scores` counts a candidate."""
        return self._offered[k]

    def score_once(self, candidate: Candidate, Q: Array, projected: Array) -> float:
        """Rise of the evidence by a candidate that is not taken in; Q and Qᵀy as `basis` has them."""
        rows = list(candidate.rows)
        X = self.whiten(candidate).reshape(-1, candidate.size)
        C = Q[rows].reshape(-1, Q.shape[2]).T @ X
        b = X.T @ self.y[rows].ravel() - C.T @ projected
        return float(increments((X.T @ X - C.T @ C)[None], b[None], candidate.spread[None])[0])

    def find(self, name: str) -> list[int]:
        """Indices of all candidates of a name."""
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
        """The fit of a hypothesis; remembered."""
        known = self.fits.get(members)
        if known is not None:
            return known
        order = (*self.nuisances, *sorted(members))
        S, b, spread = self._system(order)
        factor: Any = cho_factor(S, lower=True)
        coefficients = cho_solve(factor, b)
        covariance = cho_solve(factor, np.eye(len(b)))
        logdet = 2.0 * float(np.sum(np.log(np.diag(factor[0])) + np.log(spread)))
        gain = float(b @ coefficients)
        evidence = 0.5 * gain - 0.5 * logdet - self.price(members)
        if not self._physical(order, coefficients, covariance):
            evidence = -np.inf
        fit = Fit(members, evidence, coefficients, covariance, order, gain)
        self.fits[members] = fit
        return fit

    def _system(self, order: tuple[int, ...]) -> tuple[Array, Array, Array]:
        if not order:
            return np.zeros((0, 0)), np.zeros(0), np.zeros(0)
        S = np.block([[self.gram(i, k) for k in order] for i in order])
        spread = np.concatenate([self.candidates[k].spread for k in order])
        S = S + np.diag(spread**-2.0)
        return S, np.concatenate([self._right[k] for k in order]), spread

    def _physical(self, order: tuple[int, ...], coefficients: Array, covariance: Array) -> bool:
        start = 0
        for k in order:
            candidate = self.candidates[k]
            own = coefficients[start : start + candidate.size]
            if candidate.name and not candidate.allows(own):
                return False
            start += candidate.size
        del covariance
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
        counts: dict[str, int] = {}
        total = 0.0
        for k in members:
            candidate = self.candidates[k]
            counts[candidate.name] = counts.get(candidate.name, 0) + 1
            total += candidate.cost
        return total + sum(NEW_NAME + FURTHER_JOINT * (count - 1) for count in counts.values())

    def residual(self, fit: Fit) -> Array:
        """(n, R) whitened, weighted residual of a fit."""
        result = self.y.copy()
        start = 0
        for k in fit.order:
            candidate = self.candidates[k]
            own = fit.coefficients[start : start + candidate.size]
            result[list(candidate.rows)] -= self.columns[k] @ own
            start += candidate.size
        return result

    def compatible(self, members: Members, k: int) -> bool:
        """Whether a candidate may join a hypothesis."""
        new = self.candidates[k]
        for m in members:
            old = self.candidates[m]
            if (
                new.name == old.name
                and (new.joints == old.joints and new.links == old.links)
                and not (new.name == "torque_ripple" and abs(new.shape["cycles"] - old.shape["cycles"]) > 2.0)
            ):
                return False
            if new.name == old.name and new.name in ONCE:
                return False
            if set(new.joints) & set(old.joints) and frozenset({new.name, old.name}) in EXCLUSIVE:
                return False
            if new.links and new.links == old.links and {new.name, old.name} == {"payload", "inertial_parameters"}:
                return False
        return True

    # What could be added.

    def basis(self, members: Members) -> Array:
        """(n, R, K) whitened columns Q of a hypothesis such that 1 − Q Qᵀ is the inverse of its covariance of y."""
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
        """Rise of the evidence by each candidate alone, before the price of its name; −∞ where it is not physical."""
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
        for k, candidate in enumerate(self.candidates):
            if len(candidate.rows) > 1 and self._offered[k]:
                C = np.einsum("jrk,jrm->km", Q[list(candidate.rows)], self.columns[k], optimize=True)
                G = self.gram(k, k) - C.T @ C
                b = self._right[k] - C.T @ projected
                result[k] = _increment(G[None], b[None], candidate.spread[None], [candidate])[0]
        costs = np.array([candidate.cost for candidate in self.candidates])
        return result - costs

    def _grouped(self) -> list[tuple[int, int, npt.NDArray[np.int64], Array]]:
        """Candidates of one row, by joint and number of coefficients, side by side."""
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
        return _increment(G, b.reshape(len(candidates), -1), spread, candidates)


def increments(G: Array, b: Array, spread: Array) -> Array:
    """(m,) rises of the evidence, for information G (m, k, k), right sides b (m, k) and priors (m, k)."""
    return _solutions(G, b, spread)[0]


def _solutions(G: Array, b: Array, spread: Array) -> tuple[Array, Array]:
    scaled = spread[:, :, None] * G * spread[:, None, :] + np.eye(G.shape[1])
    c = spread * np.linalg.solve(scaled, (spread * b)[..., None])[..., 0]
    _, logdet = np.linalg.slogdet(scaled)
    return 0.5 * np.sum(b * c, axis=1) - 0.5 * logdet, c


def _increment(G: Array, b: Array, spread: Array, candidates: list[Candidate]) -> Array:
    """The same, −∞ where the coefficients are not physical."""
    result, c = _solutions(G, b, spread)
    physical = [candidate.allows(own) for candidate, own in zip(candidates, c, strict=True)]
    return np.where(physical, result, -np.inf)
