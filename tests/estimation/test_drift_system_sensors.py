"""The drift monitor in a Diagram cross-checks the filter's further sensors, by the records that the filter keeps."""

from __future__ import annotations

import numpy as np

from tests.estimation_bench import HOME, twin_terms
from twin_diagram.estimation.drift_system import DriftMonitor
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.estimation.filter.sensor_registry import note
from twin_diagram.scenario import Drift, Filter, SensorSpec
from twin_diagram.signals.layouts import NEVER, AlarmKind

TERMS = twin_terms()
TUNING = Filter(sensors=[SensorSpec(kind="imu", name="hand_imu"), SensorSpec(kind="torque")])


def test_ports_fit_the_filters() -> None:
    ekf, monitor = AdaptiveEkf(TERMS, TUNING), DriftMonitor(TERMS, Drift(), TUNING)
    size = ekf.GetOutputPort("sensor_tracks").size()
    assert size == monitor.GetInputPort("sensor_tracks").size() == 2 * len(SensorTrack) + 6 + 7
    assert not AdaptiveEkf(TERMS, Filter()).HasOutputPort("sensor_tracks")
    assert not DriftMonitor(TERMS, Drift(), Filter()).HasInputPort("sensor_tracks")


def test_a_sensor_that_parts_ways_is_named() -> None:
    system = DriftMonitor(TERMS, Drift(learning_time=0.5), TUNING)
    context = system.CreateDefaultContext()
    TERMS.set_payload(np.zeros(4))
    tau = TERMS.inverse_dynamics(HOME, np.zeros(7), 0.0)
    for name, value in (
        ("arm_state", np.concatenate([HOME, np.zeros(7)])),
        ("parameters", np.zeros(4)),
        ("innovation", np.zeros(7)),
        ("nis", [14.0]),
        ("position_measured", HOME),
        ("torque_measured", tau),
    ):
        system.GetInputPort(name).FixValue(context, value)
    rng = np.random.default_rng(0)
    imu, torque = np.zeros(len(SensorTrack) + 6), np.zeros(len(SensorTrack) + 7)
    for k in range(1200):
        t = 0.005 * (k + 1)
        white = rng.normal(size=6)
        if k >= 1000:
            white[2] += 5.0  # a gyroscope's bias
        note(imu, white, float(white @ white), t, True)
        note(torque, rng.normal(size=7), 7.0, t, True)
        system.GetInputPort("measurement_time").FixValue(context, [t])
        system.GetInputPort("sensor_tracks").FixValue(context, np.concatenate([imu, torque]))
        context.SetTime(t)
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    (record,) = system.events(context)
    assert record["kind"] == AlarmKind.SENSOR.name.lower()
    assert record["sensor"] == "hand_imu"
    assert 5.0 < record["time"] <= 5.03


def test_a_reading_that_comes_too_late_is_stale_and_not_invalid_too() -> None:
    system = AdaptiveEkf(TERMS, TUNING)
    context = system.CreateDefaultContext()
    TERMS.set_payload(np.zeros(4))
    given = (
        ("position_measured", HOME),
        ("velocity_estimated", np.zeros(7)),
        ("torque_measured", TERMS.inverse_dynamics(HOME, np.zeros(7), 0.0)),
        ("hand_imu.reading", np.zeros(6)),
        ("torque.reading", np.zeros(7)),
        ("torque.time", [NEVER]),
    )
    for name, value in given:
        system.GetInputPort(name).FixValue(context, value)
    for t, taken in ((0.005, NEVER), (0.5, NEVER), (0.505, 0.3)):  # a silence: the filter begun anew at 0.5 s
        system.GetInputPort("measurement_time").FixValue(context, [t])
        system.GetInputPort("hand_imu.time").FixValue(context, [taken])
        context.SetTime(t)
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    imu = system.belief(context).tracks[0]
    assert (imu[SensorTrack.STALE], imu[SensorTrack.INVALID], imu[SensorTrack.ACCEPTED]) == (1.0, 0.0, 0.0)
