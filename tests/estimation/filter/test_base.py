"""What a filter's parts share: bounds, sensors by name, and how sensors see the newest step."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import begun, gantry
from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.filter.ekf import Ekf, FilterError
from twin_diagram.estimation.sensors import BodyPose, LinkImu
from twin_diagram.scenario import Filter

PARAMS = Filter(parameters=["payload"])


def test_no_angle_is_less_certain_than_a_turn_and_no_speed_than_twice_its_limit() -> None:
    ekf = begun(PARAMS)
    widest = np.array([np.pi**2, np.pi**2, 4.0**2, 2.0**2])
    for share in (0.99, 4.0):
        P = np.eye(10) + 0.3
        P[:4] *= np.sqrt(share * widest / 1.3)[:, None]
        P[:, :4] *= np.sqrt(share * widest / 1.3)
        ekf.belief.P[:] = P
        correlation = P / np.sqrt(np.outer(P.diagonal(), P.diagonal()))
        ekf.bound()
        after = ekf.belief.P
        np.testing.assert_allclose(after.diagonal()[:4], min(share, 1.0) * widest)
        np.testing.assert_allclose(after[4:, 4:], P[4:, 4:])
        np.testing.assert_allclose(after / np.sqrt(np.outer(after.diagonal(), after.diagonal())), correlation)
    share = np.array([2.0, 0.9, 0.6, 3.0])  # those that are within it stay as they are
    ekf.belief.P[:4, :4] = np.diag(share * widest)
    ekf.bound()
    np.testing.assert_allclose(ekf.belief.P.diagonal()[:4], np.minimum(share, 1.0) * widest)
    ekf.belief.P[:] = 1e-12 * np.eye(10)
    ekf.belief.P[3, 3] = 100.0
    ekf.bound()
    assert ekf.belief.P[3, 3] == pytest.approx(4.0) and np.isfinite(ekf.belief.P).all()


@pytest.mark.parametrize(
    ("span", "rate", "steps"), [(0.1, 200.0, 22), (0.101, 200.0, 23), (0.0, 200.0, 2), (0.5, 100.0, 52)]
)
def test_the_past_reaches_back_as_far_as_it_is_asked_to(span: float, rate: float, steps: int) -> None:
    ekf = Ekf(gantry(), Filter(parameters=[], history=span, rate=rate))
    assert ekf.history.capacity == steps and ekf.period == pytest.approx(1.0 / rate)


@pytest.mark.parametrize("rate", [20.0, 50.0, 70.0, 100.0, 125.0])
def test_the_past_reaches_back_as_far_where_messages_are_far_apart(rate: float) -> None:
    """What lies between two messages is predicted in steps of 10 ms; at 20 Hz they reached back 30 ms, not 100."""
    ekf = begun(Filter(history=0.1, rate=rate), v=(0.0, 0.0))
    ekf.add(BodyPose(ekf.terms, "car"))
    for k in range(1, 40):
        ekf.observe(ekf.belief.q.copy(), np.zeros(2), np.zeros(2), 1.0 + k / rate)
    assert ekf.belief.time - ekf.history.oldest >= 0.1 - 1e-9


def test_sensors_are_found_by_name_or_as_themselves() -> None:
    ekf = begun(PARAMS)
    camera = BodyPose(ekf.terms, "car")
    with pytest.raises(FilterError, match="camera"):
        ekf.find(camera)
    ekf.add(camera)
    assert ekf.find("camera") is camera and ekf.find(camera) is camera and ekf.find("joints") is ekf.joints
    with pytest.raises(FilterError, match="never declared"):
        ekf.find(BodyPose(ekf.terms, "car"))
    with pytest.raises(FilterError, match="joints, camera"):
        ekf.find("lidar")
    for rule in ("covariance", "gradient"):
        Ekf(gantry(), Filter(parameters=[], rule=rule))
    with pytest.raises(ScenarioError, match="'newton'"):
        Ekf(gantry(), Filter(rule="newton"))


def test_an_exchanged_belief_begins_a_past_of_its_own() -> None:
    first, second = begun(PARAMS), Ekf(gantry(), PARAMS)
    first.predict(np.zeros(2), 0.005)
    second.by_torque = np.ones((4, 2))
    second.load(first.belief.vector)
    assert second.history.count == 1 and second.history.state(0)[0] == first.belief.time and second.by_torque is None
    np.testing.assert_array_equal(second.history.state(0)[2], first.belief.P)
    second.load(first.belief.vector, first.history.vector)
    assert second.history.count == 2
    second.load(Ekf(gantry(), PARAMS).belief.vector)
    assert second.history.count == 0


def test_sensors_see_the_acceleration_of_their_step_and_what_is_unknown_of_it() -> None:
    """A payload of unknown mass swings with what it is carried by: three times the product of both variances."""
    ekf = begun(PARAMS)
    imu = LinkImu(ekf.terms, "car")
    ekf.add(imu)
    ekf.predict(np.array([1.0, 2.0]), 0.005)
    belief, n = ekf.belief, 2
    still, by, noise = ekf.history.motion(0)
    at = ekf.linear(imu, belief.x, belief.P, 0)
    acceleration = still + by @ belief.x
    np.testing.assert_allclose(acceleration, [1.0 / 5.0, 2.0 / 2.0], atol=1e-9)
    np.testing.assert_allclose(at.reading[3:5], acceleration, atol=1e-9)
    # A mass m on the car is carried by both slides: δM/m = I, over the slides' own 5 and 2 kg.
    swing = np.diag([1.0 / 5.0, 1.0 / 2.0])
    mass_variance = belief.P[3 * n, 3 * n]
    assert mass_variance == pytest.approx(1.0, rel=1e-3)
    error = by @ belief.P @ by.T + noise
    wide = noise + 3.0 * mass_variance * swing @ error @ swing
    np.testing.assert_allclose(at.noise[3:5, 3:5], 1e-4 * np.eye(2) + wide, rtol=1e-9)
    plain = begun(Filter(parameters=[]))
    imu = LinkImu(plain.terms, "car")
    plain.add(imu)
    plain.predict(np.array([1.0, 2.0]), 0.005)
    _, _, noise = plain.history.motion(0)
    found = plain.linear(imu, plain.belief.x, plain.belief.P, 0).noise[3:5, 3:5]
    np.testing.assert_allclose(found, 1e-4 * np.eye(2) + noise, rtol=1e-9)
    own = plain.linear(plain.joints, plain.belief.x, plain.belief.P, 0)
    np.testing.assert_array_equal(own.reading, plain.belief.x[:4])
