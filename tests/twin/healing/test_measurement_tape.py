"""The tape by itself: what it keeps of an arm of two joints, how often, how long, and in which columns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from twin_diagram.errors import LogError
from twin_diagram.station import ports
from twin_diagram.twin.healing.measurement_tape import Tape

N = 2


class Ticking(LeafSystem):
    """A station of two joints with a message every 10 ms, the first at zero; column k of signal s is 10 s + k + t."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorOutputPort(ports.MEASUREMENT_TIME, 1, self._reader(None), {self.time_ticket()})
        names = (ports.POSITION_MEASURED, ports.VELOCITY_ESTIMATED, ports.TORQUE_MEASURED)
        for signal, name in enumerate(names):
            self.DeclareVectorOutputPort(name, N, self._reader(signal), {self.time_ticket()})

    @staticmethod
    def _reader(signal: int | None) -> Any:
        def read(context: Context, output: BasicVector) -> None:
            t = np.floor(100.0 * context.get_time() + 1e-6) / 100.0
            output.SetFromVector([t] if signal is None else 10.0 * signal + np.arange(N) + t)

        return read


def taped(seconds: float, rate: float) -> tuple[Simulator, Tape]:
    inner = DiagramBuilder()
    clock = inner.AddSystem(Ticking())
    for name in ports.output_names(clock):
        inner.ExportOutput(clock.GetOutputPort(name), name)
    builder = DiagramBuilder()
    station = builder.AddSystem(inner.Build())
    asked = builder.AddSystem(ConstantVectorSource([70.0, 71.0]))
    tape = Tape(builder, station, asked.get_output_port(), ("one", "two"), rate=rate, seconds=seconds)
    return Simulator(builder.Build()), tape


def play(simulator: Simulator, tape: Tape, times: list[float]) -> None:
    for time in times:
        simulator.AdvanceTo(time)
        tape.take(simulator.get_mutable_context())


def test_each_signal_of_each_joint_stands_in_its_own_column() -> None:
    simulator, tape = taped(5.0, 100.0)
    play(simulator, tape, [0.5, 1.0])
    log = tape.cut(0.0, 9.0)
    assert log.joints == ("one", "two") and log.time[0] == 0.0, "a message at zero is one, too"
    for signal, columns in enumerate((log.position, log.velocity, log.torque)):
        assert columns is not None
        np.testing.assert_allclose(columns, 10.0 * signal + np.arange(2) + log.time[:, None])
    assert log.position_commanded is not None
    np.testing.assert_array_equal(log.position_commanded, np.tile([70.0, 71.0], (len(log.time), 1)))


@pytest.mark.parametrize(("rate", "apart"), [(100.0, 0.01), (50.0, 0.02), (25.0, 0.04), (400.0, 0.01)])
def test_messages_are_kept_as_often_as_they_come_or_as_was_asked(rate: float, apart: float) -> None:
    simulator, tape = taped(5.0, rate)
    play(simulator, tape, [0.4, 0.8])
    np.testing.assert_allclose(np.diff(tape.cut(0.0, 9.0).time), apart, atol=1e-9)


def test_a_cut_begins_with_its_start_and_ends_before_its_end() -> None:
    simulator, tape = taped(5.0, 100.0)
    play(simulator, tape, [1.0])
    whole = tape.cut(0.0, 9.0).time
    part = tape.cut(whole[20], whole[50]).time
    np.testing.assert_array_equal(part, whole[20:50])
    assert len(tape.cut(whole[20], whole[22]).time) == 2, "two are a log"
    with pytest.raises(LogError, match=r"holds 1 messages from 0\.2 s to 0\.21 s"):
        tape.cut(whole[20], whole[21])


def test_what_is_older_than_the_seconds_kept_is_let_go_and_no_earlier() -> None:
    simulator, tape = taped(2.0, 100.0)
    play(simulator, tape, [1.0, 1.9])
    assert tape.oldest == 0.0
    play(simulator, tape, [2.5, 5.0])
    assert tape.newest == pytest.approx(5.0) and tape.oldest == pytest.approx(3.0)
    assert len(tape.cut(0.0, 9.0).time) == 201


def test_a_long_run_between_two_looks_is_not_piled_up() -> None:
    simulator, tape = taped(1.0, 100.0)
    play(simulator, tape, [0.0, 12.0])
    assert sum(map(len, tape._fresh)) + len(tape._rows) <= 102, "a second is kept, not twelve"
