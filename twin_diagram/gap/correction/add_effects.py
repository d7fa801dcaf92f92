"""Adds what was named to a model: refines its parameters and hands back the corrected model.

from twin_diagram.gap.correction.add_effects import add
added = add(given, logs, verdict)
added.model, added.findings          # a Model that can be saved; the findings with refined parameters
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.correction.equation_error import Hypothesis, by_torque
from twin_diagram.gap.correction.gauss_newton import Solution
from twin_diagram.gap.correction.named_effects import specs_of
from twin_diagram.gap.correction.onset_times import TUNING as ONSET_TIMES
from twin_diagram.gap.correction.output_error import output_error
from twin_diagram.gap.correction.physical_coordinates import Coordinates
from twin_diagram.gap.findings import Estimate, Finding, Moment
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.verdict.posterior import unit_of
from twin_diagram.logs import Log, fingerprint
from twin_diagram.logs.differentiation import Motion, motion
from twin_diagram.model.effects import REGISTRY
from twin_diagram.model.effects.timing import settled
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import torque_residual_rms
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array

Say = Callable[[str], None]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    most_by_motion: int = 8
    """Coordinates up to which rollouts are tried; beyond, they take too long and tell too little of each."""

    worse: float = 0.05
    """Rise of the residual's logarithm, all joints together, that other weights of samples may bring."""

    alike: float = 2.5
    """Estimates farther apart than this many of their standard errors do not speak of the same thing; torques then
    decide.

    Measured torques drive the rollouts, and their noise with them: a light joint runs away, and what is fitted to it
    then is surer of itself than it should be.
    """

    nearer: float = 2.0
    """Times that errors of simulated motion may shrink on the way from the torques' estimate to its own."""

    sure: float = 3.0
    """Standard errors of simulated motion are this many times what the windows' scatter says.

    Their noise comes with the torques that drive them and is not that of the next window alone: measured against known
    truths, errors were two to three times what the scatter promised, while those of the torques kept theirs.
    """


TUNING = Tuning()


@dataclass(frozen=True)
class Added:
    """What came of it.

    Attributes:
        model: the corrected one; the given one where nothing was named, or nothing of it can be. What starts within a
            fitted run is there from the begin of any other, and what ended is over.
        findings: with refined parameters.
        notes: what a reader should know.
    """

    model: Model
    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()


def add(
    given: Model,
    logs: Sequence[Log],
    findings: Sequence[Finding],
    say: Say | None = None,
    records: Records | None = None,
) -> Added:
    """Refine named effects and add them to a model.

    Args:
        given: with the logs' joints in the logs' order.
        logs: that the effects were found in, checked.
        findings: relative to the given model, with rough parameters.
        say: told what is being done.
        records: `prepare(given, logs)`, where the caller has it.

    Raises:
        ModelError: what was named cannot be added to this model.
    """
    say = say or (lambda text: None)
    if not findings:
        return Added(given, ())
    marks, motions = [fingerprint(log) for log in logs], [motion(log) for log in logs]
    try:
        return _added(prepare(given, logs) if records is None else records, motions, findings, say)
    except ModelError:
        # What began in an older run cannot become less; what was there ever since can.
        left = settled(given.effects, marks)
        if left == list(given.effects):
            raise
        return _added(prepare(given.with_effects(left), logs), motions, findings, say)


def _added(records: Records, motions: Sequence[Motion], findings: Sequence[Finding], say: Say) -> Added:
    """Return what `add` does, on prepared logs and their smoothed motions."""
    given, marks = records.model, [record.mark for record in records.records]
    owners: list[int] = []
    specs: list[EffectSpec] = []
    for k, finding in enumerate(findings):
        for spec in specs_of(finding, marks):
            owners.append(k)
            specs.append(spec)
    first = Hypothesis.of(given, specs)
    rough = first.model(first.start())
    say("refining by torques")
    hypothesis, torques = by_torque(first, records)

    def told(hypothesis: Hypothesis, vector: Array, covariance: Array) -> tuple[Finding, ...]:
        mine = [[i for i, owner in enumerate(owners) if owner == k] for k in range(len(findings))]
        return tuple(_told(findings[k], hypothesis, mine[k], vector, covariance) for k in range(len(findings)))

    def kept(*notes: str) -> Added:
        """Return the rough parameters; how far the refined ones went from them counts as doubt."""
        doubt = np.diag(np.square(torques.vector - first.start()))
        return Added(rough, told(_timed_roughly(first), first.start(), torques.covariance + doubt), notes)

    vector, covariance, notes = torques.vector, torques.covariance, list[str]()
    if len(vector) <= TUNING.most_by_motion:
        say("refining by simulated motion")
        moved = hypothesis.at(torques.vector)
        motion_told = output_error(moved, motions, partial(may_be_surer, hypothesis, torques))
        vector, covariance, notes = chosen(hypothesis, (torques, motion_told))
    try:
        model = hypothesis.model(vector)
    except ModelError:
        return kept("refined parameters cannot be; the rough ones are kept")
    least = _left(rough, motions)
    if _left(model, motions) > least + TUNING.worse:
        say("refining by torques, all that is left counted alike")
        plain = _plain(Hypothesis.of(given, specs), records)
        if plain is None or _left(plain[0].model(plain[1].vector), motions) > least + TUNING.worse:
            return kept(*notes, "refined parameters fit the runs worse than the rough ones, which are kept")
        hypothesis, vector, covariance = plain[0], plain[1].vector, plain[1].covariance
        model = hypothesis.model(vector)
        notes = ["laws are not exact to the noise: parameters are those that fit best below 10 Hz"]
    return Added(model, told(hypothesis, vector, covariance), tuple(notes))


def _timed_roughly(hypothesis: Hypothesis) -> Hypothesis:
    """Return the same, its onsets and ends as uncertain as those of a search."""

    def timed(part: Coordinates) -> Coordinates:
        return part.at(replace(part.when, onset_std=ONSET_TIMES.roughly, end_std=ONSET_TIMES.roughly))

    return replace(hypothesis, parts=tuple(timed(part) for part in hypothesis.parts))


def _plain(rough: Hypothesis, records: Records) -> tuple[Hypothesis, Solution] | None:
    """Return the least squares of what is left, whatever its colour; none where no such parameters can be."""
    try:
        hypothesis, solution = by_torque(rough, records, coloured=False)
        hypothesis.model(solution.vector)
    except ModelError:
        return None
    return hypothesis, solution


def _left(model: Model, motions: Sequence[Motion]) -> float:
    """Return the sum over joints of the logarithm of the residual torque of all runs, free of the joints' scales."""
    squares = np.mean([torque_residual_rms(model, smooth.log, smooth) ** 2 for smooth in motions], axis=0)
    return float(0.5 * np.sum(np.log(np.maximum(squares, 1e-24))))


def may_be_surer(hypothesis: Hypothesis, torques: Solution, covariance: Array) -> bool:
    """Return whether simulated motion, of a covariance (p, p) at the torques' estimate, may yet be the surer of any."""
    near = np.square(TUNING.sure / TUNING.nearer) * covariance
    return any(
        np.linalg.slogdet(near[s, s])[1] < np.linalg.slogdet(torques.covariance[s, s])[1] for s in hypothesis.slices()
    )


def chosen(hypothesis: Hypothesis, solutions: Sequence[Solution]) -> tuple[Array, Array, list[str]]:
    """Return per effect the estimate that is surer of itself: coordinates, their covariance and notes.

    Both speak of the same runs, so they are not averaged.
    """
    torques, motions = solutions
    vector, covariance = torques.vector.copy(), torques.covariance.copy()
    notes = []
    for part, s in zip(hypothesis.parts, hypothesis.slices(), strict=True):
        a, b = torques.covariance[s, s], TUNING.sure**2 * motions.covariance[s, s]
        apart = motions.vector[s] - torques.vector[s]
        distance = float(np.sqrt(max(0.0, float(apart @ np.linalg.pinv(a + b, hermitian=True) @ apart))))
        if distance > TUNING.alike * np.sqrt(len(apart)):
            notes.append(
                f"{part.spec.name}: simulated motion would have it {distance:.1f} standard errors off; torques decided"
            )
            continue
        if np.linalg.slogdet(b)[1] < np.linalg.slogdet(a)[1]:
            vector[s] = motions.vector[s]
            covariance[s, :], covariance[:, s] = 0.0, 0.0
            covariance[s, s] = b
    return vector, covariance, notes


def _told(finding: Finding, hypothesis: Hypothesis, mine: Sequence[int], vector: Array, covariance: Array) -> Finding:
    """Return a finding with the parameters of its effects."""
    told: dict[str, Estimate | dict[str, Estimate]] = {}
    slices, prismatic = hypothesis.slices(), hypothesis.given.prismatic
    for i in mine:
        part, s = hypothesis.parts[i], slices[i]
        values = part.effect(vector[s]).parameters
        sides: dict[str, list[Array]] = {key: [] for key in values}
        size = np.sqrt(np.maximum(np.diag(covariance[s, s]), 1e-30))
        for k in range(len(size)):
            slopes: dict[str, list[Array]] = {key: [] for key in values}
            for step in (0.01 * size[k], -0.01 * size[k]):
                moved = vector[s].copy()
                moved[k] += step
                after = part.effect(moved).parameters
                for key, value in values.items():
                    slopes[key].append((np.array(after[key]) - np.array(value)) / step)
            for key, both in slopes.items():  # at a bound of the catalogue a value moves to one side alone
                sides[key].append(max(both, key=lambda slope: float(np.linalg.norm(slope))))
        for key, value in values.items():
            if key in record_of(finding.name).untold:
                continue
            J = np.stack(sides[key], axis=1)
            std = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", J, covariance[s, s], J), 0.0))
            fixed, relative = record_of(finding.name).left_out.get(key, (0.0, 0.0))
            std = np.sqrt(std**2 + fixed**2 + (relative * np.array(value)) ** 2)
            before = finding.parameters.get(key)
            std = np.hypot(std, _doubt(before, part.spec.joints, len(value)))
            units = [unit_of(finding.name, key, joint in prismatic) for joint in part.spec.joints]
            if isinstance(before, dict):
                mapping = told.setdefault(key, {})
                assert isinstance(mapping, dict)
                if not REGISTRY[finding.name].per_joint:
                    mapping |= {
                        joint: _estimate(value, std, unit) for joint, unit in zip(part.spec.joints, units, strict=True)
                    }
                elif len(value) == len(part.spec.joints):
                    for joint, x, e, unit in zip(part.spec.joints, value, std, units, strict=True):
                        mapping[joint] = Estimate(float(x), float(e), unit)
                else:
                    mapping[part.spec.joints[0]] = _estimate(value, std, units[0])
            else:
                told[key] = _estimate(value, std, unit_of(finding.name, key))
    when = hypothesis.parts[mine[0]].when
    onset, end = finding.onset, finding.end
    if onset is not None and when.onset is not None:
        onset = Moment(onset.log, when.onset, when.onset_std)
    if end is not None and when.end is not None:
        end = Moment(end.log, when.end, when.end_std)
    return replace(finding, parameters=told, onset=onset, end=end)


def _doubt(before: Estimate | dict[str, Estimate] | None, joints: Sequence[str], count: int) -> Array:
    """Return (count,) of a rough estimate's standard error that comes from what else may be there."""
    own = [before] if isinstance(before, Estimate) else [before[j] for j in joints if j in before] if before else []
    doubts = [np.atleast_1d(np.asarray(estimate.doubt, dtype=float)) for estimate in own]
    flat = np.concatenate(doubts) if doubts else np.zeros(0)
    return flat if len(flat) == count else np.zeros(count)


def _estimate(value: Sequence[float], std: Array, unit: str) -> Estimate:
    if len(value) == 1:
        return Estimate(float(value[0]), float(std[0]), unit)
    return Estimate([float(x) for x in value], [float(x) for x in std], unit)
