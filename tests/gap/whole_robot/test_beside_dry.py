"""Damping and rotors beside dry friction: said where they are known well enough, and not where there are none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, WRIST, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.candidates.payload import payload
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.whole_robot import concluding
from twin_diagram.gap.whole_robot.beside_dry import (
    DAMPING,
    DRY,
    ROTOR,
    damped,
    largest_share,
    own_part,
    rubbing,
    told_beside,
    told_beside_dry,
)
from twin_diagram.gap.whole_robot.concluding import sure_ones
from twin_diagram.gap.whole_robot.estimates import NAMES, covariance
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.gap.whole_robot.unusual import terms_of

DAMPED, LEVEL, NOISE, RATTLE = 1.0, 6.0, 18.0, 90.0


@cache
def doubted(on_wrist: float) -> tuple[RobotProblem, np.ndarray]:
    """An arm with dry friction and damping everywhere, whose noisy wrist is told to have dry friction alone."""
    sizes = [on_wrist if j == WRIST else DAMPED for j in range(6)]
    grease = effect("viscous_friction", joints=list(ARM.joints), damping=sizes)
    records = noisy(ARM, ARM.with_effects([everywhere("coulomb_friction", torque=LEVEL), grease]))
    (made,) = records.records
    torque = made.torque.copy()
    torque[:, WRIST] += NOISE * np.random.default_rng(5).normal(size=len(torque))
    problem, z = settled(begun(records, equations(replace(records, records=(replace(made, torque=torque),)))))
    own = np.zeros_like(problem.own_free)
    own[:, [DAMPING, DRY]] = True
    own[WRIST, DAMPING] = False
    return settled(replace(problem, own_free=own), z)


def wrists_damping(problem: RobotProblem) -> np.ndarray:
    return (np.arange(6) == WRIST)[:, None] & (np.arange(problem.own_free.shape[1]) == DAMPING)


def told(problem: RobotProblem, z: np.ndarray) -> tuple[float, float]:
    """Damping of the wrist, and its standard error."""
    fit = solve(problem, None, z)
    variance = own_part(problem, np.diag(covariance(problem, fit)))[WRIST, DAMPING]
    return float(own_part(problem, fit)[WRIST, DAMPING]), float(np.sqrt(variance))


def test_damping_that_is_known_to_a_half_stands_beside_dry_friction() -> None:
    problem, z = doubted(DAMPED)
    more = damped(problem, z)
    value, error = told(more, z)
    assert value == pytest.approx(DAMPED, abs=2.0 * error) and error > value / 3.0
    np.testing.assert_array_equal(more.own_free, problem.own_free | wrists_damping(problem))
    assert sure_ones(more)[0].own_free[WRIST, DAMPING]


def test_where_there_is_none_none_is_said() -> None:
    problem, z = doubted(0.0)
    assert damped(problem, z) is problem


def lacking(name: str, key: str, size: float, *, dry: bool = True) -> tuple[RobotProblem, np.ndarray, int]:
    """An arm with dry friction everywhere and one term more on its noisy wrist; which of `OWN` that is."""
    more, term = effect(name, joints=[ARM.joints[WRIST]], **{key: [size]}), list(NAMES.values()).index((name, key))
    records = noisy(ARM, ARM.with_effects([everywhere("coulomb_friction", torque=LEVEL), more]))
    (made,) = records.records
    torque = made.torque.copy()
    torque[:, WRIST] += NOISE * np.random.default_rng(5).normal(size=len(torque))
    problem, z = settled(begun(records, equations(replace(records, records=(replace(made, torque=torque),)))))
    own = np.zeros_like(problem.own_free)
    own[:, DRY], own[WRIST, DRY], own[WRIST, term] = True, dry, True
    problem, z = settled(replace(problem, own_free=own), z)
    return problem, z, term


@pytest.mark.parametrize(("more", "said"), [(0.13, True), (0.0, False)])
def test_a_rotor_that_is_stated_wrongly_comes_back_beside_dry_friction(more: float, said: bool) -> None:
    stated = 0.3
    given = ARM.with_effects([everywhere("reflected_inertia", inertia=stated)])
    rotors = [stated + more * (j == WRIST) for j in range(6)]
    true = [everywhere("coulomb_friction", torque=LEVEL), effect("reflected_inertia", ARM.joints, inertia=rotors)]
    records = noisy(given, ARM.with_effects(true))
    (made,) = records.records
    torque = made.torque.copy()
    torque[:, WRIST] += NOISE * np.random.default_rng(5).normal(size=len(torque))
    problem, z = settled(begun(records, equations(replace(records, records=(replace(made, torque=torque),)))))
    own = np.zeros_like(problem.own_free)
    own[:, DRY] = True
    problem, z = settled(replace(problem, own_free=own), z)
    found = damped(problem, z)
    assert [bool(free) for free in found.own_free[:, ROTOR]] == [said and j == WRIST for j in range(6)]


@pytest.mark.parametrize(("rotor", "dry", "said"), [(0.13, True, True), (0.13, False, False), (0.05, True, False)])
def test_a_rotor_that_is_known_to_a_half_stands_beside_dry_friction(rotor: float, dry: bool, said: bool) -> None:
    problem, z, term = lacking("reflected_inertia", "inertia", rotor, dry=dry)
    value = own_part(problem, z)[WRIST, term]
    error = np.sqrt(own_part(problem, np.diag(covariance(problem, z)))[WRIST, term])
    assert value == pytest.approx(rotor, abs=2.0 * error) and error > value / 3.0
    assert sure_ones(problem)[0].own_free[WRIST, term] == said


def test_an_offset_that_is_not_known_to_a_third_stays_where_left_out_motion_misses_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By four nats here; else a rotor, say, that is there would lose its place to what stands in for the offset."""
    problem, z, term = lacking("torque_bias", "torque", 1.5)
    error = np.sqrt(own_part(problem, np.diag(covariance(problem, z)))[WRIST, term])
    assert error > own_part(problem, z)[WRIST, term] / 3.0
    assert sure_ones(problem)[0].own_free[WRIST, term]
    load = payload(terms_of(problem.sums, problem.sums.records.model))
    carries = replace(problem, sums=problem.sums.with_further([load]))
    assert not sure_ones(carries)[0].own_free[WRIST, term], "what it holds may be a load's weight"
    monkeypatch.setattr(concluding, "TUNING", replace(concluding.TUNING, matters=6.0))
    assert not sure_ones(problem)[0].own_free[WRIST, term]


def test_without_dry_friction_it_must_be_known_to_a_third() -> None:
    problem, _ = doubted(DAMPED)
    share = largest_share(replace(problem, own_free=problem.own_free & (np.arange(4) != DRY)), 0.3)
    assert np.all(share == 0.3) and largest_share(problem, 0.3)[WRIST, DAMPING] > 0.3
    rubs = {name: Finding(name, ("a",), (), {key: {"a": Estimate(1.0, 0.4, "")}}, 1.0) for name, key in NAMES.values()}
    assert told_beside_dry([rubs["viscous_friction"], rubs["coulomb_friction"]], 1.0) == set()
    firm = replace(rubs["coulomb_friction"], parameters={"torque": {"a": Estimate(1.0, 0.1, "")}})
    assert told_beside_dry([rubs["viscous_friction"], firm], 1.0) == {("viscous_friction", "a")}
    assert told_beside_dry([rubs["reflected_inertia"], firm], 1.0) == {("reflected_inertia", "a")}


def unrubbed(*frictions: float) -> tuple[RobotProblem, np.ndarray]:
    """An arm with dry friction, told of it on all joints that have some but the noisy wrist."""
    dry = effect("coulomb_friction", joints=list(ARM.joints), torque=list(frictions))
    records = noisy(ARM, ARM.with_effects([dry]))
    (made,) = records.records
    torque = made.torque.copy()
    torque[:, WRIST] += RATTLE * np.random.default_rng(5).normal(size=len(torque))
    problem, z = settled(begun(records, equations(replace(records, records=(replace(made, torque=torque),)))))
    own = np.zeros_like(problem.own_free)
    own[:, DRY] = (np.array(frictions) > 0.0) & (np.arange(6) != WRIST)
    return settled(replace(problem, own_free=own), z)


def test_dry_friction_that_is_known_to_a_half_stands_beside_that_of_most_joints() -> None:
    """Of 7 s of an LWR4+ it earned its place on three joints of seven: others were three times as far off."""
    problem, z = unrubbed(*[LEVEL] * 6)
    more = rubbing(problem, z)
    assert more.own_free[WRIST, DRY] and np.sum(more.own_free != problem.own_free) == 1
    fit = solve(more, None, z)
    value = own_part(more, fit)[WRIST, DRY]
    error = np.sqrt(own_part(more, np.diag(covariance(more, fit)))[WRIST, DRY])
    assert value == pytest.approx(LEVEL, abs=2.0 * error) and error > value / 3.0
    assert more.rubs == pytest.approx(LEVEL, rel=0.05)
    assert sure_ones(more)[0].own_free[WRIST, DRY] and not sure_ones(replace(more, rubs=0.0))[0].own_free[WRIST, DRY]


def test_dry_friction_on_few_joints_is_what_is_wrong_with_them() -> None:
    problem, z = unrubbed(LEVEL, LEVEL, 0.0, 0.0, 0.0, LEVEL)
    assert rubbing(problem, z) is problem
    problem, z = unrubbed(*[LEVEL] * 6)
    assert rubbing(replace(problem, known=True), z).rubs == 0.0, "links and joints are as they were found"


def test_a_joint_that_has_none_among_others_that_have_gets_none() -> None:
    problem, z = unrubbed(*[LEVEL] * 5, 0.0)
    assert not rubbing(problem, z).own_free[WRIST, DRY]


def test_friction_that_motion_tells_nothing_of_is_drawn_to_that_of_others_and_told_so() -> None:
    problem, z = unrubbed(*[LEVEL] * 6)
    problem = replace(problem, own_free=np.tile(np.arange(4) == DRY, (6, 1)), rubs=LEVEL)
    deaf = replace(problem, variance=np.where(np.arange(6) == WRIST, 1e12, problem.variance))
    fit = solve(deaf, None, z)
    assert own_part(deaf, fit)[WRIST, DRY] == pytest.approx(LEVEL, rel=0.01)
    assert np.sqrt(own_part(deaf, np.diag(covariance(deaf, fit)))[WRIST, DRY]) >= 0.99 * LEVEL
    assert np.all(own_part(deaf, fit)[:WRIST, DRY] == pytest.approx(LEVEL, rel=0.05))


def test_dry_friction_need_not_be_known_to_a_third_where_drives_are_alike() -> None:
    problem, _ = unrubbed(*[LEVEL] * 6)
    joint = ARM.joints[WRIST]
    rough = [Finding("coulomb_friction", (joint,), (), {"torque": {joint: Estimate(1.0, 0.5, "")}}, 1.0)]
    assert told_beside(rough, 1.0, problem) == set()
    alike = replace(problem, rubs=LEVEL)
    assert told_beside(rough, 1.0, alike) == {("coulomb_friction", joint)}
    assert largest_share(alike, 0.3)[WRIST, DRY] == pytest.approx(np.sqrt(0.5))
    vague = [replace(rough[0], parameters={"torque": {joint: Estimate(1.0, 0.8, "")}})]
    assert told_beside(vague, 1.0, alike) == set()
