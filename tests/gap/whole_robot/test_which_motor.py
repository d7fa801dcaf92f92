"""Torque constants: which motor is off is told no better than links and the other motors let it be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.gap.made import ARM, ELBOW, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from tests.gap.whole_robot.test_unusual import problem
from twin_diagram.gap.findings import Estimate
from twin_diagram.gap.whole_robot.concluding import said_of, sure_ones
from twin_diagram.gap.whole_robot.explain import explain
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.unusual import offered, terms_of, with_candidate
from twin_diagram.gap.whole_robot.which_motor import in_doubt, told_gains

WEAK = effect("torque_constant", joints=[ARM.joints[ELBOW]], gain=[0.95])


def gained(links: bool) -> RobotProblem:
    """A weak motor at the elbow, found beside links that may be off, or that are as described."""
    start = replace(problem(WEAK), links_free=np.full(6, links))
    there = offered(terms_of(start.sums, ARM), ("torque_constant",))
    return with_candidate(start, next(c for c in there if c.joints == (ELBOW,)), 5)


def told(links: bool) -> tuple[Estimate, float]:
    """The gain that is said, and how sure it is."""
    said = said_of(*sure_ones(gained(links)))
    assert said is not None
    (found,) = [one for one in in_doubt(said).findings if one.name == "torque_constant"]
    gain = found.parameters["gain"]
    assert isinstance(gain, dict)
    return gain[ARM.joints[ELBOW]], found.confidence


def test_links_and_other_motors_that_may_be_off_leave_a_gain_unsure() -> None:
    """All motors stronger and all links lighter are the same torque: a hundredth is left of three that each may be."""
    (as_described, sure), (beside_links, less) = told(False), told(True)
    for one in (as_described, beside_links):
        assert abs(float(np.asarray(one.value)) - 0.95) < 2.0 * float(np.asarray(one.std))
    assert float(np.asarray(as_described.std)) < 0.011 < 0.012 < float(np.asarray(beside_links.std)) < 0.03
    assert 0.9 < less < 0.99 < 0.999 < sure


def test_what_a_gain_brings_is_what_is_left_of_it_beside_the_other_motors() -> None:
    sure, unsure = (told_gains(p, solve(p))[ELBOW] for p in (gained(False), gained(True)))
    assert sure.error < 0.005 < 0.01 < unsure.error < 0.02
    assert sure.evidence > 50.0 > 10.0 > unsure.evidence > 1.0
    assert not told_gains(problem(WEAK), solve(problem(WEAK)))


def test_what_is_found_says_no_gain_surer_than_that() -> None:
    """The whole way: two links are off and a motor is weak, beside friction that is not known."""
    links = [effect("inertial_parameters", links=[ARM.tree.link[k]], mass=x) for k, x in ((2, -0.6), (4, 0.4))]
    found = explain(noisy(ARM, ARM.with_effects([everywhere("viscous_friction", damping=2.0), *links, WEAK])))
    assert found is not None
    (gain,) = [one for one in found.findings if one.name == "torque_constant"]
    told = told_gains(found.problem, found.coordinates)[ELBOW]
    value = gain.parameters["gain"][ARM.joints[ELBOW]]  # type: ignore[index]
    assert gain.joints == (ARM.joints[ELBOW],) and abs(value.value - 0.95) < 2.0 * value.std
    assert value.std >= 0.9 * told.error and gain.confidence <= 1.0 / (1.0 + np.exp(-told.evidence))
