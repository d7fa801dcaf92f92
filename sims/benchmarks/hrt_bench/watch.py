"""Turns what filter and drift monitor say into alarms with a name."""

from __future__ import annotations

import numpy as np

from hrt_bench.estimate import Array
from twin_diagram.estimation.drift.monitor import DriftEntry as Seen
from twin_diagram.estimation.drift.monitor import Evidence, Monitor
from twin_diagram.estimation.drift.state import TUNING as STATE
from twin_diagram.estimation.dynamics.positive_definite import whiten
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf, Update
from twin_diagram.scenario import Drift
from twin_diagram.signals.layouts import AlarmKind


class Watch:
    """Collects the alarms of a drift monitor that is told of all sensors; the filter heeds them as in the Diagram."""

    def __init__(self, ekf: Ekf) -> None:
        self.alarms: list[tuple[float, str]] = []
        self._ekf = ekf
        sizes = {name: sensor.size for name, sensor in ekf.declared.sensors.items()}
        self.monitor = Monitor(ekf.terms, Drift(), ekf.params, sizes)

    def reading(self, name: str, result: Update) -> None:
        """After each further sensor's reading."""
        self.monitor.reading(name, whiten(result.covariance, result.innovation), result.accepted)
        self._collect()

    def message(self, q: Array, tau: Array, t: float) -> None:
        """After each message of the arm."""
        belief, monitor = self._ekf.belief, self.monitor
        state = np.concatenate([belief.q, belief.v])
        nis = float(belief.header[Entry.NIS])
        monitor.observe(state, belief.theta, nis, q, tau, t, belief.time, belief.innovation)
        self._collect()
        self._ekf.heed(monitor.alarm())

    def _collect(self) -> None:
        raised = int(self.monitor.header[Seen.ALARMS])
        while len(self.alarms) < raised:
            row = len(self.alarms) % STATE.ring
            time, kind, _ = self.monitor.log[row]
            sensor = int(self.monitor.evidence[row, Evidence.SENSOR])
            what = self.monitor.sensors[sensor] if sensor >= 0 else AlarmKind(int(kind)).name.lower()
            self.alarms.append((float(time), what))
