"""A fit of everything smooth at once: what noise is left, and what torque was really needed.

It names nothing. Its residual bounds the noise from above while nothing has been named yet, and its torque is free of
the log's noise, so that regressors which are torques themselves are not correlated with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    negligible: float = 1e-5
    """Directions of the standardised regressors that are smaller than this are left out."""


TUNING = Tuning()


def explain(records: Records, candidates: list[Candidate]) -> tuple[Array, Array]:
    """Fit all candidates to each joint's residual by itself.

    Args:
        records: of the fit.
        candidates: any; what they hold for a joint's row is used.

    Returns:
        The explained part of the residual (ΣD, n) [N·m], and how many parameters were spent on each joint (n,).
    """
    residual = records.residual
    explained = np.zeros_like(residual)
    spent = np.zeros(records.n)
    for j in range(records.n):
        parts = [c.columns[:, c.rows.index(j)] for c in candidates if j in c.rows]
        X = np.concatenate([*parts, np.ones((len(residual), 1))], axis=1)
        size = np.sqrt(np.mean(X**2, axis=0))
        X = X[:, size > 1e-9] / size[size > 1e-9]
        explained[:, j], spent[j] = project(X, residual[:, j], TUNING.negligible)
    return explained, spent


def columns(records: Records, candidates: list[Candidate]) -> list[Array]:
    """Return (ΣD, m) per joint: what candidates hold for it, times their priors' deviations, and a constant [N·m]."""
    result = []
    for j in range(records.n):
        parts = [c.columns[:, c.rows.index(j)] * c.spread for c in candidates if j in c.rows]
        level = np.full((len(records.residual), 1), np.sqrt(np.mean(records.torque[:, j] ** 2)))
        result.append(np.concatenate([*parts, level], axis=1))
    return result


def project(X: Array, y: Array, negligible: float) -> tuple[Array, int]:
    """Return the part of y (R,) in the span of X (R, m) without its faintest directions, and how many are left."""
    values, vectors = np.linalg.eigh(X.T @ X)
    kept = values > max(negligible, 1e-7) ** 2 * values[-1]
    coefficients = vectors[:, kept] @ ((vectors[:, kept].T @ (X.T @ y)) / values[kept])
    return X @ coefficients, int(np.sum(kept))


def at_full_rate(records: Records, thinned: Array) -> tuple[Array, ...]:
    """Return thinned signals (ΣD, n), band-limited, at every record's own rate; constant beyond the ends."""
    result = []
    starts = np.concatenate([[0], np.cumsum(records.lengths)]).astype(int)
    for record, first, last in zip(records.records, starts[:-1], starts[1:], strict=True):
        spline = scipy.interpolate.CubicSpline(record.times, thinned[first:last])
        result.append(spline(np.clip(record.time, record.times[0], record.times[-1])))
    return tuple(result)
