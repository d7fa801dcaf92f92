"""From a final fit to a verdict: what is named, what is better left unnamed, and whether something is left over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.findings import Finding, Separation, Verdict
from twin_diagram.gap.residuals import whitening
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.bench import Bench, likelihood_gain
from twin_diagram.gap.search.evidence import HypothesisFit, Members
from twin_diagram.gap.verdict import leftover_structure
from twin_diagram.gap.verdict.posterior import claims, findings_of, groups, most_probable, separations_of
from twin_diagram.gap.verdict.probabilities import less_sure, outweighed, surer


@dataclass(frozen=True)
class Tuning:
    """Constants of this module.

    Those that say so were set on training cases (seeds below 10000) of `sims/benchmarks/gap_benchmark.py`, the others
    by hand; `make gap-benchmark ARGS="--suite training"` shows what they do.
    """

    remainder: float = 8.0
    """Above this, `leftover_structure.left_over` says that structure is left; set on clean training logs."""

    beside: float = 6.5
    """The same where something was named."""

    exact: float = 1e-3
    """Share of a joint's torque, twice `Bench`'s `finest`, up to which structure is what the step of a simulator or a
    controller, filters and sampling leave; noise of a four hundredth of the torque hides as much."""

    mostly: float = 0.5
    """Where a flexible model explains more of the residual than this share of what was named, nothing is named."""

    less_sure: float = 0.75
    """Where structure is left, names are this much less sure: more often than not they follow something without a
    name."""

    doubtful: float = 0.5
    """Findings of less confidence than this that are `small`, too, are not named."""

    small: float = 0.3
    """Share of the strongest finding's significance below which one is small."""

    piece: float = 0.1
    """Where structure is left, findings that explain less than this share of what was explained are not named."""

    level: float = 1.35
    """Noise of a joint whose variance is this many times what was thought possible beside any smooth law, and
    `of_few` over its samples more, is structure where something was named."""

    of_few: float = 45.0
    """Samples over whose number that bound is raised: what was thought possible is too little by half in some short
    clean logs."""

    far_above: float = 4.0
    """The same where nothing was named."""

    red: float = 6.0
    """Noise this much denser at the slow than at the fast ones of these frequencies [Hz] is no noise where something
    was found."""

    heard: float = 2.0 / 3.0
    """Share of a joint's samples whose logged torque must count for a law, where another unusual name is beside it; by
    hand: below, the two explain whatever was logged."""

    many: int = 4
    """So many unusual names at once rather follow something that has no name."""


TUNING = Tuning()


SLOW = np.linspace(0.1, 1.0, 10)
"""Frequencies at which what laws leave unexplained shows [Hz]; see `Tuning.red`."""

FAST = np.linspace(2.5, 4.0, 10)
"""Frequencies with which they are compared [Hz]: above most motion, below the filters' edge."""


def crowded(findings: Sequence[Finding]) -> bool:
    """Return whether one joint has two unusual names, or an arm many.

    Together they rather follow something without a name.

    Beside another name, one that starts within the log is unusual whatever it is: two steps follow any drift.
    """
    strange = [finding for finding in findings if not record_of(finding.name).usual]
    if len(strange) >= TUNING.many:
        return True
    unusual = [joint for finding in strange for joint in finding.joints]
    several = [joint for finding in findings for joint in finding.joints]
    started = {joint for finding in findings if finding.onset is not None for joint in finding.joints}
    return len(unusual) > len(set(unusual)) or any(several.count(joint) > 1 for joint in started)


def doubled(bench: Bench, fit: HypothesisFit) -> bool:
    """Return whether a joint has a second ripple, which follows something but cannot be told beside the first."""
    places = [bench.candidates[k].place for k in fit.members if record_of(bench.candidates[k].name).apart is not None]
    return len(set(places)) < len(places)


def share_of(bench: Bench, fit: HypothesisFit, group: Members) -> float:
    """Return the share of the log likelihood gained on some members' own joints that is lost without them."""
    rows = sorted({j for k in group for j in bench.candidates[k].rows})
    empty, without = bench.solve(frozenset()).variance, bench.solve(fit.members - group).variance
    explained = float(np.sum((bench.counts * np.log(empty / fit.variance))[rows]))
    lost = float(np.sum((bench.counts * np.log(without / fit.variance))[rows]))
    return lost / max(explained, 1e-9)


def trimmed(bench: Bench, fit: HypothesisFit) -> HypothesisFit:
    """Return the fit without the joints on which an unusual name of several explains next to nothing.

    Where structure is left, they would take the name away from the others, too.
    """
    weak: set[int] = set()
    for name, group in groups(bench, fit.members).items():
        little = {k for k in group if share_of(bench, fit, frozenset({k})) < TUNING.piece}
        if not record_of(name).usual and len(little) < len(group):
            weak |= little
    found = bench.solve(fit.members - weak)
    return found if np.isfinite(found.evidence) else fit


def negligible(finding: Finding, findings: Sequence[Finding], share: float, structure: bool) -> bool:
    """Return whether a finding is small beside the rest and doubtful, so that it is better left without a name.

    Where even the rest does not explain everything, what explains
    little of its joints may be a piece of what a stronger one's law follows not quite.
    """
    if structure and finding is not findings[0] and share < TUNING.piece:
        return True
    small = finding.significance < TUNING.small * findings[0].significance
    return (
        small and finding.confidence < TUNING.doubtful and len(finding.joints) < 2 and not record_of(finding.name).usual
    )


def redness(noise: whitening.Whitener, rate: float, told: npt.NDArray[np.bool_] | slice = slice(None)) -> float:
    """Return how much denser noise is at slow motion's frequencies than above them, on the worst of the joints told."""
    z = np.exp(-2j * np.pi / rate * np.outer(np.arange(noise.order + 1), np.concatenate([SLOW, FAST])))
    density = np.abs(noise.filters[told] @ z) ** -2.0
    return float(np.max(np.mean(density[:, : len(SLOW)], axis=1) / np.mean(density[:, len(SLOW) :], axis=1)))


def mostly_left(bench: Bench, fit: HypothesisFit, joints: npt.NDArray[np.bool_]) -> bool:
    """Return whether more of some joints' residual is left than was explained, as energies above the noise."""
    empty = bench.solve(frozenset()).variance
    noise = 1.0 + bench.finest
    left, all_there = (float(np.sum((bench.counts * (x - noise))[joints])) for x in (fit.variance, empty))
    return left > TUNING.mostly * all_there and bool(np.any(joints))


def guessed(findings: Sequence[Finding]) -> bool:
    """Return whether something else is more probable than one of the names, or all of them are guesses."""
    return any(map(outweighed, findings)) or (bool(findings) and all(map(Finding.is_guess, findings)))


def deaf(bench: Bench, fit: HypothesisFit) -> bool:
    """Return whether a joint's torque hardly counts for one unusual name while another takes what is left of it.

    Such a pair explains friction on a joint that carries nothing as well as friction does, what it does at rest too.
    """
    for k in fit.members:
        own = bench.candidates[k]
        limit = -0.5 * float(np.log(TUNING.heard)) * sum(float(bench.counts[j]) for j in own.rows)
        beside = (bench.candidates[i] for i in fit.members - {k})
        if own.unheard_cost > limit and any(
            set(other.joints) & set(own.joints) and not record_of(other.name).usual for other in beside
        ):
            return True
    return False


def outdone(bench: Bench, fit: HypothesisFit) -> bool:
    """Return whether another set of names was solved that is more probable than what was to be named."""
    return bool(fit.members) and claims(bench, most_probable(bench, fit).members) != claims(bench, fit.members)


def conclude(records: Records, terms: Terms, bench: Bench, fit: HypothesisFit) -> Verdict:
    """Return the verdict on a final fit."""
    left, chosen = leftover_structure.left_over(records, terms, bench, fit), fit
    beyond = fit.variance - bench.finest
    raised = beyond > (
        TUNING.level + TUNING.of_few / np.maximum(bench.counts, 1.0) if fit.members else TUNING.far_above
    )
    # Whether pieces of a name follow something is asked of all structure, whether to speak of it of what is no trifle.
    worth_a_word = left.beyond(TUNING.exact)
    structure = bool(np.any(raised)) or left.statistic > TUNING.remainder
    said = bool(np.any(raised)) or worth_a_word > TUNING.remainder
    noise = np.hypot(whitening.noise_below(bench.whitener, records.rate), records.above)
    findings: tuple[Finding, ...] = ()
    separation: tuple[Separation, ...] = ()
    if fit.members:
        red = redness(bench.whitener, records.rate, bench.counts > 1.0) > TUNING.red
        structure = structure or left.statistic > TUNING.beside or red
        said = said or worth_a_word > TUNING.beside or red
        findings = findings_of(records, bench, fit)
        less = trimmed(bench, fit) if structure else fit
        if less.members != fit.members:
            sure = {f.name: f.confidence for f in findings}
            fit = less
            findings = tuple(surer(f, sure[f.name]) for f in findings_of(records, bench, fit))
        separation = separations_of(records, bench, fit)
        odd = crowded(findings) or doubled(bench, fit)
        structure, said = structure or odd, said or odd
        named = {name: frozenset(group) for name, group in groups(bench, fit.members).items()}
        shares = {name: share_of(bench, fit, group) for name, group in named.items()}
        kept = tuple(f for f in findings if not negligible(f, findings, shares[f.name], structure))
        said = said or any(negligible(f, findings, shares[f.name], said) for f in findings)
        rest = frozenset().union(*(named[f.name] for f in kept))
        if not said and rest != chosen.members:  # what goes without a name is left, too
            without = leftover_structure.left_over(records, terms, bench, bench.solve(rest))
            said = without.beyond(TUNING.exact) > TUNING.beside
        findings = tuple(less_sure(f, TUNING.less_sure) for f in kept) if said else kept
    touched = np.isin(np.arange(records.n), [j for k in fit.members for j in bench.candidates[k].rows])
    doubted = mostly_left(bench, fit, raised & touched)
    unknown = said and (not findings or left.gain > TUNING.mostly * likelihood_gain(bench, fit) or doubted)
    unknown = unknown or outdone(bench, chosen) or deaf(bench, chosen) or guessed(findings)
    if unknown:
        findings, separation = (), ()
    return Verdict(
        verdict="unknown" if unknown else "named" if findings else "none",
        remainder=bool(said and findings),
        findings=findings,
        where=(),
        separation=separation,
        noise_floor=noise,
        statistic=fit.evidence,
        remainder_statistic=left.statistic,
    )
