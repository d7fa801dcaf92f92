"""Whether structure is left: a model that can follow any curve, held against the residual of what was named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.evidence import Bench, Fit
from twin_diagram.gap.records import Records
from twin_diagram.gap.saturated import project
from twin_diagram.gap.terms import Terms

Array = npt.NDArray[np.float64]

PIECES = 8


@dataclass(frozen=True)
class LeftOver:
    """What a flexible model finds in whitened residuals.

    Attributes:
        statistic: the largest of the joints' (explained − expected) / standard deviation under pure noise.
        gain: explained beyond what noise would give, all joints.
        joints: (n,) the statistic per joint.
    """

    statistic: float
    gain: float
    joints: Array


def left_over(records: Records, terms: Terms, bench: Bench, fit: Fit) -> LeftOver:
    """Regresses each joint's whitened residual on curves of its angle, speed, torque and of time."""
    residual = bench.residual(fit)
    statistic = np.zeros(records.n)
    gain = 0.0
    own = bench.basis(fit.members)
    for j in range(records.n):
        X = bench.whitener.joint(j, features(records, terms, j)) * bench.weights[j][:, None]
        # What the named model already has must not count again.
        stacked = np.concatenate([own[j], X], axis=1)
        size = np.sqrt(np.mean(stacked**2, axis=0)) + 1e-12
        projected, k = project(stacked / size, residual[j], 1e-4)
        scale = max(1.0, float(np.sum(residual[j] ** 2)) / max(1.0, len(X) - k))
        explained = float(np.sum(projected**2)) / scale
        statistic[j] = (explained - k) / np.sqrt(2.0 * k)
        gain += max(0.0, explained - k)
    return LeftOver(float(np.max(statistic)), gain, statistic)


def features(records: Records, terms: Terms, j: int) -> Array:
    """(ΣD, m) curves, reduced like the torque."""

    def law(q: Array, v: Array, tau: Array, sign: Array, share: Array) -> Array:
        angle, speed, load, age = hats(q), hats(v), hats(tau), hats(share)
        products = [angle * sign[:, None], age * sign[:, None], age * v[:, None], age * q[:, None]]
        return np.concatenate([angle, speed, load, age, *products], axis=1)

    whole_q, whole_v, whole_tau = (
        np.concatenate([x[:, j] for x in parts])
        for parts in ([r.q for r in records.records], [r.v for r in records.records], terms.load)
    )

    def hats(x: Array) -> Array:
        return hat(x, PIECES)

    parts = []
    for record, load, sign in zip(records.records, terms.load, terms.signs, strict=True):
        age = (record.time - record.time[0]) / (record.time[-1] - record.time[0])
        parts.append(
            law(
                scaled(record.q[:, j], whole_q),
                scaled(record.v[:, j], whole_v),
                scaled(load[:, j], whole_tau),
                sign[:, j],
                age,
            )
        )
    return terms.reduce(tuple(parts))


def scaled(x: Array, whole: Array) -> Array:
    """To [0, 1] over the central 98 %."""
    low, high = np.quantile(whole, [0.01, 0.99])
    return np.clip((x - low) / max(high - low, 1e-9), 0.0, 1.0)


def hat(x: Array, pieces: int) -> Array:
    """(N, pieces + 1) piecewise linear functions that add up to 1."""
    centres = np.linspace(0.0, 1.0, pieces + 1)
    return np.maximum(0.0, 1.0 - np.abs(x[:, None] - centres) * pieces)
