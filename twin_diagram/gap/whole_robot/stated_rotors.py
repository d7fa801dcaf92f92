"""Rotors that a description states: off by as much as those of the arm's other joints are, not by any amount.

A maker's rotor is off by a share of itself, a placeholder by far more. Which it is, the arm's own joints say together:
a joint whose motion hardly tells its rotor from its link's inertia is then drawn to what is stated as far as the others
bear that out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.signals.arrays import Array

ROTOR = OWN.index("rotor")
"""Which of joints' own terms a rotor is."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    shares: tuple[float, ...] = (0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
    """Of themselves, by which an arm's stated rotors may be off, one standard deviation: from a gear's grease and
    what turns with the rotor to placeholders."""


TUNING = Tuning()


def drawn_to_stated(problem: RobotProblem, z: Array) -> tuple[RobotProblem, Array]:
    """Return the problem with stated rotors drawn to what is stated, as far as they all are off, and its fit.

    Args:
        problem: with everything usual free, and its noise.
        z: (Z,) its fit.
    """
    joints = np.flatnonzero(problem.own_free[:, ROTOR] & problem.stated[:, ROTOR])
    if not len(joints):
        return problem, z
    problem = replace(problem, rotors=likeliest_share(problem, z, joints))
    return problem, solve(problem, None, z)


def likeliest_share(problem: RobotProblem, z: Array, joints: npt.NDArray[np.int64]) -> float:
    """Return the share of themselves by which stated rotors are likeliest to be off, of those in `Tuning`.

    Each is what it is off by and the error of its fit: of two normal laws, their sum.

    Args:
        problem: that was fitted, rotors next to free.
        z: (Z,) its coordinates.
        joints: whose rotors are stated and may be off.
    """
    places = 10 * problem.n + len(OWN) * joints + ROTOR
    stated = -problem.least[joints, ROTOR]
    H, _ = problem.system(z, problem.sums.whole)
    moving = np.flatnonzero(problem.free)
    at = np.searchsorted(moving, places)
    error = np.linalg.inv(H[np.ix_(moving, moving)])[np.ix_(at, at)] / np.outer(stated, stated)
    off = z[places] / stated
    likely = []
    for share in TUNING.shares:
        C = error + share**2 * np.eye(len(joints))
        likely.append(-0.5 * float(off @ np.linalg.solve(C, off)) - 0.5 * float(np.linalg.slogdet(C)[1]))
    return TUNING.shares[int(np.argmax(likely))]
