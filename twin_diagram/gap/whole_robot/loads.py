"""Whether a robot carries a payload: what the prior of all its links says of it, not what left-out motion says.

A last link that may be anything explains any payload, on any motion. What tells the two apart is how far from their
descriptions the links would have to be: the evidence, the links' priors in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.payload import payload, payload_about
from twin_diagram.gap.candidates.whole_arm import last_body
from twin_diagram.gap.whole_robot.physical_fit import TUNING as PHYSICAL_FIT
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.unusual import believable, carried, terms_of, with_candidate
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    worth: float = 1.0
    """Rise of the evidence that a payload must bring [nats]. Where there is none it falls by 3.7 to 16, where there is
    one it rises by 1.6 to 25 (`sims/benchmarks/gap_whole_robots.py`, seeds 60000 to 60048)."""

    rounds: int = 3
    """Times that a payload's centre is looked for, from where it was found before."""

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
    terms = terms_of(whole.sums, whole.sums.records.model)
    candidate = payload(terms)
    last = last_body(terms)
    near = replace(whole, spread=TUNING.usual)
    for _ in range(TUNING.rounds):  # beside a last link as it is described, or that takes the centre over
        beside = with_candidate(near, candidate, last)
        z = solve(beside, None, carried(near, start, beside))
        own = z[beside.place(len(beside.sums.further) - 1)]
        if not own[0] > 0.0 or not candidate.allows(own):
            break
        candidate = payload_about(terms, own[1:] / own[0])  # off its link's origin, a mass has inertia, too
    beside = replace(whole, sums=whole.sums.with_further([*whole.sums.further, candidate]))
    z = solve(beside, None, carried(whole, start, beside))
    noise = with_noise(beside, z)
    likely, spread = evidence(beside, noise)
    if likely - evidence(whole, noise)[0] < TUNING.worth:
        return None
    load = replace(with_candidate(whole, candidate, last), spread=spread)
    # Links that may be further off than that would take the payload over again.
    nearer = tuple(one for one in whole.spreads if one <= max(spread, min(whole.spreads)))
    load = replace(load, spreads=nearer)
    return load if believable(load) else None


def needed(problem: RobotProblem, others: Sequence[Candidate]) -> float:
    """Return by how much evidence rises with a problem's payload, beside all else that there may be [nats].

    Args:
        problem: with a payload.
        others: what is there in an explanation without one.
    """
    there = {candidate.place: candidate for candidate in (*others, *problem.sums.further)}
    rest = [candidate for candidate in there.values() if candidate.name != Payload.name]
    both = replace(problem, sums=problem.sums.with_further(list(there.values())))
    noise = with_noise(both, solve(both))
    return evidence(both, noise)[0] - evidence(replace(both, sums=problem.sums.with_further(rest)), noise)[0]


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
    for spread in problem.spreads if problem.spreads == PHYSICAL_FIT.known else TUNING.spreads:
        tried = replace(every, spread=spread)
        z = solve(tried, None, z)
        some = np.flatnonzero(tried.free)
        H, _ = tried.system(z, tried.sums.whole)
        scale = tried.deviation[some]
        _, size = np.linalg.slogdet(H[np.ix_(some, some)] * np.outer(scale, scale))
        rare = 0.5 * (np.log(spread / TUNING.usual) / np.log(TUNING.factor)) ** 2
        best = max(best, (-tried.cost(z, tried.sums.whole) - 0.5 * float(size) - float(rare), spread))
    return best
