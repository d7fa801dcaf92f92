"""From logs to a verdict: prepares, searches, refines, and weighs what else could be named."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from twin_diagram.gap import (
    arm_candidates,
    flexible,
    gears,
    holding,
    joint_candidates,
    own_candidates,
    rest,
    saturated,
    whitening,
)
from twin_diagram.gap.candidate import Candidate
from twin_diagram.gap.evidence import Bench, Fit, Members
from twin_diagram.gap.finding import Finding, Separation, Verdict
from twin_diagram.gap.locating import locate
from twin_diagram.gap.posterior import findings_of, groups, separations_of
from twin_diagram.gap.proposals import Proposer
from twin_diagram.gap.records import Records, prepare
from twin_diagram.gap.refine import refine
from twin_diagram.gap.search import Polish, climb, search
from twin_diagram.gap.terms import Terms, given_load, slow_speed, with_load
from twin_diagram.logs import Log
from twin_diagram.model import Model

Array = npt.NDArray[np.float64]

LEAST = 6.0
"""Evidence that each member must bring beyond all prices [nats]; set on clean training logs."""

MOST = 40
"""Members of a hypothesis."""

REMAINDER = 8.0
"""Above this, `flexible.left_over` says that structure is left; set on clean training logs."""

BESIDE = 6.5
"""The same where something was named."""

MOSTLY = 0.5
"""Where a flexible model explains more of the residual than this share of what was named, nothing is named."""

DOUBT = 0.03
"""Share of what was named that its law may be wrong by."""

DOUBT_TIME = 0.3
"""[s]"""

SUSPECT = 3.0
"""Above this, a joint's gear is looked at more closely."""

SUSPECTS = 4

SWUNG = ("reflected_inertia", "joint_elasticity", "backlash", "torque_constant")
"""What a gear that swings looks like at first."""

NOT_SMOOTH = ("joint_elasticity", "torque_saturation")
"""Candidates that the saturated fit can do without."""

MOTOR = ("", "time_delay", "torque_constant", "torque_bias", "torque_saturation", "actuator_fault")
"""What stands between the logged torque and the motor's: no load of the motor."""

GEAR = (*rest.DRY, "viscous_friction", "reflected_inertia")
"""What stands between the motor's torque and the link's: no load of the gear."""

BESIDE_MORE = 0.75
"""Where structure is left, names are this much less sure: more often than not they follow something without a name."""

DOUBTFUL = 0.5
SMALL = 0.3
"""Findings of less confidence, and of less than this share of the strongest one's significance, are not named."""

PIECE = 0.1
"""Where structure is left, findings that explain less than this share of what was explained are not named."""

LEVEL = 1.4
"""Noise of a joint that is this much more than was thought possible beside any smooth law is structure where something
was named [variance]; what was thought possible is too little by half in some short clean logs."""

FAR_ABOVE = 4.0
"""The same where nothing was named."""

SLOW = np.linspace(0.1, 1.0, 10)
FAST = np.linspace(2.5, 4.0, 10)
RED = 6.0
"""Noise this much denser at the slow than at the fast ones of these frequencies [Hz] is no noise where something was
found."""

USUAL = frozenset({"viscous_friction", "coulomb_friction", "stribeck_friction", "reflected_inertia"})
"""What every joint may well lack at once."""

Progress = Callable[[str], None]


def name(model: Model, logs: Sequence[Log], progress: Progress | None = None) -> Verdict:
    """Names what a model lacks.

    Args:
        model: the given one, with the logs' joints in the logs' order.
        logs: checked.
        progress: told what is being done.

    Raises:
        LogError: a log is too short.
    """
    return investigate(prepare(model, logs), progress)[0]


def investigate(records: Records, progress: Progress | None = None) -> tuple[Verdict, Bench, Fit, Terms]:
    """The same on prepared logs, with all that was found on the way."""
    say = progress or (lambda text: None)
    seconds: dict[str, float] = {}
    clock = time.perf_counter()

    def lap(what: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        seconds[what] = seconds.get(what, 0.0) + now - clock
        clock = now

    say("looking at the residual")
    terms = Terms(records, given_load(records), slow_speed(records))
    candidates = all_candidates(terms)
    lap("candidates")
    smooth = [c for c in candidates if c.name not in NOT_SMOOTH]
    explained, spent = saturated.explain(records, smooth)
    ordinary = whitening.ordinary(records.residual - explained, records.lengths, records.rate)
    counted = rest.sliding(records, terms, range(records.n)) * ordinary
    noise = whitening.estimate(records.residual - explained, records.lengths, float(np.mean(spent)), counted)
    weights = rest.moving(records, terms, noise, range(records.n))
    white = records.white(noise.order)
    quiet = weights * ordinary[noise.rows].T
    noise = whitening.restricted(records.residual, saturated.columns(records, smooth), noise, quiet, white)
    lap("noise")

    say("searching for a name")
    nuisances = [arm_candidates.timing_nuisance(terms)]
    bench = Bench(records.residual, noise, candidates, nuisances, weights, terms.torque_size)
    fit = refine(bench, terms, search(bench, LEAST, MOST, Proposer(terms), polisher(terms)))
    lap("search")

    say("searching again with the noise that is left")
    terms, bench, fit = again(records, terms, bench, fit, ordinary)
    lap("second search")
    verdict = conclude(records, terms, bench, fit)
    # Now that it is known what is noise: the first guess of it is too low where a log is short.
    places = locate(records, terms, bench.whitener)
    lap("verdict")
    return replace(verdict, seconds=seconds, where=places), bench, fit, terms


def all_candidates(terms: Terms) -> list[Candidate]:
    """The catalogue's, but for those that are proposed on the way, and those of effects that a user registered."""
    return [
        *joint_candidates.joint_candidates(terms),
        *arm_candidates.arm_candidates(terms),
        *own_candidates.own_candidates(terms),
    ]


def again(records: Records, terms: Terms, bench: Bench, fit: Fit, ordinary: Array) -> tuple[Terms, Bench, Fit]:
    """Searches once more, with noise and transmitted torque as the first hypothesis has them.

    Args:
        records: prepared.
        terms: of the first search.
        bench: of the first search.
        fit: what it found.
        ordinary: see `whitening.ordinary`.
    """
    needed = saturated.at_full_rate(records, contribution_of(records, bench, fit, without=MOTOR))
    moved = saturated.at_full_rate(records, contribution_of(records, bench, fit, without=(*MOTOR, *GEAR)))
    given = given_load(records)
    terms = with_load(
        terms,
        tuple(g + c for g, c in zip(given, needed, strict=True)),
        tuple(g + c for g, c in zip(given, moved, strict=True)),
    )
    dry = rest.dry_joints(records) | {
        j for k in fit.members if bench.candidates[k].name in rest.DRY for j in bench.candidates[k].joints
    }
    fresh = all_candidates(terms)
    weights = rest.moving(records, terms, bench.whitener, dry)
    white = records.white(bench.whitener.order)
    smooth = [c for c in fresh if c.name not in NOT_SMOOTH] + [bench.candidates[k] for k in fit.members]
    quiet = weights * ordinary[bench.whitener.rows].T
    noise = whitening.restricted(records.residual, saturated.columns(records, smooth), bench.whitener, quiet, white)
    nuisances = [arm_candidates.timing_nuisance(terms)]
    second = Bench(records.residual, noise, fresh, nuisances, weights * trusted(records, bench, fit), terms.torque_size)
    members: Members = frozenset(second.add(bench.candidates[k]) for k in fit.members)
    asked = suspects(records, terms, second, members)
    gears.propose(second, terms, members, asked)
    polish, propose = polisher(terms), Proposer(terms)
    found = climb(second, members, LEAST, MOST, propose, polish)
    other = search(second, LEAST, MOST, propose, polish)
    best = found if found.evidence >= other.evidence else other
    late = [j for j in suspects(records, terms, second, best.members) if j not in asked]
    offered = [*gears.propose(second, terms, best.members, late), *holding.propose(second, terms, best)]
    if offered:
        best = climb(second, best.members, LEAST, MOST, propose, polish)
    return terms, second, pruned(second, refine(second, terms, best))


def trusted(records: Records, bench: Bench, fit: Fit) -> Array:
    """(n, R) weights of whitened samples: where much was named, no law is exact to the noise."""
    white = bench.whitener.all(contribution_of(records, bench, fit))
    width = max(1, round(DOUBT_TIME * records.rate))
    return np.asarray(1.0 / np.sqrt(1.0 + DOUBT**2 * uniform_filter1d(white**2, width, axis=1)))


def suspects(records: Records, terms: Terms, bench: Bench, members: Members) -> list[int]:
    """Joints on which curves of motion, load or time find most structure that a hypothesis leaves.

    A gear that swings or knocks shakes the joints beside it, where it may show more.
    """
    left = flexible.left_over(records, terms, bench, bench.solve(members)).joints
    found = [int(j) for j in np.argsort(-left)[:SUSPECTS] if left[j] > SUSPECT]
    swung = [j for k in sorted(members) if bench.candidates[k].name in SWUNG for j in bench.candidates[k].joints]
    beside = [i for j in found[:1] for i in (j + 1, j - 1) if 0 <= i < records.n]
    return list(dict.fromkeys([*found, *swung, *beside]))[:SUSPECTS]


def pruned(bench: Bench, fit: Fit) -> Fit:
    """The fit without members that do not bring `LEAST` once shapes and noise have settled."""
    while fit.members:
        without = max((bench.solve(fit.members - {k}) for k in fit.members), key=lambda other: other.evidence)
        if not np.isfinite(without.evidence) or fit.evidence - without.evidence >= LEAST:
            return fit
        fit = without
    return fit


def polisher(terms: Terms) -> Polish:
    """One round of `refine`."""
    return lambda bench, fit: refine(bench, terms, fit, rounds=1, slow=False)


def contribution_of(records: Records, bench: Bench, fit: Fit, without: Sequence[str] = ()) -> Array:
    """(ΣD, n) torque that a fit adds to the given model's, reduced [N·m].

    Args:
        records: of the fit.
        bench: that it was solved on.
        fit: solved.
        without: names to leave out; the timing nuisance's is empty.
    """
    result = np.zeros_like(records.residual)
    start = 0
    for k in fit.order:
        candidate = bench.candidates[k]
        if candidate.name not in without:
            result[:, list(candidate.rows)] += candidate.columns @ fit.coefficients[start : start + candidate.size]
        start += candidate.size
    return result


def crowded(findings: Sequence[Finding]) -> bool:
    """Whether one joint has two unusual names: together they rather follow something that has no name.

    Beside another name, one that starts within the log is unusual whatever it is: two steps follow any drift.
    """
    unusual = [joint for finding in findings if finding.name not in USUAL for joint in finding.joints]
    several = [joint for finding in findings for joint in finding.joints]
    started = {joint for finding in findings if finding.onset is not None for joint in finding.joints}
    return len(unusual) > len(set(unusual)) or any(several.count(joint) > 1 for joint in started)


def share_of(bench: Bench, fit: Fit, name: str) -> float:
    """Share of what was explained on a name's own joints that is lost without it, as log likelihoods."""
    group = frozenset(groups(bench, fit.members)[name])
    rows = sorted({j for k in group for j in bench.candidates[k].rows})
    empty, without = bench.solve(frozenset()).variance, bench.solve(fit.members - group).variance
    explained = float(np.sum((bench.counts * np.log(empty / fit.variance))[rows]))
    lost = float(np.sum((bench.counts * np.log(without / fit.variance))[rows]))
    return lost / max(explained, 1e-9)


def negligible(finding: Finding, findings: Sequence[Finding], share: float, structure: bool) -> bool:
    """Whether a name is better left as something that is there.

    That is what is small beside the rest and doubtful. Where even the rest does not explain everything, what explains
    little of its joints may be a piece of what a stronger one's law follows not quite.
    """
    if structure and finding is not findings[0] and share < PIECE:
        return True
    small = finding.significance < SMALL * findings[0].significance
    return small and finding.confidence < DOUBTFUL and len(finding.joints) < 2 and finding.name not in USUAL


def redness(noise: whitening.Whitener, rate: float) -> float:
    """How much denser noise is at slow motion's frequencies than above them, on the worst joint."""
    z = np.exp(-2j * np.pi / rate * np.outer(np.arange(noise.order + 1), np.concatenate([SLOW, FAST])))
    density = np.abs(noise.filters @ z) ** -2.0
    return float(np.max(np.mean(density[:, : len(SLOW)], axis=1) / np.mean(density[:, len(SLOW) :], axis=1)))


def conclude(records: Records, terms: Terms, bench: Bench, fit: Fit) -> Verdict:
    """The verdict on a final fit."""
    left = flexible.left_over(records, terms, bench, fit)
    raised = fit.variance > (LEVEL if fit.members else FAR_ABOVE)
    structure = left.statistic > REMAINDER or bool(np.any(raised))
    noise = whitening.noise_below(bench.whitener, records.rate)
    findings: tuple[Finding, ...] = ()
    separation: tuple[Separation, ...] = ()
    if fit.members:
        findings = findings_of(records, bench, fit)
        separation = separations_of(records, bench, fit)
        red = redness(bench.whitener, records.rate) > RED
        structure = structure or left.statistic > BESIDE or red or crowded(findings)
        kept = tuple(f for f in findings if not negligible(f, findings, share_of(bench, fit, f.name), structure))
        structure = structure or len(kept) < len(findings)
        findings = tuple(replace(f, confidence=f.confidence * BESIDE_MORE) for f in kept) if structure else kept
    gain = max(left.gain, float(np.sum(bench.counts[raised] * np.log(fit.variance[raised]))))
    unknown = structure and (not findings or gain > MOSTLY * bench.gain(fit))
    if unknown:
        findings, separation = (), ()
    return Verdict(
        verdict="unknown" if unknown else "named" if findings else "none",
        remainder=bool(structure and findings),
        findings=findings,
        where=(),
        separation=separation,
        noise_floor=noise,
        statistic=fit.evidence,
        remainder_statistic=left.statistic,
    )
