"""A corrected model taken over while filter, monitor and planner run: what stays, what begins anew, and for whom."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from pydrake.systems.framework import Context, LeafSystem

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.estimation.drift_system import DriftMonitor
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.model_swap import hand_over
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.estimation.sensors.from_scenario import make_sensor
from twin_diagram.model.model import Model
from twin_diagram.planning.mpc_system import Mpc
from twin_diagram.scenario import ArmModel, Drift, EffectSpec, Filter, SensorSpec
from twin_diagram.signals.arrays import Array

DT = 0.005
EFFECTS = [
    EffectSpec("coulomb_friction", ["shoulder_lift_joint"], [], {"torque": [12.0]}),
    EffectSpec("payload", [], ["wrist_3_link"], {"mass": [2.0], "com": [0.0, 0.0, 0.1]}),
]
ARM = {"model": "arms/ur5e.urdf", "tool_frame": "tool0"}


@functools.cache
def given() -> Model:
    return Model.load(ArmModel(**ARM))


@functools.cache
def corrected() -> Model:
    return Model.load(ArmModel(**ARM, effects=EFFECTS))


def message(k: int) -> tuple[Array, Array, Array, float]:
    """What the corrected arm would measure while it swings: q, v, motor torque, time."""
    t, w = DT * k, np.array([1.1, 1.3, 0.9, 1.7, 1.5, 1.9])
    q = np.array([0.0, -1.3, 1.4, -1.6, -1.4, 0.0]) + 0.5 * np.sin(w * t + 0.4)
    v, a = 0.5 * w * np.cos(w * t + 0.4), -0.5 * w**2 * np.sin(w * t + 0.4)
    return q, v, corrected().inverse_dynamics(q, v, a), t


def tick(system: LeafSystem, context: Context, k: int) -> None:
    for name, value in zip(
        ("position_measured", "velocity_estimated", "torque_measured", "measurement_time"), message(k), strict=True
    ):
        system.GetInputPort(name).FixValue(context, np.atleast_1d(value))
    context.SetTime(DT * k)
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))


def run(system: AdaptiveEkf, context: Context, first: int, count: int) -> Array:
    """NIS (count,) of some messages."""
    found = []
    for k in range(first, first + count):
        tick(system, context, k)
        found.append(system.belief(context).header[Entry.NIS])
    return np.array(found)


def test_the_running_filter_goes_on_with_the_corrected_model() -> None:
    tuning = Filter()
    system, plain = AdaptiveEkf(given(), tuning), AdaptiveEkf(given(), tuning)
    context, other, alone = system.CreateDefaultContext(), system.CreateDefaultContext(), plain.CreateDefaultContext()
    run(system, context, 0, 120)
    run(system, other, 0, 120)
    before = system.belief(context)
    number = system.add_model(corrected())
    assert (number, system.model_number(context)) == (1, 0)
    assert np.array_equal(system.belief(context).vector, before.vector), "a model that nobody uses changes nothing"

    system.use_model(context, number)
    after, arm = system.belief(context), slice(0, 12)
    assert system.model_number(context) == 1
    assert np.array_equal(after.x[arm], before.x[arm]) and np.array_equal(after.P[arm, arm], before.P[arm, arm])
    assert after.time == before.time and after.header[Entry.ACCEPTED] == before.header[Entry.ACCEPTED]
    prior = Ekf(ArmTerms.from_model(corrected()), tuning).parameters
    assert np.array_equal(after.theta, prior.mean) and np.array_equal(after.P[18:22, 18:22], prior.covariance)
    assert not after.disturbance.any() and not after.P[18:22, :18].any()
    assert np.linalg.eigvalsh(after.P).min() > 0.0

    wrong, right = run(system, other, 120, 120), run(system, context, 120, 120)
    assert np.mean(right) < 0.2 * np.mean(wrong)
    assert abs(system.belief(context).theta[0]) < 0.05, "the payload is in the model: none is learnt a second time"
    # The other Context of the same system never heard of it.
    run(plain, alone, 0, 240)
    assert np.array_equal(system.belief(other).vector, plain.belief(alone).vector)


def test_the_way_back() -> None:
    system = AdaptiveEkf(given(), Filter())
    context = system.CreateDefaultContext()
    run(system, context, 0, 30)
    system.use_model(context, system.add_model(corrected()))
    system.use_model(context, 0)
    assert system.model_number(context) == 0
    with pytest.raises(IndexError):
        system.use_model(context, 7)


def test_a_filter_with_sensors_keeps_their_states() -> None:
    spec = SensorSpec(kind="imu", name="wrist_imu")
    old, new = (Ekf(ArmTerms.from_model(model), Filter()) for model in (given(), corrected()))
    for ekf in (old, new):
        ekf.add(make_sensor(ekf.terms, spec))
    for k in range(60):
        old.observe(*message(k))
        z = old.linear(old.find("wrist_imu"), old.belief.x, old.belief.P, 0).reading
        old.update("wrist_imu", z + 0.01, DT * k)
    hand_over(old.belief, new)
    assert old.belief.own.any() and np.array_equal(new.belief.own, old.belief.own)
    assert np.array_equal(new.belief.P[22:, 22:], old.belief.P[22:, 22:])
    assert np.array_equal(new.belief.tracks[0], old.belief.tracks[0])
    new.observe(*message(60))
    assert new.update("wrist_imu", np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8]), DT * 59.5).late

    with pytest.raises(FilterError, match="cannot hand over"):
        hand_over(Belief(6, 0), new)


def test_another_arm_is_refused() -> None:
    panda = Model.load(ArmModel())
    with pytest.raises(ModelError, match="7 joints where the filter has 6"):
        AdaptiveEkf(given(), Filter()).add_model(panda)


def test_before_the_first_message() -> None:
    system = AdaptiveEkf(given(), Filter())
    context = system.CreateDefaultContext()
    system.use_model(context, system.add_model(corrected()))
    assert not system.belief(context).valid
    assert np.mean(run(system, context, 0, 60)[20:]) < 12.0


def test_the_monitor_keeps_what_is_normal_and_forgets_the_alarm() -> None:
    system = DriftMonitor(given(), Drift(), Filter())
    context, other = system.CreateDefaultContext(), system.CreateDefaultContext()
    monitor = system.monitor
    n, state = 6, np.concatenate(message(0)[:2])
    for k in range(1200):
        q, v, tau, t = message(k)
        loud = 400.0 if k > 1150 else 12.0
        monitor.observe(np.concatenate([q, v]), np.zeros(4), loud, q, tau, t, t, np.full(n, 3.0 if k > 1150 else 0.0))
    assert monitor.armed and monitor.active and len(state) == 2 * n
    context.SetDiscreteState(0, monitor.vector)
    header = system.header(context)
    raised = system.events(context)
    system.use_model(context, system.add_model(corrected()))
    after = system.header(context)
    assert system.GetOutputPort("alarm").Eval(context)[0] == 0.0
    assert after["normal"] == header["normal"] and after["mean"] == header["mean"]
    assert after["sum"] == after["change"] == after["rollout"] == 0.0
    assert system.events(context) == raised, "what was raised stays on record"
    assert (system.model_number(context), system.model_number(other)) == (1, 0)


def test_the_planner_asks_for_what_the_corrected_model_needs() -> None:
    told = scenario.Twin(arm=ArmModel(**ARM), camera=None, home=[0.0, -1.3, 1.4, -1.6, -1.4, 0.0])
    system = Mpc(given(), told, {})
    context = system.CreateDefaultContext()
    q = np.array([0.3, -1.0, 1.2, -1.6, -1.2, 0.0])
    system.GetInputPort("arm_state").FixValue(context, np.concatenate([q, np.zeros(6)]))
    system.GetInputPort("parameters").FixValue(context, np.zeros(4))
    assert not system.GetOutputPort("torque_commanded").Eval(context).any()
    system.use_model(context, system.add_model(corrected()))
    expected = corrected().plant
    asked = system.GetOutputPort("torque_commanded").Eval(context)
    # The payload's weight about the second joint, by hand: m g times the horizontal distance.
    own = expected.CreateDefaultContext()
    expected.SetPositions(own, q)
    X_WL = expected.GetFrameByName("wrist_3_link").CalcPoseInWorld(own)
    joint = expected.GetJointByName("shoulder_lift_joint").frame_on_child().CalcPoseInWorld(own)
    arm = (X_WL @ np.array([0.0, 0.0, 0.1])) - joint.translation()
    axis = joint.rotation().matrix() @ expected.GetJointByName("shoulder_lift_joint").revolute_axis()
    assert asked[1] == pytest.approx(-axis @ np.cross(arm, [0.0, 0.0, -2.0 * 9.81]), abs=1e-9)
    with pytest.raises(IndexError):
        system.use_model(context, 5)
