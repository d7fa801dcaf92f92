"""What friction holds: samples at which a joint rests tell nothing that its dry friction could hold.

A joint that hardly moves keeps its samples in the equations, as it may have no friction. What is asked of them alone,
though, as a push or torque that acts late, may be what holds it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals import stiction
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.signals.arrays import Array

NO_FRICTION = 1e-9
"""Any torque is large beside this [N·m]."""


def dry_levels(problem: RobotProblem, z: Array) -> Array:
    """Return (n,) dry friction of each joint, the description's and what was found [N·m].

    Args:
        problem: that was fitted.
        z: (Z,) its coordinates.
    """
    own = z[10 * problem.n : 14 * problem.n].reshape(problem.n, len(OWN))
    return np.asarray(np.abs(own[:, OWN.index("coulomb")] + problem.sums.stated_dry))


def shares_of_friction(problem: RobotProblem, z: Array, push: Candidate) -> Array:
    """Return (r,) the most torque that a push brings each joint that it drives, over the joint's dry friction.

    Args:
        problem: of what is there beside it, without it.
        z: (Z,) its coordinates.
        push: as it was found.
    """
    beside = replace(problem, sums=problem.sums.with_further([*problem.sums.further, push]))
    fitted = solve(beside, None, np.concatenate([z, np.zeros(push.size)]))
    brought = np.max(np.abs(push.columns @ fitted[-push.size :]), axis=0)
    level = np.maximum(dry_levels(problem, z), dry_levels(problem, fitted))[list(push.rows)]
    return np.asarray(brought / np.maximum(level, NO_FRICTION))


def mostly_resting(problem: RobotProblem, terms: Terms) -> npt.NDArray[np.bool_]:
    """Return (n,) which joints slide too seldom for samples that slide to be all that counts, see `stiction.fewest`.

    Args:
        problem: that was fitted.
        terms: of the same samples.
    """
    shares = [float(np.mean(stiction.clear(terms.records, terms, j))) for j in range(problem.n)]
    return np.array(shares) <= stiction.TUNING.fewest


def told_by_rests(problem: RobotProblem) -> npt.NDArray[np.bool_]:
    """Return (n,) which joints are told by samples at which friction may hold them, since they hardly slide.

    Args:
        problem: that was fitted.
    """
    records = problem.sums.records
    resting = mostly_resting(problem, Terms(records, given_load(records), slow_speed(records)))
    return np.asarray(resting & np.all(problem.sums.weights > 0.0, axis=0))


def without_held(problem: RobotProblem, z: Array, terms: Terms, joints: Iterable[int]) -> tuple[RobotProblem, Array]:
    """Return the problem without samples at which some joints may be held, with the noise of what is left, and its fit.

    Args:
        problem: that was fitted.
        z: (Z,) its coordinates.
        terms: of the same samples.
        joints: that friction may hold.
    """
    weights = problem.sums.weights.copy()
    for j in joints:
        weights[:, j] *= stiction.clear(terms.records, terms, j)
    if np.array_equal(weights, problem.sums.weights):
        return problem, z
    problem = replace(problem, sums=problem.sums.weighted(weights))
    problem = with_noise(problem, solve(problem, None, z))  # what was held is no noise
    return problem, solve(problem, None, z)
