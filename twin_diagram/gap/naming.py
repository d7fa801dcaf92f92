"""From logs to a verdict: prepares, searches, refines, and weighs what else could be named."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from twin_diagram.gap.candidates import reversal_nuisances, time_delay, user_effects
from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.records import catalogue_candidates, record_of
from twin_diagram.gap.findings import Verdict
from twin_diagram.gap.residuals import stiction, whitening
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed, with_load
from twin_diagram.gap.search import gear_proposals, smooth_fit, stiction_proposals
from twin_diagram.gap.search.backlash_gaps import Knocks
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.borrowed_load import borrowing
from twin_diagram.gap.search.evidence import HypothesisFit, Members
from twin_diagram.gap.search.greedy_search import Polish, climb, plainer, possible, search, worth
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.search.proposals import Proposer
from twin_diagram.gap.search.shape_refinement import refine
from twin_diagram.gap.verdict import leftover_structure, rivals
from twin_diagram.gap.verdict.deciding import conclude
from twin_diagram.gap.verdict.locating import locate
from twin_diagram.gap.verdict.posterior import look_around, most_probable
from twin_diagram.logs import Log
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module.

    Those that say so were set on training cases (seeds below 10000) of `sims/benchmarks/gap_benchmark.py`, the others
    by hand; `make gap-benchmark ARGS="--suite training"` shows what they do.
    """

    most: int = 40
    """Members of a hypothesis."""

    doubt: float = 0.03
    """Share of what was named that its law may be wrong by."""

    doubt_time: float = 0.3
    """Over which the size of what was named is averaged for that doubt [s]."""

    suspect: float = 3.0
    """Above this, a joint's gear is looked at more closely."""

    suspects: int = 4
    """Joints at most whose gears are looked at more closely: each takes a grid of shapes."""

    turns: int = 4
    """Times at most that a rival takes the place of what was to be named."""

    uneven: float = 2.0
    """Standard errors by which a joint differs from the others."""

    again: int = 2
    """Searches at most with the transmitted torque of the one before."""


TUNING = Tuning()


Progress = Callable[[str], None]


def name(
    model: Model, logs: Sequence[Log], progress: Progress | None = None, records: Records | None = None
) -> Verdict:
    """Return the verdict on what a model lacks.

    Args:
        model: the given one, with the logs' joints in the logs' order.
        logs: checked.
        progress: told what is being done.
        records: `prepare(model, logs)`, where the caller has it.

    Raises:
        LogError: a log is too short.
    """
    return investigate(prepare(model, logs) if records is None else records, progress)[0]


def investigate(records: Records, progress: Progress | None = None) -> tuple[Verdict, Bench, HypothesisFit, Terms]:
    """Return the same on prepared logs, with all that was found on the way."""
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
    smooth = [c for c in candidates if record_of(c.name).smooth]
    explained, spent = smooth_fit.explain(records, smooth)
    ordinary = whitening.ordinary(records.residual - explained, records.lengths, records.rate)
    counted = stiction.sliding(records, terms, range(records.n)) * ordinary
    noise = whitening.estimate(records.residual - explained, records.lengths, float(np.mean(spent)), counted)
    weights = stiction.moving(records, terms, noise, range(records.n))
    white = records.white(noise.order)
    quiet = weights * ordinary[noise.rows].T
    noise = whitening.restricted(records.residual, smooth_fit.columns(records, smooth), noise, quiet, white)
    lap("noise")

    say("searching for a name")
    nuisances = [time_delay.timing_nuisance(terms), *reversal_nuisances.nuisances(terms)]
    moved = ~stiction.unmoved(records)[:, None]
    bench = Bench(records.residual, noise, candidates, nuisances, weights * moved, terms.torque_size)
    fit = refine(bench, terms, search(bench, PRIOR_COSTS.least, TUNING.most, Proposer(terms), polisher(terms)))
    lap("search")

    say("searching again with the noise that is left")
    terms, bench, fit = searched_again(records, terms, bench, fit, ordinary, say)
    lap("second search")
    verdict = conclude(records, terms, bench, fit)
    # Now that it is known what is noise: the first guess of it is too low where a log is short.
    places = locate(records, terms, bench.whitener)
    lap("verdict")
    return replace(verdict, seconds=seconds, where=places), bench, fit, terms


def all_candidates(terms: Terms) -> list[Candidate]:
    """Return the catalogue's candidates but for those that are proposed on the way, and those of a user's effects.

    Behind the gears no rotor shows.
    """
    behind_gears = terms.records.model.arm.link_side
    return [
        *(c for c in catalogue_candidates(terms) if not (behind_gears and record_of(c.name).of_rotor)),
        *user_effects.own_candidates(terms),
    ]


def second_bench(
    records: Records, terms: Terms, bench: Bench, fit: HypothesisFit, ordinary: Array
) -> tuple[Terms, Bench]:
    """Return terms and bench of another search, as a first hypothesis has noise and transmitted torque.

    Arguments as of `search_again`.
    """
    there = [bench.candidates[k] for k in fit.members]
    named = {candidate.name for candidate in there}
    dry_names = {name for name in named if record_of(name).dry}
    no_load = {"", *(name for name in named if record_of(name).motor)}
    needed = smooth_fit.at_full_rate(records, contribution_of(records, bench, fit, without=no_load))
    moved = smooth_fit.at_full_rate(records, contribution_of(records, bench, fit, without=no_load | dry_names))
    given = given_load(records)
    terms = with_load(
        terms,
        tuple(g + c for g, c in zip(given, needed, strict=True)),
        tuple(r.passed + c for r, c in zip(records.records, moved, strict=True)),
    )
    dry = stiction.dry_joints(records) | {j for c in there if c.name in dry_names for j in c.joints}
    fresh = all_candidates(terms)
    left = records.residual - contribution_of(records, bench, fit)
    coupled = [(c.joints[0], c.joints[1]) for c in there if record_of(c.name).coupled]
    weights = stiction.moving(records, terms, bench.whitener, dry, stiction.creep(records, terms, left, dry), coupled)
    white = records.white(bench.whitener.order)
    smooth = [c for c in fresh if record_of(c.name).smooth] + there
    quiet = weights * ordinary[bench.whitener.rows].T
    noise = whitening.restricted(records.residual, smooth_fit.columns(records, smooth), bench.whitener, quiet, white)
    friction = contribution_of(records, bench, fit, without=named - dry_names)
    weights = np.maximum(weights, stiction.turning(records, terms, bench.whitener, friction, dry))
    nuisances = [time_delay.timing_nuisance(terms), *reversal_nuisances.nuisances(terms)]
    weights = weights * trusted(records, bench, fit) * ~stiction.unmoved(records)[:, None]
    return terms, Bench(records.residual, noise, fresh, nuisances, weights, terms.torque_size)


def searched_again(
    records: Records, terms: Terms, bench: Bench, fit: HypothesisFit, ordinary: Array, say: Progress
) -> tuple[Terms, Bench, HypothesisFit]:
    """Search again until no gain stands on torque that only an earlier hypothesis had; arguments as of `search_again`.

    The search after that begins without it.
    """
    for _ in range(TUNING.again):
        terms, bench, fit = search_again(records, terms, bench, fit, ordinary, say)
        named = {bench.candidates[k].name for k in fit.members}
        no_load = {"", *(name for name in named if record_of(name).motor)}
        transmitted = terms.reduce(given_load(records)) + contribution_of(records, bench, fit, without=no_load)
        borrowed = borrowing(bench, fit, terms.reduce(terms.load), transmitted)
        if not borrowed:
            break
        fit = possible(bench, bench.solve(fit.members - borrowed))
    return terms, bench, fit


def search_again(
    records: Records,
    terms: Terms,
    bench: Bench,
    fit: HypothesisFit,
    ordinary: Array,
    say: Progress = lambda text: None,
) -> tuple[Terms, Bench, HypothesisFit]:
    """Search once more, with noise and transmitted torque as the first hypothesis has them.

    Args:
        records: prepared.
        terms: of the first search.
        bench: of the first search.
        fit: what it found.
        ordinary: see `whitening.ordinary`.
        say: told what is being done.
    """
    terms, second = second_bench(records, terms, bench, fit, ordinary)
    members: Members = frozenset(second.add(bench.candidates[k]) for k in fit.members)
    asked = suspects(records, terms, second, members)
    knocks = Knocks(terms, second)
    gear_proposals.propose(second, terms, members, asked, knocks)
    polish, propose = polisher(terms), Proposer(terms)
    found = climb(second, members, PRIOR_COSTS.least, TUNING.most, propose, polish)
    other = search(second, PRIOR_COSTS.least, TUNING.most, propose, polish)
    best = found if found.evidence >= other.evidence else other
    late = [j for j in suspects(records, terms, second, best.members) if j not in asked]
    plain = plainer(second, best)
    offered = [
        *gear_proposals.propose(second, terms, best.members, late, knocks),
        *stiction_proposals.propose(second, terms, plain),
    ]
    say("refining what was found")
    if offered:
        starts = dict.fromkeys((best.members, plain.members))
        best = max(
            (climb(second, some, PRIOR_COSTS.least, TUNING.most, propose, polish) for some in starts),
            key=lambda fit: fit.evidence,
        )
    best = refine(second, terms, best)
    say("weighing its rivals")
    best = rivals.refined(second, terms, pruned(second, plainer(second, best)))
    return terms, second, decided(second, terms, pruned(second, plainer(second, best)))


def decided(bench: Bench, terms: Terms, fit: HypothesisFit) -> HypothesisFit:
    """Return the most probable hypothesis, its rivals looked at as closely as itself.

    To be sure of a name, what could stand in its place is worked out; where that is better, it is what is named.
    """
    for _ in range(TUNING.turns):
        look_around(bench, fit)
        best = most_probable(bench, fit)
        if best is fit:
            break
        best = pruned(bench, plainer(bench, refine(bench, terms, best, rounds=1, slow=False)))
        if worth(bench, best, PRIOR_COSTS.least) <= worth(bench, fit, PRIOR_COSTS.least):
            break
        fit = best
    return fit


def trusted(records: Records, bench: Bench, fit: HypothesisFit) -> Array:
    """Return (n, R) weights of whitened samples: where much was named, no law is exact to the noise."""
    white = bench.whitener.all(contribution_of(records, bench, fit))
    width = max(1, round(TUNING.doubt_time * records.rate))
    return np.asarray(1.0 / np.sqrt(1.0 + TUNING.doubt**2 * uniform_filter1d(white**2, width, axis=1)))


def suspects(records: Records, terms: Terms, bench: Bench, members: Members) -> list[int]:
    """Return the joints on which curves of motion, load or time find most structure that a hypothesis leaves.

    A gear that swings or knocks shakes the joints beside it, where it may show more.
    """
    fit = bench.solve(members)
    left = leftover_structure.left_over(records, terms, bench, fit).joints
    found = [int(j) for j in np.argsort(-left)[: TUNING.suspects] if left[j] > TUNING.suspect]
    swung = [
        j for k in sorted(members) if record_of(bench.candidates[k].name).swung for j in bench.candidates[k].joints
    ]
    swung += [j for k in sorted(members) if record_of(bench.candidates[k].name).late for j in uneven(bench, fit, k)]
    beside = [i for j in found[:1] for i in (j + 1, j - 1) if 0 <= i < records.n]
    return list(dict.fromkeys([*found, *swung, *beside]))[: TUNING.suspects]


def uneven(bench: Bench, fit: HypothesisFit, member: int) -> list[int]:
    """Return the joints whose own coefficient of a member of all joints is not that of the others, surest first."""
    left = bench.whitener.all(bench.left(bench.solve(fit.members - {member}))) * bench.weights
    column = bench.columns[member][:, :, 0]
    size = np.sum(column**2, axis=1) / fit.variance + 1e-12
    told = np.sum(column * left, axis=1) / fit.variance
    others = np.sum(size) - size
    apart = np.abs(told / size - (np.sum(told) - told) / others) / np.sqrt(1.0 / size + 1.0 / others)
    return [bench.candidates[member].rows[k] for k in np.argsort(-apart) if apart[k] > TUNING.uneven]


def pruned(bench: Bench, fit: HypothesisFit) -> HypothesisFit:
    """Return the fit without members that do not bring what is asked of them once shapes and noise have settled."""

    def brings(other: HypothesisFit) -> float:
        return worth(bench, other, PRIOR_COSTS.least)

    while fit.members:
        without = max((bench.solve(fit.members - {k}) for k in fit.members), key=brings)
        if not np.isfinite(without.evidence) or brings(fit) >= brings(without):
            return fit
        fit = without
    return fit


def polisher(terms: Terms) -> Polish:
    """Return one round of `refine`."""
    return lambda bench, fit: refine(bench, terms, fit, rounds=1, slow=False)


def contribution_of(records: Records, bench: Bench, fit: HypothesisFit, without: Collection[str] = ()) -> Array:
    """Return (ΣD, n) torque that a fit adds to the given model's, reduced [N·m].

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
