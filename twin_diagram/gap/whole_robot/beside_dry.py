"""What is said beside dry friction, since that is nearer the truth, though it is not known to a third.

A drive that has dry friction has grease and a rotor, too. To say that there is no damping where it is known to ± 60 %
would bend friction's curve by more than that; and a description that lacks a drive's friction knows no better of its
rotor, which links beside it would else stand in for. An arm most of whose joints have dry friction has some on the
others, too: in a short log a joint may turn but twice, and offsets and links stand in for what it lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.findings import Finding
from twin_diagram.gap.residuals.stiction import slides
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.bounded_step import Chosen
from twin_diagram.gap.whole_robot.left_out import LeftOut
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.gap.whole_robot.well_told import TUNING as WELL_TOLD
from twin_diagram.gap.whole_robot.well_told import well_told
from twin_diagram.model.effects.friction import CoulombFriction, ViscousFriction
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction
from twin_diagram.model.effects.inertia import ReflectedInertia
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    most: float = 1.0 / np.sqrt(2.0)
    """Share of damping or a rotor up to which its standard error may be beside dry friction (Akaike 1974), and of dry
    friction beside that of most other joints: where every drive has some, its true square is what is found less the
    error's, and that is more than the error's own up to there. Leaving it out would be off by more."""

    worse: float = 1.0
    """Fall of the joint's left-out log likelihood that is no reason against such a term [nats]."""

    others: float = 0.5
    """Share of an arm's joints of which more must have dry friction for all to have some: fewer may be what is wrong
    with the arm."""

    there: float = 0.5
    """Share of dry friction up to which its standard error may be for it to be there for sure: two of them."""


TUNING = Tuning()

DAMPING, DRY, ROTOR = OWN.index("viscous"), OWN.index("coulomb"), OWN.index("rotor")
DRY_NAMES = (CoulombFriction.name, StribeckFriction.name)
"""Of which a joint has one, as dry friction changes with speed or does not."""


def damped(problem: RobotProblem, z: Array) -> RobotProblem:
    """Return the problem with damping, then rotors, on joints that have dry friction, where they are known well enough.

    Args:
        problem: with the terms that earned their place.
        z: (Z,) its fit.
    """
    if problem.sums.records.model.arm.link_side:  # what is left of friction behind the sensor is no drive's
        return problem
    for term in (DAMPING, ROTOR):
        left = problem.own_free[:, DRY] & ~problem.said[:, term]
        left &= (own_part(problem, z)[:, DRY] > 0.0) & slides(problem.sums.records)
        left &= ~problem.stated[:, DAMPING] if term == DAMPING else problem.stated[:, ROTOR]
        more = with_term(problem, z, term, left)
        if more is not problem:
            problem, z = more, solve(more, None, z)
    return problem


def rubbing(problem: RobotProblem, z: Array) -> RobotProblem:
    """Return the problem with dry friction on joints that have none yet, where most have some.

    Their drives are alike: friction that motion tells little of is drawn to what is usual with the others.

    Args:
        problem: with the terms that earned their place.
        z: (Z,) its fit.
    """
    left, model = ~problem.said[:, DRY] & ~problem.stated[:, DRY], problem.sums.records.model
    left &= slides(problem.sums.records)
    if problem.known or not np.any(left) or len(model.prismatic) not in (0, problem.n):  # newtons are no newton metres
        return problem
    own = problem.own_free.copy()
    own[:, DRY] |= left
    every = replace(problem, own_free=own)
    fit = solve(every, None, z)
    level = own_part(every, fit)[:, DRY]
    error = np.sqrt(own_part(every, np.diag(estimates.covariance(every, fit)))[:, DRY])
    there = own[:, DRY] & ~problem.stated[:, DRY] & (error <= TUNING.there * level)
    if np.mean(there) <= TUNING.others:
        return problem
    return with_term(replace(problem, rubs=float(np.median(level[there]))), z, DRY, left)


def with_term(problem: RobotProblem, z: Array, term: int, left: Chosen) -> RobotProblem:
    """Return the problem with one of joints' own terms on those of some joints (n,) where it is known well enough."""
    before = LeftOut.of(problem, z).likelihood() if np.any(left) else np.zeros(problem.n)
    while np.any(left):
        own = problem.own_free.copy()
        own[:, term] |= left
        more = replace(problem, own_free=own)
        fit = solve(more, None, z)
        error = np.sqrt(own_part(more, np.diag(estimates.covariance(more, fit)))[:, term])
        size = np.abs(own_part(more, fit)[:, term])
        over = np.where(left, error / np.maximum(size, 1e-12) - TUNING.most, -np.inf)
        if np.max(over) <= 0.0:
            over = np.where(left, before - LeftOut.of(more, fit).likelihood() - TUNING.worse, -np.inf)
            if np.max(over) <= 0.0:
                return more
        left = left & (np.arange(problem.n) != int(np.argmax(over)))
    return problem


def largest_share(problem: RobotProblem, third: float) -> Array:
    """Return (n, 4) share of joints' own terms that their standard error may be.

    Args:
        problem: with the terms that are said.
        third: of all but what stands beside dry friction.
    """
    result = np.full((problem.n, len(OWN)), third)
    if problem.rubs:
        result[~problem.stated[:, DRY], DRY] = TUNING.most
    if not problem.sums.records.model.arm.link_side:
        result[problem.own_free[:, DRY] & ~problem.stated[:, DAMPING], DAMPING] = TUNING.most
        result[problem.own_free[:, DRY], ROTOR] = TUNING.most
    return result


def told_beside_dry(findings: Sequence[Finding], rough: float) -> set[tuple[str, str]]:
    """Return name and joint of damping or a rotor that is known well enough, where dry friction is known to a third.

    Args:
        findings: any.
        rough: times the most, and times a third, that count as one.
    """
    dry = {j for one in well_told(findings, rough) if one.name in DRY_NAMES for j in one.joints}
    beside = [one for one in findings if one.name in (ViscousFriction.name, ReflectedInertia.name)]
    known = well_told(beside, rough * TUNING.most / WELL_TOLD.third)
    return {(one.name, joint) for one in known for joint in one.joints if joint in dry}


def told_beside(findings: Sequence[Finding], rough: float, problem: RobotProblem) -> set[tuple[str, str]]:
    """Return name and joint of all that need not be known to a third beside dry friction, and is known well enough.

    Args:
        findings: any.
        rough: see `told_beside_dry`.
        problem: that they are of.
    """
    alike = set(np.array(problem.sums.records.model.joints)[~problem.stated[:, DRY] & (problem.rubs > 0.0)])
    known = well_told([one for one in findings if one.name in DRY_NAMES], rough * TUNING.most / WELL_TOLD.third)
    return told_beside_dry(findings, rough) | {(one.name, j) for one in known for j in one.joints if j in alike}


def own_part(problem: RobotProblem, z: Array) -> Array:
    """Return (n, 4) what of coordinates (Z,) is joints' own."""
    return z[10 * problem.n : 14 * problem.n].reshape(problem.n, len(OWN))
