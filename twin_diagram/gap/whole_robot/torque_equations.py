"""The residual torque of fit logs as linear equations in what every arm lacks, summed up once per stretch of motion.

What is fitted later costs the same however long the logs are: it sees sums of squares and products alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.correction.equation_error import coarser
from twin_diagram.gap.residuals import stiction
from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.rigid_body import rigid_tree
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    samples: int = 8000
    """Kept at most, of all logs together: neighbours beyond say the same."""

    thin: float = 4.0
    """Samples kept per second, times the band."""

    stretch: float = 0.5
    """Shortest stretch that sums are kept of [s]."""

    stretches: int = 60
    """Stretches at most, of all logs together."""

    folds: int = 5
    """Kinds of motion that are left out in turn."""


TUNING = Tuning()

OWN = ("viscous", "coulomb", "bias", "rotor")
"""What each joint has of its own, in the order of its columns after those of the links."""


@dataclass(frozen=True)
class TorqueEquations:
    """Sums over stretches of motion.

    K = 10 n + 4 columns: links' inertial parameters in their own frames, then `OWN`; column K is the residual itself.

    Attributes:
        sums: (S, n, K + 1, K + 1) squares and products per stretch and joint.
        counts: (S, n) samples that count.
        fold: (S,) which kind of motion a stretch is of.
        columns: (N, n, K + 1) of the kept samples, for what is left in time.
        weights: (N, n) 0 where dry friction may hold a joint, else 1.
        gaps: (N,) whether a sample is the first of its log.
        seconds: that all logs last together.
    """

    sums: Array
    counts: Array
    fold: npt.NDArray[np.int64]
    columns: Array
    weights: Array
    gaps: npt.NDArray[np.bool_]
    seconds: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.sums.shape[1])

    @cached_property
    def residual_rms(self) -> Array:
        """(n,) root mean square of the residual [N·m]."""
        return np.sqrt(np.sum(self.sums[:, :, -1, -1], axis=0) / np.maximum(np.sum(self.counts, axis=0), 1.0))

    @cached_property
    def own_size(self) -> Array:
        """(n, 4) root mean square of each joint's own columns."""
        squares = np.sum(np.diagonal(self.sums, axis1=2, axis2=3), axis=0)[:, -5:-1]
        return np.sqrt(squares / np.maximum(np.sum(self.counts, axis=0), 1.0)[:, None])

    def left(self, difference: Array) -> Array:
        """Return (N, n) of the residual that a difference in parameters (n, K) leaves, 0 where a joint may be held."""
        full = np.concatenate([-difference, np.ones((self.n, 1))], axis=1)
        return np.asarray(np.einsum("njk,jk->nj", self.columns, full) * self.weights)


def equations(records: Records) -> TorqueEquations:
    """Sum up fit logs.

    Args:
        records: prepared with the given model.
    """
    records = coarser(records)
    terms = Terms(records, given_load(records), slow_speed(records))
    sliding = stiction.sliding(records, terms, range(records.n))
    parts = [_columns(records, record, sign) for record, sign in zip(records.records, terms.signs, strict=True)]
    kept = [_thinned(records, record) for record in records.records]
    columns = np.concatenate([part[k] for part, k in zip(parts, kept, strict=True)])
    ends = np.cumsum([0, *records.lengths])
    weights = np.concatenate(
        [
            _nearest(record, sliding[a:b], k)
            for record, a, b, k in zip(records.records, ends[:-1], ends[1:], kept, strict=True)
        ]
    )
    motion = np.concatenate(
        [np.hstack([record.q[k], record.v[k]]) for record, k in zip(records.records, kept, strict=True)]
    )
    gaps = np.concatenate([np.arange(len(k)) == 0 for k in kept])
    seconds = sum(float(record.time[-1] - record.time[0]) for record in records.records)
    stretch = _stretches(gaps, seconds)
    count = int(stretch[-1]) + 1
    weighted = columns * weights[:, :, None]
    sums = np.stack([np.einsum("njk,njl->jkl", weighted[stretch == s], columns[stretch == s]) for s in range(count)])
    counts = np.stack([np.sum(weights[stretch == s], axis=0) for s in range(count)])
    features = np.stack([np.mean(motion[stretch == s], axis=0) for s in range(count)])
    return TorqueEquations(sums, counts, kinds_of_motion(features), columns, weights, gaps, seconds)


def _columns(records: Records, record: Record, sign: Array) -> Array:
    """Return (N, n, K + 1) of a log at its full rate, low-passed as residuals are compared."""
    model, n = records.model, records.n
    band = min(DIFFERENTIATION.residual_cutoff, record.band)
    result = np.empty((len(record.time), n, 10 * n + len(OWN) + 1))

    def low(signal: Array) -> Array:
        return lowpass(signal.reshape(len(signal), -1), record.rate, band).reshape(signal.shape)

    for body in range(n):
        _, X_ML = model.bodies.body_of(model.tree.link[body])
        rigid = model.tree.regressor(record.q, record.v, record.a, body) @ rigid_tree.transform_inertia(X_ML)
        result[:, :, 10 * body : 10 * body + 10] = low(rigid)
    own = [record.v, sign, -np.ones_like(record.v), record.a]
    for k, signal in enumerate([*own, record.torque - record.given]):
        result[:, :, 10 * n + k] = low(signal)
    return result


def _thinned(records: Records, record: Record) -> npt.NDArray[np.int64]:
    """Return which full-rate samples of a log are kept."""
    inside = np.arange(record.kept[0], record.kept[-1] + 1)
    band = min(DIFFERENTIATION.residual_cutoff, record.band)
    whole = sum(r.kept[-1] - r.kept[0] for r in records.records)
    stride = max(1, int(record.rate / (TUNING.thin * band)), int(np.ceil(whole / TUNING.samples)))
    return inside[::stride]


def _nearest(record: Record, weights: Array, kept: npt.NDArray[np.int64]) -> Array:
    """Return weights of the search's samples at other samples of the same log."""
    nearest = np.searchsorted(record.kept, kept)
    return weights[np.clip(nearest, 0, len(weights) - 1)]


def _stretches(gaps: npt.NDArray[np.bool_], seconds: float) -> npt.NDArray[np.int64]:
    """Return (N,) which stretch a sample is of: equally many samples each, none of two logs."""
    count = int(np.clip(seconds / TUNING.stretch, TUNING.folds, TUNING.stretches))
    length = max(1, len(gaps) // count)
    begins = np.flatnonzero(gaps)
    within = np.arange(len(gaps)) - begins[np.cumsum(gaps) - 1]
    return np.asarray(np.cumsum(within % length == 0) - 1)


def kinds_of_motion(features: Array) -> npt.NDArray[np.int64]:
    """Return (S,) which kind of motion each stretch is of: like ones are of one kind, so that repeats go together.

    Args:
        features: (S, 2 n) mean positions and velocities.
    """
    scaled = features / np.maximum(np.std(features, axis=0), 1e-9)
    centres = [int(np.argmax(np.sum((scaled - np.mean(scaled, axis=0)) ** 2, axis=1)))]
    for _ in range(TUNING.folds - 1):  # farthest from those there are, so that nothing depends on chance
        apart = np.min([np.sum((scaled - scaled[c]) ** 2, axis=1) for c in centres], axis=0)
        centres.append(int(np.argmax(apart)))
    room = int(np.ceil(len(scaled) / TUNING.folds))
    distance = np.stack([np.sum((scaled - scaled[c]) ** 2, axis=1) for c in centres], axis=1)
    result = np.full(len(scaled), -1, dtype=np.int64)
    for flat in np.argsort(distance, axis=None, kind="stable"):
        stretch, fold = divmod(int(flat), TUNING.folds)
        if result[stretch] < 0 and np.sum(result == fold) < room:
            result[stretch] = fold
    return result
