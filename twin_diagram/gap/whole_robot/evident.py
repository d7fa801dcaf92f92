"""What is evident from the start: a tilted base, torque that acts late, told beside everything usual at once.

Left-out motion says little of what acts on all motion alike: of what few kinds of motion there are in a log, each has
links and friction stand in for a tilt in its own way. Evidence that counts against all that stands in for it tells one
from nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.whole_arm import last_body
from twin_diagram.gap.whole_robot.believable import believable
from twin_diagram.gap.whole_robot.beside_the_usual import EVIDENT, rise_beside_the_usual
from twin_diagram.gap.whole_robot.late_torque import later
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.unusual import (
    carried,
    offered,
    recentred,
    stands_by,
    terms_of,
    with_candidate,
)
from twin_diagram.model.effects.actuation import TimeDelay
from twin_diagram.signals.arrays import Array


def evident(problem: RobotProblem, z: Array) -> tuple[RobotProblem, Array]:
    """Return the problem with what makes its logs likelier beside everything usual, best first, and its fit.

    Args:
        problem: with everything usual free, and its noise.
        z: (Z,) its fit.
    """
    terms = terms_of(problem.sums, problem.sums.records.model)
    last, there = last_body(terms), offered(terms, EVIDENT)
    rather = [later(problem, z, c) if c.name == TimeDelay.name else c for c in there]
    there = [candidate for candidate in rather if candidate is not None]
    while there:
        best = likeliest(problem, z, there)
        if best is None:
            break
        more = with_candidate(problem, best, last)
        fitted = solve(more, None, carried(problem, z, more))
        if believable(more):
            if best.name != TimeDelay.name:  # which is about where it was found already
                more, fitted = recentred(more, fitted, terms, last)
            problem = with_noise(more, fitted)
            z = solve(problem, None, fitted)
        there = [candidate for candidate in there if candidate is not best]
    return problem, z


def likeliest(problem: RobotProblem, z: Array, there: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate that brings most beside everything usual; None where none brings what it must."""
    gains = [rise_beside_the_usual(problem, z, candidate) - stands_by(candidate) for candidate in there]
    best = int(np.argmax(gains))
    return there[best] if gains[best] > 0.0 else None
