"""Torques along motions against Drake's inverse dynamics, and plans that keep within them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.collision_scene import Scene, load_scene
from twin_diagram.planning.mpc.arm_torque import (
    ArmTorque,
    acceleration_limit,
    chain_of,
    described_acceleration,
    torque_bounds,
)
from twin_diagram.planning.mpc.limits import limits_of
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.signals.arrays import Array

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
FRICTION = scenario.EffectSpec(name="viscous_friction", joints=["panda_joint2"], parameters={"damping": [3.0]})
MASS, COM = 2.0, np.array([0.02, -0.03, 0.11])
PAYLOAD = np.array([MASS, *(MASS * COM)])
NOTHING = np.zeros(4)


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(scenario.ArmModel(effects=[FRICTION]))


@pytest.fixture(scope="module")
def loaded() -> Model:
    payload = scenario.EffectSpec(name="payload", parameters={"mass": [MASS], "com": COM.tolist()})
    return Model.load(scenario.ArmModel(effects=[FRICTION, payload]))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(scenario.ArmModel(), [scenario.Fixture()], {})


def test_torque_is_that_of_inverse_dynamics_with_what_is_carried(model: Model, loaded: Model) -> None:
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-1.5, 1.5, (3, 6, 7)) * np.array([1.0, 0.8, 3.0])[:, None, None]
    for payload, truth in ((NOTHING, model), (PAYLOAD, loaded), (PAYLOAD * np.nan, model)):
        M, load = ArmTorque(model, chain_of(model), payload).mass_and_load(q, v)
        found = np.einsum("kij,kj->ki", M, a) + load
        for k in range(len(q)):
            # The effect `payload` is a point, too.
            np.testing.assert_allclose(found[k], truth.inverse_dynamics(q[k], v[k], a[k]), atol=2e-3)
    heavier = ArmTorque(model, chain_of(model), PAYLOAD).mass_and_load(q, v)[1]
    plain = ArmTorque(model, chain_of(model), NOTHING).mass_and_load(q, v)[1]
    assert np.abs(heavier - plain).max() > 5.0


def test_of_an_arm_that_is_no_chain_nothing_is_carried(model: Model) -> None:
    turned = SimpleNamespace(joint_indices=model.arm.joint_indices[::-1], tool_frame=model.arm.tool_frame)
    other: Any = SimpleNamespace(plant=model.plant, arm=turned)
    assert chain_of(other) is None and chain_of(model) is not None
    q = np.full((1, 7), 0.3)
    found, plain = (ArmTorque(model, None, payload).mass_and_load(q, q) for payload in (PAYLOAD, NOTHING))
    for one, two in zip(found, plain, strict=True):
        np.testing.assert_array_equal(one, two)


def test_bounds_are_the_limit_or_what_is_taken_already(model: Model) -> None:
    arm, limit = ArmTorque(model, chain_of(model), PAYLOAD), np.array([5.0, 20.0, 5.0, 20.0, 5.0, 5.0, 5.0])
    q, v, a = HOME + np.zeros((2, 7)), np.zeros((2, 7)), np.zeros((2, 7))
    a[1, 0] = 8.0
    found = torque_bounds(arm, q, v, a, limit)
    torque = np.einsum("kij,kj->ki", found.mass, a) + found.load
    np.testing.assert_allclose(found.allowed, np.maximum(np.maximum(np.abs(torque), np.abs(found.load)) + 1e-3, limit))
    assert (found.allowed[0] > limit).any() and (found.allowed[1, 0] > 6.0) and found.allowed[0, 0] == 5.0
    # A motion that takes less than rest does may go back to rest.
    a[1] = -np.linalg.solve(found.mass[1], found.load[1])
    lighter = torque_bounds(arm, q, v, a, limit)
    np.testing.assert_allclose(lighter.allowed[1], np.maximum(limit, np.abs(found.load[1]) + 1e-3))


def test_bounds_about_another_motion_are_those_of_its_places_and_speeds(model: Model) -> None:
    arm, limit = ArmTorque(model, chain_of(model), PAYLOAD), np.full(7, 40.0)
    q = HOME + np.linspace(0.0, 0.5, 3)[:, None] * np.ones(7)
    v, still = np.linspace(0.0, 2.0, 3)[:, None] * np.ones(7), np.zeros((3, 7))
    found = torque_bounds(arm, HOME + still, still, still, limit).about(q, v)
    mass, load = arm.mass_and_load(q, v)
    np.testing.assert_array_equal(found.mass, mass)
    np.testing.assert_array_equal(found.load, load)
    assert (found.allowed > np.abs(load)).all(), "going on without acceleration stays allowed"


def test_acceleration_is_limited_by_description_by_torque_and_by_how_soon_speed_is_reached(model: Model) -> None:
    fast = np.full(7, 1e3)
    found = acceleration_limit(model, fast, 0.7)
    rng = np.random.default_rng(5)
    q = rng.uniform(np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi), (300, 7))
    for x in q:
        # One joint alone, from rest, either way: seldom more than is allowed, by little.
        for j, sign in ((1, 1.0), (1, -1.0), (3, 1.0), (6, -1.0)):
            torque = model.inverse_dynamics(x, np.zeros(7), sign * found[j] * np.eye(7)[j])
            assert abs(torque[j]) <= 0.7 * model.effort_limit[j] * 1.06
    assert (acceleration_limit(model, fast, 0.35) < 0.6 * found).all()
    np.testing.assert_allclose(acceleration_limit(model, np.full(7, 0.05), 0.7), 0.5)
    assert np.isinf(described_acceleration(model.plant, model.arm.joint_indices)).all()
    told = Model.load(scenario.ArmModel())
    told.plant.get_joint(told.arm.joint_indices[2]).set_acceleration_limits([-1.5], [2.5])
    np.testing.assert_allclose(described_acceleration(told.plant, told.arm.joint_indices)[[1, 2]], [np.inf, 1.5])
    assert acceleration_limit(told, fast, 0.7)[2] == 1.5


def largest_share(model: Model, planner: MotionPlanner, payload: Array, goal: Array, *, bounded: bool) -> float:
    """Of the torque limit, at the knots of all plans on the way to a goal of joint 2."""
    arm = ArmTorque(model, planner.scene.chain, payload) if bounded else None
    memory, shares = planner.initial(HOME), [0.0]
    for tick in range(24):
        now = tick / 15
        q, v, _ = memory.trajectory.at(np.array([now]))
        memory, report = planner.tick(memory, now, np.concatenate([q[0], v[0]]), np.zeros(0), goal, arm=arm)
        assert report.solved
        knots = memory.trajectory.start + planner.params.step * np.arange(1, planner.params.knots - 1)
        true = ArmTorque(model, planner.scene.chain, payload)
        q, v, a = memory.trajectory.at(knots)
        M, load = true.mass_and_load(q, v)
        torque = np.abs(np.einsum("kij,kj->ki", M, a) + load)
        # Nobody can ask for less than weight alone takes.
        over = np.where(np.abs(load) < planner.limits.torque, torque / planner.limits.torque, 0.0)
        shares.append(float(over.max()))
    assert np.abs(memory.trajectory.position(9.0) - HOME).max() > 0.2
    return max(shares)


def test_plans_keep_within_the_torques_that_weight_and_payload_leave(scene: Scene, model: Model, loaded: Model) -> None:
    params = replace(scenario.Planner(), velocity_share=1.0, acceleration=12.0)
    limits = limits_of(model, scene, model.velocity_limit, params)
    tight = replace(limits, torque=np.array([9.0, 62.0, 25.0, 30.0, 8.0, 8.0, 8.0]))
    planner = MotionPlanner(scene, model.velocity_limit, params, limits=tight)
    # A way that is new leads far from the plan before: bounds that are linearised about that one alone were passed by
    # 6 and 30 %.
    for goal in ([0.0, 1.0, 0.0, 0.0, 0.45, -0.35, 0.5], [0.0, 1.0, 0.0, 0.0, 0.6, -0.26, 0.33]):
        assert largest_share(model, planner, PAYLOAD, np.array(goal), bounded=False) > 1.3
        assert largest_share(model, planner, PAYLOAD, np.array(goal), bounded=True) < 1.03
