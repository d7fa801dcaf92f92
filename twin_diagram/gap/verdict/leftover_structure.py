"""Whether structure is left: a model that can follow any curve, held against the residual of what was named."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms, rate_of
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search.bench import Bench, noise_of
from twin_diagram.gap.search.evidence import HypothesisFit
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    pieces: int = 8
    """Hats that a curve is made of: enough for the bend of a friction near rest."""

    room: float = 2.0
    """A joint of which less than this many samples per curve count tells nothing."""


TUNING = Tuning()


@dataclass(frozen=True)
class LeftOver:
    """What a flexible model finds in residuals.

    Attributes:
        statistic: the largest of the joints' (explained − expected) / standard deviation under pure noise.
        gain: twice the log likelihood gained beyond what noise would give, all joints.
        joints: (n,) the statistic per joint.
        shares: (n,) what is explained beyond what noise would give, over the joint's torque, both root mean square;
            empty: not known.
    """

    statistic: float
    gain: float
    joints: Array
    shares: Array = field(default_factory=lambda: np.zeros(0))

    def beyond(self, share: float) -> float:
        """Return the largest statistic of joints on which more than a share of their torque is explained."""
        if not len(self.shares):
            return self.statistic
        return float(np.max(np.where(self.shares > share, self.joints, 0.0)))


def left_over(records: Records, terms: Terms, bench: Bench, fit: HypothesisFit) -> LeftOver:
    """Regress each joint's residual on curves of its angle, speed, torque and of time."""
    residual = bench.left(fit)
    noise = noise_of(bench, fit)
    statistic, shares = np.zeros(records.n), np.zeros(records.n)
    gain = 0.0
    for j in range(records.n):
        # What the named model already has must not count again; a time shift is of all joints or none.
        own = [
            bench.candidates[k].columns[:, bench.candidates[k].rows.index(j)]
            for k in fit.order
            if j in bench.candidates[k].rows and bench.candidates[k].name
        ]
        known = np.concatenate([np.zeros((len(residual), 0)), *own], axis=1)
        both = np.concatenate([known, features(records, terms, j)], axis=1)
        before, spent = profiled(residual[:, j], known, noise, j, bench.weights[j])
        after, more = profiled(residual[:, j], both, noise, j, bench.weights[j])
        count, k = bench.counts[j], max(1, more - spent)
        free = max(2.0, count - spent)
        if count < TUNING.room * (spent + k):
            continue
        ratio = count * float(np.log(before / after))
        expected = count * float(np.log(free / max(1.0, free - k)))
        statistic[j] = (ratio - expected) / (np.sqrt(2.0 * k) * count / max(1.0, free - k))
        gain += max(0.0, ratio - expected)
        explained = noise.sigma[j] * np.sqrt(max(0.0, -np.expm1(-(ratio - expected) / count)))
        shares[j] = explained / max(float(terms.torque_size[j]), 1e-12)
    return LeftOver(float(np.max(statistic)), gain, statistic, shares)


def profiled(y: Array, X: Array, noise: Whitener, j: int, weights: Array) -> tuple[float, int]:
    """Return the squares that regressors X (ΣD, m) leave of y (ΣD,) on a joint, whitened, and how many count."""
    white = noise.joint(j, np.column_stack([y, X])) * weights[:, None]
    size = np.sqrt(np.mean(white[:, 1:] ** 2, axis=0)) + 1e-12
    c, rank = regression(white[:, 1:] / size, white[:, 0], 1e-4)
    return float(np.sum((white[:, 0] - (white[:, 1:] / size) @ c) ** 2)), rank


def regression(X: Array, y: Array, negligible: float) -> tuple[Array, int]:
    """Return the least squares in the directions that are not negligible, and their number."""
    if not X.shape[1]:
        return np.zeros(0), 0
    values, vectors = np.linalg.eigh(X.T @ X)
    kept = values > max(negligible, 1e-7) ** 2 * values[-1]
    return vectors[:, kept] @ ((vectors[:, kept].T @ (X.T @ y)) / values[kept]), int(np.sum(kept))


def features(records: Records, terms: Terms, j: int) -> Array:
    """Return (ΣD, m) curves, reduced like the torque."""

    def law(q: Array, v: Array, tau: Array, sign: Array, share: Array) -> Array:
        angle, speed, load, age = hats(q), hats(v), hats(tau), hats(share)
        products = [angle * sign[:, None], age * sign[:, None], age * v[:, None], age * q[:, None]]
        return np.concatenate([angle, speed, load, age, *products], axis=1)

    whole_q, whole_v, whole_tau = (
        np.concatenate([x[:, j] for x in parts])
        for parts in ([r.q for r in records.records], [r.v for r in records.records], terms.load)
    )

    def hats(x: Array) -> Array:
        return hat(x, TUNING.pieces)

    parts = []
    for record, load, sign, logged in zip(records.records, terms.load, terms.signs, terms.smooth_torque, strict=True):
        age = (record.time - record.time[0]) / (record.time[-1] - record.time[0])
        curves = law(
            scaled(record.q[:, j], whole_q),
            scaled(record.v[:, j], whole_v),
            scaled(load[:, j], whole_tau),
            sign[:, j],
            age,
        )
        # Noise is not correlated with its own derivative, so that the logged torque's may be used as it is.
        parts.append(np.column_stack([curves, rate_of(load[:, j], record), rate_of(logged[:, j], record)]))
    return terms.reduce(tuple(parts))


def scaled(x: Array, whole: Array) -> Array:
    """Return a signal scaled to [0, 1] over its central 98 %."""
    low, high = np.quantile(whole, [0.01, 0.99])
    return np.clip((x - low) / max(high - low, 1e-9), 0.0, 1.0)


def hat(x: Array, pieces: int) -> Array:
    """Return (N, pieces + 1) piecewise linear functions that add up to 1."""
    centres = np.linspace(0.0, 1.0, pieces + 1)
    return np.maximum(0.0, 1.0 - np.abs(x[:, None] - centres) * pieces)
