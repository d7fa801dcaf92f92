"""The drift monitor as a LeafSystem: a thin shell around `Monitor`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, cast

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus

from twin_diagram.estimation.drift.alarm_events import events
from twin_diagram.estimation.drift.monitor import DriftEntry, Monitor
from twin_diagram.estimation.drift.sensor_consistency import newest
from twin_diagram.estimation.drift.state import TUNING as STATE
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.filter.belief import TUNING as BELIEF
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.estimation.sensors.from_scenario import make_sensor
from twin_diagram.model.model import Model
from twin_diagram.model.model_user import ModelUser
from twin_diagram.runtime.timing import timed
from twin_diagram.scenario import Drift, Filter
from twin_diagram.scenario.validation import check_filter
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ALARM_LOG_FIELDS, ALARM_SIZE, NEVER


class DriftMonitor(ModelUser[Monitor]):
    """Raises an alarm when model and measurement part ways.

    .. pydrake_system::

        name: DriftMonitor
        input_ports:
        - arm_state
        - parameters
        - innovation
        - nis
        - position_measured
        - torque_measured
        - measurement_time
        - sensor_tracks
        output_ports:
        - alarm
        - alarm_log
        - alarm_evidence

    Rate: `Filter.rate`, a periodic discrete update at the instants of the filter's; a rollout every `Drift.period`.
    Latency: one period, since it sees what the filter made of the message before; it keeps that message to go with it.

    Ports:
        arm_state: (2n) x̂ of the filter [rad, rad/s].
        parameters: (p) θ̂ of the filter.
        innovation: (n) of the filter, whitened.
        nis: (1) of the filter.
        position_measured: (n) of the station, as the filter gets it [rad].
        torque_measured: (n) of the station, as the filter gets it [N·m].
        measurement_time: (1) of the station [s].
        sensor_tracks: of the filter, there where it fuses further sensors (`Filter.sensors`); they are cross-checked.
        alarm: (4) 1 while an alarm stands, `AlarmKind`, time raised [s] (`NEVER` before the first), largest statistic
            over threshold.
        alarm_log: (32 × 3, row by row) a ring: time raised (`NEVER` where empty), kind, statistic.
        alarm_evidence: (32 × (10 + n)) a row for each of the log's, by `state.Evidence`, then each joint's share of
            the change in standard deviations.

    `events` makes log and evidence into records for a JSON Lines file.

    A corrected model is handed on as `ModelUser` says; what was measured against the old one is forgotten: see
    `Monitor.begin_anew`.
    """

    def __init__(self, model: Model | ArmTerms, params: Drift, tuning: Filter) -> None:
        """Declare ports and state.

        Args:
            model: the twin's model, or the terms of any arm.
            params: tuning of the monitor.
            tuning: of the filter that it watches.
        """
        super().__init__()
        check_filter(tuning)
        self._params, self._tuning = params, tuning
        self.monitor = self._make(model)
        self._begin_with(self.monitor)
        terms = self.monitor.terms
        self._view = self._make(terms)
        n, p = terms.n, self.monitor.parameters.size
        self._inputs = [
            self.DeclareVectorInputPort(name, size)
            for name, size in (
                ("arm_state", 2 * n),
                ("parameters", p),
                ("innovation", n),
                ("nis", 1),
                ("position_measured", n),
                ("torque_measured", n),
                ("measurement_time", 1),
            )
        ]
        sizes = self._sizes(terms)
        ends = np.cumsum([0, *(len(SensorTrack) + size for size in sizes.values())])
        self._tracks = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self._further = self.DeclareVectorInputPort("sensor_tracks", int(ends[-1])) if sizes else None
        state = self.DeclareDiscreteState(self._view.vector)
        # The message of the instant before: position, torque, time.
        self._message = self.DeclareDiscreteState(cast(Any, np.concatenate([np.zeros(2 * n), [NEVER]])))
        self._seen = self.DeclareDiscreteState(int(ends[-1]))
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / tuning.rate, 0.0, self._update)
        for name, size, calc in (
            ("alarm", ALARM_SIZE, self._calc_alarm),
            ("alarm_log", STATE.ring * ALARM_LOG_FIELDS, self._calc_log),
            ("alarm_evidence", self.monitor.evidence.size, self._calc_evidence),
        ):
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={self.discrete_state_ticket(state)})

    def header(self, context: Context) -> dict[str, float]:
        """Return what the monitor knows, by `monitor.DriftEntry`: for plots and tests."""
        values = context.get_discrete_state(0).value()
        return {entry.name.lower(): float(values[entry]) for entry in DriftEntry}

    def events(self, context: Context, joints: Sequence[str] = ()) -> list[dict[str, Any]]:
        """Return all alarms still in the ring, oldest first, as records: see `alarm_events.events`."""
        return events(self._of(context), joints)

    def _hand_over(self, context: Context, made: Monitor) -> None:
        made.vector[:] = context.get_discrete_state(0).value()
        made.begin_anew()
        context.SetDiscreteState(0, made.vector)

    def _make(self, model: Model | ArmTerms) -> Monitor:
        terms = ArmTerms.of(model)
        return Monitor(terms, self._params, self._tuning, self._sizes(terms))

    def _sizes(self, terms: ArmTerms) -> dict[str, int]:
        sensors = [make_sensor(terms, spec) for spec in self._tuning.sensors]
        return {sensor.name: sensor.size for sensor in sensors}

    @timed("DriftMonitor")
    def _update(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        state, theta, innovation, nis, q, tau, t = (cast(Array, port.Eval(context)) for port in self._inputs)
        monitor = self._in_use(context)
        monitor.vector[:] = context.get_discrete_state(0).value()
        before = context.get_discrete_state(self._message).value()
        n, message_time = len(q), float(before[-1])
        # The filter carried its state on from that message to the present.
        ahead = min(max(context.get_time() - message_time, 0.0), BELIEF.longest_look)
        q_then, tau_then = before[:n], before[n : 2 * n]
        monitor.observe(state, theta, float(nis[0]), q_then, tau_then, message_time, message_time + ahead, innovation)
        if self._further is not None:
            tracks = cast(Array, self._further.Eval(context))
            seen = context.get_discrete_state(self._seen).value()
            for name, part in zip(monitor.sensors, self._tracks, strict=True):
                reading = newest(seen[part], tracks[part])
                if reading is not None:
                    monitor.reading(name, *reading)
            discrete.set_value(int(self._seen), tracks)
        discrete.set_value(0, monitor.vector)
        discrete.set_value(int(self._message), cast(Any, np.concatenate([q, tau, t])))
        return EventStatus.Succeeded()

    def _of(self, context: Context) -> Monitor:
        self._view.vector[:] = context.get_discrete_state(0).value()
        return self._view

    def _calc_alarm(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._of(context).alarm()))

    def _calc_log(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._of(context).log.ravel()))

    def _calc_evidence(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._of(context).evidence.ravel()))
