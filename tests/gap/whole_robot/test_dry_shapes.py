"""How dry friction sets in: bristles against a closed form, and shapes found with the right level."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, WRIST, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import dry_shapes, estimates
from twin_diagram.gap.whole_robot.dry_shapes import bent, shaped, with_shapes
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.gap.whole_robot.torque_equations import OWN, DryShape, equations
from twin_diagram.model.effects import Effect

LEVEL = 6.0
WAY = 6e-3
SPEED = 0.07


def fitted(records: Records) -> tuple[RobotProblem, np.ndarray]:
    return shaped(*settled(begun(records, equations(records))))


def levels(z: np.ndarray) -> np.ndarray:
    return z[60:84].reshape(6, 4)[:, OWN.index("coulomb")]


@cache
def bending(given: tuple[Effect, ...] = ()) -> Records:
    """An arm whose dry friction builds up over a way."""
    model = ARM.with_effects(list(given))
    records = noisy(model, ARM, 10.0)
    (made,) = records.records
    way = np.stack([bent(made.q[:, j], WAY) for j in range(6)], axis=1)
    return Records(model, (replace(made, torque=made.torque + LEVEL * way),))


def test_bristles_go_to_the_level_exponentially_and_back_after_a_turn() -> None:
    q = np.concatenate([np.linspace(0.0, 0.1, 400), np.linspace(0.1, 0.0, 57)[1:]])
    share = bent(q, 0.01)
    np.testing.assert_allclose(share[:400], 1.0, atol=1e-9)  # it moved before the log began
    np.testing.assert_allclose(share[400:], 2.0 * np.exp(-(0.1 - q[400:]) / 0.01) - 1.0, atol=1e-9)
    np.testing.assert_allclose(bent(np.repeat(q, 3), 0.01)[::3][1:], share[1:])  # what rests bends no further
    assert np.all(bent(np.zeros(5), 0.01) == 0.0)
    np.testing.assert_allclose(bent(-q, 0.01), -share)


def test_bristles_at_rest_follow_each_small_turn() -> None:
    """Against the law, step by step, on an angle that trembles and rests."""
    rng = np.random.default_rng(2)
    q = np.cumsum(rng.choice([-1e-3, 0.0, 2e-3], 500))
    steps, share = np.diff(q), bent(q, WAY)
    for k, step in enumerate(steps):
        sign = np.sign(step)
        expected = sign + (share[k] - sign) * np.exp(-abs(step) / WAY) if step else share[k]
        assert share[k + 1] == pytest.approx(expected, abs=1e-9)


def test_friction_that_builds_up_over_a_way_is_found_with_its_level() -> None:
    problem, z = fitted(bending())
    assert {shape.way for shape in problem.sums.shapes} == {WAY}
    np.testing.assert_allclose(levels(z), LEVEL, rtol=0.02)


def test_a_description_that_states_friction_tells_the_same_level() -> None:
    """What it states changes its shape with the rest: else the sum of both would depend on what was stated."""
    stated = 10.0
    problem, z = fitted(bending((everywhere("coulomb_friction", torque=stated),)))
    assert {shape.way for shape in problem.sums.shapes} == {WAY}
    np.testing.assert_allclose(stated + levels(z), LEVEL, rtol=0.02)


@pytest.mark.parametrize(
    ("crawl", "name", "keys"),
    [(1.6, "stribeck_friction", {"coulomb", "static", "stribeck_velocity"}), (0.3, "coulomb_friction", {"torque"})],
)
def test_friction_that_falls_with_speed_has_its_own_name_and_what_rises_is_coulombs(
    crawl: float, name: str, keys: set[str]
) -> None:
    law = everywhere("stribeck_friction", coulomb=LEVEL, static=crawl * LEVEL, stribeck_velocity=SPEED)
    problem, z = fitted(noisy(ARM, ARM.with_effects([law]), 10.0))
    assert {(shape.speed, shape.crawl) for shape in problem.sums.shapes} == {(SPEED, crawl)}
    np.testing.assert_allclose(levels(z), LEVEL, rtol=0.03)
    k = OWN.index("coulomb")
    own = np.zeros((6, len(OWN)), dtype=bool)
    own[:, k] = True
    only = replace(problem, own_free=own, links_free=np.zeros(6, dtype=bool))
    names = {estimates.name_of(only, j, k) for j in range(6)}
    assert names == {name}
    (told,) = estimates.findings(only, z, np.eye(len(z)) * 1e-4, ARM, {name: 1.0})
    assert told.joints == ARM.joints and set(told.parameters) == keys


@pytest.mark.long
def test_friction_that_rises_on_one_joint_is_found_beside_others_that_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tried on all joints at once, links stand in for what is wrong on the others."""
    rising = effect("stribeck_friction", joints=[ARM.joints[WRIST]], coulomb=0.3, static=0.0, stribeck_velocity=0.12)
    others = [joint for j, joint in enumerate(ARM.joints) if j != WRIST]
    plain = effect("coulomb_friction", joints=others, torque=[40.0] * 5)
    records = noisy(ARM, ARM.with_effects([plain, rising]), 10.0)
    problem, z = fitted(records)
    assert [shape.told for shape in problem.sums.shapes] == [False] * WRIST + [True]
    assert levels(z)[WRIST] == pytest.approx(0.3, rel=0.1)
    short = estimates.falls_short(problem, WRIST)
    assert 0.05 < short < 0.5 and estimates.falls_short(problem, 0) == 0.0
    error = estimates.error_of(problem, z, np.zeros((len(z), len(z))), 60 + 4 * WRIST + OWN.index("coulomb"))
    assert error >= short * levels(z)[WRIST]
    monkeypatch.setattr(dry_shapes, "one_by_one", lambda problem, z, chosen: chosen)
    assert not fitted(records)[0].sums.shapes[WRIST].told


def test_plain_friction_keeps_its_shape_and_back_is_as_before() -> None:
    records = noisy(ARM, ARM.with_effects([everywhere("coulomb_friction", torque=LEVEL)]), 10.0)
    problem, _ = fitted(records)
    assert sum(shape.told for shape in problem.sums.shapes) <= 1
    sums = equations(records)
    there = with_shapes(sums, [DryShape(way=WAY)] * 6)
    assert np.max(np.abs(there.whole - sums.whole)) > 0.0
    np.testing.assert_allclose(with_shapes(there, [DryShape()] * 6).whole, sums.whole)


def test_a_change_with_speed_that_noise_all_but_hides_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """As little evidence comes of whatever else a log of some seconds holds, and bends friction's curve."""
    law = everywhere("stribeck_friction", coulomb=LEVEL, static=0.3 * LEVEL, stribeck_velocity=SPEED)
    records = noisy(ARM, ARM.with_effects([law]), 10.0)
    (made,) = records.records
    torque = made.torque + 0.7 * np.random.default_rng(1).normal(size=made.torque.shape)
    records = replace(records, records=(replace(made, torque=torque),))
    assert not any(shape.speed for shape in fitted(records)[0].sums.shapes)
    monkeypatch.setattr(dry_shapes, "TUNING", replace(dry_shapes.TUNING, speedy=4.0))
    assert any(shape.speed for shape in fitted(records)[0].sums.shapes)


def test_what_does_not_explain_motion_that_is_fitted_is_no_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Left-out motion likes it by what it makes of links, and that is chance."""
    law = everywhere("stribeck_friction", coulomb=LEVEL, static=0.3 * LEVEL, stribeck_velocity=SPEED)
    records = noisy(ARM, ARM.with_effects([law]), 10.0)
    monkeypatch.setattr(dry_shapes, "explained", lambda problem, z: np.zeros(problem.n))
    assert not any(shape.speed for shape in fitted(records)[0].sums.shapes)
