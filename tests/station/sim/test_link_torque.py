"""Torques behind the gears: what the arm's description says without rotors and friction, whatever these are."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from twin_diagram.errors import ScenarioError
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmDefects, ArmModel, EffectSpec, Scenario
from twin_diagram.scenario.validation import check_twin
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports
from twin_diagram.station.sim.station import SimStation

UR5E = {"model": "arms/ur5e.urdf", "tool_frame": "tool0"}
FRICTION = EffectSpec("coulomb_friction", ["shoulder_lift_joint"], [], {"torque": [6.0]})
GEAR = EffectSpec("joint_elasticity", ["elbow_joint"], [], {"stiffness": [8000.0], "rotor_inertia": [0.5]})
PAYLOAD = EffectSpec("payload", [], [], {"mass": [1.5], "com": [0.0, 0.03, 0.05]})


def swung(side: str, *effects: EffectSpec, duration: float = 1.0) -> tuple[Array, Array]:
    """Times with measured positions, speeds, torques (N, 3, 6) of an arm that swings about its home."""
    plan = Scenario(seed=3)
    plan.twin.arm, plan.world.arm = ArmModel(**UR5E), ArmModel(**UR5E, effects=list(effects))
    plan.twin.home, plan.twin.camera = [0.0, -1.3, 1.4, -1.6, -1.4, 0.0], None
    plan.world.objects, plan.world.fixtures = {}, []
    plan.world.time_step, plan.world.arm_defects = 0.0025, ArmDefects(30, 0.0, 0.0)
    plan.twin.driver.torque_side = side
    station = SimStation(plan)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    names = (ports.POSITION_MEASURED, ports.VELOCITY_ESTIMATED, ports.TORQUE_MEASURED)
    times, rows = [], []
    for k in range(round(duration * 400.0)):
        now = k / 400.0
        command = np.array(plan.twin.home) + 0.3 * (1.0 - np.cos(2.0 * np.pi * now)) * np.array([1, -1, 1, 1, -1, 1])
        station.GetInputPort(ports.POSITION_COMMANDED).FixValue(context, command)
        simulator.AdvanceTo(now + 1e-7)
        times.append(now)
        rows.append([np.array(station.GetOutputPort(name).Eval(context)) for name in names])
    return np.array(times), np.array(rows)


def residual(side: str, *effects: EffectSpec, told: tuple[EffectSpec, ...] = ()) -> Array:
    """RMS (6,) of torque that a model of that side does not explain [N·m], and of the torque itself."""
    times, rows = swung(side, *effects)
    q, v, tau = rows[40:, 0], rows[40:, 1], rows[40:, 2]
    model = Model.load(ArmModel(**UR5E, effects=list(told)), torque_side=side)
    a = np.gradient(v, times[40:], axis=0)
    off = tau - model.inverse_dynamics(q, v, a)
    return np.asarray(np.sqrt((off[3:-3] ** 2).mean(axis=0)))


def test_behind_the_gears_neither_rotor_nor_friction_shows() -> None:
    assert (residual("link", FRICTION) < [0.35, 0.35, 0.35, 0.1, 0.1, 0.05]).all()
    assert residual("motor", FRICTION)[1] > 3.0, "there the friction shows"


def test_a_load_shows_on_both_sides() -> None:
    assert (residual("link", PAYLOAD, told=(PAYLOAD,)) < [0.4, 0.4, 0.4, 0.1, 0.1, 0.05]).all()
    assert residual("link", PAYLOAD)[1] > 5.0


def test_of_a_gear_that_yields_the_link_is_behind_it() -> None:
    # The joints stand in another order in the plant then: the other ones' torques must still be their own.
    assert (residual("link", GEAR)[[0, 1, 3, 4, 5]] < [0.5, 0.5, 0.2, 0.2, 0.1]).all()


def test_another_side_is_refused_with_the_field() -> None:
    plan = Scenario()
    plan.twin.driver.torque_side = "output"
    with pytest.raises(ScenarioError, match=r"twin\.driver\.torque_side.*motor, link"):
        check_twin(plan.twin)
