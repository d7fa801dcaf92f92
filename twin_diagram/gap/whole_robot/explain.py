"""What a whole robot lacks at once, found on its fit logs alone: model, findings, and how much they close.

from twin_diagram.gap.whole_robot.explain import explain
found = explain(records)
found.model, found.findings, found.left      # None: left-out motion earns nothing a place
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.payload import carried_always
from twin_diagram.gap.experiments.advice import experiment
from twin_diagram.gap.findings import Finding, Separation
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.regressors import present
from twin_diagram.gap.whole_robot.all_links import with_all_links
from twin_diagram.gap.whole_robot.colour_of_noise import between, whitened
from twin_diagram.gap.whole_robot.concluding import WholeRobot, concluded, last_of, own_terms, well_known
from twin_diagram.gap.whole_robot.dry_shapes import shaped
from twin_diagram.gap.whole_robot.edges_of_events import without_edges
from twin_diagram.gap.whole_robot.evident import evident
from twin_diagram.gap.whole_robot.left_out import TUNING as LEFT_OUT
from twin_diagram.gap.whole_robot.left_out import (
    LeftOut,
    best_spread,
    earning,
    free_units,
    likelihood,
    missed,
)
from twin_diagram.gap.whole_robot.loads import TUNING as LOADS
from twin_diagram.gap.whole_robot.loads import loaded, needed
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, known_spreads, solve, with_noise
from twin_diagram.gap.whole_robot.physical_links import Links
from twin_diagram.gap.whole_robot.stated_rotors import drawn_to_stated
from twin_diagram.gap.whole_robot.torque_equations import OWN, TorqueEquations, equations
from twin_diagram.gap.whole_robot.unusual import least, price, room_for, unusual
from twin_diagram.gap.whole_robot.which_motor import in_doubt
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.model.effects.link_inertia import InertialParameters
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    spread: float = 0.2
    """Of links, at first."""

    share: float = 0.05
    """Of a sample that is independent, at first."""

    settle: int = 20
    """Times that fit and noise take turns at most: where a description is far off, each turn quiets some joints."""

    settled: float = 0.02
    """Share by which no joint's noise, nor what of it is independent, changes any more."""

    turns: int = 2
    """Times that what is unusual and what is usual take turns."""

    each: float = 1.0
    """Rise of the left-out log likelihood that each of many must bring beyond a few [nats]."""


TUNING = Tuning()


def explain(records: Records, *, known: bool = False, told: Array | None = None) -> WholeRobot | None:
    """Fit all links and joints at once, and keep what left-out motion asks for; None where that is nothing.

    What is unusual is looked for beside what every arm lacks, once what does not matter is gone and once before that.
    Left-out motion says which it is, and of two that are as good the one that says less. A payload is decided on by
    the links' priors: on left-out motion, links stand in for any.

    Args:
        records: prepared with the given model.
        known: whether that was corrected before: links are then as they were, and all names are looked for first.
        told: covariance that they were then found with, if known, see `RobotProblem`.
    """
    whole = begun(records, equations(records))
    if known:
        spreads, links = known_spreads(told), 10 * records.n
        found_so = None if told is None else told[:links, :links]
        whole = replace(whole, spread=max(spreads), spreads=spreads, told=found_so, known=True)
    bare, first = shaped(*drawn_to_stated(*settled(whole)))
    whole, start = evident(bare, first)
    plain = best_of(whole, start, known)
    if whole.sums.further:
        plain = rather(plain, best_of(bare, first, known), whole)
    load = loaded(whole, start)
    carried = None if load is None else best_of(*settled(load), known)
    found = better(plain, carried, whole)
    if found is not None and told is not None and len(told) > 10 * records.n:
        found = beside_what_was_found(found, whole, told)
    found = None if found is None else beside_its_events(found, whole)
    found = None if found is None else well_known(found)
    return None if found is None else in_doubt(with_all_links(found))


def rather(plain: WholeRobot | None, other: WholeRobot | None, whole: RobotProblem) -> WholeRobot | None:
    """Return the better of two explanations, of which the other one need hold what is evident.

    Which links and joints' terms are chosen, and then what is unusual, depends on what comes first.

    Args:
        plain: that began with what is evident.
        other: that began without.
        whole: with what is evident, and everything usual free.
    """
    if plain is None or other is None:
        return plain
    there = {candidate.name for candidate in other.problem.sums.further}
    if not {candidate.name for candidate in whole.sums.further} <= there:
        return plain
    judge = quieter(whole, [plain, other])
    return max(plain, other, key=lambda one: worth(one, judge))


def better(plain: WholeRobot | None, carried: WholeRobot | None, whole: RobotProblem) -> WholeRobot | None:
    """Return the better explanation of one without and one with a payload.

    Args:
        plain: without.
        carried: with one, as far as there still is one in it.
        whole: with everything usual free.
    """
    if carried is None or plain is None:
        return plain or carried
    judge = quieter(whole, [plain, carried])
    if not has_load(carried):  # what was found beside it may yet be better
        return max(plain, carried, key=lambda one: worth(one, judge))
    rise = needed(carried.problem, plain.problem.sums.further)
    if rise < LOADS.worth:
        return plain
    carried = as_sure(carried, rise)
    return replace(carried, separation=nearest([carried, plain], judge))


def beside_what_was_found(found: WholeRobot, whole: RobotProblem, told: Array) -> WholeRobot:
    """Return the better of an explanation without a payload and one with it, rotors and offsets being as they were.

    An offset lifts what a load weighs: on short motion one that may be anything makes a load's mass unsure, and stands
    for it beside a last link that is heavier. A payload is the better one where it says no more, and left-out motion is
    no less likely.

    Args:
        found: with offsets that may be anything.
        whole: with everything usual free.
        told: (14 n, 14 n) covariance that links and joints' own terms were found with before.
    """
    if has_load(found):
        return found
    near = replace(whole, told=told)
    load = loaded(near, solve(near))
    carried = None if load is None else best_of(*settled(load), True)
    if carried is None or not has_load(carried):
        return found
    judge = quieter(whole, [found, carried])
    rise = float(np.sum(likelihood(judge, carried.left) - likelihood(judge, found.left)))
    return as_sure(carried, LOADS.worth + rise) if rise > 0.0 and carried.terms() <= found.terms() else found


def beside_its_events(found: WholeRobot, whole: RobotProblem) -> WholeRobot:
    """Return what was found with what is usual chosen anew, where a push neither comes nor goes.

    Which push there is was decided on all samples: leaving some out speaks for none.

    Args:
        found: with a push, or without, which stays.
        whole: with everything usual free.
    """
    problem = without_edges(found.problem)
    if problem is None:
        return found
    links, own = room_for(problem.sums, last_of(whole))
    every = replace(problem, links_free=whole.links_free & links, own_free=whole.own_free & own, gone=whole.gone)
    every, _ = settled(every)
    more = concluded(weeded(every, every))
    return more if more is not None and named(found) <= named(more) else found


def has_load(found: WholeRobot) -> bool:
    """Return whether there is a payload that is there all the time."""
    return any(carried_always(candidate) for candidate in found.problem.sums.further)


def is_load(finding: Finding) -> bool:
    """Return whether a finding is a payload that is there all the time."""
    return finding.name == Payload.name and finding.onset is None and finding.end is None


def named(found: WholeRobot) -> set[str]:
    """Return the names of what is unusual."""
    return {candidate.name for candidate in found.problem.sums.further} & {one.name for one in found.findings}


def as_sure(found: WholeRobot, rise: float) -> WholeRobot:
    """Return what was found with a payload that is as sure as the evidence for it.

    Args:
        found: with a payload.
        rise: of the evidence that it brings [nats].
    """
    sure = float(1.0 / (1.0 + np.exp(-min(rise - LOADS.worth, 30.0))))
    findings = [replace(one, confidence=sure) if is_load(one) else one for one in found.findings]
    return replace(found, findings=tuple(findings))


def best_of(whole: RobotProblem, start: Array, known: bool) -> WholeRobot | None:
    """Return the best explanation in which there is a payload, or there is none.

    Args:
        whole: with everything usual free.
        start: its fit (Z,).
        known: whether links are rather as they were, see `explain`.
    """
    usual = chosen(whole, start)
    found = [grown(concluded(usual), whole)] if np.any(usual.free) else []
    if known:
        nothing = np.zeros(whole.n, dtype=bool)
        bare = replace(whole, links_free=nothing, own_free=np.zeros_like(whole.own_free))
        strange = unusual(bare, solve(bare), whole.sums.records.model)
        if strange.sums.further:
            found.append(grown(concluded(settled_beside(strange, whole)), whole))
    # Of a joint that something unusual drives, nothing usual earns its place as long as that has no name.
    beside = unusual(whole, start, whole.sums.records.model)
    if beside.sums.further != whole.sums.further:
        beside, _ = settled(beside)
        found.append(grown(concluded(weeded(beside, beside)), whole))
    there = [one for one in found if one is not None]
    return max(there, key=lambda one: worth(one, quieter(whole, there)), default=None)


def quieter(whole: RobotProblem, found: Sequence[WholeRobot]) -> RobotProblem:
    """Return a problem with the noise that explanations are judged by.

    What one of them explains is no noise, or a joint that the others leave coloured would count too little.
    """
    for one in found:
        brief = [c for c in one.problem.sums.further if c.passing]
        noise = with_noise(one.problem, one.coordinates)
        whole = whitened(whole, noise, brief[0]) if brief else between(whole, noise)
    return whole


def nearest(told: Sequence[WholeRobot], whole: RobotProblem) -> tuple[Separation, ...]:
    """Return how far an explanation with a payload is from one in which links stand in for it, or the other way round.

    Args:
        told: the better one, and its rival, if there is one.
        whole: whose noise counts for both.
    """
    if len(told) < 2:
        return ()
    loads = [[f"{f.name} on {f.links[0]}" for f in one.findings if is_load(f)] for one in told]
    if bool(loads[0]) == bool(loads[1]):
        return ()
    links = [
        f"{f.name} on {', '.join(f.links)}" for f in told[bool(loads[0])].findings if f.name == InertialParameters.name
    ]
    if not links:
        return ()
    likelier = float(np.sum(likelihood(whole, told[0].left) - likelihood(whole, told[1].left)))
    pair = (loads[0][0], links[0]) if loads[0] else (links[0], loads[1][0])
    names = (Payload.name, InertialParameters.name)
    return (Separation(*pair, float(np.sqrt(2.0 * max(likelier, 0.0))), experiment(*names)),)


def grown(found: WholeRobot | None, whole: RobotProblem) -> WholeRobot | None:
    """Return what was found with what is unusual beside it, as long as there is more."""
    for _ in range(TUNING.turns):
        if found is None:
            break
        more = unusual(found.problem, found.coordinates, found.model)
        if more.sums.further == found.problem.sums.further:
            break
        found = concluded(settled_beside(more, whole)) or found
    return found


def worth(found: WholeRobot, whole: RobotProblem) -> float:
    """Return the left-out log likelihood less what is asked of all that is said [nats].

    Args:
        found: one of several explanations.
        whole: whose noise counts for all of them.
    """
    problem = found.problem
    asked = LEFT_OUT.link * np.sum(problem.links_free) + LEFT_OUT.own * np.sum(problem.said)
    asked += sum(least(candidate) + price(candidate) for candidate in problem.sums.further)
    return float(np.sum(likelihood(whole, found.left)) - asked)


def settled_beside(problem: RobotProblem, whole: RobotProblem) -> RobotProblem:
    """Return the problem with what links and joints' own terms are missed beside what is unusual.

    Args:
        problem: with it.
        whole: of everything usual.
    """
    z = solve(problem)
    problem = with_noise(problem, z)
    links, own = room_for(problem.sums, last_of(whole))
    every = replace(problem, links_free=whole.links_free & links, own_free=whole.own_free & own)
    problem, left_out = missed(problem, every, z)
    return earning(problem, left_out)


def chosen(whole: RobotProblem, start: Array) -> RobotProblem:
    """Return the problem with the links and joints' terms that earn their place.

    Where few links are off, they come one by one: together, each would stand in for the others. Where all are, one
    alone stands in for all, and what does not matter goes one by one. Left-out motion says which it is.
    What everything together leaves is the noise: were it looked at again, a joint that fits badly would count less.

    Args:
        whole: everything free, with its noise.
        start: its fit (Z,).
    """
    bare = replace(whole, links_free=np.zeros(whole.n, dtype=bool))
    few, many = weeded(missed(bare, whole, solve(bare))[0], whole), weeded(whole, whole)
    more = int(np.sum(free_units(many))) - int(np.sum(free_units(few)))
    scores = [LeftOut.of(x, start).score() for x in (few, many)]
    return many if scores[1] - scores[0] > TUNING.each * max(1, more) else few


def weeded(problem: RobotProblem, whole: RobotProblem) -> RobotProblem:
    """Return the problem with the spread that left-out motion likes best, and without what does not earn its place."""
    problem, left_out = best_spread(problem, solve(problem))
    problem = earning(problem, left_out)
    return missed(problem, whole, solve(problem))[0]


def begun(records: Records, sums: TorqueEquations) -> RobotProblem:
    """Return the problem with everything free."""
    there = present(records)
    least = -np.stack([there.damping, there.coulomb, np.full(records.n, np.inf), there.rotor], axis=1)
    links = Links.of(records.model)
    return RobotProblem(
        sums=sums,
        links=links,
        least=least,
        spread=TUNING.spread,
        variance=np.maximum(sums.residual_rms**2, 1e-18),
        share=np.full(records.n, TUNING.share),
        links_free=links.heavy,
        gone=np.zeros((records.n, len(OWN)), dtype=bool),
        own_free=own_terms(records),
    )


def settled(problem: RobotProblem, z: Array | None = None) -> tuple[RobotProblem, Array]:
    """Return the problem with the noise that its own fit leaves, and that fit."""
    for _ in range(TUNING.settle):
        z, before = solve(problem, None, z), problem
        problem = with_noise(before, z)
        noise, last = ([one.variance, one.share] for one in (problem, before))
        if np.allclose(noise, last, rtol=TUNING.settled, atol=0.0):
            break
    return problem, solve(problem, None, z)
