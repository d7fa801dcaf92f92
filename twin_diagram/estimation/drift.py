"""Notices when model and measurement part ways, usable without any Diagram.

Three tests run side by side:

- **innovation**, at the filter's rate: normalised innovation squared (NIS), averaged over a tenth of a second and as a
  cumulative sum (Page's test), against the band of normal operation;
- **change**, at the filter's rate: the whitened innovations of the joints' torques, summed with exponential forgetting
  over some 2 to 20 messages: a generalised likelihood ratio for a torque that began then and stays (see `change`);
- **rollout**, every `Drift.period`: the model runs for `Drift.horizon` from a state and parameters that the filter
held then,
  under the torques measured since, and is compared with the encoders now (Hybrid Reality Twins, section 3.4). The error
  counts as joint torque.

Thresholds are μ + kσ of normal operation (section 3.4, "Threshold Selection"), but never within what the filter itself
claims: an innovation that its covariance allows is no drift. Normal operation begins when the parameters have settled,
so a payload that is being learnt is neither an alarm nor a lesson.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np

from twin_diagram.estimation import change
from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.disturbance import disturbance_std
from twin_diagram.estimation.parameters import ParameterSet
from twin_diagram.estimation.rollout import rollout, torque_error
from twin_diagram.scenario import Drift, Filter
from twin_diagram.signals import ALARM_LOG_FIELDS, ALARM_SIZE, NEVER, AlarmKind, Array

RING: Final = 32
"""Alarms that are remembered."""
WINDOW: Final = 0.1
"""Time over which NIS is averaged [s]."""
SETTLING: Final = 0.25
"""Parameters have settled when they change by less than `SETTLED` of their prior's deviation in this time [s]."""
SETTLED: Final = 0.05
PATIENCE: Final = 5.0
"""After this many learning times normal operation is taken for granted: a model may never settle."""
HOLD: Final = 0.5
"""An alarm ends when its test has been quiet for this long [s]."""
LONGEST_GAP: Final = 0.25
"""A longer silence of the sensors ends a rollout [s]."""
_RUNAWAY: Final = 1e6
"""Stands for the error of a rollout that ran away [N·m]."""
_SPIKE: Final = 10.0
"""One message counts for no more than this many times the degrees of freedom, so that a spike alone is no drift."""
_SLACK: Final = 0.5
"""The cumulative sum forgives this many standard deviations per message."""
_JUMP: Final = 2.0
"""It alarms at this many k standard deviations."""
_TENTHS: Final = 30
_STANDS_OUT: Final = 4.0
"""A joint is named where its share of a change is this many standard deviations."""
_OF_LARGEST: Final = 0.4
"""And this share of the largest."""


class Evidence(IntEnum):
    """What an alarm stands on; each joint's share of the change follows, in standard deviations."""

    SHAPE = 0
    """`Shape`."""
    JOINT = 1
    """Whose torque changed, by index; negative where none stands out."""
    ABOVE = 2
    """How long the statistic was above its threshold [s]."""
    NIS = 3
    """Averaged over a tenth of a second, over its degrees of freedom."""
    CHANGE = 4
    """Change test, over its threshold."""
    ROLLOUT = 5
    """Newest rollout, over its threshold."""
    SUM = 6
    """Page's sum, in standard deviations."""


class Entry(IntEnum):
    """Entries of a monitor's header."""

    TIME = 0
    """Of the newest message [s]; `NEVER` before the first."""
    SINCE = 1
    """Of the first."""
    NORMAL = 2
    """Time spent in normal operation [s]."""
    CHECKED = 3
    """When it was last checked that the parameters have settled [s]."""
    SETTLED = 4
    """1 while they have."""
    NIS = 5
    """Averaged over `WINDOW`."""
    SUM = 6
    """Cumulative sum of NIS, in standard deviations."""
    COUNT = 7
    """Messages learnt from."""
    MEAN = 8
    """Of the averaged NIS in normal operation."""
    SQUARES = 9
    """Sum of its squared deviations."""
    SPREAD = 10
    """Sum of squared deviations of NIS itself from its mean."""
    ROLLOUTS = 11
    """Rollouts learnt from."""
    NEXT = 12
    """When the next rollout starts [s]."""
    STARTED = 13
    """When the running rollout started [s]; `NEVER` when none runs."""
    FILLED = 14
    """Torques stored for it."""
    KIND = 15
    """`AlarmKind` of the newest alarm."""
    RAISED = 16
    """When it was raised [s]."""
    STATISTIC = 17
    """Its largest statistic over the threshold."""
    QUIET = 18
    """Until when it stays active [s]."""
    ALARMS = 19
    """Raised so far."""
    ROLLOUT = 20
    """Statistic of the newest rollout over its threshold."""
    CHANGE = 21
    """Statistic of the newest message's change test over its threshold."""
    ABOVE = 22
    """For how long the newest alarm's statistic was above its threshold [s]."""
    SHAPE = 23
    """`Shape` of the newest alarm."""
    JOINT = 24
    """Which joint's torque it is about, by index; negative where none stands out."""
    TENTH = 25
    """Largest statistic of this tenth of a second."""
    TENTHS = 26
    """Tenths of a second seen."""
    FROM = 27
    """When this tenth began [s]."""
    MOVED = 28
    """1 where parameters moved during the newest alarm: what began has stayed, and is being learnt."""


class Monitor:
    """The drift monitor of n joints and p parameters; all that it knows is one flat vector.

    Attributes:
        vector: all of it.
        header: by `Entry`.
        log: (RING, 3) time, kind and statistic of each alarm.
        evidence: (RING, 7 + n) of each alarm, by `Evidence`, then each joint's share of the change, in standard
            deviations.
    """

    def __init__(self, terms: ArmTerms, drift: Drift, tuning: Filter) -> None:
        self.terms, self.params = terms, drift
        self.parameters = ParameterSet(terms, tuning)
        self._tuning = tuning
        n, p = terms.n, self.parameters.size
        self._rows = int(np.ceil(drift.horizon * tuning.rate * 2.0)) + 4
        changes = len(change.FORGETTING)
        sizes = [len(Entry), RING * ALARM_LOG_FIELDS, p, n, n, 2 * n, p, self._rows * (n + 1)]
        sizes += [changes * n, 2 * changes, _TENTHS, RING * (len(Evidence) + n)]
        ends = np.cumsum(sizes)
        self.vector: Any = np.zeros(ends[-1])
        parts = np.split(self.vector, ends[:-1])  # views
        self.header, log, self._checked, self._roll_mean, self._roll_squares = parts[:5]
        self._from_state, self._from_theta, torques, sums, self._change, self._tenths, evidence = parts[5:]
        self._sums = sums.reshape(changes, n)
        self.evidence = evidence.reshape(RING, len(Evidence) + n)
        self._claimed_change = change.threshold(n)
        self.log = log.reshape(RING, ALARM_LOG_FIELDS)
        self._torques = torques.reshape(self._rows, n + 1)
        self.header[[Entry.TIME, Entry.SINCE, Entry.STARTED, Entry.RAISED, Entry.QUIET]] = NEVER
        self.log[:, 0] = NEVER

    @property
    def armed(self) -> bool:
        """Whether normal operation has been learnt."""
        return bool(self.header[Entry.NORMAL] >= self.params.learning_time)

    @property
    def active(self) -> bool:
        """Whether an alarm stands."""
        return bool(self.header[Entry.TIME] < self.header[Entry.QUIET])

    def alarm(self) -> Array:
        """(4,): active, `AlarmKind`, time raised [s], statistic over threshold."""
        h = self.header
        result = np.array([float(self.active), h[Entry.KIND], h[Entry.RAISED], h[Entry.STATISTIC]])
        assert len(result) == ALARM_SIZE
        return result

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
        """Takes in what the filter made of a message. What is not new or not finite is left out.

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
        finite = np.isfinite(t) and 0.0 <= nis < np.inf
        for values in (state, theta, q, tau, *(() if innovation is None else (innovation,))):
            finite = finite and bool(np.all(np.abs(values) < 1e6))  # NaN compares false
        if not finite or t < 0.0 or t == h[Entry.TIME]:
            return
        if h[Entry.SINCE] < 0.0:
            h[Entry.SINCE] = h[Entry.CHECKED] = t
            h[Entry.NEXT] = t + SETTLING
            h[Entry.NIS] = min(nis, 2.0 * self.terms.n)
            self._checked[:] = theta
            h[Entry.TIME] = t
            return
        dt = t - h[Entry.TIME]
        if not 0.0 < dt <= LONGEST_GAP:
            # A gap, or a clock set back: what came before does not join up with what comes now.
            self._resume(theta, t)
            return
        h[Entry.TIME] = t
        self._settle(theta, t)
        learning = bool(h[Entry.SETTLED]) and not self.armed
        if learning:
            h[Entry.NORMAL] += dt
        self._tenth(t)
        self._innovation(nis, innovation, dt, t, learning)
        self._rollout(state, theta, q, tau, t, state_time, learning)

    def begin_anew(self) -> None:
        """The model was corrected: what was measured against the old one says nothing now.

        What normal operation looks like stays as it was learnt: a model that is right again is held to the same band.
        An alarm that stands ends; one that the corrected model deserves comes back.
        """
        h = self.header
        self._resume(self.parameters.mean, float(h[Entry.TIME]))
        h[Entry.QUIET] = min(h[Entry.QUIET], h[Entry.TIME])
        h[Entry.NEXT] += SETTLING
        h[Entry.NIS] = min(h[Entry.NIS], h[Entry.MEAN] if h[Entry.COUNT] else 2.0 * self.terms.n)
        h[[Entry.SUM, Entry.CHANGE, Entry.ROLLOUT, Entry.TENTH, Entry.TENTHS]] = 0.0
        self._sums[:] = 0.0

    # Details.

    def _resume(self, theta: Array, t: float) -> None:
        h = self.header
        h[[Entry.TIME, Entry.CHECKED, Entry.NEXT]] = t
        h[Entry.STARTED] = NEVER
        h[Entry.SETTLED] = 0.0
        h[Entry.SINCE] = min(h[Entry.SINCE], t)
        h[Entry.QUIET] = min(h[Entry.QUIET], t + HOLD)
        self._checked[:] = theta

    def _settle(self, theta: Array, t: float) -> None:
        h = self.header
        if t - h[Entry.CHECKED] < SETTLING:
            return
        calm = bool(np.all(np.abs(theta - self._checked) <= SETTLED * self.parameters.scale))
        late = t - h[Entry.SINCE] > PATIENCE * self.params.learning_time
        h[Entry.SETTLED] = float(calm or late)
        if not calm and t < h[Entry.QUIET]:
            h[Entry.MOVED] = 1.0
        h[Entry.CHECKED] = t
        self._checked[:] = theta

    def _innovation(self, nis: float, white: Array | None, dt: float, t: float, learning: bool) -> None:
        h, k, dof = self.header, self.params.sigma, 2.0 * self.terms.n
        capped = min(nis, _SPIKE * dof)
        blend = min(dt / WINDOW, 1.0)
        h[Entry.NIS] += blend * (capped - h[Entry.NIS])
        changes = np.zeros(0) if white is None else change.follow(self._sums, white)
        mean, squares = self._change.reshape(2, -1)
        if learning:
            h[Entry.COUNT] += 1
            before = h[Entry.NIS] - h[Entry.MEAN]
            h[Entry.MEAN] += before / h[Entry.COUNT]
            h[Entry.SQUARES] += before * (h[Entry.NIS] - h[Entry.MEAN])
            h[Entry.SPREAD] += (capped - h[Entry.MEAN]) ** 2
            if len(changes):
                beyond = changes - mean
                mean += beyond / h[Entry.COUNT]
                squares += beyond * (changes - mean)
            return
        if not self.armed:
            return
        count = max(h[Entry.COUNT], 1.0)
        # Averaging over a window of W messages leaves 1/(2W) of the variance; white innovations of the claimed
        # covariance have mean 2n and variance 4n.
        claimed = dof + k * np.sqrt(2.0 * dof * 0.5 * blend)
        threshold = max(h[Entry.MEAN] + k * np.sqrt(h[Entry.SQUARES] / count), claimed)
        level = max(h[Entry.MEAN], dof)
        spread = np.sqrt(max(h[Entry.SPREAD] / count, 2.0 * dof))
        h[Entry.SUM] = max(0.0, h[Entry.SUM] + min((nis - level) / spread, 0.5 * k) - _SLACK)
        if len(changes):
            learnt = mean + k * np.sqrt(squares / count)
            h[Entry.CHANGE] = float(np.max(changes / np.maximum(learnt, self._claimed_change)))
        statistic = max(h[Entry.NIS] / threshold, h[Entry.SUM] / (_JUMP * k), h[Entry.CHANGE])
        h[Entry.SUM] = min(h[Entry.SUM], 2.0 * _JUMP * k)
        h[Entry.TENTH] = max(h[Entry.TENTH], statistic)
        if statistic > 1.0:
            self._raise(AlarmKind.INNOVATION, t, statistic, dt)
        elif h[Entry.ALARMS] > 0 and t < h[Entry.QUIET]:
            self._reshape()

    def _tenth(self, t: float) -> None:
        """Keeps the largest statistic of each tenth of a second, from which an alarm's shape is told."""
        h = self.header
        if t - h[Entry.FROM] < WINDOW:
            return
        self._tenths[:-1] = self._tenths[1:]
        self._tenths[-1] = h[Entry.TENTH]
        h[Entry.TENTHS] = min(h[Entry.TENTHS] + 1, len(self._tenths))
        h[Entry.TENTH], h[Entry.FROM] = 0.0, t

    def _reshape(self) -> None:
        """What had grown before it crossed the threshold stays a trend; of the rest, what is gone was a spike."""
        h = self.header
        row = int(h[Entry.ALARMS] - 1) % RING
        if h[Entry.SHAPE] != change.Shape.TREND:
            brief = h[Entry.ABOVE] <= change.SPIKE_TIME and h[Entry.TENTH] < 1.0 and h[Entry.MOVED] == 0.0
            h[Entry.SHAPE] = float(change.Shape.SPIKE if brief else change.Shape.STEP)
        self.evidence[row, Evidence.SHAPE] = h[Entry.SHAPE]
        self.evidence[row, Evidence.ABOVE] = h[Entry.ABOVE]

    def _rollout(
        self, state: Array, theta: Array, q: Array, tau: Array, t: float, state_time: float, learning: bool
    ) -> None:
        h = self.header
        if h[Entry.STARTED] >= 0.0 and t <= h[Entry.STARTED]:
            self._torques[0, 1:] = tau  # the state was carried on beyond its message
        elif h[Entry.STARTED] >= 0.0:
            row = int(h[Entry.FILLED])
            if row >= self._rows:  # messages come faster than expected: give up this rollout
                h[Entry.STARTED] = NEVER
                return
            self._torques[row, 0], self._torques[row, 1:] = t, tau
            h[Entry.FILLED] += 1
            if t - h[Entry.STARTED] >= self.params.horizon - 1e-6:
                self._compare(q, t, learning)
                h[Entry.STARTED] = NEVER
        if h[Entry.STARTED] < 0.0 and t >= h[Entry.NEXT] - 1e-6:
            # Until enough has been learnt, one rollout follows on the other.
            wait = self.params.period if self.armed else self.params.horizon
            h[Entry.NEXT] = t + max(wait, self.params.horizon)
            h[Entry.STARTED], h[Entry.FILLED] = state_time, 1.0
            self._from_state[:], self._from_theta[:] = state, theta
            self._torques[0, 0], self._torques[0, 1:] = state_time, tau

    def _compare(self, q: Array, t: float, learning: bool) -> None:
        h, terms = self.header, self.terms
        filled = int(h[Entry.FILLED])
        times, torques = self._torques[:filled, 0], self._torques[:filled, 1:]
        end, speed = rollout(terms, self.parameters, self._from_state, self._from_theta, times, torques)
        span = float(times[-1] - times[0])
        error = np.abs(torque_error(terms, self.parameters, q, self._from_theta, q - end, span))
        error = np.nan_to_num(error, nan=_RUNAWAY, posinf=_RUNAWAY).clip(max=_RUNAWAY)
        if learning:
            h[Entry.ROLLOUTS] += 1
            before = error - self._roll_mean
            self._roll_mean += before / h[Entry.ROLLOUTS]
            self._roll_squares += before * (error - self._roll_mean)
            return
        if not self.armed:
            return
        k = self.params.sigma
        forward, backward = terms.dry(terms.true_position(q), speed, torques[-1])
        level = 0.5 * (forward + backward)
        claimed = k * disturbance_std(self._tuning, np.ones(terms.n, dtype=bool), level)
        learnt = self._roll_mean + k * np.sqrt(self._roll_squares / max(h[Entry.ROLLOUTS], 1.0))
        h[Entry.ROLLOUT] = float(np.max(error / np.maximum(learnt, claimed)))
        if h[Entry.ROLLOUT] > 1.0:
            self._raise(AlarmKind.ROLLOUT, t, float(h[Entry.ROLLOUT]))

    def _raise(self, kind: AlarmKind, t: float, statistic: float, dt: float = 0.0) -> None:
        h = self.header
        quiet = t + HOLD + (self.params.period if kind is AlarmKind.ROLLOUT else 0.0)
        row = int(h[Entry.ALARMS] - 1) % RING
        share = self._sums[1] * np.sqrt(1.0 - change.FORGETTING[1] ** 2)
        if t < h[Entry.QUIET] and h[Entry.ALARMS] > 0:  # the alarm that stands goes on
            worse = statistic > h[Entry.STATISTIC]
            h[Entry.STATISTIC] = max(h[Entry.STATISTIC], statistic)
            self.log[row, 2] = h[Entry.STATISTIC]
            h[Entry.ABOVE] += dt
        else:
            worse = True
            h[Entry.KIND], h[Entry.RAISED], h[Entry.STATISTIC] = float(kind), t, statistic
            before = self._tenths[len(self._tenths) - int(h[Entry.TENTHS]) :]
            grown = change.grows(before)
            h[Entry.SHAPE] = float(change.Shape.TREND if grown else change.Shape.STEP)
            h[Entry.ABOVE], h[Entry.MOVED] = dt, 0.0
            row = int(h[Entry.ALARMS]) % RING
            self.log[row] = t, float(kind), statistic
            self.evidence[row] = 0.0
            h[Entry.ALARMS] += 1
        if worse:
            # Whitening by Cholesky's factor leaves what a joint's torque does in it and in those after it: the first
            # that stands out is the one.
            clear = np.abs(share) > max(_STANDS_OUT, _OF_LARGEST * float(np.abs(share).max()))
            h[Entry.JOINT] = float(np.argmax(clear)) if clear.any() else -1.0
            self.evidence[row, Evidence.JOINT] = h[Entry.JOINT]
            self.evidence[row, Evidence.NIS] = h[Entry.NIS] / (2.0 * self.terms.n)
            self.evidence[row, Evidence.CHANGE] = h[Entry.CHANGE]
            self.evidence[row, Evidence.ROLLOUT] = h[Entry.ROLLOUT]
            self.evidence[row, Evidence.SUM] = h[Entry.SUM]
            self.evidence[row, len(Evidence) :] = share
        self.evidence[row, Evidence.SHAPE] = h[Entry.SHAPE]
        self.evidence[row, Evidence.ABOVE] = h[Entry.ABOVE]
        h[Entry.QUIET] = max(h[Entry.QUIET], quiet)
