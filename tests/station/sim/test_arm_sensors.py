"""The arm's sensors by themselves: what each port holds, when, and which defects are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import ArmDefects
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.sim.arm_sensors import ArmSensors
from twin_diagram.station.sim.noise import Stream, generator

N, G = 3, 2
STATE = np.array([0.3, -1.2, 2.5, 0.01, 0.02, 0.7, -0.8, 0.9, 0.03, -0.04])
"""Positions of three joints and two fingers, then their speeds."""
TORQUE = np.array([10.0, -20.0, 30.0])
CLEAN = ArmDefects(encoder_bits=40, velocity_noise=0.0, torque_noise=0.0)


def sensed(defects: ArmDefects, until: float, rate: float = 100.0, g: int = G, seed: int = 7) -> dict[str, Any]:
    system = ArmSensors(N, g, defects, rate, seed)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    state = STATE if g else STATE[[0, 1, 2, 5, 6, 7]]
    system.GetInputPort("motor_state").FixValue(context, state)
    system.GetInputPort("torque").FixValue(context, TORQUE)
    simulator.AdvanceTo(until)
    ports = [system.get_output_port(index) for index in range(system.num_output_ports())]
    return {port.get_name(): np.array(port.Eval(context)) for port in ports}


def test_each_port_holds_its_own() -> None:
    found = sensed(CLEAN, 0.025)
    np.testing.assert_allclose(found["position_measured"], STATE[:3], atol=1e-9)
    np.testing.assert_array_equal(found["velocity_estimated"], STATE[5:8])
    np.testing.assert_array_equal(found["torque_measured"], TORQUE)
    np.testing.assert_array_equal(found["gripper_measured"], STATE[[3, 4, 8, 9]])
    np.testing.assert_allclose(found["measurement_time"], [0.02])
    bare = sensed(CLEAN, 0.025, g=0)
    assert "gripper_measured" not in bare
    np.testing.assert_array_equal(bare["velocity_estimated"], STATE[5:8])
    np.testing.assert_array_equal(bare["torque_measured"], TORQUE)


@pytest.mark.parametrize(("until", "time"), [(0.0099, NEVER), (0.0101, 0.01), (0.0301, 0.03)])
def test_message_k_is_taken_at_k_over_the_rate_and_none_at_zero(until: float, time: float) -> None:
    found = sensed(CLEAN, until)
    assert found["measurement_time"][0] == pytest.approx(time)
    assert np.any(found["torque_measured"]) == (time > 0.0)


def test_positions_are_whole_counts() -> None:
    count = 2.0 * np.pi / 2.0**5
    found = sensed(ArmDefects(encoder_bits=5, velocity_noise=0.0, torque_noise=0.0), 0.015)["position_measured"]
    np.testing.assert_allclose(found, count * np.array([2.0, -6.0, 13.0]))
    small = sensed(ArmDefects(encoder_bits=1, velocity_noise=0.0, torque_noise=0.0), 0.015)["position_measured"]
    assert small[0] == 0.0 and not np.signbit(small[0])
    np.testing.assert_allclose(small, [0.0, 0.0, np.pi])
    assert not np.signbit(small[1]), "no negative zero"


def test_noise_and_bias_are_added_as_seed_and_message_say() -> None:
    bias = [0.5, -0.25, 0.125]
    defects = ArmDefects(encoder_bits=40, velocity_noise=0.02, torque_noise=0.3, torque_bias=bias)
    found = sensed(defects, 0.035, seed=11)
    noise = generator(11, Stream.ARM, 3).standard_normal(6)
    np.testing.assert_allclose(found["velocity_estimated"] - STATE[5:8], 0.02 * noise[:3], atol=1e-12)
    np.testing.assert_allclose(found["torque_measured"] - TORQUE - bias, 0.3 * noise[3:], atol=1e-12)


def test_a_gain_is_of_what_is_measured_and_the_bias_comes_after_it() -> None:
    gain, bias = [1.02, 0.99, 1.0], [0.5, -0.25, 0.0]
    found = sensed(ArmDefects(torque_noise=0.0, torque_gain=gain, torque_bias=bias), 0.035)["torque_measured"]
    np.testing.assert_allclose(found, np.array(gain) * TORQUE + bias, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"encoder_bits": 0}, "encoder_bits"),
        ({"encoder_bits": 61}, "encoder_bits"),
        ({"velocity_noise": -1e-9}, "velocity_noise"),
        ({"torque_noise": -1e-9}, "torque_noise"),
        ({"velocity_noise": float("nan")}, "velocity_noise"),
        ({"torque_bias": [1.0, 2.0]}, "torque_bias"),
        ({"torque_gain": [1.0, 2.0]}, "torque_gain"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, Any], field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"world\.arm_defects\.{field}"):
        ArmSensors(N, G, ArmDefects(**change), 100.0, 1)


def test_the_ends_of_what_can_be_are_allowed() -> None:
    for bits in (1, 60):
        ArmSensors(N, G, ArmDefects(encoder_bits=bits, velocity_noise=0.0, torque_noise=0.0), 100.0, 1)
    for rate in (0.0, -1.0):
        with pytest.raises(ScenarioError, match=r"twin\.driver\.rate"):
            ArmSensors(N, G, CLEAN, rate, 1)
