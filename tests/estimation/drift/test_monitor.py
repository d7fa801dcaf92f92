"""The drift monitor without any Diagram: silent in normal operation, quick when something changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation_bench import HOME, JOINTS, World, simulate, twin_terms
from twin_diagram.estimation.drift import alarm_lifecycle
from twin_diagram.estimation.drift import monitor as drift
from twin_diagram.estimation.drift.alarm_events import events
from twin_diagram.estimation.drift.likelihood_ratio import AlarmShape
from twin_diagram.estimation.drift.monitor import Monitor
from twin_diagram.estimation.drift.state import TUNING as STATE
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.short_rollout import short_rollout, torque_error
from twin_diagram.estimation.filter import belief
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.scenario import Drift, Filter
from twin_diagram.signals.layouts import NEVER, AlarmKind

TERMS = twin_terms()
PERIOD = 0.005
"""Of the messages [s]."""


@dataclass
class Watched:
    """A run as the monitor saw it."""

    monitor: Monitor
    armed_at: float
    log: np.ndarray
    ekf: Ekf
    stood: float
    """How long alarms stood [s]."""


def watch(world: World, duration: float, spike_at: float = np.inf) -> Watched:
    run = simulate(world, duration)
    ekf, monitor = Ekf(TERMS, Filter()), Monitor(TERMS, Drift(), Filter())
    armed_at, stood = np.inf, 0.0
    for k in range(len(run.time)):
        q = run.q[k].copy()
        if spike_at <= run.time[k] < spike_at + PERIOD:
            q[3] += 0.02
        ekf.observe(q, run.v[k], run.tau[k], run.time[k])
        b = ekf.belief
        nis = float(b.header[belief.Entry.NIS])
        monitor.observe(b.x[:14], b.theta, nis, q, run.tau[k], float(run.time[k]), innovation=b.innovation)
        if monitor.armed and armed_at == np.inf:
            armed_at = float(run.time[k])
        stood += monitor.active * PERIOD
    return Watched(monitor, armed_at, monitor.log[monitor.log[:, 0] >= 0.0], ekf, stood)


@pytest.mark.slow
def test_silent_for_a_quarter_of_a_minute():
    watched = watch(World.draw(11, period=6.0), 15.0)  # two periods and a half; minutes are among the slow tests
    # Learning takes 2 s, once the payload has been learnt.
    assert 2.0 < watched.armed_at < 6.0
    assert len(watched.log) == 0
    header = watched.monitor.header
    assert header[drift.DriftEntry.ROLLOUTS] >= 10
    assert 0.0 < header[drift.DriftEntry.ROLLOUT] < 0.5
    assert watched.monitor.alarm().tolist() == [0.0, AlarmKind.NONE, NEVER, 0.0]


@pytest.mark.slow
def test_silent_when_the_arm_rests_while_the_band_is_learnt():
    watched = watch(World.draw(12, start=4.0), 10.0)
    assert watched.armed_at < 4.0
    assert len(watched.log) == 0


@pytest.mark.slow
def test_no_false_alarm_over_many_runs():
    for seed in range(20):
        period = [4.0, 6.0, 10.0][seed % 3]
        watched = watch(World.draw(200 + seed, period=period), 60.0)
        assert len(watched.log) == 0, f"seed {seed}: {watched.log}"


@pytest.mark.parametrize(
    ("changes", "within"),
    [
        pytest.param({"added_mass": 1.0, "added_at": 5.0}, 0.10, marks=pytest.mark.slow),
        pytest.param({"dead_joint": 1, "dead_at": 5.0}, 0.03, marks=pytest.mark.slow),
        pytest.param({"dead_joint": 3, "dead_at": 5.0, "motor_left": 0.8}, 0.06, marks=pytest.mark.long),
    ],
)
def test_notices_abrupt_changes(changes, within):
    watched = watch(World.draw(13, period=6.0, **changes), 5.6)
    print(watched.log)
    assert len(watched.log) >= 1
    time, kind, statistic = watched.log[0]
    assert 5.0 < time <= 5.0 + within + 1e-9
    assert kind == AlarmKind.INNOVATION
    assert statistic > 1.0
    assert watched.stood >= alarm_lifecycle.TUNING.hold - PERIOD


@pytest.mark.slow
def test_alarm_ends_and_the_filter_has_learnt():
    world = World.draw(14, period=6.0, added_mass=1.0, added_at=4.0)
    watched = watch(world, 8.0)
    assert len(watched.log) == 1
    assert not watched.monitor.active
    assert watched.ekf.belief.theta[0] == pytest.approx(world.mass + 1.0, rel=0.05)


@pytest.mark.slow
def test_a_spike_is_no_drift():
    watched = watch(World.draw(15, period=6.0), 6.0, spike_at=5.0)
    assert watched.ekf.belief.header[belief.Entry.REFUSED] == 1
    assert len(watched.log) == 0


def test_an_encoder_that_jumps_is_found_with_its_second_message():
    monitor = Monitor(TERMS, Drift(), Filter())
    t = feed(monitor, 800)
    t = feed(monitor, 1, 5e4, start=t)
    assert not monitor.active
    t = feed(monitor, 50, start=t)
    feed(monitor, 2, 5e4, start=t)
    assert monitor.active
    assert monitor.alarm()[2] == pytest.approx(t + PERIOD)


@pytest.mark.parametrize(
    ("nis", "shape"),
    [
        ([5e4] * 3, AlarmShape.SPIKE),
        ([200.0] * 100, AlarmShape.STEP),
        (list(np.linspace(14.0, 50.0, 400)), AlarmShape.TREND),
    ],
)
def test_spike_step_and_trend_are_told_apart(nis, shape):
    monitor = Monitor(TERMS, Drift(), Filter())
    t = feed(monitor, 700)
    for value in nis:
        t = feed(monitor, 1, value, start=t)
    assert monitor.header[drift.DriftEntry.ALARMS] == 1
    t = feed(monitor, 200, start=t)
    (record,) = events(monitor)
    assert record["shape"] == shape.name.lower()


def test_readings_of_unknown_sensors_are_refused():
    monitor = Monitor(TERMS, Drift(), Filter(), {"imu": 6})
    feed(monitor, 10)
    monitor.reading("imu", np.zeros(6), True)
    before = monitor.vector.copy()
    with pytest.raises(FilterError, match="it knows imu"):
        monitor.reading("lidar", np.zeros(6), True)
    with pytest.raises(FilterError, match="6 are expected"):
        monitor.reading("imu", np.zeros(3), True)
    np.testing.assert_array_equal(monitor.vector, before)
    monitor.reading("imu", np.full(6, np.nan), True)
    assert np.all(np.isfinite(monitor.vector)) and not monitor.active


# Rollouts.


def test_rollout_follows_the_truth():
    world = World(mass=0.0, period=6.0)
    run = simulate(world, 3.0)
    parameters = ParameterSet(TERMS, Filter())
    start, end = 400, 420  # 0.1 s in full motion
    state = np.concatenate([run.q_true[start], run.v_true[start]])
    window = slice(start, end + 1)
    q, v = short_rollout(TERMS, parameters, state, parameters.mean, run.time[window], run.tau[window])
    # The torques' noise of 0.05 N·m moves the light wrist; as torque that is nothing.
    np.testing.assert_allclose(q[:4], run.q_true[end][:4], atol=3e-4)
    np.testing.assert_allclose(v[:4], run.v_true[end][:4], atol=1e-2)
    error = torque_error(TERMS, parameters, q, parameters.mean, q - run.q_true[end], 0.1)
    np.testing.assert_allclose(error, 0.0, atol=0.06)
    # A kilogram that the model does not know of shows as the torque of its weight.
    heavy = np.array([1.0, 0.0, 0.0, 0.2])
    wrong, _ = short_rollout(TERMS, parameters, state, heavy, run.time[window], run.tau[window])
    error = torque_error(TERMS, parameters, q, heavy, wrong - run.q_true[end], 0.1)
    TERMS.set_payload(heavy)
    loaded = TERMS.inverse_dynamics(run.q_true[start], np.zeros(7), 0.0)
    TERMS.set_payload(np.zeros(4))
    weight = loaded - TERMS.inverse_dynamics(run.q_true[start], np.zeros(7), 0.0)
    assert abs(weight[1]) > 4.0
    assert -error[1] == pytest.approx(weight[1], rel=0.25)


def test_rollout_that_runs_away_ends():
    parameters = ParameterSet(TERMS, Filter())
    torques = np.full((30, 7), 1e5)
    q, v = short_rollout(TERMS, parameters, np.zeros(14), parameters.mean, 0.005 * np.arange(30), torques)
    assert np.all(np.isfinite(q)) and np.all(np.isfinite(v))


# The monitor alone.


def feed(monitor: Monitor, count: int, nis: float = 14.0, start: float = 0.0, theta: np.ndarray | None = None) -> float:
    """Messages of an arm at rest, its torque holding it."""
    q, v = HOME, np.zeros(7)
    TERMS.set_payload(np.zeros(4))
    tau = TERMS.inverse_dynamics(q, v, 0.0)
    theta = np.zeros(4) if theta is None else theta
    for k in range(count):
        t = start + PERIOD * k
        monitor.observe(np.concatenate([q, v]), theta, nis, q, tau, t)
    return start + PERIOD * count


def test_learns_only_once_parameters_have_settled():
    monitor = Monitor(TERMS, Drift(), Filter())
    t = 0.0
    for k in range(20):  # 2 s in which the mass grows by 0.5 kg/s
        t = feed(monitor, 20, start=t, theta=np.array([0.05 * k, 0.0, 0.0, 0.0]))
    assert monitor.header[drift.DriftEntry.NORMAL] == 0.0
    t = feed(monitor, 1, 1000.0, start=t)
    assert not monitor.active
    feed(monitor, 600, start=t)
    assert monitor.armed
    # A model that never settles is watched nevertheless.
    restless = Monitor(TERMS, Drift(learning_time=0.5), Filter())
    t = 0.0
    for k in range(40):
        t = feed(restless, 20, start=t, theta=np.array([float(k % 2), 0.0, 0.0, 0.0]))
    assert restless.armed


@pytest.mark.long
def test_ring_of_alarms():
    monitor = Monitor(TERMS, Drift(), Filter())
    t = feed(monitor, 600)
    for _ in range(STATE.ring + 3):
        t = feed(monitor, 40, 500.0, start=t)
        t = feed(monitor, 200, start=t)
    assert monitor.header[drift.DriftEntry.ALARMS] == STATE.ring + 3
    assert np.all(monitor.log[:, 0] > 0.0)
    assert np.all(np.diff(np.sort(monitor.log[:, 0])) > 0.5)
    assert np.argmax(monitor.log[:, 0]) == 2


def test_rollout_alarm():
    """The filter claims all is well, and yet the arm goes elsewhere: only the rollout sees it."""
    monitor = Monitor(TERMS, Drift(), Filter())
    t = feed(monitor, 800)
    q, tau = HOME, TERMS.inverse_dynamics(HOME, np.zeros(7), 0.0)
    start, first = t, {}
    while t < start + 1.0:
        s = t - start
        moved = q + np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * 2.0 * s * s
        state = np.concatenate([moved, [0.0, 4.0 * s, 0.0, 0.0, 0.0, 0.0, 0.0]])
        monitor.observe(state, np.zeros(4), 14.0, moved, tau, t)
        t += 0.005
        if monitor.active and not first:
            first = events(monitor)[0]
    assert monitor.header[drift.DriftEntry.KIND] == AlarmKind.ROLLOUT
    assert monitor.active
    # The hand, from the same rollout and the plant's own kinematics.
    ends = [first["time"] - Drift().horizon, first["time"]]
    moved = [q + np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * 2.0 * (at - start) ** 2 for at in ends]
    state = np.concatenate([moved[0], [0.0, 4.0 * (ends[0] - start), 0.0, 0.0, 0.0, 0.0, 0.0]])
    times = np.linspace(*ends, 21)
    reached, _ = short_rollout(TERMS, ParameterSet(TERMS, Filter()), state, np.zeros(4), times, np.tile(tau, (21, 1)))
    context, frame = TERMS.plant.CreateDefaultContext(), TERMS.plant.GetFrameByName("panda_tcp")
    hands = []
    for angles in (reached, moved[1]):
        for joint, angle in zip(JOINTS, angles, strict=True):
            TERMS.plant.GetJointByName(joint).set_angle(context, angle)
        hands.append(frame.CalcPoseInWorld(context).translation())
    assert first["evidence"]["hand"] == pytest.approx(np.linalg.norm(hands[0] - hands[1]), abs=2e-4)
    assert first["evidence"]["hand"] > 0.01


def test_gap_ends_a_rollout():
    monitor = Monitor(TERMS, Drift(), Filter())
    t = feed(monitor, 620)
    feed(monitor, 200, start=t + 5.0)
    assert np.all(monitor.log[:, 0] == NEVER)
    feed(monitor, 200, start=1.0)  # a clock set back
    assert np.all(monitor.log[:, 0] == NEVER)
    assert monitor.header[drift.DriftEntry.TIME] == pytest.approx(1.995)


NUMBER = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, -1.0, 1e300, -1e300, np.nan, np.inf])
)


READY = Monitor(TERMS, Drift(), Filter())
READY_TIME = feed(READY, 500)


@given(st.lists(st.tuples(NUMBER, NUMBER, NUMBER, NUMBER, st.floats(-1.0, 1.0)), min_size=1, max_size=30))
def test_hostile_messages(messages):
    monitor = Monitor(TERMS, Drift(), Filter())
    monitor.vector[:] = READY.vector
    t = READY_TIME
    assert monitor.armed
    for nis, position, torque, mass, jump in messages:
        q, tau = HOME.copy(), np.zeros(7)
        q[2], tau[4] = position, torque
        t += jump
        monitor.observe(np.concatenate([q, np.zeros(7)]), np.array([mass, 0.0, 0.0, 0.0]), nis, q, tau, t)
        assert np.all(np.isfinite(monitor.vector))


def test_state_is_all_in_the_vector():
    """Two monitors that exchange vectors go on alike."""
    first, second = Monitor(TERMS, Drift(), Filter()), Monitor(TERMS, Drift(), Filter())
    t = feed(first, 333)
    second.vector[:] = first.vector
    feed(first, 300, 30.0, start=t)
    feed(second, 300, 30.0, start=t)
    np.testing.assert_array_equal(first.vector, second.vector)


def test_works_on_any_arm():
    from tests.estimation.filter.test_ekf import pendulum

    arm: ArmTerms = pendulum()
    monitor = Monitor(arm, Drift(), Filter(parameters=[]))
    for k in range(700):
        monitor.observe(np.zeros(2), np.zeros(0), 2.0, np.zeros(1), np.zeros(1), 0.005 * k)
    assert monitor.armed and not monitor.active


def test_a_filter_that_learns_other_parameters_is_refused() -> None:
    learning = Filter(parameters=["viscous_friction"])
    ekf = Ekf(TERMS, learning)
    ekf.observe(HOME, np.zeros(7), np.zeros(7), 0.0)
    with pytest.raises(FilterError, match=r"learns 7 parameters and the monitor was made for 4: .*tuning="):
        Monitor(TERMS).watch(ekf.belief, HOME, np.zeros(7))
    assert not Monitor(TERMS, tuning=learning).watch(ekf.belief, HOME, np.zeros(7))
