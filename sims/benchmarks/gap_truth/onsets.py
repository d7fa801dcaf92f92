"""How well an onset can be told at all: by an estimator that knows the torque law, its size and the noise.

It weighs the same effect begun a little earlier or later: with δ the whitened difference of their torques and n the
log's noise, the log-likelihood ratio to the true onset is δ·n − |δ|²/2, and its answer is the greatest. For a constant
torque in white noise the error is the argmax of a two-sided Brownian motion with drift: at |δ|² = r |Δ|, 95 % lie
within 11.0 / r (Bai 1997, table of the limiting distribution).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from gap_truth import explanations
from gap_truth.cases import Case
from gap_truth.hidden import Hidden
from gap_truth.separation import Whitening, fitted, signature, spread

Array = npt.NDArray[np.float64]

_LATER = np.geomspace(0.001, 8.0, 44)
SHIFTS = np.concatenate([-_LATER[::-1], [0.0], _LATER])
"""That are weighed [s]."""

DRAWS = 400
"""Of the noise."""

KEPT = 20
"""Quantiles of the error that stand for its distribution."""


def oracle_errors(case: Case) -> list[list[float] | None]:
    """Of each hidden effect, `KEPT` equally likely absolute errors of such an estimator [s]; None: it has no onset."""
    if all(thing.onset is None for thing in case.hidden):
        return [None] * len(case.hidden)
    setting, missing = signature(case, case.fit)
    white = Whitening(case, setting, whole_band=True)
    n = case.chain.n
    every = tuple(range(n))

    def columns(thing: Hidden) -> Array:
        """(N, n, k)."""
        parts = []
        for _, explanation in explanations.of_truth(setting, thing):
            part = np.zeros((len(setting.time), n, explanation.columns.shape[2]))
            part[:, list(explanation.rows)] = explanation.columns
            parts.append(part)
        return np.concatenate(parts, axis=2)

    def whitened(signal: Array) -> Array:
        return spread(white(signal, every), every, n)

    own = [columns(thing) for thing in case.hidden]
    sizes = fitted(whitened(missing[..., None])[:, 0], np.hstack([whitened(part) for part in own]))
    ends = np.cumsum([part.shape[2] for part in own])[:-1]
    result: list[list[float] | None] = []
    for k, (thing, size) in enumerate(zip(case.hidden, np.split(sizes, ends), strict=True)):
        if thing.onset is None:
            result.append(None)
            continue
        torque = columns(replace(thing, onset=None)) @ size
        first = thing.onset + np.minimum(SHIFTS, 0.0)
        between = (setting.time[:, None] >= first) & (setting.time[:, None] < first + np.abs(SHIFTS))
        delta = whitened(torque[:, :, None] * between[:, None])
        result.append(equally_likely_errors(delta, SHIFTS, np.random.default_rng([case.seed, k])))
    return result


def equally_likely_errors(delta: Array, shifts: Array, rng: np.random.Generator) -> list[float]:
    """`KEPT` quantiles of the absolute error [s].

    Between two shifts the ratio goes as a Brownian bridge, whose maximum has a closed form.

    Args:
        delta: (F, m) whitened differences that shifts make.
        shifts: (m,) in order, with zero among them [s].
        rng: of the noise.
    """
    gram = delta.T @ delta
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    size = np.diagonal(gram)
    ratio = rng.normal(size=(DRAWS, len(shifts))) @ root.T - 0.5 * size
    steps = np.maximum(size[1:] + size[:-1] - 2.0 * np.diagonal(gram, 1), 0.0)
    spread_out = np.sqrt(np.diff(ratio, axis=1) ** 2 + 2.0 * steps * rng.exponential(size=(DRAWS, len(steps))))
    best = np.argmax(ratio[:, 1:] + ratio[:, :-1] + spread_out, axis=1)
    found = np.abs(0.5 * (shifts[1:] + shifts[:-1]))[best]
    return [float(x) for x in np.quantile(found, (np.arange(KEPT) + 0.5) / KEPT)]
