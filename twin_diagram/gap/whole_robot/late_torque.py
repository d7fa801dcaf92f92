"""How much later the logged torque acts, by logs in which it is that much later: no law of first order.

Stiff control answers noise with torque that moves the arm, some milliseconds later. What acts late is that torque with
its noise, which the rate of a model's torque hardly has; a logged torque that is shifted has it, and stays as large.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.time_delay import TUNING as TIME_DELAY
from twin_diagram.gap.candidates.time_delay import delay
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.search.golden_section import least
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.believable import TUNING as BELIEVABLE
from twin_diagram.gap.whole_robot.concluding import corrected
from twin_diagram.gap.whole_robot.held_by_friction import dry_levels, without_held
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.torque_equations import TorqueEquations, low_passed
from twin_diagram.gap.whole_robot.unusual import terms_of
from twin_diagram.model.dynamics.onsets import shifted as later_signal
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    tried: tuple[float, ...] = (0.0, 0.003, 0.006, 0.01, 0.014, 0.02, 0.03, 0.04, 0.05)
    """By how much the torque is shifted at first [s]: nearer each other than a band of 20 Hz turns in a quarter."""

    sections: int = 6
    """Times that what lies between the neighbours of the best shrinks to 0.62 of itself: to half of a millisecond."""

    alone: float = 15.0
    """By how much likelier logs must be with one joint's torque later for a word about it [nats]: up to 12 on arms of
    training of which none is late."""

    rather: float = 3.0
    """Times what any other joint gains so, as a delay of all would have them gain as well."""

    others: float = 3.0
    """By how much likelier all joints but the one that gains most must be with a delay of all [nats]: 3.3 and
    more on 13 arms of training with one that is told. One joint alone that is late moves them by little: up to 4.9 on
    seven arms, with shifts of 5 ms at most."""

    behind: float = 30.0
    """By how much likelier logs must be with all joints' torque earlier for a word about it [nats]: −128 to −2 with
    6 ms on six arms whose torques do not lag, 78 on one whose torques are 14 ms late."""


TUNING = Tuning()
COARSE = TUNING.tried[::2]
"""By how much one joint's torque is shifted at first [s]."""


def later(problem: RobotProblem, z: Array, candidate: Candidate) -> Candidate | None:
    """Return a delay about the one with which logs are likeliest; None where there is none of all joints.

    That is no more than a sample, or one joint's alone.

    Args:
        problem: with everything usual free, and its noise.
        z: (Z,) its fit.
        candidate: a delay to first order.
    """
    seconds = likeliest_shift(problem, z)
    if seconds <= (1.0 + BELIEVABLE.edge) * float(candidate.lower[0]):
        return None
    if problem.n > 1 and _of_one(problem, z, seconds):
        return None
    moved = replace(problem, sums=shifted(problem.sums, seconds))
    fit, given = solve(moved, None, z), problem.sums.records.model
    said = estimates.findings(moved, fit, np.zeros((len(fit), len(fit))), given, defaultdict(lambda: 1.0))
    model = corrected(given, said, [record.mark for record in problem.sums.records.records])
    if model is None:
        return candidate
    return delay(terms_of(problem.sums, model), TIME_DELAY.longest_delay, seconds)


def _of_one(problem: RobotProblem, z: Array, seconds: float) -> bool:
    """Return whether a shift of all joints' torque makes logs likelier for one of several joints alone."""
    gains = costs_of(problem, z, 0.0) - costs_of(problem, z, seconds)
    return bool(np.sum(gains) - np.max(gains) < TUNING.others or np.max(gains_alone(problem, z)) > np.sum(gains))


def one_late(problem: RobotProblem, z: Array) -> tuple[int, float] | None:
    """Return the joint whose logged torque alone acts later, and by how much [s]; None where none does, or more do.

    The catalogue has no name for it, but where there is no other joint: in its place stands what it is most like there.
    What dry friction holds is left out: it follows the last motion, and seems late.

    Args:
        problem: with all that was found, and its noise.
        z: (Z,) its fit.
    """
    if problem.n == 1:
        return None
    records = problem.sums.records
    terms = Terms(records, given_load(records), slow_speed(records))
    problem, z = without_held(problem, z, terms, np.flatnonzero(dry_levels(problem, z)).tolist())
    gains = gains_alone(problem, z)
    best, joint = (int(k) for k in np.unravel_index(int(np.argmax(gains)), gains.shape))
    others = np.delete(np.max(gains, axis=0), joint)
    if gains[best, joint] < max(TUNING.alone, TUNING.rather * np.max(others, initial=0.0)):
        return None
    ends = COARSE[best - 1], COARSE[min(best + 1, len(COARSE) - 1)]
    return joint, least(lambda shift: _cost(problem, z, shift, joint), *ends, TUNING.sections)[1]


def behind(problem: RobotProblem, z: Array) -> float:
    """Return by how much all logged torques lag the motion that they belong to [s]; 0 where they do not.

    A drive's filter does that, or stamps of another clock. The catalogue has no name for it: an arm cannot answer a
    torque before it comes. What dry friction holds is left out: it follows the last motion.

    Args:
        problem: with all that was found, and its noise.
        z: (Z,) its fit.
    """
    records = problem.sums.records
    terms = Terms(records, given_load(records), slow_speed(records))
    problem, z = without_held(problem, z, terms, np.flatnonzero(dry_levels(problem, z)).tolist())
    none = costs_of(problem, z, 0.0)
    gains = np.array([none - costs_of(problem, z, -seconds) for seconds in COARSE])
    best = int(np.argmax(np.sum(gains, axis=1)))
    rest = np.sum(gains[best]) - np.max(gains[best])
    if np.sum(gains[best]) < TUNING.behind or (problem.n > 1 and rest < TUNING.others):
        return 0.0
    if np.min(gains[best]) < -TUNING.others:  # a lag is all joints', and not what some have no name for
        return 0.0
    ends = COARSE[best - 1], COARSE[min(best + 1, len(COARSE) - 1)]
    seconds = least(lambda shift: float(np.sum(costs_of(problem, z, -shift))), *ends, TUNING.sections)[1]
    return seconds if seconds > max(record.period for record in records.records) else 0.0


def gains_alone(problem: RobotProblem, z: Array) -> Array:
    """Return (T, n) by how much likelier logs are with one joint's torque alone later by each of `COARSE` [nats].

    Args:
        problem: with its noise.
        z: (Z,) its fit.
    """
    costs = np.array([[_cost(problem, z, shift, j) for j in range(problem.n)] for shift in COARSE])
    return np.asarray(costs[0] - costs)


def _cost(problem: RobotProblem, z: Array, seconds: float, joint: int) -> float:
    return float(np.sum(costs_of(problem, z, seconds, [joint])))


def likeliest_shift(problem: RobotProblem, z: Array) -> float:
    """Return by how much the torque is shifted where logs are likeliest [s]; 0 where that is not at all, or backwards.

    Args:
        problem: with everything usual free, and its noise.
        z: (Z,) its fit.
    """
    costs = [float(np.sum(costs_of(problem, z, seconds))) for seconds in TUNING.tried]
    best = int(np.argmin(costs))
    if best == 0:
        return 0.0
    ends = TUNING.tried[best - 1], TUNING.tried[min(best + 1, len(TUNING.tried) - 1)]
    return least(lambda seconds: float(np.sum(costs_of(problem, z, seconds))), *ends, TUNING.sections)[1]


def costs_of(problem: RobotProblem, z: Array, seconds: float, joints: Sequence[int] | None = None) -> Array:
    """Return (n,) by how much logs are less likely with a shifted torque, but for a constant [nats].

    Args:
        problem: with everything usual free, and its noise.
        z: (Z,) its fit.
        seconds: by which the torque is later.
        joints: whose; None: all.
    """
    moved = replace(problem, sums=shifted(problem.sums, seconds, joints))
    squares = moved.squares(solve(moved, None, z), moved.sums.whole)
    return np.asarray(0.5 * problem.share * problem.sums.counted * np.log(np.maximum(squares, 1e-30)))


def shifted(sums: TorqueEquations, seconds: float, joints: Sequence[int] | None = None) -> TorqueEquations:
    """Return the same of torques that were logged some time before [s]; of some joints, or of all."""
    some = list(range(sums.n) if joints is None else joints)
    columns, parts = sums.columns.copy(), []
    for record in sums.records.records:
        logged = record.torque[:, some]
        before = later_signal(logged, record.time, -seconds)  # between samples, straight lines would take noise away
        parts.append(low_passed(before - logged, record)[record.kept])
    columns[:, some, -1] += np.concatenate(parts)
    return sums.with_columns(columns, [*range(columns.shape[2] - 1), -1])
