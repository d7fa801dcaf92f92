"""Gate and update on a gantry: to the border; late readings at their own time; what a run of refusals opens."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from tests.estimation.small_arms import begun
from twin_diagram.estimation.filter.belief import Entry, SensorTrack
from twin_diagram.estimation.filter.ekf import Ekf, FilterError
from twin_diagram.estimation.filter.noise_adaptation import Update
from twin_diagram.estimation.filter.update import _open_payload, absorb, covariance_of, gate
from twin_diagram.estimation.sensors import Sensor, WristWrench
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

PARAMS = Filter(parameters=[], noise_time=0.0)
GATES = {m: float(chi2.isf(1e-6, m)) for m in (1, 2, 4)}


class Gauge(Sensor):
    """Reads the first slide, with a bias where it is given a prior."""

    def __init__(self, *bias: float, name: str = "gauge", std: float = 1e-3) -> None:
        super().__init__(name, 1)
        self.bias, self.std = np.array(bias), std

    def reading(self, x: Array) -> Array:
        return x[:1] + x[self.own].sum()

    def jacobian(self, x: Array) -> Array:
        H = np.zeros((1, len(x)))
        H[0, 0], H[0, self.own] = 1.0, 1.0
        return H

    def noise(self, x: Array) -> Array:
        return np.array([[self.std**2]])

    def own_std(self) -> Array:
        return self.bias

    def own_walk(self) -> Array:
        return 0.0 * self.bias


def correlated(ekf: Ekf, seed: int = 0, scale: float = 1e-3) -> None:
    A = np.random.default_rng([1360, seed]).normal(size=(ekf.belief.size,) * 2)
    ekf.belief.P[:] = scale**2 * (A @ A.T + np.eye(len(A)))


@pytest.mark.parametrize(("share", "accepted"), [(0.99, True), (1.01, False)])
def test_a_good_reading_is_refused_once_in_a_million(share: float, accepted: bool) -> None:
    for seed in range(5):
        ekf = begun(PARAMS)
        correlated(ekf, seed)
        y = np.random.default_rng(seed).normal(size=2)
        S = ekf.belief.P[:2, :2] + (2e-5) ** 2 * np.eye(2)
        y *= np.sqrt(share * GATES[2] / (y @ np.linalg.solve(S, y)))
        before = ekf.belief.x.copy()
        result = ekf.update("encoder", ekf.belief.q + y)
        assert result.accepted == accepted and not result.surprise and not result.late
        assert result.nis == pytest.approx(share * GATES[2])
        np.testing.assert_allclose(result.innovation, y, atol=1e-15)
        np.testing.assert_allclose(result.covariance, S)
        assert np.any(ekf.belief.x != before) == accepted


def test_an_update_is_bayes_rule() -> None:
    ekf = begun(PARAMS)
    correlated(ekf)
    belief = ekf.belief
    x, P, z = belief.x.copy(), belief.P.copy(), belief.q + [1e-3, -2e-3]
    H, R = np.eye(2, 6), (2e-5) ** 2 * np.eye(2)
    ekf.update("encoder", z)
    information = np.linalg.inv(P) + H.T @ H / R[0, 0]
    np.testing.assert_allclose(belief.P, np.linalg.inv(information), rtol=1e-4, atol=1e-14)
    expected = x + P @ H.T @ np.linalg.solve(H @ P @ H.T + R, z - x[:2])
    np.testing.assert_allclose(belief.x, expected, rtol=1e-9)
    np.testing.assert_array_equal(ekf.history.state(0)[1], belief.x)
    np.testing.assert_array_equal(ekf.history.state(0)[2], belief.P)


@pytest.mark.parametrize("explain", [True, False])
def test_a_torque_within_the_efforts_explains_a_surprise(explain: bool) -> None:
    """On 5 kg for 5 ms, 40 N make 0.04 m/s: what asks for more than the gate allows of that is refused."""
    for share, explained in ((0.99, True), (1.01, False)):
        ekf = begun(PARAMS)
        ekf.predict(np.zeros(2), 0.005)
        belief, by = ekf.belief, ekf.by_torque
        assert by is not None
        added = np.zeros((6, 6))
        added[:4, :4] = by @ np.diag([1600.0, 400.0]) @ by.T
        S = belief.P[2:4, 2:4] + 4e-6 * np.eye(2)
        wide = S + added[2:4, 2:4]
        y = np.array([np.sqrt(share * GATES[2] * wide[0, 0]), 0.0])
        x, P = belief.x.copy(), belief.P + added
        result = ekf.update("velocity", belief.v + y, explain=explain)
        assert result.accepted == result.surprise == (explained and explain)
        assert result.nis == pytest.approx(y @ np.linalg.solve(S, y))
        np.testing.assert_allclose(result.covariance, S)
        if result.accepted:
            np.testing.assert_allclose(belief.x, x + P[:, 2:4] @ np.linalg.solve(wide, y), rtol=1e-9, atol=1e-12)
            K = P[:, 2:4] @ np.linalg.inv(wide)
            np.testing.assert_allclose(belief.P, P - K @ wide @ K.T, rtol=1e-6, atol=1e-12)
            assert ekf.history.motion(0)[2][0, 0] * 0.005**2 > added[2, 2]  # late readings will know of it


def test_a_message_s_jump_of_speed_may_have_moved_its_joint() -> None:
    """Of the message as a whole the positions' part knows how far the speeds jumped."""
    ekf = begun(PARAMS)
    ekf.predict(np.zeros(2), 0.005)
    at = ekf.linear(ekf.joints, ekf.belief.x, ekf.belief.P, 0)
    R = ekf.joints.noise(ekf.belief.x)
    z = ekf.belief.x[:4] + [0.0, 0.0, 0.05, -0.03]
    gated = gate(ekf, ekf.joints, z, at, R, True)
    assert gated.added is not None and ekf.by_torque is not None
    extra = gated.added[:4, :4] - ekf.by_torque @ np.diag([1600.0, 400.0]) @ ekf.by_torque.T
    np.testing.assert_allclose(extra, np.diag([0.05**2 * 0.005**2 / 12, 0.03**2 * 0.005**2 / 12, 0, 0]), atol=1e-12)
    assert gate(ekf, ekf.joints, ekf.belief.x[:4], at, R, True).added is None


def test_the_gradient_rule_gathers_what_is_no_surprise() -> None:
    ekf = begun(Filter(parameters=["torque_bias"], rule="gradient", noise_time=0.0))
    ekf.predict(np.zeros(2), 0.005)
    ekf.update("velocity", ekf.belief.v + 1e-3)
    kept = ekf.belief.gradient.copy()
    assert kept.any()
    result = ekf.update("velocity", ekf.belief.v + 0.04)
    assert result.surprise
    np.testing.assert_array_equal(ekf.belief.gradient, kept)


def gauged(*bias: float, std: float = 1e-3) -> tuple[Ekf, Gauge]:
    ekf, gauge = begun(PARAMS), Gauge(*bias, std=std)
    ekf.add(gauge)
    for _ in range(10):
        ekf.predict(np.zeros(2), 0.005)
    ekf.belief.header[Entry.HEARD] = ekf.belief.time
    return ekf, gauge


def test_a_late_reading_is_expected_where_its_slide_was_then() -> None:
    """Between two steps, 1 ms before the nearest: the slide was 0.5 mm behind."""
    ekf, gauge = gauged()
    back = 4
    time, x, P = (part.copy() if isinstance(part, np.ndarray) else part for part in ekf.history.state(back))
    t = time - 0.001
    S = P[0, 0] - 2.0 * 0.001 * P[0, 2] + 1e-6 * P[2, 2] + 1e-6
    for share, accepted in ((1.01, False), (0.99, True)):
        before = ekf.belief.x.copy()
        z = x[:1] - 0.001 * x[2] + np.sqrt(share * GATES[1] * S)
        result = ekf.update(gauge, z, t)
        assert result.late and result.accepted == accepted and result.nis == pytest.approx(share * GATES[1], rel=1e-6)
        assert np.any(ekf.belief.x != before) == accepted
    track = ekf.belief.tracks[0]
    assert track[SensorTrack.LATE] == 1.0 and track[SensorTrack.ACCEPTED] == 1.0 and track[SensorTrack.REFUSED] == 1.0
    assert track[SensorTrack.LAST] == pytest.approx(t)
    K = (P[:, 0] - 0.001 * P[:, 2]) / S
    np.testing.assert_allclose(ekf.history.state(back)[1], x + K * np.sqrt(0.99 * GATES[1] * S), rtol=1e-6, atol=1e-12)


def test_an_own_sensor_s_late_reading_is_counted() -> None:
    ekf, _ = gauged()
    ekf.update("encoder", ekf.belief.q - 0.02 * ekf.belief.v, ekf.belief.time - 0.02)
    assert ekf.belief.header[Entry.LATE] == 1.0 and ekf.belief.header[Entry.HEARD] == ekf.belief.time


def test_a_later_reading_is_predicted_to_and_a_far_one_is_not() -> None:
    ekf, gauge = gauged()
    now = ekf.belief.time
    ekf.update(gauge, ekf.belief.q[:1], now + 1e-10)
    assert ekf.belief.time == now
    ekf.update(gauge, ekf.belief.q[:1] + 0.5 * 0.004, now + 0.004)
    assert ekf.belief.time == now + 0.004 == ekf.history.state(0)[0]
    ekf.update("encoder", ekf.belief.q + 0.01 * ekf.belief.v, now + 0.014)
    assert ekf.belief.header[Entry.HEARD] == now + 0.014
    with pytest.raises(FilterError, match="ahead"):
        ekf.update(gauge, np.zeros(1), ekf.belief.time + 2.51)
    with pytest.raises(FilterError, match="lies before all"):
        ekf.update(gauge, np.zeros(1), 0.9)
    assert ekf.belief.tracks[0][SensorTrack.STALE] == 1.0
    for wrong in (np.nan, 2e6):
        assert not ekf.update(gauge, np.array([wrong])).accepted
        assert not ekf.update("encoder", np.array([0.0, wrong])).accepted
    assert ekf.belief.tracks[0][SensorTrack.INVALID] == 2.0 and ekf.belief.header[Entry.INVALID] == 2.0


def test_ten_refusals_open_what_only_this_sensor_tells() -> None:
    for vouched in (True, False):
        ekf, gauge = gauged(0.5)
        belief = ekf.belief
        belief.P[6, 6], belief.P[0, 6], belief.P[6, 0] = 1e-6, 1e-12, 1e-12
        if not vouched:
            belief.header[Entry.HEARD] = belief.time - 0.2
        P = belief.P.copy()
        for k in range(10):
            result = ekf.update(gauge, belief.q[:1] + 0.1)
            assert not result.accepted
            assert belief.tracks[0][SensorTrack.STREAK] == (k + 1 if k < 9 else 0)
            if k < 9:
                np.testing.assert_array_equal(belief.P, P)
        assert belief.tracks[0][SensorTrack.REACQUIRED] == 1.0
        expected = P.copy()
        expected[6, :], expected[:, 6] = 0.0, 0.0
        expected[6, 6] = 0.25
        if not vouched:
            # Twice as far off as the gate thought, at least; no speed wider than twice its limit.
            wider = np.sqrt(2.0 * result.nis)
            expected[:4, :] *= wider
            expected[:, :4] *= wider
        np.testing.assert_allclose(belief.P, expected, rtol=1e-9)
        assert ekf.history.count == 1
        np.testing.assert_array_equal(ekf.history.state(0)[2], belief.P)


def test_a_changed_payload_is_open_again_where_it_explains_what_its_sensor_insists_on() -> None:
    """Weight of a kilogram more, or a force that no payload of the opening's size can make."""
    for rule in ("covariance", "gradient"):
        for kilograms, opened in ((3.0, True), (40.0, False)):
            ekf = begun(Filter(parameters=["payload"], noise_time=0.0, rule=rule))
            wrench = WristWrench(ekf.terms, "car")
            ekf.add(wrench)
            ekf.belief.acceleration[:] = 10.0
            ekf.predict(np.array([50.0, 20.0]), 0.005)
            belief = ekf.belief
            belief.P[6:10, 6:10] = 1e-6 * np.eye(4)
            at = ekf.linear(wrench, belief.x, belief.P, 0)
            innovation = at.jacobian[:, 6:10] @ np.array([kilograms, 0.0, 0.0, 0.0])
            S = at.jacobian @ belief.P @ at.jacobian.T + at.noise
            before = belief.P.copy()
            _open_payload(ekf, wrench, Update(False, False, 1e9, innovation, S))
            expected = np.zeros_like(before)
            if opened and rule == "covariance":
                expected[6:10, 6:10] = ekf.parameters.opening
            np.testing.assert_allclose(belief.P - before, expected, atol=1e-12)
            assert belief.header[Entry.OPENINGS] == float(opened and rule == "covariance")


def test_the_border_of_what_a_payload_explains() -> None:
    ekf = begun(Filter(parameters=["payload"], noise_time=0.0))
    wrench = WristWrench(ekf.terms, "car")
    ekf.add(wrench)
    ekf.belief.acceleration[:] = 10.0
    ekf.predict(np.array([50.0, 20.0]), 0.005)
    H = ekf.linear(wrench, ekf.belief.x, ekf.belief.P, 0).jacobian[:, 6:10]
    S = np.diag([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    whole = S + H @ ekf.parameters.opening @ H.T
    y = np.array([0.1, -0.2, 0.3, 0.1, 0.2, -0.1])
    y /= np.sqrt(y @ np.linalg.solve(whole, y))
    for share, opens in ((1.01, 0.0), (0.99, 1.0)):
        _open_payload(ekf, wrench, Update(False, False, 1e9, np.sqrt(share * chi2.isf(1e-6, 6)) * y, S))
        assert ekf.belief.header[Entry.OPENINGS] == opens


def test_noise_of_a_reading_is_a_covariance_or_deviations() -> None:
    gauge = Gauge()
    pair = begun(PARAMS).encoder
    np.testing.assert_allclose(covariance_of(pair, np.array([0.1, 0.2])), np.diag([0.01, 0.04]))
    lopsided = np.array([[2.0, 0.9], [0.5, 1.0]])
    np.testing.assert_allclose(covariance_of(pair, lopsided), [[2.0, 0.7], [0.7, 1.0]])
    for std, sound in ((1.1e-9, True), (0.9e-9, False), (0.9e9, True), (1.1e9, False), (np.nan, False)):
        for noise in (np.array([1.0, std]), np.diag([std**2, 1.0])):
            if sound:
                covariance_of(pair, noise)
            else:
                with pytest.raises(FilterError, match="encoder"):
                    covariance_of(pair, noise)
    for wrong in ([[1.0, 1.1], [1.1, 1.0]], [[1.0, 1.0], [1.0, 1.0]], [1.0], [1.0, 2.0, 3.0], [[1.0, 0.0]]):
        with pytest.raises(FilterError):
            covariance_of(pair, np.array(wrong))
    covariance_of(pair, np.array([[1.0, 0.999], [0.999, 1.0]]))
    assert gauge.gate == pytest.approx(GATES[1], rel=1e-6)


def test_a_reading_s_own_noise_is_what_counts() -> None:
    ekf, gauge = gauged()
    p = float(ekf.belief.P[0, 0])
    result = ekf.update(gauge, ekf.belief.q[:1] + 1e-3, noise=np.array([0.01]))
    assert result.covariance[0, 0] == pytest.approx(p + 1e-4, rel=1e-9)
    late = ekf.update(gauge, ekf.belief.q[:1], ekf.belief.time - 0.02, noise=np.array([[0.04]]))
    assert late.late and late.covariance[0, 0] == pytest.approx(0.04, rel=1e-3)


def test_what_cannot_be_fused_leaves_the_filter_as_it_was() -> None:
    ekf, gauge = gauged()
    ekf.belief.P[0, 0] = -1.0
    before = ekf.belief.vector.copy()
    with pytest.raises(FilterError, match="cannot be fused"):
        ekf.update(gauge, np.zeros(1))
    np.testing.assert_array_equal(ekf.belief.vector, before)


def test_bounds_hold_after_an_update() -> None:
    ekf = begun(Filter(parameters=["torque_constant"], noise_time=0.0))
    ekf.belief.theta[:] = 5.0
    at = ekf.linear(ekf.encoder, ekf.belief.x, ekf.belief.P, 0)
    absorb(ekf, gate(ekf, ekf.encoder, ekf.belief.q.copy(), at, at.noise, False))
    np.testing.assert_array_equal(ekf.belief.theta, 1.0)
