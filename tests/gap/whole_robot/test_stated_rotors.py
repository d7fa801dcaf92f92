"""Rotors that a description states: how far they are off is learned from all of an arm's joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, WRIST, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.gap.whole_robot.stated_rotors import ROTOR, TUNING, drawn_to_stated, likeliest_share
from twin_diagram.gap.whole_robot.torque_equations import OWN, equations

STATED, NOISE = 0.05, 18.0


@cache
def fitted(off: tuple[float, ...]) -> tuple[RobotProblem, np.ndarray]:
    """An arm whose stated rotors are off by shares of themselves; its wrist's torque is next to noise alone."""
    given = ARM.with_effects([everywhere("reflected_inertia", inertia=STATED)])
    rotors = [STATED * (1.0 + share) for share in off]
    true = ARM.with_effects([effect("reflected_inertia", joints=list(ARM.joints), inertia=rotors)])
    records = noisy(given, true, 10.0)
    (made,) = records.records
    torque = made.torque.copy()
    torque[:, WRIST] += NOISE * np.random.default_rng(3).normal(size=len(torque))
    records = replace(records, records=(replace(made, torque=torque),))
    return settled(begun(records, equations(records)))


def rotors(problem: RobotProblem, z: np.ndarray) -> np.ndarray:
    return z[10 * problem.n : 14 * problem.n].reshape(problem.n, len(OWN))[:, ROTOR]


def test_a_rotor_that_motion_hardly_tells_is_drawn_to_what_is_stated_as_the_others_bear_out() -> None:
    off = (0.1, -0.1, 0.05, -0.05, 0.1, 0.05)
    problem, z = fitted(off)
    drawn, after = drawn_to_stated(problem, z)
    assert drawn.rotors == min(TUNING.shares)
    before, now = (np.abs(rotors(problem, x) / STATED - off) for x in (z, after))
    assert before[WRIST] > 0.1 and now[WRIST] < 0.5 * before[WRIST]
    others = np.arange(6) != WRIST
    np.testing.assert_allclose(now[others], before[others], atol=0.05)


def test_placeholders_draw_no_rotor() -> None:
    problem, z = fitted((-0.8,) * 6)
    drawn, after = drawn_to_stated(problem, z)
    assert drawn.rotors >= 0.8
    others = np.arange(6) != WRIST
    np.testing.assert_allclose(rotors(problem, after)[others] / STATED, -0.8, atol=0.2)


@pytest.mark.parametrize("joint", range(6))
def test_a_rotor_that_is_not_stated_is_next_to_free(joint: int) -> None:
    problem, _ = fitted((0.1, -0.1, 0.05, -0.05, 0.1, 0.05))
    least = problem.least.copy()
    least[joint, ROTOR] = 0.0
    there = replace(problem, least=least)
    np.testing.assert_array_equal(replace(there, rotors=0.2).own_deviation[joint], there.own_deviation[joint])
    assert likeliest_share(problem, problem.mean, np.array([joint])) == min(TUNING.shares)
