"""What may be learnt: priors, bounds, openings and torque of each block, on arms whose figures are known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import constant_friction, crank, gantry
from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.scenario import Filter

EFFORT = np.array([40.0, 20.0])
LAWS = constant_friction(2.0, 1.0, backward=(4.0, 3.0))
LEVEL, DAMPING = np.array([3.0, 2.0]), np.array([6.0, 0.5])
ALL = ["payload", "torque_bias", "viscous_friction", "coulomb_friction", "torque_constant"]


def learnt(*names: str, **more: float) -> ParameterSet:
    return ParameterSet(gantry(LAWS, tuple(DAMPING)), Filter(parameters=list(names), **more))


def test_a_bias_is_known_to_a_fiftieth_of_the_effort_and_bound_to_a_fifth() -> None:
    found = learnt("torque_bias")
    np.testing.assert_allclose(found.covariance, np.diag((0.02 * EFFORT) ** 2))
    np.testing.assert_array_equal(found.opening, found.covariance)
    for sign in (1.0, -1.0):
        theta = sign * 99.0 * np.ones(2)
        found.clip(theta)
        np.testing.assert_allclose(theta, sign * 0.2 * EFFORT)
    assert not found.freeable.any() and found.groups == [slice(0, 1), slice(1, 2)]
    np.testing.assert_array_equal(found.push(np.array([0.3, -0.2]), EFFORT), [0.3, -0.2])


@pytest.mark.parametrize(("name", "level"), [("viscous_friction", DAMPING), ("coulomb_friction", LEVEL)])
def test_friction_is_off_by_three_tenths_and_may_change_together(name: str, level: np.ndarray) -> None:
    """Beside half a hundredth of the effort; bound to a tenth of it or twice its level, never negative in all."""
    found = learnt(name)
    np.testing.assert_allclose(found.covariance, np.diag((0.005 * EFFORT) ** 2 + (0.3 * level) ** 2))
    opening = 0.5 * np.outer(level, level)
    np.testing.assert_allclose(found.opening, opening + np.diag(0.5 * level**2))
    assert found.groups == [slice(0, 2)]
    np.testing.assert_array_equal(found.freeable, [True, True])
    upper, lower = np.full(2, 99.0), np.full(2, -99.0)
    found.clip(upper)
    found.clip(lower)
    np.testing.assert_allclose(upper, np.maximum(0.1 * EFFORT, 2.0 * level))
    np.testing.assert_allclose(lower, -level)


def test_little_friction_is_opened_as_far_as_its_prior() -> None:
    found = ParameterSet(gantry(constant_friction(0.01, 0.01)), Filter(parameters=["coulomb_friction"]))
    np.testing.assert_allclose(found.opening.diagonal(), found.covariance.diagonal())
    assert found.opening[0, 1] == pytest.approx(0.5e-4)
    lower = np.full(2, -99.0)
    found.clip(lower)
    np.testing.assert_allclose(lower, -0.01)


def test_a_torque_constant_is_known_to_its_tolerance_and_a_motor_may_have_lost_all() -> None:
    found = learnt("torque_constant")
    np.testing.assert_allclose(found.covariance, 0.02**2 * np.eye(2))
    np.testing.assert_allclose(found.opening, 0.25 * np.eye(2))
    theta = np.array([5.0, -5.0])
    found.clip(theta)
    np.testing.assert_array_equal(theta, [1.0, -1.0])
    np.testing.assert_allclose(found.push(np.array([0.5, -0.25]), np.array([8.0, 4.0])), [4.0, -1.0])


def test_a_payload_s_prior_is_a_mass_about_the_tool() -> None:
    """Second moments of independent mass and centre, by drawing; the crank's tool is 0.8 m out."""
    found = ParameterSet(crank(), Filter(mass_std=1.5, com_std=0.2))
    rng = np.random.default_rng(1370)
    mass, centre = 1.5 * rng.normal(size=400_000), np.array([0.8, 0.0, 0.0]) + 0.2 * rng.normal(size=(400_000, 3))
    drawn = np.column_stack([mass, mass[:, None] * centre])
    np.testing.assert_allclose(found.covariance, drawn.T @ drawn / len(drawn), atol=0.015)
    np.testing.assert_array_equal(found.opening, found.covariance)
    assert found.payload == slice(0, 4) and not found.mean.any()


@pytest.mark.parametrize(
    ("mass", "far", "within"),
    [(2.0, 0.999, True), (2.0, 1.001, False), (0.1, 0.999, True), (0.05, 1.999, True), (0.05, 2.001, False)],
)
def test_a_payload_s_centre_lies_within_five_deviations_of_the_tool(mass: float, far: float, within: bool) -> None:
    """1 m for 0.2; while it weighs less than a tenth of its prior, as if it weighed that."""
    found = ParameterSet(crank(), Filter(mass_std=1.0, com_std=0.2))
    way = np.array([0.6, 0.0, -0.8])
    theta = np.concatenate([[mass], mass * (np.array([0.8, 0.0, 0.0]) + far * way)])
    kept = theta.copy()
    found.clip(theta)
    if within:
        np.testing.assert_array_equal(theta, kept)
    else:
        reach = 1.0 * max(mass, 0.1) / mass
        np.testing.assert_allclose(theta[1:], mass * (np.array([0.8, 0.0, 0.0]) + reach * way))
    for wrong, right in ((-1.0, 0.0), (11.0, 10.0), (9.9, 9.9)):
        theta = np.array([wrong, 0.0, 0.0, 0.0])
        found.clip(theta)
        assert theta[0] == right


def test_regressors_are_what_the_motors_must_give_more() -> None:
    found, terms = learnt(*ALL), gantry(LAWS, tuple(DAMPING))
    q, v, a, tau = np.zeros(2), np.array([0.5, -2e-3]), np.array([3.0, 4.0]), np.array([8.0, -6.0])
    Y = found.regressor(terms, q, v, a, tau)
    expected = np.zeros((2, 12))
    expected[:, 0] = a  # a kilogram more for both slides to carry
    expected[:, 4:6] = -np.eye(2)
    expected[:, 6:8] = np.diag(v)
    expected[:, 8:10] = np.diag(v / np.sqrt(v**2 + 1e-6))
    expected[:, 10:] = np.diag(-tau)
    np.testing.assert_allclose(Y, expected, atol=1e-12)
    sure = np.array([0.5, 0.25])
    expected[:, 6:10] *= sure[:, None]  # friction counts as far as a joint surely slides
    np.testing.assert_allclose(found.regressor(terms, q, v, a, tau, sure), expected, atol=1e-12)


def test_blocks_are_stacked_in_the_order_given() -> None:
    found = learnt("torque_constant", "payload", "viscous_friction")
    assert found.size == 8 and found.slices == [slice(0, 2), slice(2, 6), slice(6, 8)] and found.payload == slice(2, 6)
    assert found.groups == [slice(0, 1), slice(1, 2), slice(2, 6), slice(6, 8)]
    theta = np.arange(8.0)
    np.testing.assert_array_equal(found.payload_of(theta), [2.0, 3.0, 4.0, 5.0])
    np.testing.assert_array_equal(found.viscous(theta, DAMPING), DAMPING + [6.0, 7.0])
    np.testing.assert_array_equal(found.viscous(-theta, DAMPING), [0.0, 0.0])
    np.testing.assert_array_equal(found.push(theta, np.array([2.0, 3.0])), [0.0, 3.0])
    assert found.dry(theta) == 0.0
    np.testing.assert_array_equal(learnt("coulomb_friction").dry(np.array([1.0, -2.0])), [1.0, -2.0])
    np.testing.assert_allclose(found.scale, np.sqrt(found.covariance.diagonal()))
    assert found.labels(["x", "y"])[:3] == ["torque_constant.x [1]", "torque_constant.y [1]", "payload.mass [kg]"]
    np.testing.assert_array_equal(found.freeable, [True, True, *[False] * 4, True, True])
    none = learnt()
    assert none.size == 0 and none.payload is None and not none.payload_of(np.zeros(0)).any()
    for names in (["gravity"], ["payload", "payload"]):
        with pytest.raises(ScenarioError, match=names[0]):
            learnt(*names)


def test_only_what_is_opened_wide_can_be_given_up() -> None:
    """An opening of more than twice the prior's variance."""
    for share, freeable in ((0.68, True), (0.72, False)):
        level = 3.0
        effort = np.sqrt((share * level) ** 2 - (0.3 * level) ** 2) / 0.005
        arm = crank(constant_friction(level), effort=float(effort))
        assert ParameterSet(arm, Filter(parameters=["coulomb_friction"])).freeable[0] == freeable
