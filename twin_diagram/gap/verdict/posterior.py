"""How sure a name is, what else it could be, and what would tell them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.experiments.advice import experiment
from twin_diagram.gap.findings import Alternative, Estimate, Finding, Moment, Separation
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.search.bench import Bench, noise_distance
from twin_diagram.gap.search.evidence import HypothesisFit, Members
from twin_diagram.gap.search.greedy_search import additions, everywhere, finer, handicaps
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.search.prior_costs import asked
from twin_diagram.gap.verdict.probabilities import Claim, Hypothesis, normalised, shared_out
from twin_diagram.model.effects import REGISTRY
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module.

    Those that say so were set on training cases (seeds below 10000) of `sims/benchmarks/gap_benchmark.py`, the others
    by hand; `make gap-benchmark ARGS="--suite training"` shows what they do.
    """

    temperature: float = 2.0
    """Evidence is divided by this before it becomes a probability; set on training logs, where it makes them
    calibrated."""

    alternatives: int = 3
    """Told beside a finding at most: the layout of gap.json has so many."""

    rivals: int = 12
    """Candidates that are solved exactly in the place of a finding, of which the best count as its rivals."""

    more_unseen: float = 0.08
    """Probability, for each further joint, that an effect is there unseen (`EffectRecord.unseen`), where it is on
    several joints already; set on training logs."""

    negligible: float = 1e-4
    """Hypotheses of less probability say nothing about a parameter's error."""

    together: float = 1.0
    """Effects of one name that start within this time start together [s]."""


TUNING = Tuning()


def groups(bench: Bench, members: Members) -> dict[str, list[int]]:
    """Return the members by name, in the order of their joints."""
    result: dict[str, list[int]] = {}
    for k in sorted(members, key=lambda k: bench.candidates[k].joints):
        result.setdefault(bench.candidates[k].name, []).append(k)
    return result


def claim(candidates: list[Candidate]) -> Claim:
    """Return what several candidates of one name say together."""
    joints = sorted({j for candidate in candidates for j in candidate.joints})
    links = tuple(dict.fromkeys(link for candidate in candidates for link in candidate.links))
    return candidates[0].name, tuple(joints), links


def claims(bench: Bench, members: Members) -> Hypothesis:
    """Return all that a hypothesis says."""
    return frozenset(claim([bench.candidates[k] for k in group]) for group in groups(bench, members).values())


def posterior(bench: Bench, fit: HypothesisFit) -> dict[Hypothesis, float]:
    """Return probabilities of all sets of claims that were ever solved; of each set, its best shapes count.

    What the search asks of a hypothesis for the sake of simplicity is asked here, too, or else what it would never
    name would seem more probable than what it did: a finer law is held to what `greedy_search.plainer` asks of it,
    and a larger set to what its further members must bring.
    """
    return {claims(bench, tried.members): p for tried, p in weighed(bench, fit)}


def weighed(bench: Bench, fit: HypothesisFit) -> list[tuple[HypothesisFit, float]]:
    """Return the best fit of each set of claims with its probability, see `posterior`."""
    best: dict[Hypothesis, tuple[HypothesisFit, float]] = {}
    for tried, value in _ranked(bench, fit):
        best.setdefault(claims(bench, tried.members), (tried, value))
    probability = normalised({key: value for key, (_, value) in best.items()}, TUNING.temperature)
    return [(best[key][0], p) for key, p in probability.items()]


def most_probable(bench: Bench, fit: HypothesisFit) -> HypothesisFit:
    """Return the best of all hypotheses that were ever solved, as `posterior` weighs them beside a fit."""
    best, value = _ranked(bench, fit)[0]
    own = next(value for tried, value in _ranked(bench, fit) if tried.members == fit.members)
    return best if value > own + 1e-9 else fit


def _ranked(bench: Bench, fit: HypothesisFit) -> list[tuple[HypothesisFit, float]]:
    """Return all hypotheses that were solved, with their evidence less what is asked of them, best first."""
    less = handicaps(bench, fit)
    mine = asked([bench.candidates[k] for k in fit.members], PRIOR_COSTS.least)
    result = []
    for members, tried in bench.solver.fits.items():
        if not np.isfinite(tried.evidence):
            continue
        there = [bench.candidates[k] for k in members]
        more = max(0.0, asked(there, PRIOR_COSTS.least) - mine)
        result.append((tried, tried.evidence - more - finer(bench, fit, members, less)))
    return sorted(result, key=lambda item: -item[1])


def unseen(said: Claim, joints: int) -> float:
    """Return the probability that a claim lacks a joint on which it could not be told, on an arm of so many joints."""
    name, named, _ = said
    first = record_of(name).unseen
    if first == 0.0:
        return 0.0
    each = first if len(named) == 1 else TUNING.more_unseen
    return float(1.0 - (1.0 - each) ** (joints - len(named)))


def look_around(bench: Bench, fit: HypothesisFit) -> None:
    """Solve what could stand in the place of each member, or of all of one name, or beside them.

    `posterior` meets it on the bench.
    """
    additions(bench, fit.members, TUNING.rivals)
    everywhere(bench, fit)
    for group in groups(bench, fit.members).values():
        additions(bench, fit.members - frozenset(group), TUNING.rivals)
        for k in group:
            additions(bench, fit.members - {k}, TUNING.rivals)


def findings_of(records: Records, bench: Bench, fit: HypothesisFit) -> tuple[Finding, ...]:
    """Return one finding per name, or per name and time, strongest first."""
    look_around(bench, fit)
    hypotheses = weighed(bench, fit)
    probability = {claims(bench, tried.members): p for tried, p in hypotheses}
    mine = claims(bench, fit.members)
    names = records.model.joints
    result = []
    for group in groups(bench, fit.members).values():
        said = claim([bench.candidates[k] for k in group])
        shared = shared_out(said, mine, probability, lambda other: unseen(other, records.n), TUNING.alternatives)
        for part in together(bench, group):
            first = bench.candidates[part[0]]
            _, joints, links = claim([bench.candidates[k] for k in part])
            result.append(
                Finding(
                    name=said[0],
                    joints=tuple(names[j] for j in joints),
                    links=links,
                    parameters=parameters_of(records, bench, fit, part, hypotheses),
                    confidence=shared.sure,
                    alternatives=tuple(
                        Alternative(name, tuple(names[j] for j in joints), links, float(p))
                        for (name, joints, links), p in shared.others
                    ),
                    onset=None if first.onset is None else Moment(*first.onset),
                    end=None if first.end is None else Moment(*first.end),
                    significance=noise_distance(bench, fit, bench.solve(fit.members - frozenset(part))),
                    rest=shared.rest,
                )
            )
    return tuple(sorted(result, key=lambda finding: -finding.significance))


def together(bench: Bench, group: list[int]) -> list[list[int]]:
    """Return the members of one name, parted where some of them start or end at other times than others."""

    def alike(a: tuple[int, float] | None, b: tuple[int, float] | None) -> bool:
        if a is None or b is None:
            return a is b
        return a[0] == b[0] and abs(a[1] - b[1]) < TUNING.together

    parts: list[list[int]] = []
    for k in group:
        new = bench.candidates[k]
        for part in parts:
            old = bench.candidates[part[0]]
            if alike(new.onset, old.onset) and alike(new.end, old.end):
                part.append(k)
                break
        else:
            parts.append([k])
    return parts


def parameters_of(
    records: Records,
    bench: Bench,
    fit: HypothesisFit,
    group: list[int],
    hypotheses: Sequence[tuple[HypothesisFit, float]] = (),
) -> dict[str, Estimate | dict[str, Estimate]]:
    """Return parameters in the layout of gap.json; of several ripples on one joint, the largest.

    Args:
        records: of the fit.
        bench: that it was solved on.
        fit: what is named.
        group: members of it, of one name.
        hypotheses: with their probabilities; see `doubt_of`.
    """
    result: dict[str, Estimate | dict[str, Estimate]] = {}
    told = {k: bench.candidates[k].parameters(*bench.part(fit, k)) for k in group}
    for k in sorted(group, key=lambda k: float(np.max(told[k]["amplitude"][0])) if "amplitude" in told[k] else 0.0):
        candidate = bench.candidates[k]
        doubts = doubt_of(bench, fit, k, hypotheses)
        for key, (value, std) in told[k].items():
            doubt = doubts.get(key, np.zeros(len(value)))
            if not record_of(candidate.name).per_joint:
                result[key] = _estimate(value, std, unit_of(candidate.name, key), doubt)
                continue
            per_joint = result.setdefault(key, {})
            assert isinstance(per_joint, dict)
            for joint in (records.model.joints[j] for j in candidate.joints):
                unit = unit_of(candidate.name, key, joint in records.model.prismatic)
                per_joint[joint] = _estimate(value, std, unit, doubt)
    return result


def doubt_of(
    bench: Bench, fit: HypothesisFit, member: int, hypotheses: Sequence[tuple[HypothesisFit, float]]
) -> dict[str, Array]:
    """Return what other hypotheses add to the standard errors of a member's parameters, per key.

    The law of total variance over all that hold it, by their probability: how far they lie apart, and how much less
    sure they are. A standard error within one hypothesis takes for granted that nothing is missing beside it: where
    a joint's viscous friction is too weak to be named, its dry friction takes the place of it.
    """
    own = bench.candidates[member]
    here = own.parameters(*bench.part(fit, member))
    squares, total = {key: np.zeros(len(value)) for key, (value, _) in here.items()}, 0.0
    for tried, p in hypotheses:
        for k in (k for k in tried.members if p > TUNING.negligible and bench.candidates[k].place == own.place):
            there = bench.candidates[k].parameters(*bench.part(tried, k))
            if all(key in there and len(there[key][0]) == len(value) for key, (value, _) in here.items()):
                total += p
                for key, (value, std) in here.items():
                    other, wider = there[key]
                    squares[key] = squares[key] + p * ((other - value) ** 2 + wider**2 - std**2)
            break
    return {key: np.sqrt(np.maximum(square, 0.0) / max(total, 1e-12)) for key, square in squares.items()}


def unit_of(name: str, key: str, prismatic: bool = False) -> str:
    """Return a parameter's unit, as its effect's class states it, on a revolute or prismatic joint."""
    return REGISTRY[name].kinds[key].unit_on(prismatic)


def _estimate(value: Array, std: Array, unit: str, doubt: Array) -> Estimate:
    std = np.hypot(std, doubt)
    if len(value) == 1:
        return Estimate(float(value[0]), float(std[0]), unit, float(doubt[0]))
    return Estimate([float(x) for x in value], [float(x) for x in std], unit, [float(x) for x in doubt])


def separations_of(records: Records, bench: Bench, fit: HypothesisFit) -> tuple[Separation, ...]:
    """Return nearest rivals of each name, those farther than 30 left out."""
    result = []
    mine = claims(bench, fit.members)
    for group in groups(bench, fit.members).values():
        said = claim([bench.candidates[k] for k in group])
        rest = fit.members - frozenset(group)
        nearest: dict[Claim, float] = {}
        for members, tried in bench.solver.fits.items():
            if not np.isfinite(tried.evidence) or len(members) > len(fit.members):
                continue
            others = claims(bench, members)
            if said in others or not rest <= members:
                continue
            for other in others - mine:
                distance = noise_distance(bench, fit, tried)
                nearest[other] = min(nearest.get(other, np.inf), distance)
        for other, distance in sorted(nearest.items(), key=lambda item: item[1])[: TUNING.alternatives]:
            if distance < 30.0:
                result.append(
                    Separation(_say(records, said), _say(records, other), distance, experiment(said[0], other[0]))
                )
    return tuple(sorted(result, key=lambda s: s.distance))


def _say(records: Records, said: Claim) -> str:
    places = [records.model.joints[j] for j in said[1]] + list(said[2])
    return f"{said[0]} on {', '.join(places)}" if places else said[0]
