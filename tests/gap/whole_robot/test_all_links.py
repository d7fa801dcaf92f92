"""All links are said where some have earned their place and left-out motion does not speak against the others."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, effect, everywhere, swing
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import explain as explaining
from twin_diagram.gap.whole_robot.all_links import no_offsets, with_all_links
from twin_diagram.gap.whole_robot.concluding import WholeRobot, said_of
from twin_diagram.gap.whole_robot.estimates import covariance
from twin_diagram.gap.whole_robot.explain import explain
from twin_diagram.gap.whole_robot.physical_fit import solve
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.model.model import Model

LINKS = ARM.tree.link
HEAVY, LIGHT = LINKS[1:3], LINKS[3:6]


@cache
def off_a_little() -> tuple[Records, Model, WholeRobot]:
    """An arm two of whose links are off by much and the others by little, and what is found before the others."""
    much = [effect("inertial_parameters", links=[x], mass=1.5, com=[0.02, -0.02, 0.03]) for x in HEAVY]
    little = [effect("inertial_parameters", links=[x], mass=0.05, com=[0.003, 0.003, -0.003]) for x in LIGHT]
    true = ARM.with_effects([*much, *little, everywhere("coulomb_friction", torque=4.0)])
    records = noisy(ARM, true, 8.0, 8)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(explaining, "with_all_links", lambda found: found)
        found = explain(records)
    assert found is not None
    return records, true, found


def links(found: WholeRobot) -> tuple[str, ...]:
    return next(one.links for one in found.findings if one.name == "inertial_parameters")


def off(true: Model, found: WholeRobot) -> float:
    _, q, v, a = swing(6.0, seed=99)
    apart = found.model.inverse_dynamics(q, v, a) - true.inverse_dynamics(q, v, a)
    return float(np.sqrt(np.mean(apart**2)))


def test_links_that_are_off_by_little_are_said_beside_those_that_are_off_by_much() -> None:
    records, true, found = off_a_little()
    more = with_all_links(found)
    assert set(HEAVY) <= set(links(found)) < set(links(more))
    assert len(links(more)) == np.sum(found.problem.links.heavy)
    explained = explain(records)
    assert explained is not None and links(explained) == links(more)
    assert off(true, more) < off(true, found)


def test_they_change_no_other_name_nor_how_sure_any_is_nor_how_many_earned_their_place() -> None:
    *_, found = off_a_little()
    more = with_all_links(found)
    said = [[(one.name, one.joints, one.confidence) for one in x.findings] for x in (found, more)]
    assert said[0] == said[1]
    assert more.terms() == found.terms() and more.links() == found.links() and more.along > 0
    assert with_all_links(more) is more


def test_one_link_alone_or_an_arm_that_was_corrected_before_has_no_others() -> None:
    *_, found = off_a_little()
    alone = np.arange(found.problem.n) == 1
    for problem in (replace(found.problem, links_free=alone), replace(found.problem, known=True)):
        other = replace(found, problem=problem)
        assert with_all_links(other) is other


def test_an_offset_of_which_all_links_leave_nothing_is_gone() -> None:
    """0.7 ± 0.9 mN·m were told of a log of 4 s, of 1.6 ± 1.2 beside the links that had earned their place."""
    _, true, found = off_a_little()
    own, bias = found.problem.own_free.copy(), OWN.index("bias")
    own[ELBOW, bias] = True
    problem = replace(found.problem, own_free=own)
    z = solve(problem, None, found.coordinates)
    with_offset = said_of(problem, z, covariance(problem, z))
    assert with_offset is not None
    assert ("torque_bias", ARM.joints[ELBOW]) in no_offsets(with_offset)
    more = with_all_links(with_offset)
    assert "torque_bias" not in {one.name for one in more.findings}
    assert off(true, more) < off(true, found)
