"""AdaptiveEkf and DriftMonitor as systems: ports, state, hostile messages, the same figures as without a Diagram."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from tests.estimation_bench import COULOMB, HOME, JOINTS, VISCOUS, Recording, World, simulate, twin_terms
from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.drift_system import DriftMonitor
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, Drift, EffectSpec, Filter
from twin_diagram.signals.layouts import ALARM_LOG_FIELDS, ALARM_SIZE, NEVER, AlarmKind

MESSAGE = ("position_measured", "velocity_estimated", "torque_measured", "measurement_time")
SYSTEM = AdaptiveEkf(twin_terms(), Filter(), HOME)


@functools.cache
def recording(duration: float = 3.0, **changes: float) -> Recording:
    return simulate(World(period=6.0, seed=5, **changes), duration)


class Player(LeafSystem):
    """Plays a recording like a station: each message is 2.5 ms old when it can be read."""

    def __init__(self, run: Recording, age: float = 0.0025) -> None:
        super().__init__()
        self._run, self._age = run, age
        for name, values in zip(MESSAGE, (run.q, run.v, run.tau), strict=False):
            self.DeclareVectorOutputPort(name, 7, functools.partial(self._calc, values))
        self.DeclareVectorOutputPort("measurement_time", 1, self._calc_time)

    def _index(self, context: Context) -> int:
        return min(int((context.get_time() - self._age) / 0.005 + 1e-6), len(self._run.time) - 1)

    def _calc(self, values: np.ndarray, context: Context, output: BasicVector) -> None:
        index = self._index(context)
        output.SetFromVector(values[index] if context.get_time() >= self._age else np.full(7, np.nan))

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        known = context.get_time() >= self._age
        output.SetFromVector([self._run.time[self._index(context)] if known else NEVER])


def loop(run: Recording, model=None) -> tuple[Diagram, dict[str, LeafSystem]]:
    """Player, filter and monitor, wired as the twin wires them."""
    builder = DiagramBuilder()
    model = model or twin_terms()
    player = builder.AddNamedSystem("player", Player(run))
    ekf = builder.AddNamedSystem("ekf", AdaptiveEkf(model, Filter(), HOME))
    monitor = builder.AddNamedSystem("monitor", DriftMonitor(model, Drift(), Filter()))
    for name in MESSAGE:
        builder.Connect(player.GetOutputPort(name), ekf.GetInputPort(name))
        if name != "velocity_estimated":
            builder.Connect(player.GetOutputPort(name), monitor.GetInputPort(name))
    for name in ("arm_state", "parameters", "innovation", "nis"):
        builder.Connect(ekf.GetOutputPort(name), monitor.GetInputPort(name))
    log = LogVectorOutput(ekf.GetOutputPort("arm_state"), builder, 0.005)
    return builder.Build(), {"ekf": ekf, "monitor": monitor, "log": log}


def tick(system: LeafSystem, context: Context, q, v, tau, t) -> None:
    for name, value in zip(MESSAGE, (q, v, tau, np.atleast_1d(t)), strict=True):
        system.GetInputPort(name).FixValue(context, value)
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))


def test_ports():
    assert [SYSTEM.get_input_port(i).get_name() for i in range(SYSTEM.num_input_ports())] == [*MESSAGE, "alarm"]
    sizes = {SYSTEM.get_output_port(i).get_name(): SYSTEM.get_output_port(i).size() for i in range(5)}
    assert sizes == {"arm_state": 14, "parameters": 4, "covariance": 18**2, "innovation": 7, "nis": 1}
    assert SYSTEM.HasAnyDirectFeedthrough() is False
    monitor = DriftMonitor(twin_terms(), Drift(), Filter())
    names = [monitor.get_input_port(i).get_name() for i in range(monitor.num_input_ports())]
    assert names == ["arm_state", "parameters", "innovation", "nis", *MESSAGE[:1], *MESSAGE[2:]]
    assert monitor.GetOutputPort("alarm").size() == ALARM_SIZE
    assert monitor.GetOutputPort("alarm_log").size() == 32 * ALARM_LOG_FIELDS
    assert monitor.HasAnyDirectFeedthrough() is False
    for system in (SYSTEM, monitor):
        assert "pydrake_system::" in type(system).__doc__
        for name in [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]:
            assert f"- {name}" in type(system).__doc__


def test_before_the_first_message():
    context = SYSTEM.CreateDefaultContext()
    for _ in range(3):
        tick(SYSTEM, context, np.full(7, np.nan), np.zeros(7), np.zeros(7), NEVER)
    np.testing.assert_array_equal(SYSTEM.GetOutputPort("arm_state").Eval(context), np.concatenate([HOME, np.zeros(7)]))
    np.testing.assert_array_equal(SYSTEM.GetOutputPort("parameters").Eval(context), 0.0)
    covariance = SYSTEM.GetOutputPort("covariance").Eval(context).reshape(18, 18)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert covariance[0, 0] > 1.0
    assert SYSTEM.GetOutputPort("nis").Eval(context)[0] == 0.0
    assert not any(SYSTEM.counters(context).values())


def test_same_as_without_a_diagram():
    run = recording()
    context = SYSTEM.CreateDefaultContext()
    ekf = Ekf(twin_terms(), Filter())
    for k in range(200):
        tick(SYSTEM, context, run.q[k], run.v[k], run.tau[k], run.time[k])
        ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
    np.testing.assert_array_equal(SYSTEM.belief(context).vector, ekf.belief.vector)
    np.testing.assert_array_equal(SYSTEM.GetOutputPort("parameters").Eval(context), ekf.belief.theta)
    context.SetTime(run.time[199])
    np.testing.assert_allclose(SYSTEM.GetOutputPort("arm_state").Eval(context), ekf.belief.x[:14], atol=1e-12)
    outside = np.r_[0:14, 21:25]
    covariance = SYSTEM.GetOutputPort("covariance").Eval(context).reshape(18, 18)
    np.testing.assert_array_equal(covariance, ekf.belief.P[np.ix_(outside, outside)])
    assert np.all(np.abs(SYSTEM.GetOutputPort("innovation").Eval(context)) < 4.0)


def test_two_contexts_do_not_meet():
    run = recording()
    first, second = SYSTEM.CreateDefaultContext(), SYSTEM.CreateDefaultContext()
    alone = SYSTEM.CreateDefaultContext()
    for k in range(60):
        tick(SYSTEM, alone, run.q[k], run.v[k], run.tau[k], run.time[k])
    for k in range(60):
        tick(SYSTEM, first, run.q[k], run.v[k], run.tau[k], run.time[k])
        tick(SYSTEM, second, run.q[300 - k], -run.v[300 - k], run.tau[300 - k], run.time[k])
        SYSTEM.GetOutputPort("covariance").Eval(second)
    np.testing.assert_array_equal(SYSTEM.belief(first).vector, SYSTEM.belief(alone).vector)


def test_in_a_diagram_the_state_is_of_the_present():
    run = recording()
    diagram, parts = loop(run)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.9)
    context = simulator.get_context()
    log = parts["log"].FindLog(context)
    times, states = log.sample_times(), log.data()
    later = times > 0.1
    truth = np.array([np.interp(times, run.time, run.q_true[:, j]) for j in range(7)])
    error = states[:7, later] - truth[:, later]
    assert np.abs(run.v_true).max() > 0.4  # a latency of 5 ms would be 2 mrad
    assert np.sqrt(np.mean(error**2)) < 3e-5
    assert np.abs(error).max() < 2e-4
    counters = parts["ekf"].counters(parts["ekf"].GetMyContextFromRoot(context))
    assert counters["accepted"] >= 570
    assert sum(counters.values()) == counters["accepted"]


@pytest.mark.long
def test_alarm_in_a_diagram():
    run = recording(5.6, added_mass=1.5, added_at=5.0)
    diagram, parts = loop(run)
    simulator = Simulator(diagram)
    monitor = parts["monitor"]
    context = monitor.GetMyContextFromRoot(simulator.get_context())
    simulator.AdvanceTo(4.99)
    assert monitor.header(context)["normal"] >= 2.0
    assert monitor.header(context)["rollouts"] >= 10
    assert 0.0 < monitor.header(context)["rollout"] < 0.5
    np.testing.assert_array_equal(monitor.GetOutputPort("alarm").Eval(context), [0.0, AlarmKind.NONE, NEVER, 0.0])
    assert np.all(monitor.GetOutputPort("alarm_log").Eval(context).reshape(32, 3)[:, 0] == NEVER)
    simulator.AdvanceTo(5.3)
    active, kind, time, statistic = monitor.GetOutputPort("alarm").Eval(context)
    assert active == 1.0 and kind == AlarmKind.INNOVATION and 5.0 < time < 5.1 and statistic > 1.0
    ring = monitor.GetOutputPort("alarm_log").Eval(context).reshape(32, 3)
    np.testing.assert_array_equal(ring[0], [time, kind, statistic])
    assert np.all(ring[1:, 0] == NEVER)


def test_two_runs_are_identical():
    run = recording()
    diagram, parts = loop(run)
    vectors = []
    for _ in range(2):
        simulator = Simulator(diagram)
        simulator.AdvanceTo(0.8)
        contexts = [parts[name].GetMyContextFromRoot(simulator.get_context()) for name in ("ekf", "monitor")]
        vectors.append(np.concatenate([c.get_discrete_state(0).value() for c in contexts]))
    np.testing.assert_array_equal(vectors[0], vectors[1])


def test_with_a_model():
    joints = list(JOINTS)
    model = Model.load(
        ArmModel(
            effects=[
                EffectSpec("coulomb_friction", joints, [], {"torque": COULOMB.tolist()}),
                EffectSpec("viscous_friction", joints, [], {"damping": VISCOUS.tolist()}),
            ]
        )
    )
    run = recording()
    system, reference = AdaptiveEkf(model, Filter()), AdaptiveEkf(twin_terms(), Filter())
    contexts = [s.CreateDefaultContext() for s in (system, reference)]
    for k in range(100):
        for s, context in zip((system, reference), contexts, strict=True):
            tick(s, context, run.q[k], run.v[k], run.tau[k], run.time[k])
    beliefs = [s.belief(context) for s, context in zip((system, reference), contexts, strict=True)]
    np.testing.assert_allclose(beliefs[0].x, beliefs[1].x, atol=1e-9)


def test_without_parameters():
    system = AdaptiveEkf(twin_terms(), Filter(parameters=[]))
    context = system.CreateDefaultContext()
    run = recording()
    for k in range(20):
        tick(system, context, run.q[k], run.v[k], run.tau[k], run.time[k])
    assert system.GetOutputPort("parameters").size() == 0
    assert system.GetOutputPort("covariance").size() == 14**2
    with pytest.raises(ScenarioError):
        AdaptiveEkf(twin_terms(), Filter(parameters=["nonsense"]))


# Hostile messages.

NUMBER = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 1e-300, 1e9, -1e9, 1e300, np.nan, np.inf, -np.inf]),
    st.floats(-10.0, 10.0),
    st.floats(allow_nan=True, allow_infinity=True),
)
EVENT = st.tuples(
    st.sampled_from(["good", "position", "velocity", "torque", "all", "time", "late", "silence"]),
    NUMBER,
    st.integers(0, 6),
)


def warm_up() -> np.ndarray:
    run, context = recording(), SYSTEM.CreateDefaultContext()
    for k in range(100):
        tick(SYSTEM, context, run.q[k], run.v[k], run.tau[k], run.time[k])
    return context.get_discrete_state_vector().value().copy()


WARM = warm_up()


EVENTS = st.lists(EVENT, min_size=1, max_size=15)


@pytest.mark.long
@settings(max_examples=60)
@given(EVENTS, st.booleans())
def test_hostile_messages_never_poison_the_state(events, warm):
    come_back(events, warm)


@pytest.mark.slow
@settings(max_examples=600)
@given(EVENTS, st.booleans())
def test_many_hostile_messages_never_poison_the_state(events, warm):
    come_back(events, warm)


def come_back(events, warm):
    """Thousands of bad messages; then good ones, and the filter is back on the truth."""
    run = recording()
    context = SYSTEM.CreateDefaultContext()
    if warm:
        context.SetDiscreteState(WARM)
    k = 100  # the message's number
    for kind, number, joint in events:
        q, v, tau, t = run.q[k].copy(), run.v[k].copy(), run.tau[k].copy(), float(run.time[k])
        if kind in ("position", "all"):
            q[joint] = number
        if kind in ("velocity", "all"):
            v[joint] = number
        if kind in ("torque", "all"):
            tau[joint] = number
        if kind in ("time", "all"):
            t = number
        if kind == "late":
            t -= 0.3
        if kind != "silence":
            tick(SYSTEM, context, q, v, tau, t)
        k += 1
        belief = SYSTEM.belief(context)
        assert np.all(np.isfinite(belief.vector))
        assert np.all(np.isfinite(SYSTEM.GetOutputPort("arm_state").Eval(context)))
        assert belief.P.diagonal().min() >= 0.0
        assert 0.0 <= belief.theta[0] <= 10.0
        assert np.abs(belief.theta[1:]).max() <= 10.0
    last = k + 29
    for k in range(k, last + 1):  # noqa: B020
        tick(SYSTEM, context, run.q[k], run.v[k], run.tau[k], run.time[k])
    belief = SYSTEM.belief(context)
    assert belief.time == run.time[last]
    assert np.abs(belief.q - run.q_true[last]).max() < 1e-3
    assert np.linalg.eigvalsh(belief.P).min() > -1e-12


def test_what_is_missing_is_counted_and_held():
    run = recording()
    context = SYSTEM.CreateDefaultContext()
    context.SetDiscreteState(WARM)
    before = SYSTEM.belief(context)
    bad = np.full(7, np.nan)
    tick(SYSTEM, context, bad, run.v[100], run.tau[100], run.time[100])
    tick(SYSTEM, context, run.q[99], run.v[99], run.tau[99], run.time[99])
    after = SYSTEM.belief(context)
    np.testing.assert_array_equal(after.x, before.x)
    counters = SYSTEM.counters(context)
    assert counters["invalid"] == 1 and counters["stale"] == 1
    # Without a torque the state still follows the encoders, and the payload hardly moves.
    tick(SYSTEM, context, run.q[100], run.v[100], bad, run.time[100])
    belief = SYSTEM.belief(context)
    assert belief.time == run.time[100]
    assert np.abs(belief.q - run.q_true[100]).max() < 5e-5
    assert np.abs(belief.theta - before.theta).max() < 1e-3
    assert SYSTEM.counters(context)["invalid"] == 2


def test_alarm_at_the_port_holds_the_noise() -> None:
    """The same messages, with an alarm that stands and without."""
    system = AdaptiveEkf(twin_terms(), Filter(encoder_std=1e-3), HOME)
    run, levels = recording(2.0), []
    for stands in (0.0, 1.0):
        context = system.CreateDefaultContext()
        system.GetInputPort("alarm").FixValue(context, [stands, 0.0, NEVER, 0.0])
        for k in range(len(run.time)):
            tick(system, context, run.q[k], run.v[k], run.tau[k], run.time[k])
        levels.append(np.abs(system.belief(context).noise).max())
    assert levels[0] > 0.1
    assert levels[1] == 0.0
