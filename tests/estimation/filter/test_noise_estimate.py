"""How noisy the sensors are: found where the given figures are wrong, left alone during an alarm."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from pydrake.math import RotationMatrix

from tests.estimation_bench import HOME, JOINTS, Recording, World, simulate, twin_terms
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.process_model import step
from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.disturbance import TUNING as DISTURBANCE
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.noise_estimate import (
    TUNING as NOISE_ESTIMATE,
)
from twin_diagram.estimation.filter.noise_estimate import (
    WIDEST,
    follow_sensor,
    gain,
    held,
    scaled,
)
from twin_diagram.estimation.sensors import BodyPose, LinkImu
from twin_diagram.scenario import Filter
from twin_diagram.signals.layouts import NEVER, AlarmKind
from twin_diagram.signals.rotations import exp, multiply

POSITION, SPEED, TORQUE = 2e-4, 4e-3, 0.3

VISIBLE = slice(0, 3)
"""The joints that are heavy enough for their encoders' noise to show beside what the torque's does."""


@functools.cache
def terms() -> ArmTerms:
    """Without dry friction, so that nothing but noise is left to find."""
    return ArmTerms(twin_terms().plant, JOINTS, tool_frame="panda_tcp")


@functools.cache
def noisy() -> Recording:
    """An arm that swings, moved by the very step of the filter, with white noise in torque and sensors."""
    arm, ekf = terms(), Ekf(terms(), Filter(parameters=[]))
    rng = np.random.default_rng(1202)
    count = 1800
    run = Recording(*(np.zeros((count, 7)) for _ in range(6)))
    run.time = 0.005 * np.arange(count)
    run.q_true[0] = HOME
    for k in range(count):
        if k:  # the filter takes the mean of two messages' torques for the step that ends with the second
            tau = 0.5 * (run.tau[max(k - 2, 0)] + run.tau[k - 1])
            pushed = TORQUE * rng.normal(size=7)
            moved = step(arm, ekf.parameters, run.q_true[k - 1], run.v_true[k - 1], np.zeros(0), tau, pushed, 0.005)
            late = TORQUE * rng.normal(size=7)  # when within the step it acted: see `propagate`
            held_back = moved.mass + 0.005 * np.diag(moved.drag)
            run.q_true[k] = moved.q + 0.005**2 / np.sqrt(12.0) * np.linalg.solve(held_back, late)
            run.v_true[k] = moved.v
        q, v = run.q_true[k], run.v_true[k]
        a = 3.0 * np.cos(run.time[k] * np.linspace(3.0, 5.0, 7)) + 20.0 * (HOME - q) - 2.0 * v
        run.tau[k] = arm.inverse_dynamics(q, v, a)
    run.tau[1:] = run.tau[:-1].copy()
    run.q = run.q_true + POSITION * rng.normal(size=run.q.shape)
    run.v = run.v_true + SPEED * rng.normal(size=run.v.shape)
    return run


def follow(ekf: Ekf, run: Recording, until: float = np.inf) -> None:
    for k in range(len(run.time)):
        if run.time[k] < until:
            ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])


@pytest.mark.long
@pytest.mark.parametrize("wrong", [3.0, pytest.param(1.0 / 3.0, marks=pytest.mark.slow)])
def test_wrong_noise_is_found(wrong: float) -> None:
    ekf = Ekf(terms(), Filter(encoder_std=wrong * POSITION, velocity_std=wrong * SPEED, noise_time=0.5))
    run = noisy()
    follow(ekf, run)
    moved = VISIBLE
    assert np.all(np.mean(np.abs(run.v_true[300:, moved]) > 2.0 * DISTURBANCE.creep, axis=0) > 0.5)
    found = ekf.noise()
    np.testing.assert_allclose(wrong * found["encoder"][moved], 1.0, atol=0.2)
    np.testing.assert_allclose(wrong * found["velocity"][moved], 1.0, atol=0.2)


@pytest.mark.long
def test_right_noise_is_kept() -> None:
    ekf = Ekf(terms(), Filter(encoder_std=POSITION, velocity_std=SPEED))
    follow(ekf, noisy())
    for name in ("encoder", "velocity"):
        np.testing.assert_allclose(ekf.noise()[name], 1.0, atol=0.2)


@pytest.mark.slow
def test_noise_has_settled_before_a_monitor_has_learnt() -> None:
    """Told five times too large, the speeds' noise is within twice after two seconds (3.3 by a span of two alone)."""
    ekf, run, found = Ekf(terms(), Filter(encoder_std=POSITION, velocity_std=5.0 * SPEED)), noisy(), []
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        found.append(5.0 * ekf.noise()["velocity"][VISIBLE])
    assert np.all(found[400] < 2.0)
    np.testing.assert_allclose(found[600:], 1.0, atol=0.5)
    np.testing.assert_allclose(found[-1], 1.0, atol=0.15)


def test_noise_told_far_too_small_is_found_and_not_taken_for_torque() -> None:
    """What surprises for longer than a hold is noise, and found within tenths of a second; torque is no culprit."""
    ekf = Ekf(terms(), Filter(encoder_std=POSITION, velocity_std=0.2 * SPEED))
    follow(ekf, noisy(), 2.0)
    np.testing.assert_allclose(0.2 * ekf.noise()["velocity"][:2], 1.0, atol=0.3)
    assert np.all(ekf.noise()["torque"][VISIBLE] < 2.5)  # 6, were it as eager after the hold
    assert ekf.belief.header[Entry.NIS_MEAN] < 1.5


def test_first_readings_count_for_more() -> None:
    assert gain(0.005, 2.0, 0.0) == NOISE_ESTIMATE.largest_step
    assert gain(0.005, 2.0, 1e6) == 0.005 / 2.0
    rising = [gain(0.005, 2.0, n) for n in range(2000)]
    assert np.all(np.diff(rising) <= 0.0)
    assert np.sum(rising[:400]) > np.log(25.0)  # a deviation five times too large comes down within two seconds


@pytest.mark.long
def test_stands_still_while_an_alarm_is_on() -> None:
    ekf = Ekf(terms(), Filter(encoder_std=3.0 * POSITION, velocity_std=SPEED))
    run = noisy()
    follow(ekf, run, 2.0)
    ekf.hold_noise(4.0)
    before = ekf.belief.noise.copy()
    for k in np.flatnonzero(run.time >= 2.0):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        if run.time[k] < 4.0:
            np.testing.assert_array_equal(ekf.belief.noise, before)
    assert np.abs(ekf.belief.noise - before).max() > 0.1  # and then goes on


def test_stands_still_by_itself_and_not_for_ever() -> None:
    belief = Belief(1, 0)
    assert not held(belief, 0.5, False)
    assert held(belief, 1.0, True)
    assert held(belief, 1.0 + 0.9 * NOISE_ESTIMATE.hold, False)
    assert held(belief, 1.0 + 0.95 * NOISE_ESTIMATE.hold, True)  # goes on, but is not made longer
    assert not held(belief, 1.0 + 1.1 * NOISE_ESTIMATE.hold, True)
    assert not held(belief, 1.0 + 1.9 * NOISE_ESTIMATE.hold, True)
    assert held(belief, 1.0 + 2.1 * NOISE_ESTIMATE.hold, True)
    assert belief.header[Entry.ALARM] == pytest.approx(1.0 + 3.1 * NOISE_ESTIMATE.hold)


def test_alarm_is_heeded_once() -> None:
    """It holds the noise while it stands; if new and about the joints, it opens the parameters; a sensor's never."""
    run, ekf = noisy(), Ekf(terms(), Filter(parameters=["payload"], encoder_std=POSITION, velocity_std=SPEED))
    header = ekf.belief.header
    ekf.heed(np.array([1.0, AlarmKind.INNOVATION, 0.5, 2.0]))  # nothing to open yet
    assert header[Entry.HEEDED] == 0.0
    follow(ekf, run, 1.0)
    openings, std = header[Entry.OPENINGS], np.sqrt(ekf.belief.P[21, 21])
    header[Entry.ALARM] = 0.0
    for kind, raised, active in ((0, NEVER, 0), (3, 0.98, 1), (1, np.nan, 1), (1, np.inf, 0)):
        ekf.heed(np.array([active, kind, raised, 2.0]))
        assert header[Entry.OPENINGS] == openings
        assert (header[Entry.ALARM] > ekf.belief.time) == (kind != 0)
    ekf.heed(np.array([0.0, AlarmKind.ROLLOUT, 0.99, 2.0]))
    assert header[Entry.OPENINGS] == openings + 1
    assert np.sqrt(ekf.belief.P[21, 21]) > 5.0 * std
    opened = ekf.belief.P.copy()
    ekf.heed(np.array([1.0, AlarmKind.ROLLOUT, 0.99, 3.0]))
    np.testing.assert_array_equal(ekf.belief.P, opened)


@pytest.mark.long
def test_fault_is_not_taken_for_noise() -> None:
    """A dead motor, with the alarm that a monitor raises 20 ms later: no sensor is believed less for it."""
    run = simulate(World.draw(1203, period=2.0, dead_joint=1, dead_at=4.0), 5.0)
    ekf = Ekf(twin_terms(), Filter(parameters=["payload"]))
    follow(ekf, run, 4.02)
    before = ekf.belief.noise.copy()
    ekf.hold_noise(6.0)
    for k in np.flatnonzero(run.time >= 4.02):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    np.testing.assert_array_equal(ekf.belief.noise, before)
    assert np.abs(before).max() < WIDEST


@pytest.mark.slow
def test_camera_finds_its_own() -> None:
    run = noisy()
    ekf = Ekf(terms(), Filter(encoder_std=POSITION, velocity_std=SPEED, noise_time=1.0))
    camera = BodyPose(ekf.terms, "panda_hand", std_p=0.009, std_r=0.004, name="camera")
    ekf.add(camera)
    rng = np.random.default_rng(4)
    for k in range(len(run.time)):
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
        if k % 4 == 0:
            R, p = camera.frame.pose(run.q_true[k])
            angle = rng.normal(0.0, 0.012, 3)
            z = _turned(R, angle, p + rng.normal(0.0, 0.003, 3))
            ekf.update("camera", z, run.time[k])
    given = np.repeat([0.004, 0.009], 3)
    np.testing.assert_allclose(given * ekf.noise()["camera"], np.repeat([0.012, 0.003], 3), rtol=0.2)


@pytest.mark.long
def test_resting_arm_says_nothing_of_a_gyroscope() -> None:
    """What friction may do to a joint that rests is far more than it does: beside it any gyroscope would seem finer."""
    arm, rng = twin_terms(), np.random.default_rng(5)
    ekf = Ekf(arm, Filter(parameters=[]))
    ekf.add(LinkImu(arm, "panda_hand"))
    still = np.zeros(7)
    tau = arm.inverse_dynamics(HOME, still, still)
    for k in range(800):
        noise = rng.normal(size=20)
        ekf.observe(HOME + 2e-5 * noise[:7], 2e-3 * noise[7:14], tau, 0.005 * k)
        z = ekf.declared.sensors["imu"].reading(np.concatenate([HOME, still, np.zeros(ekf.belief.size - 14)]))
        z += np.repeat([1e-3, 1e-2], 3) * noise[14:]
        ekf.update("imu", z, 0.005 * k)
    assert ekf.counters()["imu"]["accepted"] > 700
    np.testing.assert_allclose(ekf.noise()["imu"], 1.0, atol=0.1)


def _turned(R: np.ndarray, angle: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.concatenate([multiply(exp(angle), RotationMatrix(R).ToQuaternion().wxyz()), p])


def test_bounds_and_switch() -> None:
    level = np.zeros(2)
    for _ in range(10000):
        follow_sensor(level, np.exp(level), 1.0 / np.exp(level), np.array([0.0, 1e3]) / np.exp(level), 0.05)
    np.testing.assert_allclose(level, [-WIDEST, WIDEST])
    R = np.array([[4.0, 1.0], [1.0, 9.0]])
    np.testing.assert_allclose(scaled(R, np.log([4.0, 0.25])), [[16.0, 1.0], [1.0, 2.25]])
    ekf = Ekf(terms(), Filter(encoder_std=1e-3, noise_time=0.0))
    follow(ekf, noisy(), 1.0)
    assert not np.any(ekf.belief.noise)
    assert len(JOINTS) == ekf.belief.noise.shape[1]
