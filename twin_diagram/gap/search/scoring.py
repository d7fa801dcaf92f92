"""What each further candidate would add to the evidence of a hypothesis, without solving it anew.

The noise's level stays as it was whitened with: the scores rank candidates, and the best of them are solved for.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import Members
from twin_diagram.gap.search.normal_equations import increment, increments
from twin_diagram.signals.arrays import Array


def basis(bench: Bench, members: Members) -> Array:
    """Return (n, R, K) whitened columns Q of a hypothesis: 1 − Q Qᵀ is the inverse of its covariance of y."""
    order = bench.solver.order(members)
    total = sum(bench.candidates[k].size for k in order)
    stacked = np.zeros((bench.n, bench.rows, total))
    start = 0
    for k in order:
        candidate = bench.candidates[k]
        stacked[list(candidate.rows), :, start : start + candidate.size] = bench.columns[k]
        start += candidate.size
    if total == 0:
        return stacked
    S = np.block([[bench.products.gram(i, k) for k in order] for i in order])
    S = S + np.diag(np.concatenate([bench.candidates[k].spread for k in order]) ** -2.0)
    L = np.linalg.cholesky(S)
    flat = stacked.reshape(-1, total)
    return np.ascontiguousarray(solve_triangular(L, flat.T, lower=True).T.reshape(stacked.shape))


def score_candidates(bench: Bench, members: Members) -> Array:
    """Return the rise of the evidence by each candidate alone, before its name's price; −∞ where it is not physical."""
    Q = basis(bench, members)
    projected = np.einsum("jrk,jr->k", Q, bench.y) if Q.shape[2] else np.zeros(0)
    result = np.full(len(bench.candidates), -np.inf)
    for j, size, indices, X in bench.offered.by_joint():
        C = Q[j].T @ X
        result[indices] = _increments(
            X.reshape(bench.rows, len(indices), size),
            C.reshape(-1, len(indices), size),
            X.T @ bench.y[j] - C.T @ projected,
            [bench.candidates[k] for k in indices],
        )
    flat = Q.reshape(bench.n * bench.rows, Q.shape[2])
    several, wide = bench.offered.wide()
    C = flat.T @ wide
    start = 0
    of_size: dict[int, list[tuple[int, Array, Array]]] = {}
    for k in several:
        candidate = bench.candidates[k]
        own = C[:, start : start + candidate.size]
        start += candidate.size
        left = bench.products.gram(k, k) - own.T @ own, bench.right[k] - own.T @ projected
        of_size.setdefault(candidate.size, []).append((k, *left))
    for group in of_size.values():  # side by side: one by one, calls would take longer than the work
        candidates = [bench.candidates[k] for k, _, _ in group]
        spread = np.stack([candidate.spread for candidate in candidates])
        G, b = (np.stack([part[i] for part in group]) for i in (1, 2))
        result[[k for k, _, _ in group]] = increment(G, b, spread, candidates)
    costs = np.array([candidate.price for candidate in bench.candidates])
    return result - costs


def _increments(X: Array, C: Array, b: Array, candidates: list[Candidate]) -> Array:
    G = np.einsum("rmi,rmk->mik", X, X, optimize=True) - np.einsum("kmi,kmj->mij", C, C, optimize=True)
    spread = np.stack([candidate.spread for candidate in candidates])
    return increment(G, b.reshape(len(candidates), -1), spread, candidates)


def score_candidate(
    bench: Bench,
    candidate: Candidate,
    Q: Array,
    projected: Array,
    bounded: bool = False,
    white: Array | None = None,
) -> float:
    """Return the rise of the evidence by a candidate that is not taken in.

    Args:
        bench: with the data.
        candidate: reduced like the bench's residual.
        Q: (n, R, K) of the hypothesis that it would join, as `basis` has it.
        projected: (K,) Qᵀy.
        bounded: whether it is −∞ where the coefficients are not physical.
        white: what `Bench.whiten` gave, where the caller has it.
    """
    rows = list(candidate.rows)
    X = (bench.whiten(candidate) if white is None else white).reshape(-1, candidate.size)
    C = Q[rows].reshape(len(X), Q.shape[2]).T @ X
    b = X.T @ bench.y[rows].ravel() - C.T @ projected
    G = (X.T @ X - C.T @ C)[None]
    if bounded:
        return float(increment(G, b[None], candidate.spread[None], [candidate])[0])
    return float(increments(G, b[None], candidate.spread[None])[0])
