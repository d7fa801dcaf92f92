"""What each further candidate would add to the evidence of a hypothesis, without solving it anew.

The noise's level stays as it was whitened with: the scores rank candidates, and the best of them are solved for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import Members
from twin_diagram.gap.search.normal_equations import increment, increments, solutions
from twin_diagram.gap.search.offered_columns import Group
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


def _beside_all(bench: Bench, members: Members) -> tuple[Array, Array]:
    """Return products of a hypothesis's basis with all offered columns (K, M), see `OfferedColumns.beside`, and with y.

    The basis itself, of as many samples as the logs have, is not needed for them.
    """
    order = bench.solver.order(members)
    if not order:
        return np.zeros((0, bench.offered.width())), np.zeros(0)
    _, right, between = bench.products.stacked(order)
    S = np.sum(between, axis=0) + np.diag(np.concatenate([bench.candidates[k].spread for k in order]) ** -2.0)
    both = np.column_stack([np.concatenate([bench.offered.beside(k) for k in order]), np.sum(right, axis=0)])
    found = solve_triangular(np.linalg.cholesky(S), both, lower=True, check_finite=False)
    return found[:, :-1], found[:, -1]


def score_candidates(bench: Bench, members: Members) -> Array:
    """Return the rise of the evidence by each candidate alone, before its name's price; −∞ where it is not physical."""
    C, projected = _beside_all(bench, members)
    result = np.full(len(bench.candidates), -np.inf)
    of_one_size: dict[int, list[tuple[Group, Array, Array]]] = {}
    first = 0
    for group in bench.offered.by_joint():
        many, size = group.spread.shape
        apart = C[:, first : first + many * size].reshape(len(C), many, size).transpose(1, 2, 0)
        first += many * size
        left = group.own - apart @ apart.transpose(0, 2, 1), group.right - apart @ projected
        of_one_size.setdefault(size, []).append((group, *left))
    for groups in of_one_size.values():  # side by side: one by one, calls would take longer than the work
        there = [group for group, _, _ in groups]
        G, b = (np.concatenate([part[i] for part in groups]) for i in (1, 2))
        spread, lower, upper = (
            np.concatenate([getattr(group, name) for group in there]) for name in ("spread", "lower", "upper")
        )
        rise, c = solutions(G, b, spread)
        physical = np.all((c >= lower) & (c <= upper), axis=1)
        start = 0
        for group in there:
            for at in group.conditional:
                physical[start + at] &= bench.candidates[group.indices[at]].allows(c[start + at])
            start += len(group.indices)
        result[np.concatenate([group.indices for group in there])] = np.where(physical, rise, -np.inf)
    several, _ = bench.offered.wide()
    start = first
    of_size: dict[int, list[tuple[int, Array, Array]]] = {}
    for k in several:
        candidate = bench.candidates[k]
        own = C[:, start : start + candidate.size]
        start += candidate.size
        left = bench.products.gram(k, k) - own.T @ own, bench.right[k] - own.T @ projected
        of_size.setdefault(candidate.size, []).append((k, *left))
    for group_of in of_size.values():
        candidates = [bench.candidates[k] for k, _, _ in group_of]
        spread = np.stack([candidate.spread for candidate in candidates])
        G, b = (np.stack([part[i] for part in group_of]) for i in (1, 2))
        result[[k for k, _, _ in group_of]] = increment(G, b, spread, candidates)
    return result - np.array(bench.prices)


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
    free, physical = score_both(bench, candidate, Q, projected, bench.whiten(candidate) if white is None else white)
    return physical if bounded else free


def score_both(bench: Bench, candidate: Candidate, Q: Array, projected: Array, white: Array) -> tuple[float, float]:
    """Return the rise of the evidence by a candidate that is not taken in, and the same, −∞ if it is not physical.

    Args:
        bench: with the data.
        candidate: reduced like the bench's residual.
        Q: (n, R, K) of the hypothesis that it would join, as `basis` has it.
        projected: (K,) Qᵀy.
        white: what `Bench.whiten` gave.
    """
    rows = list(candidate.rows)
    X = white.reshape(-1, candidate.size)
    C = on_rows(Q, rows).T @ X
    b = X.T @ bench.y[rows].ravel() - C.T @ projected
    rise, c = solutions((X.T @ X - C.T @ C)[None], b[None], candidate.spread[None])
    free = float(rise[0])
    return free, free if candidate.allows(c[0]) else -np.inf


def on_rows(Q: Array, rows: Sequence[int]) -> Array:
    """Return a basis (n, R, K) on some joints, put end to end (len(rows) R, K); not copied where they are all."""
    return (Q if len(rows) == len(Q) else Q[rows]).reshape(len(rows) * Q.shape[1], Q.shape[2])


def score_spans(bench: Bench, candidate: Candidate, acts: Sequence[Array], Q: Array, projected: Array) -> Array:
    """Return (m,) what `score_candidate` does of a candidate over each of several spans of time that are much alike.

    Where all of them say the same, it is whitened and summed once.

    Args:
        bench: with the data.
        candidate: over all of the logs.
        acts: m times (ΣD,) 1 while it acts.
        Q: (n, R, K) of the hypothesis that it would join, as `basis` has it.
        projected: (K,) Qᵀy.
    """
    rows, order, size = list(candidate.rows), bench.whitener.order, candidate.size
    differing = np.flatnonzero(np.any(np.stack(acts) != acts[0], axis=0))
    first, last = (int(differing[0]), int(differing[-1])) if len(differing) else (0, 0)
    bounds = np.concatenate([[0], np.cumsum(bench.whitener.lengths)])
    log = int(np.searchsorted(bounds, first, side="right")) - 1
    begin, end = int(bounds[log]), int(bounds[log + 1])
    if last >= end:  # in several logs: nothing to share
        whole = (candidate.during(act, None, None) for act in acts)
        return np.array([score_candidate(bench, each, Q, projected) for each in whole])
    start = max(first - order, begin)  # a whitened sample holds some before it
    stop = max(min(last + order + 1, end), min(start + order, end))
    inner = Whitener(bench.whitener.filters, bench.whitener.sigma, (stop - start,))
    at = int(np.searchsorted(bench.whitener.rows, start + order))
    place = slice(at, at + max(stop - start - order, 0))
    one = bench.whiten(candidate.during(acts[0], None, None))
    one[:, place] = 0.0
    parts = [inner.joints(rows, candidate.columns[start:stop] * act[start:stop, None, None]) for act in acts]
    parts = [part * bench.weights[rows, place, None] for part in parts]
    near, there = Q[rows, place].reshape(-1, Q.shape[2]), bench.y[rows, place].ravel()
    flat, C = one.reshape(-1, size), on_rows(Q, rows).T @ one.reshape(-1, size)
    G, b = flat.T @ flat, flat.T @ bench.y[rows].ravel()
    informed, right = [], []
    for part in parts:
        X = part.reshape(-1, size)
        shared = C + near.T @ X
        informed.append(G + X.T @ X - shared.T @ shared)
        right.append(b + X.T @ there - shared.T @ projected)
    return increments(np.stack(informed), np.stack(right), np.broadcast_to(candidate.spread, (len(acts), size)))
