"""Parameters of named effects, refined on the runs that they were found in, by their equation error.

The torque that the corrected model needs for the measured motion is held against the logged one, both low-passed,
whitened, and without the samples at which dry friction holds a joint. Times at which effects start or end take turns
with their parameters. `output_error` has the other way: rollouts against measured positions.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.correction import onset_times
from twin_diagram.gap.correction.gauss_newton import Solution, minimise
from twin_diagram.gap.correction.merge_effects import merged
from twin_diagram.gap.correction.physical_coordinates import Coordinates
from twin_diagram.gap.residuals import stiction, whitening
from twin_diagram.gap.residuals.prepared_logs import TUNING as PREPARED_LOGS
from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.logs.differentiation import lowpass
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    cluster: float = 0.5
    """Residuals nearer than this may hang together [s]."""

    retimed: int = 2
    """Times that onsets and parameters take turns."""

    colours: int = 2
    """Times that the noise's level and colour are looked at again."""

    factors: tuple[float, ...] = (0.6, 0.7, 0.8, 0.88, 0.94, 1.06, 1.13, 1.25, 1.45, 1.7)
    """By which a rough value of a record's `scanned` parameter is multiplied in a first scan: denser near 1, where
    most are."""


TUNING = Tuning()


@dataclass(frozen=True)
class Hypothesis:
    """What was added to a model, as a function of coordinates.

    Attributes:
        given: the given model.
        parts: of the effects that are added.
    """

    given: Model
    parts: tuple[Coordinates, ...]

    @staticmethod
    def of(given: Model, specs: Sequence[EffectSpec]) -> Hypothesis:
        """Return the hypothesis that effects, relative to a model, are added to it."""
        return Hypothesis(given, tuple(Coordinates.of(given, spec) for spec in specs))

    def slices(self) -> list[slice]:
        """Return where each part stands in the whole vector."""
        ends = np.cumsum([0, *(len(part.start()) for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]

    def start(self) -> Array:
        """Return the rough values (p,)."""
        return np.concatenate([part.start() for part in self.parts])

    def prior(self) -> tuple[Array, Array]:
        """Return the mean and deviation (p,)."""
        both = [part.prior() for part in self.parts]
        return np.concatenate([a for a, _ in both]), np.concatenate([b for _, b in both])

    def steps(self) -> Array:
        """Return (p,) of finite differences."""
        return 1e-3 * np.maximum(np.abs(self.start()), 1e-2)

    def at(self, vector: Array) -> Hypothesis:
        """Return the same, started from other coordinates; their wide priors go along."""
        specs = self.specs(vector)
        return replace(self, parts=tuple(part.started(spec) for part, spec in zip(self.parts, specs, strict=True)))

    def specs(self, vector: Array) -> list[EffectSpec]:
        """Return the effects, relative to the given model."""
        return [part.effect(vector[s]) for part, s in zip(self.parts, self.slices(), strict=True)]

    def model(self, vector: Array) -> Model:
        """Return the corrected model.

        Raises:
            ModelError: these values cannot be.
        """
        return self.given.with_effects(merged(self.given.effects, self.specs(vector)))


def by_torque(hypothesis: Hypothesis, whole: Records, *, coloured: bool = True) -> tuple[Hypothesis, Solution]:
    """Fit parameters by equation error, in turns with the times at which effects start or end.

    Args:
        hypothesis: with its rough values.
        whole: the runs that it was named in, prepared with the hypothesis's given model.
        coloured: whether what is left counts as noise of a colour; where laws are not exact, what they leave is slow
            like themselves, and the colour takes their own frequencies' weight away.
    """
    sharp = any(record_of(part.spec.name).sharp for part in hypothesis.parts)  # its knocks are
    records = whole if sharp else coarser(whole)
    marks = {record.mark for record in whole.records}
    solution = equation_error(hypothesis, records, coloured=coloured)
    for _ in range(TUNING.retimed if any(part.spec.log in marks for part in hypothesis.parts) else 0):
        before = [(part.when.onset, part.when.end) for part in hypothesis.parts]
        hypothesis = _retimed(hypothesis.at(solution.vector), solution.vector, whole)
        solution = equation_error(hypothesis, records, coloured=coloured)
        after = [(part.when.onset, part.when.end) for part in hypothesis.parts]
        if after == before:
            break
    return hypothesis, solution


def coarser(records: Records) -> Records:
    """Return the same at no more samples than smooth motions need; what is reduced from them is at the same times."""

    def thinned(record: Record) -> Record:
        stride = int(record.kept[1] - record.kept[0])
        every = max(
            k
            for k in range(1, stride + 1)
            if stride % k == 0 and record.rate / k >= min(PREPARED_LOGS.laws, record.rate)
        )
        if every == 1:
            return record
        index = np.arange(int(record.kept[0]) % every, len(record.time), every)
        torque = lowpass(record.torque, record.rate, 0.4 * record.rate / every)
        return replace(
            record,
            time=record.time[index],
            rate=record.rate / every,
            q=record.q[index],
            v=record.v[index],
            a=record.a[index],
            torque=torque[index],
            given=record.given[index],
            passed=record.passed[index],
            kept=(record.kept - index[0]) // every,
        )

    return replace(records, records=tuple(thinned(record) for record in records.records))


def _left(hypothesis: Hypothesis, vector: Array, records: Records) -> Array:
    """Return the logged less needed torque (ΣD, n)."""
    return left_by(hypothesis.model(vector), records)


def left_by(model: Model, records: Records) -> Array:
    """Return the logged less needed torque (ΣD, n) of a model, in the band of the records [N·m]."""

    def law(record: Record) -> Array:
        run = model.for_run(record.mark)
        needed = run.inverse_dynamics(record.q, record.v, record.a, time=record.time, seen=record.torque)
        return np.asarray(record.torque - needed)

    return records.reduce(law)


def _retimed(hypothesis: Hypothesis, vector: Array, records: Records) -> Hypothesis:
    """Return the hypothesis with the times that fit best; parts that start and end together stay together."""
    marks = [record.mark for record in records.records]
    groups: dict[tuple[str, str, float | None, float | None], list[int]] = {}
    for k, part in enumerate(hypothesis.parts):
        if part.spec.log in marks:
            groups.setdefault((part.spec.log, part.spec.name, part.spec.onset, part.spec.end), []).append(k)
    parts = list(hypothesis.parts)
    for (mark, *_), members in groups.items():
        residual = _left(replace(hypothesis, parts=tuple(parts)), vector, records)
        noise = whitening.estimate(residual, records.lengths, len(vector) / records.n)
        weights = np.ones((records.n, len(noise.rows)))
        specs = [part.effect(vector[s]) for part, s in zip(parts, hypothesis.slices(), strict=True)]
        always = [
            replace(spec, onset=None, end=None, log="", elsewhere={}) if k in members else spec
            for k, spec in enumerate(specs)
        ]
        never = [spec for k, spec in enumerate(specs) if k not in members]
        effects = hypothesis.given.effects
        try:
            present, absent = (
                hypothesis.given.with_effects(merged(effects, chosen)).for_run(mark) for chosen in (always, never)
            )
        except ModelError:
            continue
        when = parts[members[0]].when
        record = _stretch_of(records, mark, when)
        when = onset_times.retimed(when, present, absent, record, records, noise, weights)
        for k in members:
            parts[k] = parts[k].at(when)
    return replace(hypothesis, parts=tuple(parts))


def _stretch_of(records: Records, mark: str, when: onset_times.When) -> Record:
    """Return the record in which an effect starts, or else ends: a run that went silent has several, of one mark."""
    own = [record for record in records.records if record.mark == mark]
    moments = [moment for moment in (when.onset, when.end) if moment is not None]
    return next((r for t in moments for r in own if r.time[0] <= t <= r.time[-1]), own[0])


def equation_error(hypothesis: Hypothesis, records: Records, *, coloured: bool = True) -> Solution:
    """Fit parameters to the logged torque; see the module.

    Args:
        hypothesis: with its rough values.
        records: of the fitted logs.
        coloured: see `by_torque`.
    """
    order = whitening.TUNING.order if coloured else 0
    start = hypothesis.start()

    def left(vector: Array) -> Array:
        return _left(hypothesis, vector, records)

    level = np.maximum(np.std(left(start), axis=0), 1e-12)
    start = _scanned(hypothesis, start, lambda vector: (left(vector) / level).ravel())
    terms = Terms(records, given_load(records), slow_speed(records))
    rate = records.reduce(lambda record: np.gradient(record.given, 1.0 / record.rate, axis=0))
    period = max(record.period for record in records.records)
    block = blocks(records.times, records.owner)
    solution = None
    for _ in range(TUNING.colours):  # what a rough model leaves is no noise
        noise = whitening.estimate(left(start), records.lengths, len(start) / records.n, order=order)
        dry = stiction.dry_joints(Records(hypothesis.model(start), records.records))
        weights = stiction.moving(records, terms, noise, dry) * ~stiction.unmoved(records)[:, None]

        def residual(vector: Array, noise: whitening.Whitener = noise, weights: Array = weights) -> Array:
            try:
                return np.asarray((noise.all(left(vector)) * weights).ravel())
            except ModelError:
                return np.full(weights.size, np.inf)

        _, clusters = np.unique(block[noise.rows], return_inverse=True)
        waits = any(record_of(part.spec.name).late for part in hypothesis.parts)
        late = None if waits else (noise.all(0.6 * period * rate) * weights).ravel()[:, None]
        whole = np.tile(clusters.reshape(-1), records.n)
        solution = minimise(residual, start, hypothesis.steps(), whole, hypothesis.prior(), late)
        moved = np.abs(solution.vector - start) / np.sqrt(np.maximum(np.diag(solution.covariance), 1e-300))
        start = solution.vector
        if np.all(moved < 1.0):
            break
    assert solution is not None
    return solution


def blocks(times: Array, owner: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return (D,) the number of each sample's stretch of its log, by times (D,) [s] and the log's number (D,)."""
    each = np.stack([owner, (times / TUNING.cluster).astype(np.int64)], axis=1)
    return np.asarray(np.unique(each, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.int64)


def _scanned(hypothesis: Hypothesis, start: Array, residual: Callable[[Array], Array]) -> Array:
    """Return the start, with coordinates in which the residual rings brought near to their best."""
    best, least = start, float(np.sum(residual(start) ** 2))
    for part, s in zip(hypothesis.parts, hypothesis.slices(), strict=True):
        key = record_of(part.spec.name).scanned
        if not key:
            continue
        count = len(part.spec.parameters[key])
        keys = list(part.spec.parameters)
        first = s.start + sum(len(part.spec.parameters[other]) for other in keys[: keys.index(key)])
        for k in range(first, first + count):
            centre = best.copy()
            for factor in TUNING.factors:
                trial = centre.copy()
                trial[k] = trial[k] + np.log(factor) if part.logarithmic(key) else trial[k] * factor
                cost = float(np.sum(residual(trial) ** 2))
                if cost < least:
                    best, least = trial, cost
    return best


__all__ = ["Hypothesis", "by_torque"]
