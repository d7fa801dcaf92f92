"""Whether what is unusual is told beside everything usual: links, gains, joints' terms, a load, rough friction.

While only some links and terms are free, what the others do passes for something that acts for a while; so does a
payload, while it may not be there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.payload import payload
from twin_diagram.gap.candidates.records import RECORDS
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.rough_friction import rough_friction
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.model.effects.actuation import TimeDelay, TorqueConstant
from twin_diagram.model.effects.environment import GravityTilt
from twin_diagram.signals.arrays import Array

EVIDENT = (GravityTilt.name, TimeDelay.name)
"""Which evidence beside everything usual decides on, not left-out motion: see `evident`."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    gains: float = 0.03
    """By which motors' torque constants may be off, one standard deviation."""

    evident: float = 8.0
    """What a tilt or a delay must bring beside everything usual [nats]. It brought 8.7 to 208 on 16 of 30 arms of
    which each had one, up to 4.8 where the other was there, and up to 1.9 on 16 that had neither (seeds 60200 to 60277
    of `sims/benchmarks/gap_whole_robots.py --quick`, the 30 each with such a thing)."""


TUNING = Tuning()


def rise_beside_the_usual(problem: RobotProblem, z: Array, candidate: Candidate) -> float:
    """Return by how much a candidate makes the logs likelier where everything usual is off as far as it may [nats].

    Both fits are drawn to the description by the same priors, and judged by the noise that is left with the candidate.

    Args:
        problem: without the candidate, or with it.
        z: (Z,) its coordinates.
        candidate: what is judged.
    """
    without = everything_usual(problem, z, candidate)
    beside = replace(without, sums=problem.sums.with_further([*without.sums.further, candidate]))
    before = solve(without, None, np.concatenate([z[: 14 * problem.n], np.zeros(_coefficients(without))]))
    after = solve(beside, None, np.concatenate([before, np.zeros(candidate.size)]))
    before = solve(without, None, after[: -candidate.size])  # or what is only nearer its best fit would be a rise
    noise = with_noise(beside, after)
    share = np.maximum(noise.share, problem.share)
    costs = []
    for one, start in ((without, before), (beside, after)):
        judged = replace(one, variance=noise.variance, share=share)
        costs.append(judged.cost(solve(judged, None, start), one.sums.whole))
    return float(costs[0] - costs[1])


def offset_evidence(problem: RobotProblem, z: Array) -> Array:
    """Return (n,) how much likelier joints' offsets are than none, where links and gains are off as they may [nats].

    What gravity makes of those passes for an offset, and left-out motion weighs as much as any. An offset's spread is
    taken to be the likeliest: at t standard errors evidence rises by (t² − 1) / 2 − ln t.

    Args:
        problem: with what was found.
        z: (Z,) its coordinates.
    """
    told = {c.place for c in problem.sums.further}
    rest = [c for c in gains(problem) if c.place not in told]
    every = replace(all_usual(problem), sums=problem.sums.with_further([*problem.sums.further, *rest]))
    fitted = solve(every, None, np.concatenate([z, np.zeros(sum(c.size for c in rest))]))
    every = with_noise(every, fitted)
    fitted = solve(every, None, fitted)
    places = 10 * problem.n + len(OWN) * np.arange(problem.n) + OWN.index("bias")
    errors = np.sqrt(np.diag(estimates.covariance(every, fitted))[places])
    t = np.maximum(np.abs(fitted[places]) / np.maximum(errors, 1e-300), 1.0)
    return np.asarray(0.5 * (t**2 - 1.0) - np.log(t))


def everything_usual(problem: RobotProblem, z: Array, but: Candidate) -> RobotProblem:
    """Return the problem with all that any robot may lack, and what else is in it, but for one candidate.

    Args:
        problem: any.
        z: (Z,) its coordinates.
        but: which is not in it.
    """
    every = all_usual(problem)
    further = [c for c in problem.sums.further if c.place != but.place]
    told = {c.place for c in further} | {but.place}
    further += [c for c in (payload(_terms(problem)), *gains(problem)) if c.place not in told]
    return replace(every, sums=problem.sums.with_further([*further, *rough_friction(every, z, range(problem.n))]))


def gains(problem: RobotProblem) -> list[Candidate]:
    """Return motors' torque constants, which may be off by as much as they usually are."""
    on_joints = RECORDS[TorqueConstant.name].on_joints
    there = [] if on_joints is None else [c for each in on_joints(_terms(problem)) for c in each]
    return [replace(c, spread=np.full_like(c.spread, TUNING.gains)) for c in there]


def _coefficients(problem: RobotProblem) -> int:
    """Return how many coefficients further candidates have."""
    return sum(candidate.size for candidate in problem.sums.further)


def _terms(problem: RobotProblem) -> Terms:
    records = problem.sums.records
    return Terms(records, given_load(records), slow_speed(records))


def all_usual(problem: RobotProblem) -> RobotProblem:
    """Return the problem with all links and joints' own terms free; behind the gears no rotor shows."""
    own = np.ones((problem.n, len(OWN)), dtype=bool)
    own[:, OWN.index("rotor")] = not problem.sums.records.model.arm.link_side
    return replace(problem, links_free=problem.links.heavy, own_free=own)
