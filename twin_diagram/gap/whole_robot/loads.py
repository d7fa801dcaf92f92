"""Whether a robot carries a payload: what the prior of all its links says of it, not what left-out motion says.

A last link that may be anything explains any payload, on any motion. What tells the two apart is how far from their
descriptions the links would have to be: the evidence, the links' priors in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.payload import carried_always, payload, payload_about
from twin_diagram.gap.candidates.whole_arm import last_body, reach
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.whole_robot.believable import believable
from twin_diagram.gap.whole_robot.load_as_body import as_a_body
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, known_spreads, solve, with_noise
from twin_diagram.gap.whole_robot.unusual import carried, offered, terms_of, with_candidate
from twin_diagram.model.effects.actuation import TorqueConstant
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    worth: float = -1.5
    """Rise of the evidence that a payload must bring [nats]: that mass and centre may be anything costs it some four.
    Where there is none it falls by 3.5 to 17, where there is one it is −6 to 140, below −1.5 on four of 30 arms (seeds
    60000 to 60102 of `sims/benchmarks/gap_whole_robots.py`, each with a payload and before it was put on)."""

    gains: float = 0.03
    """By which motors' torque constants may be off while payload and links are weighed: they lift links, too."""

    rounds: int = 3
    """Times that a payload's centre is looked for, from where it was found before."""

    off: tuple[float, ...] = (0.24, 0.12)
    """Shares of an arm's reach off its tool's frame at which a centre is looked for where at that frame there is none:
    two thirds and one third of how far it may be."""

    zeros: float = 0.05
    """Share of the largest force that a joint which slides logs by which its offset may be while a payload is weighed,
    one standard deviation: what a sensor's zero, a cable or a hose do. One that may be anything holds all that a load
    weighs on a gantry's or a SCARA's upright axis. Where joints turn, a load differs with the pose; a counterbalance's
    level there is far more (5.3 instead of 1.1 N·m of a KR300's second joint were left)."""

    nearer: float = 1.0
    """Rise of the evidence that a centre which is found by a loose last link must bring [nats]."""

    solid: float = 5.0
    """Fall of it up to which a payload with a moment of inertia of its own stays: that is a number more."""

    spreads: tuple[float, ...] = (0.0125, 0.025, 0.05, 0.1, 0.15)
    """Of links about their description, from which the evidence chooses: at the last, masses are off by 30 % as a rule.

    Links that may be further off than that would be any payload, on any motion.
    """

    usual: float = 0.06
    """What they are as a rule: masses, centres and moments off by some 3 to 30 %."""

    factor: float = 2.0
    """By which this differs from arm to arm, one standard deviation."""


TUNING = Tuning()


def loaded(whole: RobotProblem, start: Array) -> RobotProblem | None:
    """Return the problem with a payload in the last link's place; None where it is not worth looking at.

    Args:
        whole: everything usual free, with its noise.
        start: its coordinates (Z,).
    """
    whole, terms = replace(whole, zeros=TUNING.zeros), terms_of(whole.sums, whole.sums.records.model)
    candidate, last = centred(whole, start, terms) or payload(terms), last_body(terms)
    rise, spread = rise_with(whole, start, candidate, whole.sums.further)
    body = as_a_body(whole, start, terms)
    if body is not None:
        more, near = rise_with(whole, start, body, whole.sums.further)
        # Beside a last link that is free, evidence tells no point from a solid.
        if more > rise + (-TUNING.solid if body.variant else TUNING.nearer):
            candidate, rise, spread = body, more, near
    if rise < TUNING.worth:
        return None
    load = replace(with_candidate(whole, candidate, last), spread=spread)
    # Links that may be further off than that would take the payload over again.
    nearer = tuple(one for one in whole.spreads if one <= spread)
    load = replace(load, spreads=nearer or (spread,))
    return load if believable(load) else None


def centred(whole: RobotProblem, start: Array, terms: Terms) -> Candidate | None:
    """Return a payload about the centre that it is found at; None where it is found nowhere.

    A mass without inertia, as it is looked for at first, is none where a load off the tool has much: all that motion
    and gravity tell of it then is its first moment, mass times centre. Along that it is looked for again, off the tool.

    Args:
        whole: everything usual free, with its noise.
        start: its coordinates (Z,).
        terms: of the same samples.
    """
    near = replace(whole, spread=TUNING.usual if whole.told is None else max(whole.spreads))
    first, moment, settles = _about_where_it_is(near, start, terms, payload(terms))
    size = float(np.linalg.norm(moment))
    for share in TUNING.off if size > 0.0 and not settles else ():
        off = payload_about(terms, share * reach(terms) * moment / size)
        found, _, settles = _about_where_it_is(near, start, terms, off)
        if settles:
            return found
    return first


def _about_where_it_is(
    near: RobotProblem, start: Array, terms: Terms, candidate: Candidate
) -> tuple[Candidate | None, Array, bool]:
    """Return a payload about the centre that it has, looked for in turns; None where it cannot be.

    Also its first moment (3,) [kg·m] as it was found last, and whether it could be in all turns.
    """
    last = last_body(terms)
    found: Candidate | None = None
    for _ in range(TUNING.rounds):  # beside a last link as it is described, or that takes the centre over
        beside = with_candidate(near, candidate, last)
        z = solve(beside, None, carried(near, start, beside))
        own = z[beside.place(len(beside.sums.further) - 1)]
        if not own[0] > 0.0 or not candidate.allows(own):
            return found, own[1:], False
        candidate = found = payload_about(terms, own[1:] / own[0])  # off its link's origin, a mass has inertia, too
    return found, own[1:], True


def needed(problem: RobotProblem, others: Sequence[Candidate]) -> float:
    """Return by how much evidence rises with a problem's payload, beside all else that there may be [nats].

    Args:
        problem: with a payload.
        others: what is there in an explanation without one.
    """
    there = {candidate.place: candidate for candidate in (*others, *problem.sums.further)}
    (load,) = [candidate for candidate in there.values() if carried_always(candidate)]
    rest = [candidate for candidate in there.values() if candidate is not load]
    return rise_with(problem, solve(problem), load, rest)[0]


def rise_with(problem: RobotProblem, start: Array, load: Candidate, rest: Sequence[Candidate]) -> tuple[float, float]:
    """Return by how much evidence rises with a payload [nats], and the spread of links that it is likeliest at.

    Motors' torque constants may be off meanwhile: where links would have to stand in for them, too, nothing could be
    told from links.

    Args:
        problem: with or without it.
        start: its coordinates (Z,).
        load: the payload.
        rest: what else is there beside it.
    """
    terms = terms_of(problem.sums, problem.sums.records.model)
    told = {candidate.place for candidate in rest}
    gains = [c for c in offered(terms, (TorqueConstant.name,)) if c.place not in told]
    rest = [*rest, *(replace(c, spread=np.full_like(c.spread, TUNING.gains)) for c in gains)]
    problem = replace(problem, zeros=TUNING.zeros)
    without, both = (replace(problem, sums=problem.sums.with_further(some)) for some in (rest, [*rest, load]))
    noise = with_noise(both, solve(both, None, carried(problem, start, both)))
    likely, spread = evidence(both, noise)
    return likely - evidence(without, noise)[0], spread


def evidence(problem: RobotProblem, noise: RobotProblem) -> tuple[float, float]:
    """Return how likely fit logs are with all links and own terms free, priors counted [nats]; and the links' spread.

    That is the one that makes the logs likeliest.

    Args:
        problem: with what is there beside them.
        noise: whose variance and colour count.
    """
    every = replace(problem, links_free=problem.links.heavy, own_free=noise.own_free, gone=np.zeros_like(noise.gone))
    every = replace(every, variance=noise.variance, share=noise.share)
    best, z = (-np.inf, TUNING.usual), None
    for spread in known_spreads(problem.told) if problem.known else TUNING.spreads:
        tried = replace(every, spread=spread)
        z = solve(tried, None, z)
        some = np.flatnonzero(tried.free)
        H, _ = tried.system(z, tried.sums.whole)
        scale = tried.deviation[some]
        _, size = np.linalg.slogdet(H[np.ix_(some, some)] * np.outer(scale, scale))
        if tried.told is not None:  # a prior that hangs together is narrower than its diagonal
            _, prior = np.linalg.slogdet(tried.precision[np.ix_(some, some)] * np.outer(scale, scale))
            size -= prior
        rare = 0.5 * (np.log(spread / TUNING.usual) / np.log(TUNING.factor)) ** 2 if tried.told is None else 0.0
        best = max(best, (-tried.cost(z, tried.sums.whole) - 0.5 * float(size) - float(rare), spread))
    return best
