"""All links beside those that earn their place: where some are off, the others are, too, as far as their prior goes.

A link alone must bring a few nats of left-out motion to be named, which one that is off by little does not, and what
those named cannot do, they stand in for: of other motion that is more than the prior's care leaves of all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.whole_robot.beside_dry import told_beside
from twin_diagram.gap.whole_robot.concluding import TUNING as CONCLUDING
from twin_diagram.gap.whole_robot.concluding import WholeRobot, last_of, lost_names, said_of, without_names
from twin_diagram.gap.whole_robot.estimates import covariance
from twin_diagram.gap.whole_robot.left_out import TUNING as LEFT_OUT
from twin_diagram.gap.whole_robot.left_out import LeftOut, best_spread
from twin_diagram.gap.whole_robot.physical_fit import solve
from twin_diagram.gap.whole_robot.unusual import room_for
from twin_diagram.gap.whole_robot.well_told import share_of
from twin_diagram.model.effects.actuation import TorqueBias


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    some: int = 2
    """Links that must have earned their place: one that is off alone is one that was changed."""

    against: float = LEFT_OUT.link
    """Fall of the left-out log likelihood that speaks against all links: as much as must speak for one [nats]. Where it
    was less, held-out torque of four training arms (60200 to 60221) and eight parts of real logs was 1.4 % nearer at
    the mean, 8 % at the most, and up to 2.7 % further off. Parts of two real logs that fall by 20 were 5 and 0.5 %
    further off."""


TUNING = Tuning()


def with_all_links(found: WholeRobot) -> WholeRobot:
    """Return what was found with all links free, where left-out motion does not speak against it, nor a name is lost.

    How sure each name is, was decided by what earned its place. Of an arm that was corrected before, links are as they
    were found then.

    Args:
        found: with the links that earned their place.
    """
    problem = found.problem
    links = problem.links_free | (problem.links.heavy & room_for(problem.sums, last_of(problem))[0])
    if problem.known or np.sum(problem.links_free) < TUNING.some or np.array_equal(links, problem.links_free):
        return found
    every, left_out = best_spread(replace(problem, links_free=links), found.coordinates)
    if left_out.score() < LeftOut.of(problem, found.coordinates).score() - TUNING.against:
        return found
    z = solve(every, None, found.coordinates)
    # Those that earned their place are off by more than the rest, which draws the spread down: no reason to be surer.
    every = replace(every, spread=max(every.spread, problem.spread))
    more = said_of(every, z, covariance(every, z))
    if more is None or unsure(more) - unsure(found):
        return found
    if none := no_offsets(more):  # the other links stand for them
        every = without_names(every, z, none)
        z = solve(every, None, z)
        more = said_of(every, z, covariance(every, z)) or more
    sure = {one.name: one.confidence for one in found.findings}
    findings = tuple(replace(one, confidence=sure[one.name]) for one in more.findings)
    return replace(more, findings=findings, separation=found.separation, along=len(links_of(more) - links_of(found)))


def unsure(found: WholeRobot) -> set[tuple[str, str]]:
    """Return names, with the joint of each or an empty one, that are known no better than to a third."""
    return lost_names(found.findings) - told_beside(found.findings, CONCLUDING.rough, found.problem)


def no_offsets(found: WholeRobot) -> set[tuple[str, str]]:
    """Return offsets, each with its joint, that are smaller than their own error."""
    there = [(one, joint) for one in found.findings if one.name == TorqueBias.name for joint in one.joints]
    return {(one.name, joint) for one, joint in there if share_of(one, joint) >= CONCLUDING.none}


def links_of(found: WholeRobot) -> set[str]:
    """Return the links that are named."""
    return {link for finding in found.findings for link in finding.links}
