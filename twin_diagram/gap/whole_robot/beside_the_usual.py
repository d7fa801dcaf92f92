"""Whether an event is told beside everything usual: links that are off, joints' terms, a load, friction that is rough.

While only some links and terms are free, what the others do passes for something that acts for a while; so does a
payload, while it may not be there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.payload import payload
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.rough_friction import rough_friction
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.signals.arrays import Array


def rise_beside_the_usual(problem: RobotProblem, z: Array, event: Candidate) -> float:
    """Return by how much an event makes the logs likelier where everything usual may be off as far as it may [nats].

    Both fits are drawn to the description by the same priors, and judged by the noise that is left with the event.

    Args:
        problem: without the event.
        z: (Z,) its coordinates.
        event: what is judged.
    """
    every = all_usual(problem)
    further = [c for c in problem.sums.further if c.place != event.place]
    further += [load for load in [load_of(problem)] if load.name not in [c.name for c in further]]
    further += rough_friction(every, z, range(problem.n))
    without = replace(every, sums=problem.sums.with_further(further))
    beside = replace(every, sums=problem.sums.with_further([*further, event]))
    start = np.concatenate([z[: 14 * problem.n], np.zeros(sum(c.size for c in further))])
    before = solve(without, None, start)
    after = solve(beside, None, np.concatenate([before, np.zeros(event.size)]))
    noise = with_noise(beside, after)
    share = np.maximum(noise.share, problem.share)
    costs = [
        replace(one, variance=noise.variance, share=share).cost(x, one.sums.whole)
        for one, x in ((without, before), (beside, after))
    ]
    return float(costs[0] - costs[1])


def load_of(problem: RobotProblem) -> Candidate:
    """Return what the robot may carry: a last link alone is drawn too near to its description to stand in for it."""
    records = problem.sums.records
    return payload(Terms(records, given_load(records), slow_speed(records)))


def all_usual(problem: RobotProblem) -> RobotProblem:
    """Return the problem with all links and joints' own terms free; behind the gears no rotor shows."""
    own = np.ones((problem.n, len(OWN)), dtype=bool)
    own[:, OWN.index("rotor")] = not problem.sums.records.model.arm.link_side
    return replace(problem, links_free=problem.links.heavy, own_free=own)
