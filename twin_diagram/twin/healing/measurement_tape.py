"""The last seconds of what a station measured, kept aside while the loop runs.

Drake's own log sink gathers the messages in the Context of the run; between two steps they are taken out of it, so the
Context never grows and nothing large is copied with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import Multiplexer, VectorLogSink

from twin_diagram.errors import LogError
from twin_diagram.logs import Log
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports

_MEASURED = (ports.POSITION_MEASURED, ports.VELOCITY_ESTIMATED, ports.TORQUE_MEASURED)
"""The station's ports that are kept beside the time."""
_AS = ("position", "velocity", "torque", "position_commanded")
"""What a `Log` calls them; the command, which is no port of the station, comes last."""


class Tape:
    """A measured log of the newest seconds.

    Attributes:
        joints: in the order of the station's ports.
        seconds: how much is kept.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        station: System,
        commanded: OutputPort,
        joints: tuple[str, ...],
        *,
        rate: float,
        seconds: float,
    ) -> None:
        """Add a sink to a Diagram that is being built.

        Args:
            builder: holds the station.
            station: any.
            commanded: the positions that the arm is asked for (n) [rad].
            joints: names of the n joints.
            rate: of the station's messages; none more often is kept [1/s].
            seconds: kept.
        """
        self.joints, self.seconds = joints, seconds
        n = len(joints)
        gather = builder.AddNamedSystem("tape_columns", Multiplexer([1, n, n, n, n]))
        self._sink = builder.AddNamedSystem("tape", VectorLogSink(1 + 4 * n, 1.0 / rate))
        sources = [station.GetOutputPort(name) for name in (ports.MEASUREMENT_TIME, *_MEASURED)] + [commanded]
        for index, port in enumerate(sources):
            builder.Connect(port, gather.get_input_port(index))
        builder.Connect(gather.get_output_port(), self._sink.get_input_port())
        self._rows: Any = np.zeros((0, 1 + 4 * n))
        self._fresh: list[Array] = []
        self._newest = -np.inf

    @property
    def newest(self) -> float:
        """Time of the newest message [s]; minus infinity before the first."""
        return float(self._newest)

    @property
    def oldest(self) -> float:
        """Time of the oldest message that is kept [s]; infinity where there is none."""
        self._gather()
        return float(self._rows[0, 0]) if len(self._rows) else np.inf

    def take(self, context: Context) -> None:
        """Move what came since the last time from a root Context to the tape; between two steps of a simulator."""
        log = self._sink.FindMutableLog(context)
        rows = log.data().T
        # A message stands on the ports until the next one comes, and none stands there before the first.
        rows = rows[(rows[:, 0] >= 0.0) & (rows[:, 0] > self._newest)]
        rows = rows[np.append(True, np.diff(rows[:, 0]) > 0.0)] if len(rows) else rows
        if len(rows):
            self._newest = rows[-1, 0]
            self._fresh.append(np.array(rows))
        log.Clear()
        if sum(map(len, self._fresh)) > 1000:
            self._gather()

    def cut(self, start: float, end: float) -> Log:
        """Return the messages from one time to another, the later one left out [s].

        Raises:
            LogError: there are fewer than two of them.
        """
        self._gather()
        rows = self._rows[(self._rows[:, 0] >= start) & (self._rows[:, 0] < end)]
        if len(rows) < 2:
            raise LogError(f"the tape holds {len(rows)} messages from {start:g} s to {end:g} s")
        n = len(self.joints)
        parts = {name: rows[:, 1 + k * n : 1 + (k + 1) * n] for k, name in enumerate(_AS)}
        return Log(rows[:, 0], self.joints, **parts, source=f"{start:.1f} s to {end:.1f} s of this run")

    def _gather(self) -> None:
        if not self._fresh:
            return
        self._rows = np.concatenate([self._rows, *self._fresh])
        self._fresh.clear()
        self._rows = self._rows[np.searchsorted(self._rows[:, 0], self._newest - self.seconds) :]
