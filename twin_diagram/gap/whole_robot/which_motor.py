"""Which motor is off: what is said of torque constants is no surer than links and the other motors let it be.

Joints that lift the same links tell how their motors differ, and hardly which is off: a link that is lighter and the
other motor stronger do the same. Left-out motion misses a gain all the same, once the others are taken as right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.beside_the_usual import gains
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.transmitted_torque import transmitted
from twin_diagram.model.effects.actuation import TorqueConstant
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ToldGain:
    """What is known of a named torque constant where the other motors' may be off, too.

    Attributes:
        error: standard error of its coefficient, with what that shifts by.
        evidence: by how much likelier it is than none [nats], as in `offset_evidence`.
    """

    error: float
    evidence: float


def told_gains(problem: RobotProblem, z: Array) -> dict[int, ToldGain]:
    """Return what is known of each named torque constant, by its joint; all motors may be off as they usually are.

    Args:
        problem: with what was found.
        z: (Z,) its coordinates.
    """
    named = {c.joints[0]: k for k, c in enumerate(problem.sums.further) if c.name == TorqueConstant.name}
    if not named:
        return {}
    others = [
        replace(c, columns=transmitted(problem, z, c.joints[0])[:, None, None])
        for c in gains(problem)
        if c.joints[0] not in named
    ]
    every = replace(problem, sums=problem.sums.with_further([*problem.sums.further, *others]))
    fitted = solve(every, None, np.concatenate([z, np.zeros(len(others))]))
    every = with_noise(every, fitted)
    fitted = solve(every, None, fitted)
    errors, result = np.sqrt(np.diag(estimates.covariance(every, fitted))), {}
    for joint, at in named.items():
        place = problem.place(at).start
        t = max(abs(float(fitted[place] / errors[place])), 1.0)
        error = float(np.hypot(errors[place], fitted[place] - z[place]))
        result[joint] = ToldGain(error, 0.5 * (t**2 - 1.0) - float(np.log(t)))
    return result


def in_doubt(found: WholeRobot) -> WholeRobot:
    """Return what was found with torque constants that are no surer than links and the other motors let them be."""
    if not any(finding.name == TorqueConstant.name for finding in found.findings):
        return found
    told, joints = told_gains(found.problem, found.coordinates), found.model.joints
    by_joint = {joints[j]: one for j, one in told.items()}
    findings = [_doubted(one, by_joint) if one.name == TorqueConstant.name else one for one in found.findings]
    return replace(found, findings=tuple(findings))


def _doubted(finding: Finding, told: dict[str, ToldGain]) -> Finding:
    """Return the finding of torque constants with these errors, where they are larger, and as sure as the weakest."""
    said = finding.parameters["gain"]
    assert isinstance(said, dict)
    values: dict[str, Estimate] = {}
    for joint, one in said.items():
        gain, std = (float(np.asarray(x)) for x in (one.value, one.std))
        values[joint] = replace(one, std=max(std, gain**2 * told[joint].error))  # of one over one and the coefficient
    sure = min(1.0 / (1.0 + float(np.exp(-min(told[joint].evidence, 30.0)))) for joint in said)
    return replace(finding, parameters={"gain": values}, confidence=min(finding.confidence, sure))
