"""The residual torque of fit logs as linear equations in what every arm lacks, summed up once per stretch of motion.

What is fitted later costs the same however long the logs are: it sees sums of squares and products alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from pydrake.math import RollPitchYaw

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.correction.equation_error import coarser
from twin_diagram.gap.residuals import stiction
from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.whole_robot.column_sums import summed, summed_again
from twin_diagram.logs.differentiation import TUNING as DIFFERENTIATION
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.effects.environment import GravityTilt
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

    slid: int = 80
    """Samples that slide, from which on a joint needs none at which it may be held: neighbours say half the same, and
    forty are three times the coefficients that a link and its joint have."""

    dead: float = 1e-9
    """Share of itself by which a torque must change to be one: what is not logged, or a brake holds, tells nothing."""


TUNING = Tuning()

OWN = ("viscous", "coulomb", "bias", "rotor")
"""What each joint has of its own, in the order of its columns after those of the links."""


@dataclass(frozen=True)
class DryShape:
    """How a joint's dry friction sets in; without any of these, at once.

    Attributes:
        way: over which it builds up after the joint has turned [rad].
        speed: about which it changes as the joint gets under way [rad/s].
        crawl: what it is far below that speed, over what it is far above.
    """

    way: float = 0.0
    speed: float = 0.0
    crawl: float = 1.0

    def times(self, unit: float) -> DryShape:
        """Return the same shape in another unit of position."""
        return replace(self, way=self.way * unit, speed=self.speed * unit)

    @property
    def told(self) -> bool:
        """Whether it is another than that of friction that is there at once."""
        return bool(self.way or self.speed)


@dataclass(frozen=True)
class LinksWeight:
    """What links weigh on joints in the kept samples of some logs: worked out once, where a tilt is looked for."""

    records: Records

    @cached_property
    def per_axis(self) -> Array:
        """(3, N, n, 10 n) per unit of links' parameters, and of gravity along each axis of the base [m/s²]."""
        tree, result = self.records.model.tree, []
        for axis in np.eye(3):
            aside = replace(tree.bare(tree.inertia), gravity=axis)
            resting = [(r, np.zeros_like(r.q)) for r in self.records.records]
            result.append(np.concatenate([_of_links(self.records, r, aside, still, still) for r, still in resting]))
        return np.stack(result)


@dataclass(frozen=True)
class TorqueEquations:
    """Sums over stretches of motion.

    K = 10 n + 4 + E columns: links' inertial parameters in their own frames, then `OWN`, then one per coefficient of
    the `further` candidates, 0 on joints that they do not touch; column K is the residual itself.

    Attributes:
        counts: (S, n) samples that count.
        fold: (S,) which kind of motion a stretch is of.
        columns: (N, n, K + 1) of the kept samples, for what is left in time.
        weights: (N, n) 0 where dry friction may hold a joint, or its torque never changes in that log, else 1.
        gaps: (N,) whether a sample is the first of its log.
        seconds: that all logs last together.
        stretch: (N,) which stretch a sample is of.
        records: of the kept samples.
        signs: per log (N, n) directions of motion.
        stated_dry: (n,) dry friction that the given model has [N·m].
        largest: (n,) torque that is logged [N·m].
        shapes: (n) of joints' dry friction.
        further: what else may be there.
        tilt: of the base, on which links weigh: roll and pitch [rad].
        weight: of links, on a base that is tilted.
        known: sums over each kind of motion, where they were worked out with the columns; see `of_kinds`.
    """

    counts: Array
    fold: npt.NDArray[np.int64]
    columns: Array
    weights: Array
    gaps: npt.NDArray[np.bool_]
    seconds: float
    stretch: npt.NDArray[np.int64]
    records: Records
    signs: tuple[Array, ...]
    stated_dry: Array
    largest: Array
    shapes: tuple[DryShape, ...]
    weight: LinksWeight
    further: tuple[Candidate, ...] = ()
    tilt: tuple[float, float] = (0.0, 0.0)
    known: Array | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.columns.shape[1])

    @cached_property
    def residual_rms(self) -> Array:
        """(n,) root mean square of the residual [N·m]."""
        return np.sqrt(self.whole[:, -1, -1] / self.counted)

    @cached_property
    def kinds(self) -> tuple[int, ...]:
        """Kinds of motion that there are."""
        return tuple(int(kind) for kind in np.unique(self.fold))

    @cached_property
    def of_kinds(self) -> Array:
        """(F, n, K + 1, K + 1) sums over each kind of motion."""
        return summed(self.columns, self.weights, self.kind) if self.known is None else self.known

    @cached_property
    def kind(self) -> npt.NDArray[np.int64]:
        """(N,) which of `kinds` a sample is of."""
        at = np.searchsorted(self.kinds, self.fold).astype(np.int64)
        return np.asarray(at[self.stretch])

    @cached_property
    def whole(self) -> Array:
        """(n, K + 1, K + 1) sums over everything."""
        return np.asarray(np.sum(self.of_kinds, axis=0))

    @cached_property
    def counted(self) -> Array:
        """(n,) samples that count, at least 1."""
        return np.maximum(np.sum(self.counts, axis=0), 1.0)

    @cached_property
    def own_size(self) -> Array:
        """(n, 4) root mean square of each joint's own columns."""
        squares = np.diagonal(self.whole, axis1=1, axis2=2)[:, 10 * self.n : 10 * self.n + len(OWN)]
        return np.sqrt(squares / self.counted[:, None])

    def with_further(self, further: Sequence[Candidate]) -> TorqueEquations:
        """Return the same with other further candidates, made of `records`; without a tilt, links weigh as on level."""
        level = not any(candidate.name == GravityTilt.name for candidate in further)
        same = self.on_base((0.0, 0.0)) if level else self
        there, at = {}, 10 * self.n + len(OWN)
        for candidate in same.further:
            there[id(candidate)], at = slice(at, at + candidate.size), at + candidate.size
        was, parts = list(range(10 * self.n + len(OWN))), [same.columns[:, :, : 10 * self.n + len(OWN)]]
        for candidate in further:
            place = there.get(id(candidate))
            was += [-1] * candidate.size if place is None else range(place.start, place.stop)
            parts.append(self.spread_out(candidate) if place is None else same.columns[:, :, place])
        columns = np.concatenate([*parts, self.columns[:, :, -1:]], axis=2)
        return replace(same.with_columns(columns, [*was, at]), further=tuple(further))

    def with_columns(self, columns: Array, was: Sequence[int]) -> TorqueEquations:
        """Return the same with other columns (N, n, K + 1); sums of those that were there are kept.

        Args:
            columns: all of them.
            was: (K + 1,) where each was, −1 where it is new.
        """
        again = summed_again(self.of_kinds, was, columns, self.weights, self.kind)
        return replace(self, columns=columns, known=again)

    def on_base(self, tilt: tuple[float, float]) -> TorqueEquations:
        """Return the same with what links weigh on a base of some roll and pitch [rad].

        On a tilted base what links weigh beyond the description pulls aside, too: no first-order term has that.
        """
        if tilt == self.tilt:
            return self
        gravity, columns = self.records.model.tree.gravity, self.columns.copy()
        change = turned(tilt, gravity) - turned(self.tilt, gravity)
        columns[:, :, : 10 * self.n] += np.tensordot(change, self.weight.per_axis, axes=1)
        return replace(self, columns=columns, tilt=tilt, known=None)

    def weighted(self, weights: Array) -> TorqueEquations:
        """Return the same with other weights (N, n) of samples."""
        count = int(self.stretch[-1]) + 1
        counts = np.stack([np.sum(weights[self.stretch == s], axis=0) for s in range(count)])
        return replace(self, weights=weights, counts=counts, known=None)

    def spread_out(self, candidate: Candidate) -> Array:
        """Return (N, n, k) columns of a candidate on all joints."""
        result = np.zeros((len(self.columns), self.n, candidate.size))
        result[:, list(candidate.rows)] = candidate.columns
        return result

    def left(self, difference: Array) -> Array:
        """Return (N, n) of the residual that a difference in parameters (n, K) leaves, 0 where a joint may be held."""
        full = np.concatenate([-difference, np.ones((self.n, 1))], axis=1)
        return np.asarray(np.einsum("njk,jk->nj", self.columns, full) * self.weights)


def equations(records: Records) -> TorqueEquations:
    """Sum up fit logs.

    Args:
        records: prepared with the given model.
    """
    told = [np.ptp(r.torque, axis=0) > TUNING.dead * np.max(np.abs(r.torque), axis=0) for r in records.records]
    records = coarser(records)
    kept = [_thinned(records, record) for record in records.records]
    # Candidates' columns are reduced by the records, and must hold no more of a band than the residual does.
    same = [
        replace(r, kept=k, compared=DIFFERENTIATION.residual_cutoff) for r, k in zip(records.records, kept, strict=True)
    ]
    records = replace(records, records=tuple(same))
    terms = Terms(records, given_load(records), slow_speed(records))
    weights = stiction.sliding(records, terms, range(records.n), many=TUNING.slid)
    weights *= np.repeat(told, [len(k) for k in kept], axis=0) & ~stiction.unmoved(records)
    columns = np.concatenate([_columns(records, r, sign) for r, sign in zip(records.records, terms.signs, strict=True)])
    motion = np.hstack(records.motion[:2])
    gaps = np.concatenate([np.arange(len(k)) == 0 for k in kept])
    seconds = sum(float(record.time[-1] - record.time[0]) for record in records.records)
    stretch = _stretches(gaps, seconds)
    count = int(stretch[-1]) + 1
    counts = np.stack([np.sum(weights[stretch == s], axis=0) for s in range(count)])
    features = np.stack([np.mean(motion[stretch == s], axis=0) for s in range(count)])
    return TorqueEquations(
        counts=counts,
        fold=kinds_of_motion(features),
        columns=columns,
        weights=weights,
        gaps=gaps,
        seconds=seconds,
        stretch=stretch,
        records=records,
        signs=terms.signs,
        stated_dry=terms.present.coulomb,
        largest=np.max([np.max(np.abs(r.torque), axis=0) for r in records.records], axis=0),
        shapes=(DryShape(),) * records.n,
        weight=LinksWeight(records),
    )


def _columns(records: Records, record: Record, sign: Array) -> Array:
    """Return (D, n, K + 1) of a log's kept samples, low-passed as residuals are compared."""
    model, n = records.model, records.n
    result = np.empty((len(record.kept), n, 10 * n + len(OWN) + 1))
    result[:, :, : 10 * n] = _of_links(records, record, model.tree, record.v, record.a)
    own = [record.v, sign, -np.ones_like(record.v), record.a]
    for k, signal in enumerate([*own, record.torque - record.given]):
        result[:, :, 10 * n + k] = low_passed(signal, record)[record.kept]
    return result


def _of_links(records: Records, record: Record, tree: rigid_tree.RigidTree, v: Array, a: Array) -> Array:
    """Return (D, n, 10 n) torques per unit of links' parameters at a log's angles, with other motion and gravity.

    Link by link: at the full rate, those of all links at once are ten times what a long log itself is.
    """
    result = []
    for body in range(records.n):
        _, X_ML = records.model.bodies.body_of(tree.link[body])
        moved = tree.regressor(records.angles(record), v, a, body) @ rigid_tree.transform_inertia(X_ML)
        result.append(low_passed(moved, record)[record.kept])
    return np.concatenate(result, axis=2)


def turned(tilt: tuple[float, float], gravity: Array) -> Array:
    """Return (3,) gravity [m/s²] in a base that is rolled and pitched [rad]."""
    return np.asarray(RollPitchYaw(*tilt, 0.0).ToRotationMatrix().matrix().T @ gravity)


def low_passed(signal: Array, record: Record) -> Array:
    """Return a signal (N, …) of a log's full rate, low-passed as residuals are compared."""
    band = min(DIFFERENTIATION.residual_cutoff, record.band)
    return lowpass(signal.reshape(len(signal), -1), record.rate, band).reshape(signal.shape)


def _thinned(records: Records, record: Record) -> npt.NDArray[np.int64]:
    """Return which full-rate samples of a log are kept."""
    inside = np.arange(record.kept[0], record.kept[-1] + 1)
    band = min(DIFFERENTIATION.residual_cutoff, record.band)
    seconds = sum((r.kept[-1] - r.kept[0]) / r.rate for r in records.records)
    most = int(np.ceil(record.rate * seconds / TUNING.samples - 1e-6))  # logs of any rate count by how long they last
    stride = max(1, int(record.rate / (TUNING.thin * band)), most)
    return inside[::stride]


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
