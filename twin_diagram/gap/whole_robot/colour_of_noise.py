"""The colour of noise by which a candidate is judged: what it takes away of it was no noise, if it is there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem


def between(problem: RobotProblem, after: RobotProblem) -> RobotProblem:
    """Return the problem with the colour of noise half-way to that beside something more.

    Colour that a candidate takes away was no noise if it is there, and was if it is not.
    """
    return replace(problem, share=np.sqrt(problem.share * np.maximum(problem.share, after.share)))


def whitened(problem: RobotProblem, after: RobotProblem, candidate: Candidate) -> RobotProblem:
    """Return the problem with the colour of noise by which a candidate is judged.

    Args:
        problem: without it.
        after: with it, and the noise that is left.
        candidate: what is judged. A push alone lets a joint's residual hang together over all of its span: that is no
            noise, which went on before and after it.
    """
    return quietest(problem, after) if candidate.passing else between(problem, after)


def quietest(problem: RobotProblem, after: RobotProblem) -> RobotProblem:
    """Return the problem with the colour of noise that is less, its own or that beside something more."""
    return replace(problem, share=np.maximum(problem.share, after.share))
