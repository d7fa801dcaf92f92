"""Where the residual torque is: which joints, when, and under which condition.

A joint's whitened residual is regressed on what each condition would make of it; the condition that explains most of
its energy above the noise is the one that is said. Nothing is named here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.findings import Place
from twin_diagram.gap.residuals import stiction
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.search import smooth_fit
from twin_diagram.gap.verdict.leftover_structure import hat, scaled
from twin_diagram.signals.arrays import Array

CONDITIONS = {
    "everywhere": "everywhere, the same",
    "reversal": "at velocity reversals",
    "speed": "with speed",
    "load": "with load",
    "angle": "with angle",
    "acceleration": "with acceleration",
    "onset": "from an onset on",
}
"""When a residual shows, and how the report says so."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    cheap: float = 0.9
    """A condition of fewer parameters is preferred where it explains this share of what the best one does."""

    present: float = 4.0
    """Standard deviations above pure noise from which on a joint's residual counts."""

    least_share: float = 0.01
    """Joints with less of the whole are not worth a word."""

    shares: tuple[float, ...] = (0.02, 0.98)
    """Quantiles of the residual's energy between which it is said to be in time."""


TUNING = Tuning()


def locate(records: Records, terms: Terms, whitener: Whitener) -> tuple[Place, ...]:
    """Rank joints by their share of the residual's energy above the noise.

    Args:
        records: of the fit.
        terms: of them.
        whitener: of the noise.
    """
    weights = stiction.moving(records, terms, whitener, stiction.dry_joints(records))
    y = whitener.all(records.residual) * weights
    count = np.sum(weights > 0.0, axis=1)
    excess = np.sum(y**2, axis=1) - count
    seen = excess > TUNING.present * np.sqrt(2.0 * count)
    seen &= excess > TUNING.least_share * float(np.sum(excess[seen]))
    total = float(np.sum(excess[seen]))
    places = []
    for j in np.argsort(-excess):
        if not seen[j]:
            continue
        log, first, last = _when(records, whitener, y[j])
        places.append(
            Place(
                joint=records.model.joints[j],
                share=float(excess[j] / total),
                condition=said(
                    condition(records, terms, whitener, int(j), y[j], weights[j]),
                    records.model.joints[j] in records.model.prismatic,
                ),
                time=(first, last),
                log=log,
            )
        )
    return tuple(places)


def said(key: str, prismatic: bool) -> str:
    """Return a condition in words, on a revolute or prismatic joint."""
    return "with position" if prismatic and key == "angle" else CONDITIONS[key]


def condition(records: Records, terms: Terms, whitener: Whitener, j: int, y: Array, weights: Array) -> str:
    """Return the key of `CONDITIONS` that tells most about a joint's whitened residual."""
    gains = {}
    for key, columns in _shapes(records, terms, j).items():
        X = whitener.joint(j, columns) * weights[:, None]
        fitted, _ = smooth_fit.project(X / (np.sqrt(np.mean(X**2, axis=0)) + 1e-12), y, 1e-5)
        gains[key] = float(np.sum(fitted**2)), columns.shape[1]
    best = max(gain for gain, _ in gains.values())
    good = [key for key, (gain, _) in gains.items() if gain >= TUNING.cheap * best]
    return min(good, key=lambda key: (gains[key][1], -gains[key][0]))


def _shapes(records: Records, terms: Terms, j: int) -> dict[str, Array]:
    q, v, a = (x[:, j] for x in records.motion)
    load = terms.reduce(terms.load)[:, j]
    sign = terms.reduced_signs[:, j]
    one = np.ones_like(q)
    age = np.linspace(0.0, 1.0, len(q))  # one log after the other: each has a clock of its own
    steps = np.stack([(age > start).astype(float) for start in np.linspace(0.05, 0.95, 19)], axis=1)
    return {
        "everywhere": one[:, None],
        "reversal": np.stack([sign, one], axis=1),
        "speed": np.stack([v, one], axis=1),
        "load": np.stack([load, one], axis=1),
        "acceleration": np.stack([a, one], axis=1),
        "angle": hat(scaled(q, q), 8),
        "onset": np.concatenate([one[:, None], steps], axis=1),
    }


def _when(records: Records, whitener: Whitener, y: Array) -> tuple[int, float, float]:
    """Return the log with most energy, and the times between which nearly all of it is."""
    rows = whitener.rows
    owner, times = records.owner[rows], records.times[rows]
    energy = np.maximum(y**2 - 1.0, 0.0)
    log = int(np.argmax(np.bincount(owner, energy, minlength=len(records.records))))
    mine = owner == log
    share = np.cumsum(energy[mine]) / max(float(np.sum(energy[mine])), 1e-12)
    first, last = (int(np.searchsorted(share, level)) for level in TUNING.shares)
    own = times[mine]
    return log, float(own[first]), float(own[min(last, len(own) - 1)])
