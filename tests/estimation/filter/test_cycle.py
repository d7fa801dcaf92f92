"""The cycle on a gantry: what each message changes, what an alarm opens, and what a further sensor adds."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import begun, gantry
from twin_diagram.estimation.filter.belief import Entry, SensorTrack
from twin_diagram.estimation.filter.ekf import Ekf, FilterError
from twin_diagram.estimation.filter.parameter_status import ParameterStatus
from twin_diagram.estimation.sensors import BodyPose, LinkImu, WristWrench
from twin_diagram.scenario import Filter
from twin_diagram.signals.layouts import AlarmKind

PARAMS = Filter(parameters=["torque_bias"])
DT = 0.005
Q, V = np.array([0.1, -0.2]), np.array([0.5, -0.4])


def follow(ekf: Ekf, steps: int, tau: tuple[float, float] = (0.0, 0.0), v: np.ndarray = V) -> float:
    """Messages of slides that go on as they are; answers the newest one's time."""
    t = ekf.belief.time
    q = ekf.belief.q.copy()
    for _ in range(steps):
        t, q = t + DT, q + DT * v
        ekf.observe(q, v, np.array(tau), t)
    return t


def test_a_sensor_added_later_keeps_what_is_known() -> None:
    ekf = begun(PARAMS)
    ekf.add(LinkImu(ekf.terms, "car"))
    follow(ekf, 5)
    ekf.belief.levels[0][:], ekf.belief.tracks[0][:] = 0.3, 7.0
    before = ekf.belief
    header, x, P = before.header.copy(), before.x.copy(), before.P.copy()
    for name in ("noise", "steady", "told", "troubled", "model", "freed", "score"):
        getattr(before, name)[...] += 0.125
    names = ("torque", "drift", "regime", "noise", "steady", "told", "troubled", "model", "freed", "score", "gradient")
    kept = {name: getattr(before, name).copy() for name in names}
    wrench = WristWrench(ekf.terms, "car")
    ekf.add(wrench)
    after = ekf.belief
    np.testing.assert_array_equal(after.header, header)
    np.testing.assert_array_equal(after.x, [*x, *np.zeros(6)])
    np.testing.assert_array_equal(after.P[:14, :14], P)
    np.testing.assert_allclose(after.P[14:, 14:], np.diag(np.repeat([0.1, 1.0], 3) ** 2))
    assert not after.P[:14, 14:].any()
    for name, value in kept.items():
        np.testing.assert_array_equal(getattr(after, name), value)
    assert np.all(after.tracks[0] == 7.0) and np.all(after.levels[0] == 0.3) and not after.levels[1].any()
    assert wrench.own == slice(14, 20) and wrench.payload is None
    assert ekf.history.count == 1 and ekf.history.state(0)[0] == after.time
    loaded = Ekf(gantry(), Filter(parameters=["torque_bias", "payload"]))
    wrench = WristWrench(loaded.terms, "car")
    loaded.add(wrench)
    assert wrench.payload == slice(8, 12) and wrench.own == slice(12, 18) and loaded.history.count == 0
    with pytest.raises(FilterError, match="joints"):
        loaded.add(BodyPose(loaded.terms, "car", name="joints"))


def test_noise_is_told_as_deviations() -> None:
    ekf = begun(PARAMS)
    ekf.add(BodyPose(ekf.terms, "car"))
    ekf.belief.noise[:], ekf.belief.levels[0][:] = np.log([[4.0, 4.0], [9.0, 9.0], [0.25, 0.25]]), np.log(16.0)
    found = ekf.noise()
    for name, value in (("encoder", 2.0), ("velocity", 3.0), ("torque", 0.5), ("camera", 4.0)):
        np.testing.assert_allclose(found[name], value)


def test_standings_are_of_the_parameters() -> None:
    ekf = Ekf(gantry(), PARAMS)
    assert [s.std for s in ekf.standings(["x", "y"])] == pytest.approx([0.8, 0.4])
    ekf = begun(PARAMS)
    ekf.belief.theta[:], ekf.belief.P[6:, 6:] = [0.5, -0.1], np.diag([0.3**2, 0.3**2])
    first, second = ekf.standings(["x", "y"])
    assert (first.value, first.status) == (0.5, ParameterStatus.SETTLED) and first.std == pytest.approx(0.3)
    assert (second.value, second.status) == (-0.1, ParameterStatus.NOT_EXCITED)
    assert ekf.labels(["x", "y"]) == ["torque_bias.x [N]", "torque_bias.y [N]"]


@pytest.mark.parametrize(
    ("alarm", "holds", "opens"),
    [
        ((1.0, AlarmKind.INNOVATION, 0.9, 2.0), True, True),
        ((0.0, AlarmKind.ROLLOUT, 0.9, 2.0), False, True),
        ((0.6, AlarmKind.NONE, 0.9, 2.0), True, False),
        ((0.4, AlarmKind.SENSOR, 0.9, 2.0), False, False),
        ((1.0, AlarmKind.INNOVATION, 0.5, 2.0), True, False),  # the one that was heeded
        ((1.0, AlarmKind.INNOVATION, 0.4, 2.0), True, False),
        ((1.0, AlarmKind.INNOVATION, np.inf, 2.0), True, False),
    ],
)
def test_an_alarm_is_heeded(alarm: tuple[float, ...], holds: bool, opens: bool) -> None:
    ekf = begun(PARAMS)
    h = ekf.belief.header
    h[Entry.HEEDED] = 0.5
    ekf.heed(np.array(alarm))
    assert h[Entry.ALARM] == (1.0 + 2.0 * DT if holds else 0.0)
    assert h[Entry.OPENINGS] == float(opens) and h[Entry.HEEDED] == (0.9 if opens else 0.5)
    ekf.hold_noise(0.5)
    assert h[Entry.ALARM] == (1.0 + 2.0 * DT if holds else 0.5)
    for quiet, opened in ((1.0, 1.0), (1.0 + 1e-9, 0.0)):
        ekf = begun(PARAMS)
        ekf.belief.header[Entry.QUIET] = quiet
        ekf.heed(np.array([1.0, AlarmKind.INNOVATION, 0.9, 2.0]))
        assert ekf.belief.header[Entry.OPENINGS] == opened and ekf.belief.header[Entry.HEEDED] == 0.9


def test_counters_are_those_of_the_record() -> None:
    ekf = begun(PARAMS)
    ekf.add(BodyPose(ekf.terms, "car"))
    ekf.belief.tracks[0][: len(SensorTrack)] = np.arange(12.0)
    names = ["accepted", "refused", "invalid", "stale", "late", "reacquired"]
    assert ekf.counters() == {"camera": dict(zip(names, range(4, 10), strict=True))}


def test_a_message_is_predicted_to_by_the_mean_torque_of_its_ends_and_gated_as_a_whole() -> None:
    """The first torque after a start is as good as unknown: as unsure as the efforts are large."""
    ekf = begun(PARAMS)
    h = ekf.belief.header
    for k, (tau, mean) in enumerate(((8.0, 4.0), (2.0, 5.0), (2.0, 2.0))):
        assert h[Entry.FRESH] == float(k == 0)
        copy = Ekf(gantry(), PARAMS)
        copy.load(ekf.belief.vector)
        copy.predict(np.array([mean, 0.0]), DT, ekf.terms.effort_limit if k == 0 else 0.3)
        noise = copy.history.motion(0)[2]
        z = copy.belief.x[:4] + [1e-5, -2e-5, 1e-3, 2e-3]
        S = copy.belief.P[:4, :4] + np.diag(np.repeat([2e-5, 2e-3], 2) ** 2 * np.exp(copy.belief.noise[:2]).ravel())
        y = z - copy.belief.x[:4]
        ekf.observe(z[:2], z[2:], np.array([tau, 0.0]), 1.0 + DT * (k + 1))
        assert h[Entry.NIS] == pytest.approx(float(y @ np.linalg.solve(S, y)), rel=1e-5)
        np.testing.assert_allclose(ekf.history.motion(0)[2], noise, rtol=1e-6, atol=1e-9)
        np.testing.assert_array_equal(ekf.belief.torque, [tau, 0.0])
        assert h[Entry.FRESH] == 0.0 and bool(ekf.belief.score.any()) == (k > 0)


def test_messages_that_cannot_be_heard_leave_the_torque_as_it_was() -> None:
    ekf = begun(PARAMS)
    follow(ekf, 3, (1.0, 2.0))
    score = ekf.belief.score.copy()
    assert ekf.observe(ekf.belief.q + DT * V, V, np.array([np.nan, 0.0]), 1.0 + 4 * DT)
    np.testing.assert_array_equal(ekf.belief.torque, [1.0, 2.0])
    np.testing.assert_array_equal(ekf.belief.score, score)
    assert ekf.belief.header[Entry.INVALID] == 1.0
    # Its step is as unsure as the efforts are large.
    assert ekf.history.motion(0)[2][0, 0] == pytest.approx((40.0 / 5.0) ** 2, rel=0.01)


def test_times_and_records_of_a_message() -> None:
    ekf = begun(PARAMS)
    t = follow(ekf, 4)
    h = ekf.belief.header
    assert h[Entry.TIME] == h[Entry.HEARD] == ekf.history.state(0)[0] == t and h[Entry.ACCEPTED] == 4.0
    assert not ekf.observe(Q, V, np.zeros(2), t) and h[Entry.STALE] == 1.0
    assert not ekf.observe(Q, V, np.zeros(2), -1.0) and not ekf.observe(Q, V, np.zeros(2), np.nan)
    assert ekf.observe(ekf.belief.q - 0.5 * DT * V, V, np.zeros(2), t - 0.5 * DT)  # late
    assert h[Entry.LATE] == 1.0 and h[Entry.TIME] == t
    assert ekf.observe(Q, V, np.zeros(2), t + 0.3) and h[Entry.RESTARTS] == 1.0
    np.testing.assert_array_equal(ekf.belief.q, Q)


def test_half_a_message_is_used_where_the_other_is_beyond_all_efforts() -> None:
    ekf = begun(PARAMS)
    t = follow(ekf, 20) + DT
    good = ekf.belief.q + DT * V
    ekf.observe(good, V + [3.0, 0.0], np.zeros(2), t)
    h = ekf.belief.header
    assert h[Entry.REFUSED] == 1.0 and h[Entry.STREAK] == 1.0 and h[Entry.GATHERED] == 1.0
    np.testing.assert_allclose(ekf.belief.q, good, atol=1e-5)
    assert ekf.belief.v[0] < 0.6 and h[Entry.HEARD] == t
    kept = ekf.belief.v.copy()
    ekf.observe(good + [0.5, 0.0], kept, np.zeros(2), t + DT)
    np.testing.assert_allclose(ekf.belief.q, good + DT * kept, atol=1e-4)
    assert h[Entry.STREAK] == 2.0


def test_parameters_open_where_innovations_are_twice_their_covariance() -> None:
    for level, opens in ((1.9, False), (2.4, True)):
        ekf = begun(PARAMS)
        t = follow(ekf, 20)
        h = ekf.belief.header
        h[Entry.NIS_MEAN] = level
        ekf.belief.score[:] = 0.0
        follow(ekf, 1)
        assert h[Entry.OPENINGS] == float(opens)
        if opens:
            assert h[Entry.QUIET] == pytest.approx(t + DT + 0.2)
            h[Entry.NIS_MEAN] = 9.0
            follow(ekf, 1)
            assert h[Entry.OPENINGS] == 1.0  # not again at once
            follow(ekf, 41)
    ekf = begun(PARAMS)
    follow(ekf, 20)
    for streak, opens in ((1.0, False), (0.0, True)):
        ekf.belief.score[:] = [[1.0, 0.0, 50.0], [0.0, 1.0, 0.0]]
        ekf.belief.header[Entry.STREAK] = streak
        if streak:
            ekf.observe(ekf.belief.q + 0.5, ekf.belief.v, np.zeros(2), ekf.belief.time + DT)
        else:
            follow(ekf, 1, v=ekf.belief.v.copy())
        assert (ekf.belief.header[Entry.OPENINGS] > 0.0) == opens


def test_a_prior_is_refuted_by_what_was_learnt() -> None:
    params = Filter(parameters=["torque_constant"])
    ekf = begun(params)
    follow(ekf, 3)
    ekf.belief.theta[0] = -0.2
    follow(ekf, 1)
    assert ekf.belief.freed[0] == 1.0 and ekf.belief.header[Entry.OPENINGS] == 1.0


def test_predictions_ask_for_finite_numbers_and_a_time_ahead() -> None:
    ekf = begun(PARAMS)
    ekf.predict(np.zeros(2), 2.5)
    for u, dt in (
        (np.zeros(2), 2.51),
        (np.zeros(2), 0.0),
        (np.zeros(2), -0.1),
        (np.zeros(3), 0.1),
        (np.zeros(2), np.inf),
    ):
        with pytest.raises(FilterError):
            ekf.predict(u, dt)
    with pytest.raises(FilterError):
        ekf.predict(np.array([0.0, np.inf]), 0.1)
    with pytest.raises(FilterError, match="no state"):
        Ekf(gantry(), PARAMS).predict(np.zeros(2), 0.1)


def test_a_filter_that_runs_away_takes_its_state_anew_and_keeps_its_parameters() -> None:
    ekf = begun(PARAMS)
    t = follow(ekf, 3) + DT
    ekf.belief.theta[:] = ekf.belief.model[:] = [0.5, -0.25]
    P = ekf.belief.P[6:, 6:].copy()
    ekf.belief.P[0, 0] = -1.0
    accepted = float(ekf.belief.header[Entry.ACCEPTED])
    assert ekf.observe(Q, V, np.array([1.0, 2.0]), t)
    np.testing.assert_array_equal(ekf.belief.x, [*Q, *V, 0.0, 0.0, 0.5, -0.25])
    np.testing.assert_array_equal(ekf.belief.P[6:, 6:], P)
    np.testing.assert_array_equal(ekf.belief.torque, [1.0, 2.0])
    h = ekf.belief.header
    assert h[Entry.TIME] == t and h[Entry.RESTARTS] == 1.0 and h[Entry.FRESH] == 1.0
    assert h[Entry.ACCEPTED] == accepted
