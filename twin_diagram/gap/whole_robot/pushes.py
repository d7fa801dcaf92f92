"""Pushes from outside that a whole robot may have felt: link, wrench and span of time, from what its fit leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, Span
from twin_diagram.gap.candidates.external_force import TUNING as EXTERNAL
from twin_diagram.gap.candidates.external_force import external_forces, force_at, near, placed, turned, with_its_point
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.events import TUNING as EVENTS
from twin_diagram.gap.whole_robot.events import SpansBeside, Tried, during, likeliest_spans, spanned
from twin_diagram.gap.whole_robot.held_by_friction import mostly_resting, shares_of_friction, without_held
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.rough_friction import rough_friction
from twin_diagram.gap.whole_robot.setting_off import with_the_log
from twin_diagram.gap.whole_robot.sharp_moments import sharpened
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    shortest: float = 0.4
    """That a push lasts [s]: what a fit leaves hangs together about as long wherever motion is hard, and what is over
    sooner has little more in it than a wrench has coefficients."""

    worth: float = 10.0
    """Rise of the log likelihood, less what coefficients cost, from which on a push is looked at [nats]."""

    alike: float = 2.0
    """A push on an inner link suffices where it explains as much, but for this [nats]."""

    rather: float = 0.8
    """Share of what the best push explains from which on one whose wrench the motion tells is taken for it: the best
    would have no name."""

    alone: float = 4.0
    """By how much more than others a push must explain that drives one joint alone [nats]: that is rather the joint's
    own doing."""

    held: float = 3.2
    """Times a joint's dry friction by which what holds it may change while it rests: from one direction to the other,
    and before it slides it is up to 1.6 times what it is then."""

    drifts: float = 0.1
    """The same by which friction changes as joints warm, or with the angle: what brings no joint more is no push."""

    point: float = 6.0
    """What a force's point on a link costs [nats]: two numbers, each as dear as a moment."""

    rounds: int = 2
    """Times that the span is looked for: with the noise that is left without, then with that beside the best one."""


TUNING = Tuning()


def pushes(problem: RobotProblem, z: Array, terms: Terms) -> list[Candidate]:
    """Return the push, over the span of time that suits it best, on the innermost link that suffices; or none.

    Forces at links' origins are tried, and wrenches. A push is an event, so the fit of all motion judges it, also
    one in which friction is only roughly its law's.

    Args:
        problem: of what is there beside it.
        z: (Z,) its coordinates.
        terms: of the same samples.
    """
    wrenches = external_forces(terms)
    # A push alone lets the joints that it drives hang together over all of its span.
    quiet = replace(problem, share=np.maximum(problem.share, np.median(problem.share)))
    for _ in range(TUNING.rounds):
        found = likeliest_spans(SpansBeside.of(quiet, solve(quiet, None, z)), wrenches)
        if not found:
            return []
        tried = [Tried.of(problem, z, spanned(terms, *one[1:])) for one in found]
        best, (_, wrench, _, _) = max(zip(tried, found, strict=True), key=lambda both: both[0].score)
        quiet = replace(problem, variance=best.variance, share=best.share)
    if (
        brief(best.candidate)
        or with_the_log(best.candidate, problem.sums.records)
        or np.all(shares_of_friction(problem, z, best.candidate) < TUNING.drifts)
    ):
        return []
    problem, z = while_sliding(problem, z, terms, best.candidate)
    best = Tried.of(problem, z, best.candidate)
    if best.score < TUNING.worth or beside_rough_friction(problem, z, best) < TUNING.worth:
        return []
    span = best.candidate.onset, best.candidate.end
    span = sharpened(problem, z, terms, span, lambda *moments: during(terms, wrench, *moments))
    return [on_the_innermost(problem, z, terms, during(terms, wrench, *span))]


def brief(push: Candidate) -> bool:
    """Return whether what suits a push best is over too soon to be told from a burst of what any fit leaves."""
    return push.onset is not None and push.end is not None and push.end[1] - push.onset[1] < TUNING.shortest


def while_sliding(problem: RobotProblem, z: Array, terms: Terms, push: Candidate) -> tuple[RobotProblem, Array]:
    """Return the problem without samples at which dry friction can hold what a push brings to a joint, and its fit.

    A joint that mostly rests hardly tells how much its friction can hold: its rests say nothing, whatever was found.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        push: as it was found.
    """
    shares, rests = shares_of_friction(problem, z, push), mostly_resting(problem, terms)
    held = [j for j, share in zip(push.rows, shares, strict=True) if share < TUNING.held or rests[j]]
    return without_held(problem, z, terms, held)


def beside_rough_friction(problem: RobotProblem, z: Array, push: Tried) -> float:
    """Return a push's score where the joints that it explains may have rough friction [nats], see `rough_friction`.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        push: as it was found.
    """
    joints = np.flatnonzero(push.rises > EVENTS.force)
    rough = rough_friction(problem, z, [int(j) for j in joints])
    beside = replace(problem, sums=problem.sums.with_further([*problem.sums.further, *rough]))
    start = np.concatenate([z, np.zeros(sum(one.size for one in rough))])
    beside = with_noise(beside, solve(beside, None, start))
    return Tried.of(beside, solve(beside, None, start), push.candidate).score


def on_the_innermost(problem: RobotProblem, z: Array, terms: Terms, push: Candidate) -> Candidate:
    """Return a push over the same span of time on the innermost link that suffices.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        push: as it was found.
    """
    span = push.onset, push.end
    wrenches = external_forces(terms)
    tried = [Tried.of(problem, z, during(terms, wrench, *span)) for wrench in wrenches]
    plain = _innermost(tried)
    points = [_at_its_point(problem, z, terms, wrench, span) for wrench in wrenches if wrench.size == 6]
    there = [one for one in points if one is not None and one.told]
    if not there or max(one.score for one in there) <= max(one.score for one in tried) + TUNING.alike:
        return plain.candidate
    return _innermost(there).candidate


def _at_its_point(problem: RobotProblem, z: Array, terms: Terms, wrench: Candidate, span: Span) -> Tried | None:
    """Return a force over a span at the point of a link that suits it best; None where that is not near the link.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        terms: of the same samples.
        wrench: at the link's origin, always.
        span: when it acts.
    """
    R_WL, far = turned(terms, terms.records.model.tree.link.index(wrench.links[0])), near(terms)
    at, force = np.zeros(3), np.zeros(3)
    for _ in range(EXTERNAL.steps):
        both = during(terms, with_its_point(wrench, R_WL, at, force, far), *span)
        beside = replace(problem, sums=problem.sums.with_further([*problem.sums.further, both]))
        fitted = solve(beside, None, np.concatenate([z, np.zeros(6)]))
        force, step = np.split(fitted[-6:], 2)
        at = at + step
        if np.linalg.norm(at) > far:
            return None
    errors = np.sqrt(np.diag(estimates.covariance(with_noise(beside, fitted), fitted))[-6:])
    made = placed(during(terms, force_at(wrench, R_WL, at), *span), errors)
    one = Tried.of(problem, z, replace(made, cost=made.cost + TUNING.point))
    return replace(one, score=one.score - TUNING.point)


def _innermost(tried: Sequence[Tried]) -> Tried:
    """Return the push on the innermost link that explains as much as any, but for little; inner links come first."""
    top = max(one.score for one in tried)
    told = [one for one in tried if one.told and one.score > TUNING.rather * top]
    if told:
        tried, top = told, max(one.score for one in told)
    several = [one for one in tried if one.joints > 1]
    if several and max(one.score for one in several) > top - TUNING.alone:
        tried, top = several, max(one.score for one in several)
    return next(one for one in tried if one.score >= top - TUNING.alike)
