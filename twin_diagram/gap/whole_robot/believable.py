"""Whether what was fitted beside links and joints' own terms is to be believed: it can be, and is known well enough."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.beside_the_usual import EVIDENT
from twin_diagram.gap.whole_robot.events import counted
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.model.effects.transmission import JointSpring


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    sure: float = 0.3
    """No name where the standard error is more than this share of the value: of so many names some always suits."""

    third: float = 1.0 / 3.0
    """The same of a payload: whether it is there is decided by evidence."""

    edge: float = 0.05
    """Share beyond the least that a name can say, up to which it says nothing: logs themselves may lag by a sample."""

    beyond_own: float = 2.0
    """Times the last link's own doubt that a payload must weigh."""


TUNING = Tuning()


def believable(problem: RobotProblem, at: int = -1) -> bool:
    """Return whether a further candidate can be, is known well enough, and is no doubt of the description.

    Args:
        problem: with it.
        at: which of the further ones.
    """
    z = solve(problem)
    at = at % len(problem.sums.further)
    candidate, s = problem.sums.further[at], problem.place(at)
    covariance = estimates.covariance(with_noise(problem, z), z)[s, s]  # what it explains is no noise
    least = (candidate.lower > 0.0) & (z[s] <= (1.0 + TUNING.edge) * candidate.lower)
    if not candidate.allows(z[s]) or np.any(least):  # no more than what is no effect at all
        return False
    if candidate.name == Payload.name:
        own, mass = 0.0 if candidate.passing else estimates.own_doubt(problem), abs(z[s][0])
        return bool(mass > TUNING.beyond_own * own and np.hypot(np.sqrt(covariance[0, 0]), own) < TUNING.third * mass)
    if candidate.name in EVIDENT:  # gains that have no name would be noise here, which evidence counts against it
        return True
    # A straight spring's level alone would be an offset.
    told = slice(0, 1) if candidate.name == JointSpring.name and not candidate.variant else slice(None)
    size, spread, number = z[s][told], covariance[told, told], min(counted(candidate), len(z[s][told]))
    return float(np.sqrt(size @ np.linalg.pinv(spread, hermitian=True) @ size / number)) > 1.0 / TUNING.sure


def without_doubtful(problem: RobotProblem) -> RobotProblem:
    """Return the problem without further candidates that are believable no more beside what came after them."""
    while True:
        doubtful = [k for k in range(len(problem.sums.further)) if not believable(problem, k)]
        if not doubtful:
            return problem
        kept = [c for k, c in enumerate(problem.sums.further) if k != doubtful[0]]
        problem = replace(problem, sums=problem.sums.with_further(kept))
