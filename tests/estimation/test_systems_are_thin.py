"""The systems say what filter and monitor say that are driven by hand: message by message, on a gantry."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.framework import Context, LeafSystem

from tests.estimation.small_arms import gantry
from twin_diagram.errors import ModelError
from twin_diagram.estimation.drift.monitor import DriftEntry, Monitor
from twin_diagram.estimation.drift_system import DriftMonitor
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.filter.belief import Entry, SensorTrack
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.sensor_registry import note
from twin_diagram.estimation.sensors.from_scenario import make_sensor
from twin_diagram.scenario import Drift, Filter, SensorSpec
from twin_diagram.signals.layouts import NEVER, AlarmKind

ARM = gantry()
DT = 0.005
SPECS = [SensorSpec(kind="body_pose", name="camera"), SensorSpec(kind="torque")]
Q, V, TAU = np.array([0.1, -0.2]), np.array([0.5, -0.4]), np.array([1.0, -0.5])


def fix(system: LeafSystem, context: Context, **values: object) -> None:
    for name, value in values.items():
        system.GetInputPort(name.replace("__", ".")).FixValue(context, np.atleast_1d(value))


def tick(system: LeafSystem, context: Context, t: float) -> None:
    context.SetTime(t)
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))


def out(system: LeafSystem, context: Context, name: str) -> np.ndarray:
    return np.asarray(system.GetOutputPort(name).Eval(context))


def message(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    return Q + DT * k * V, V + 1e-4 * (k % 3 - 1), TAU * (k % 2), 1.0 + DT * k


def test_a_filter_before_the_first_message() -> None:
    """All within a turn and the speeds' limits; it stands at home."""
    system = AdaptiveEkf(ARM, Filter(parameters=["torque_bias"], sensors=SPECS), Q)
    context = system.CreateDefaultContext()
    np.testing.assert_array_equal(out(system, context, "arm_state"), [*Q, 0.0, 0.0])
    covariance = np.diag([np.pi**2, np.pi**2, 4.0, 1.0, 0.8**2, 0.4**2])
    np.testing.assert_allclose(out(system, context, "covariance").reshape(6, 6), covariance)
    assert not out(system, context, "parameters").any() and out(system, context, "nis")[0] == 0.0
    period, offset = system.GetUniquePeriodicDiscreteUpdateAttribute().period_sec(), 0.0
    assert period == pytest.approx(DT) and offset == 0.0
    assert system.GetInputPort("camera.noise").size() == 36 and system.GetInputPort("camera.reading").size() == 7
    assert not system.HasInputPort("torque.noise") and system.GetOutputPort("sensor_tracks").size() == 12 + 6 + 12 + 2
    standing = AdaptiveEkf(ARM, Filter(parameters=[]))
    assert not out(standing, standing.CreateDefaultContext(), "arm_state").any()


def test_a_filter_says_what_the_same_filter_says_by_hand() -> None:
    params = Filter(parameters=["torque_bias"], sensors=SPECS)
    system, ekf = AdaptiveEkf(ARM, params), Ekf(ARM, params)
    for spec in SPECS:
        ekf.add(make_sensor(ARM, spec))
    context = system.CreateDefaultContext()
    camera = ekf.declared.sensors["camera"]
    noise = 0.01 * np.eye(6)
    fix(system, context, camera__time=NEVER, camera__noise=np.zeros(36), torque__time=NEVER)
    fix(system, context, camera__reading=np.zeros(7), torque__reading=np.zeros(2))
    for k in range(30):
        q, v, tau, t = message(k)
        fix(system, context, position_measured=q, velocity_estimated=v, torque_measured=tau, measurement_time=t)
        ekf.observe(q, v, tau, t)
        if k in (5, 6, 12, 20):
            z, taken = camera.reading(np.concatenate([q, np.zeros(4)])), t - 0.002 * (k == 12) + 0.003 * (k == 6)
            R = noise if k == 12 else np.zeros((6, 6))
            fix(system, context, camera__reading=z, camera__time=taken, camera__noise=R.ravel())
            ekf.update("camera", z, taken, noise if k == 12 else None)
        if k == 9:
            fix(system, context, torque__reading=[0.01, 0.02], torque__time=t)
            ekf.update("torque", np.array([0.01, 0.02]), t)
        tick(system, context, t)
        np.testing.assert_allclose(system.belief(context).vector, ekf.belief.vector, rtol=1e-12, atol=1e-15)
    belief = ekf.belief
    for name, value in (
        ("parameters", belief.theta),
        ("covariance", belief.outside_covariance().ravel()),
        ("innovation", belief.innovation),
        ("nis", belief.header[[Entry.NIS]]),
        ("sensor_tracks", np.concatenate(belief.tracks)),
    ):
        np.testing.assert_array_equal(out(system, context, name), value)
    context.SetTime(belief.time + 0.004)
    np.testing.assert_array_equal(out(system, context, "arm_state"), belief.state_at(belief.time + 0.004))
    counters = system.counters(context)
    assert counters["accepted"] == 29 and counters["refused"] == 0 and "time" not in counters
    assert ekf.counters()["camera"]["accepted"] == 4 and ekf.counters()["torque"]["accepted"] == 1


def test_a_filter_without_further_sensors_keeps_times_alone_and_says_the_same() -> None:
    """Its arm's messages are never fused late, so nobody asks for steps as they were linearised."""
    params = Filter(parameters=["torque_bias"])
    system, ekf = AdaptiveEkf(ARM, params), Ekf(ARM, params)
    context = system.CreateDefaultContext()
    for k in (0, 1, 2, 3, 3, 4, 5):
        q, v, tau, t = message(k)
        fix(system, context, position_measured=q, velocity_estimated=v, torque_measured=tau, measurement_time=t)
        ekf.observe(q, v, tau, t)
        tick(system, context, t)
        np.testing.assert_array_equal(system.belief(context).vector, ekf.belief.vector)
    assert system.counters(context)["accepted"] == 5 and system.counters(context)["stale"] == 1
    fix(system, context, measurement_time=message(2)[3])
    tick(system, context, message(5)[3])
    assert system.counters(context)["stale"] == 2  # too old for it, where a history as a whole would take it in
    kept, whole = system.ekf.history, ekf.history
    assert kept.count == 1 and kept.knows(message(5)[3]) and not kept.knows(message(4)[3])
    assert whole.state(0)[2].any() and not kept.state(0)[2].any()


@pytest.mark.parametrize(
    ("ahead", "accepted", "invalid", "stale"),
    [(0.249, 1, 0, 0), (0.251, 0, 1, 0), (-5.0, 0, 0, 1), (np.nan, 0, 0, 0), (-1.5, 0, 0, 0)],
)
def test_readings_of_the_future_or_the_far_past_are_counted_and_left_out(
    ahead: float, accepted: int, invalid: int, stale: int
) -> None:
    params = Filter(parameters=[], sensors=SPECS[1:])
    system = AdaptiveEkf(ARM, params)
    context = system.CreateDefaultContext()
    fix(system, context, torque__reading=np.zeros(2), torque__time=NEVER)
    for k in range(3):
        q, v, tau, t = message(k + 1000)
        if k == 2:
            fix(system, context, torque__time=-0.5 if ahead == -1.5 else t + ahead)
        fix(system, context, position_measured=q, velocity_estimated=v, torque_measured=tau, measurement_time=t)
        tick(system, context, t)
    track = out(system, context, "sensor_tracks")
    counts = track[[SensorTrack.ACCEPTED, SensorTrack.INVALID, SensorTrack.STALE]]
    np.testing.assert_array_equal(counts, [accepted, invalid, stale])
    before = track.copy()
    tick(system, context, 9.0)  # the same reading is used once
    np.testing.assert_array_equal(
        out(system, context, "sensor_tracks")[SensorTrack.ACCEPTED], before[SensorTrack.ACCEPTED]
    )


def test_readings_wait_for_the_first_message_and_may_be_taken_at_time_zero() -> None:
    system = AdaptiveEkf(ARM, Filter(parameters=[], sensors=SPECS[1:]))
    context = system.CreateDefaultContext()
    fix(system, context, torque__reading=np.zeros(2), torque__time=0.0)
    fix(system, context, position_measured=Q, velocity_estimated=V, torque_measured=TAU, measurement_time=NEVER)
    tick(system, context, 0.0)
    assert not out(system, context, "sensor_tracks")[SensorTrack.ACCEPTED]
    fix(system, context, measurement_time=0.0)
    tick(system, context, 0.0)
    assert out(system, context, "sensor_tracks")[SensorTrack.ACCEPTED] == 1.0


def test_a_filter_heeds_an_alarm() -> None:
    system = AdaptiveEkf(ARM, Filter(parameters=["torque_bias"]))
    context = system.CreateDefaultContext()
    for k in range(3):
        q, v, tau, t = message(k)
        fix(system, context, position_measured=q, velocity_estimated=v, torque_measured=tau, measurement_time=t)
        fix(system, context, alarm=[1.0, AlarmKind.INNOVATION, 0.5, 2.0] if k == 2 else np.zeros(4))
        tick(system, context, t)
    assert system.counters(context)["openings"] == 1
    with pytest.raises(ModelError, match="2 joints"):
        from tests.estimation.small_arms import crank

        AdaptiveEkf(crank(), Filter(parameters=[]))._make(ARM)
    alone = AdaptiveEkf.of_plant(ARM.plant, ["bridge_slide", "car_slide"], Filter())
    assert alone.ekf.terms.n == 2 and alone.ekf.parameters.size == 4


def test_a_monitor_says_what_the_same_monitor_says_by_hand() -> None:
    """It sees what the filter made of the message before, carried on to now: by 20 ms at most."""
    params = Filter(parameters=["torque_bias"], sensors=SPECS)
    drift = Drift(learning_time=0.5)
    system = DriftMonitor(ARM, drift, params)
    monitor = Monitor(ARM, drift, params, {"camera": 6, "torque": 2})
    context = system.CreateDefaultContext()
    rng, previous = np.random.default_rng(1390), (np.zeros(2), np.zeros(2), NEVER)
    tracks = [np.zeros(12 + 6), np.zeros(12 + 2)]
    loud = False
    for k in range(260):
        q, v, tau, t = message(k)
        late = 0.003 if k % 5 else 0.03 if k % 2 else -0.002
        x, theta, white = np.concatenate([q, v]), np.full(2, 1e-4), rng.normal(size=2)
        nis = 500.0 if k > 240 else 4.0
        if k % 4 == 0:
            reading = rng.normal(size=6)
            note(tracks[0], reading, float(reading @ reading), t, k % 12 != 0)
        fix(system, context, arm_state=x, parameters=theta, innovation=white, nis=nis)
        fix(system, context, position_measured=q, torque_measured=tau, measurement_time=t)
        fix(system, context, sensor_tracks=np.concatenate(tracks))
        tick(system, context, t + late)
        q_then, tau_then, t_then = previous
        ahead = min(max(t + late - t_then, 0.0), 0.02)
        monitor.observe(x, theta, nis, q_then, tau_then, t_then, t_then + ahead, white)
        if k % 4 == 0:
            monitor.reading("camera", np.clip(reading, -6.0, 6.0), k % 12 != 0)
        previous = (q, tau, t)
        state = context.get_discrete_state(0).value()
        np.testing.assert_allclose(state, monitor.vector, rtol=1e-9, atol=1e-9)
        loud = loud or monitor.active
    assert loud and monitor.header[DriftEntry.ROLLOUTS] > 2
    np.testing.assert_allclose(out(system, context, "alarm"), monitor.alarm(), rtol=1e-9)
    np.testing.assert_allclose(out(system, context, "alarm_log"), monitor.log.ravel(), rtol=1e-9)
    np.testing.assert_allclose(out(system, context, "alarm_evidence"), monitor.evidence.ravel(), rtol=1e-7, atol=1e-9)
    assert system.header(context)["alarms"] == monitor.header[DriftEntry.ALARMS]
    assert system.GetUniquePeriodicDiscreteUpdateAttribute().period_sec() == pytest.approx(DT)
    assert system.events(context)[0]["kind"] in ("innovation", "rollout", "sensor")
