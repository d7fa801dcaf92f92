"""Notices when model and measurement part ways, usable without any Diagram.

Tests run side by side:

- **innovation**, at the filter's rate: NIS and a torque that begins and stays (`innovation_statistic`), and torques on
  sliding joints that were not there before (`momentum_observer`);
- **rollout**, every `Drift.period`: the model runs ahead for `Drift.horizon` (`rollout_statistic`);
- **sensor**, at each further sensor's rate: whether it parts ways with the rest (`sensor_consistency`).

Thresholds are μ + kσ of normal operation (Hybrid Reality Twins, section 3.4, "Threshold Selection"), but never within
what the filter itself claims, and all are widened as far as the rate of false alarms asks for (`false_alarm_rate`).
Normal operation begins when the parameters have settled, so a payload that is being learnt is neither an alarm nor a
lesson.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin_diagram.errors import expect
from twin_diagram.estimation.drift import alarm_lifecycle, innovation_statistic, likelihood_ratio
from twin_diagram.estimation.drift.false_alarm_rate import FalseRate
from twin_diagram.estimation.drift.momentum_observer import TorqueTest
from twin_diagram.estimation.drift.rollout_statistic import RolloutTest
from twin_diagram.estimation.drift.sensor_consistency import CrossCheck
from twin_diagram.estimation.drift.state import DriftEntry, DriftState, Evidence
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.model.model import Model
from twin_diagram.scenario import Drift, Filter
from twin_diagram.scenario.validation import check_filter
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ALARM_SIZE, NEVER, AlarmKind

__all__ = ["DriftEntry", "Evidence", "Monitor"]


@dataclass(frozen=True)
class Tuning:
    """When normal operation begins: chosen by hand.

    `sims/benchmarks/false_alarms.py` shows what it costs in false alarms.
    """

    settling: float = 0.25
    """Parameters have settled when they change by less than `settled` of their prior's deviation in this time [s]."""

    settled: float = 0.05
    """Share of its prior's deviation by which a parameter that has settled still changes in that time."""

    patience: float = 5.0
    """After this many learning times normal operation is taken for granted: a model may never settle."""

    longest_gap: float = 0.25
    """A longer silence of the sensors ends a rollout [s]."""


TUNING = Tuning()


INNOVATION, TORQUE, ROLLOUT, SENSORS = range(4)
"""Tests by the numbers that their margins have; each further sensor has one of its own."""


class Monitor:
    """The drift monitor of n joints and p parameters; all that it knows is one flat vector.

    Attributes:
        state: all that it knows.
        vector: the same as one vector.
        header: by `DriftEntry`.
        log: (ring, 3) time, kind and statistic of each alarm.
        evidence: (ring, len(Evidence) + n) of each alarm, by `Evidence`, then each joint's share of the change, in
            standard deviations.
        sensors: names of the further sensors that are cross-checked.
    """

    def __init__(
        self,
        terms: ArmTerms | Model,
        drift: Drift | None = None,
        tuning: Filter | None = None,
        sensors: Mapping[str, int] | None = None,
    ) -> None:
        """Make one that has not heard anything yet.

        Args:
            terms: the arm; of a model they are worked out.
            drift: tuning of the monitor; `Drift()` where None.
            tuning: of the filter that it watches; `Filter()` where None.
            sensors: degrees of freedom of each further sensor whose readings it will be told of, by name.
        """
        drift, tuning = drift or Drift(), tuning or Filter()
        expect(drift, Drift, "drift", "a Drift (the filter's tuning is `tuning`)")
        check_filter(tuning)
        self.terms = terms = ArmTerms.of(terms)
        self.params = drift
        self.parameters = ParameterSet(terms, tuning)
        self.sensors = tuple(sensors or ())
        self._cross = CrossCheck(tuple((sensors or {}).values()), drift.sigma, drift.learning_time)
        self._rollouts = RolloutTest(terms, self.parameters, drift, tuning)
        self._motors = TorqueTest(terms, self.parameters, tuning, drift.sigma)
        rows, changes = RolloutTest.rows(drift, tuning), len(likelihood_ratio.FORGETTING)
        self._rate = FalseRate(SENSORS + len(self.sensors), drift.false_alarms)
        sizes = self._cross.size, self._motors.size, self._rate.size
        self.state = DriftState(terms.n, self.parameters.size, changes, rows, *sizes)
        self._rate.begin(self.state.margins)
        self.vector: Any = self.state.vector
        self.header, self.log, self.evidence = self.state.header, self.state.log, self.state.evidence

    @property
    def armed(self) -> bool:
        """Whether normal operation has been learnt."""
        return bool(self.header[DriftEntry.NORMAL] >= self.params.learning_time)

    @property
    def active(self) -> bool:
        """Whether an alarm stands."""
        return alarm_lifecycle.stands(self.state)

    def alarm(self) -> Array:
        """Return (4,): active, `AlarmKind`, time raised [s], statistic over threshold."""
        h = self.header
        result = np.array([float(self.active), h[DriftEntry.KIND], h[DriftEntry.RAISED], h[DriftEntry.STATISTIC]])
        assert len(result) == ALARM_SIZE
        return result

    def watch(self, belief: Belief, q: Array, tau: Array) -> bool:
        """Take in what a filter made of the message that it has just observed; return whether an alarm stands.

        Args:
            belief: of the filter: `ekf.belief`.
            q: (n,) measured positions of that message [rad].
            tau: (n,) its measured torques [N·m].

        Raises:
            FilterError: the filter learns other parameters than the monitor was made for.
        """
        if belief.p != self.parameters.size:
            raise FilterError(
                f"the filter learns {belief.p} parameters and the monitor was made for {self.parameters.size}: "
                "Monitor(terms, tuning=…) takes the Filter that the filter was made with"
            )
        nis, t = float(belief.header[Entry.NIS]), float(belief.header[Entry.TIME])
        self.observe(belief.x[: 2 * belief.n], belief.theta, nis, q, tau, t, innovation=belief.innovation)
        return self.active

    def observe(
        self,
        state: Array,
        theta: Array,
        nis: float,
        q: Array,
        tau: Array,
        t: float,
        state_time: float | None = None,
        innovation: Array | None = None,
    ) -> None:
        """Take in what the filter made of a message. What is not new or not finite is left out.

        Args:
            state: (2n,) x̂.
            theta: (p,) θ̂.
            nis: of the message, 2n degrees of freedom.
            q: (n,) measured positions [rad].
            tau: (n,) measured torques [N·m].
            t: measurement time [s].
            state_time: that x̂ belongs to [s]; t where None.
            innovation: (n,) whitened; the change test is left out where None.
        """
        h = self.header
        state_time = t if state_time is None else state_time
        said = np.concatenate([state, theta, q, tau] if innovation is None else [state, theta, q, tau, innovation])
        sound = np.abs(said).max() < 1e6 and 0.0 <= nis < np.inf and 0.0 <= t < np.inf  # NaN compares false
        dt = self._elapsed(theta, nis, t) if sound else None
        if dt is None:
            return
        h[DriftEntry.TIME] = t
        self._settle(theta, t)
        learning = bool(h[DriftEntry.SETTLED]) and not self.armed
        if learning:
            h[DriftEntry.NORMAL] += dt
        alarm_lifecycle.turn_over(self.state, t)
        armed, margins = self.armed, self.state.margins
        self._rate.turn_over(margins, t, armed and not self.active)
        found = innovation_statistic.innovation_test(
            self.state, nis, innovation, dt, self.params.sigma, learning, armed
        )
        found = self._rate.take(margins, INNOVATION, found)
        if armed:
            found = max(found, innovation_statistic.in_a_row(self.state))
        calm = bool(h[DriftEntry.SETTLED]) and found < 1.0 and not self.active
        gained, joint, torque = self._motors.follow(self.state.motors, state, theta, tau, state_time, calm, armed)
        gained = self._rate.take(margins, TORQUE, gained)
        found = max(found, gained)
        alarm_lifecycle.note(self.state, found)
        if found > 1.0:
            named = (joint, torque) if gained > 1.0 else None
            alarm_lifecycle.raise_alarm(self.state, AlarmKind.INNOVATION, t, found, dt=dt, gained=named)
        elif armed and not learning and h[DriftEntry.ALARMS] > 0 and t < h[DriftEntry.QUIET]:
            alarm_lifecycle.reshape(self.state)
        found = self._rollouts.follow(self.state, state, theta, q, tau, t, state_time, learning, armed)
        found = self._rate.take(margins, ROLLOUT, found)
        if found > 1.0:
            alarm_lifecycle.raise_alarm(self.state, AlarmKind.ROLLOUT, t, found, longer=self.params.period)

    def reading(self, sensor: str, white: Array, accepted: bool) -> None:
        """Take in what the filter made of a further sensor's reading, after the message that came before it.

        Args:
            sensor: its name.
            white: whitened innovation, one number for each degree of freedom.
            accepted: whether the filter used it.

        Raises:
            FilterError: a sensor that the monitor was not made for, or another number of degrees of freedom.
        """
        if sensor not in self.sensors:
            known = ", ".join(self.sensors) or "none"
            raise FilterError(f"a sensor {sensor!r} that the monitor was not told of; it knows {known}")
        index, white = self.sensors.index(sensor), np.asarray(white, dtype=float)
        if white.shape != (self._cross.sizes[index],):
            raise FilterError(f"{sensor}: {white.shape} innovations where {self._cross.sizes[index]} are expected")
        t = float(self.header[DriftEntry.TIME])
        if t <= 0.0:
            return
        found = self._cross.follow(self.state.sensors, index, white, accepted, t, not self.active)
        found = self._rate.take(self.state.margins, SENSORS + index, found)
        alarm_lifecycle.note(self.state, found)
        if found > 1.0:
            alarm_lifecycle.raise_alarm(self.state, AlarmKind.SENSOR, t, found, sensor=index)

    def begin_anew(self) -> None:
        """Begin anew with a corrected model: what was measured against the old one says nothing now.

        What normal operation looks like stays as it was learnt: a model that is right again is held to the same band.
        Only the torque that each joint lacks is learnt anew: it is the model's own.
        An alarm that stands ends; one that the corrected model deserves comes back.
        """
        h = self.header
        self._resume(self.parameters.mean, float(h[DriftEntry.TIME]))
        h[DriftEntry.QUIET] = min(h[DriftEntry.QUIET], h[DriftEntry.TIME])
        h[DriftEntry.NEXT] += TUNING.settling
        h[[DriftEntry.ROLLOUT, DriftEntry.TENTH, DriftEntry.TENTHS]] = 0.0
        innovation_statistic.forget(self.state)
        self._cross.begin(self.state.sensors)
        self._motors.begin(self.state.motors)

    # Details.

    def _elapsed(self, theta: Array, nis: float, t: float) -> float | None:
        """Return the time since the message before [s]; None where there is none that this one joins up with."""
        h = self.header
        if t == h[DriftEntry.TIME]:
            return None
        if h[DriftEntry.SINCE] < 0.0:
            h[DriftEntry.SINCE] = h[DriftEntry.CHECKED] = h[DriftEntry.TIME] = t
            h[DriftEntry.NEXT] = t + TUNING.settling
            h[DriftEntry.NIS] = min(nis, 2.0 * self.terms.n)
            self.state.checked[:] = theta
            return None
        dt = float(t - h[DriftEntry.TIME])
        if 0.0 < dt <= TUNING.longest_gap:
            return dt
        self._resume(theta, t)  # a gap, or a clock set back
        return None

    def _resume(self, theta: Array, t: float) -> None:
        h = self.header
        h[[DriftEntry.TIME, DriftEntry.CHECKED, DriftEntry.NEXT]] = t
        h[DriftEntry.STARTED] = NEVER
        h[DriftEntry.SETTLED] = 0.0
        h[DriftEntry.SINCE] = min(h[DriftEntry.SINCE], t)
        h[DriftEntry.QUIET] = min(h[DriftEntry.QUIET], t + alarm_lifecycle.TUNING.hold)
        self.state.checked[:] = theta

    def _settle(self, theta: Array, t: float) -> None:
        h = self.header
        if t - h[DriftEntry.CHECKED] < TUNING.settling:
            return
        calm = bool(np.all(np.abs(theta - self.state.checked) <= TUNING.settled * self.parameters.scale))
        late = t - h[DriftEntry.SINCE] > TUNING.patience * self.params.learning_time
        h[DriftEntry.SETTLED] = float(calm or late)
        if not calm and t < h[DriftEntry.QUIET]:
            h[DriftEntry.MOVED] = 1.0
        h[DriftEntry.CHECKED] = t
        self.state.checked[:] = theta
