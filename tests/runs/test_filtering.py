"""The filter over a log in memory: against the same calls one by one, and against the true motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.logs import Log
from twin_diagram.model.model import Model
from twin_diagram.runs.filtering import filter_log
from twin_diagram.scenario import ArmModel, Filter
from twin_diagram.signals.arrays import Array

URDF = """<robot name="gantry">
  <link name="base"/>
  <link name="cart"><inertial><mass value="6"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="2" effort="300"/></joint>
  <joint name="shoulder" type="revolute"><parent link="cart"/><child link="upper"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="80"/></joint>
</robot>
"""
PERIOD = 0.004


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    path = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    path.write_text(URDF)
    return Model.load(ArmModel(model=str(path), joints=["rail", "shoulder"], tool_frame=""))


def recorded(model: Model, velocities: bool, gap: float = 0.0, count: int = 250) -> tuple[Log, Array]:
    """A log of smooth motion, with a gap after its hundredth sample, and the true [q, v]."""
    time = PERIOD * np.arange(count)
    time[100:] += gap
    w = np.array([3.0, 4.0])
    q = 0.3 * np.sin(np.outer(time, w)) + [0.0, 0.4]
    v, a = 0.3 * w * np.cos(np.outer(time, w)), -0.3 * w**2 * np.sin(np.outer(time, w))
    tau = model.inverse_dynamics(q, v, a)
    noisy = q + 1e-5 * np.random.default_rng(0).normal(size=q.shape)
    log = Log(time, ("rail", "shoulder"), noisy, velocity=v if velocities else None, torque=tau)
    return log, np.hstack([q, v])


@pytest.mark.parametrize("velocities", [True, False])
def test_states_follow_the_true_motion(model: Model, velocities: bool) -> None:
    log, truth = recorded(model, velocities)
    ekf, states = filter_log(model, log, ["viscous_friction"])
    assert states.shape == (250, 4)
    np.testing.assert_allclose(states[100:, :2], truth[100:, :2], atol=5e-5)  # of five deviations
    error = np.sqrt(np.mean((states[100:, 2:] - truth[100:, 2:]) ** 2))
    assert error < (1e-3 if velocities else 4e-3)
    assert [label.split(".")[0] for label in ekf.labels(log.joints)] == ["viscous_friction"] * 2


@pytest.mark.parametrize("velocities", [True, False])
def test_a_log_may_begin_before_zero(model: Model, velocities: bool) -> None:
    """Its times may be counted from a trigger: every message counted as none, and all states were zeros."""
    log, _ = recorded(model, velocities, count=60)
    _, expected = filter_log(model, log, [])
    _, states = filter_log(model, replace(log, time=log.time - 3.0), [])
    np.testing.assert_allclose(states, expected, atol=1e-9)


def test_messages_are_given_as_they_came(model: Model) -> None:
    log, _ = recorded(model, velocities=True, count=60)
    _, states = filter_log(model, log, [])
    ekf = Ekf(ArmTerms.from_model(model), Filter(rate=250.0, parameters=[]))
    assert log.velocity is not None and log.torque is not None
    for k in range(60):
        ekf.observe(log.position[k], log.velocity[k], log.torque[k], log.time[k])
        np.testing.assert_allclose(states[k], ekf.belief.x[:4], atol=1e-9)


@pytest.mark.parametrize(("gap", "anew"), [(0.0, False), (0.24, False), (0.25, True), (0.4, True)])
def test_encoders_alone_are_fused_one_by_one(model: Model, gap: float, anew: bool) -> None:
    """The step across the gap is 4 ms longer: a quarter of a second at most is predicted."""
    log, _ = recorded(model, velocities=False, gap=gap, count=130)
    _, states = filter_log(model, log, [])
    ekf = Ekf(ArmTerms.from_model(model), Filter(rate=250.0, parameters=[]))
    assert log.torque is not None
    for k in range(130):
        if k == 0 or (anew and k == 100):
            velocity = (log.position[k + 1] - log.position[k]) / PERIOD
            ekf.start(log.position[k], velocity, log.torque[k], log.time[k])
            np.testing.assert_allclose(states[k], np.r_[log.position[k], velocity], atol=1e-9)
        else:
            mean = (log.torque[k - 1] + log.torque[k]) / 2
            ekf.predict(mean, log.time[k] - log.time[k - 1])
            ekf.update("encoder", log.position[k], log.time[k])
        np.testing.assert_allclose(states[k], ekf.belief.x[:4], atol=1e-7)


def test_a_last_sample_after_a_gap_stands_still(model: Model) -> None:
    log, _ = recorded(model, velocities=False, gap=0.5, count=101)
    _, states = filter_log(model, log, [])
    np.testing.assert_array_equal(states[100], np.r_[log.position[100], 0.0, 0.0])


def test_velocities_of_one_joint_alone_are_none(model: Model) -> None:
    """The filter takes a message's whole; NaN of the other joint would be a state of NaN."""
    log, _ = recorded(model, velocities=True, count=60)
    assert log.velocity is not None
    half = replace(log, velocity=np.where([True, False], log.velocity, np.nan))
    _, expected = filter_log(model, replace(log, velocity=None), [])
    _, states = filter_log(model, half, [])
    np.testing.assert_array_equal(states, expected)
