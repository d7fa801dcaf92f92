"""All that a drift monitor knows, in one flat vector: it copies at once and lives in a Diagram's discrete state."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ALARM_LOG_FIELDS, NEVER


@dataclass(frozen=True)
class Tuning:
    """Sizes of what is remembered, chosen by hand.

    A recording holds them, so that another size makes another layout.
    """

    ring: int = 32
    """Alarms that are remembered."""

    tenths: int = 30
    """Tenths of a second over which the largest statistic is remembered, to tell a jump from what grew."""


TUNING = Tuning()


class Evidence(IntEnum):
    """What an alarm stands on; each joint's share of the change follows, in standard deviations."""

    SHAPE = 0
    """`likelihood_ratio.AlarmShape`."""
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
    HAND = 7
    """By how much the newest rollout missed the hand [m]."""
    SENSOR = 8
    """Which further sensor parts ways with the rest, by index; negative where it is not about one."""
    TORQUE = 9
    """Torque that a sliding joint has gained and the model lacks [N·m]; 0 where that is not what the alarm is about."""


class DriftEntry(IntEnum):
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
    """Averaged over a tenth of a second."""
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
    """`AlarmShape` of the newest alarm."""
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
    HAND = 29
    """By how much the newest rollout missed the hand [m]."""
    SENSOR = 30
    """Which further sensor the newest alarm is about, by index; negative where it is not about one."""
    LOUD = 31
    """Messages in a row that are far off."""


class DriftState:
    """Views into one flat vector; writing to them writes there.

    Attributes:
        vector: all of it.
        header: by `DriftEntry`.
        log: (ring, 3) time, kind and statistic of each alarm.
        evidence: (ring, len(Evidence) + n) of each alarm.
        checked: (p,) parameters when it was last checked that they have settled.
        roll_mean, roll_squares: (n + 1,) of the rollouts' errors in normal operation: joints [N·m], hand [m].
        from_state, from_theta: (2n,), (p,) that the running rollout started from.
        torques: (rows, 1 + n) time and measured torque since then.
        sums: (L, n) of whitened innovations, one row for each forgetting.
        change: (2, L) mean and sum of squared deviations of their statistics in normal operation.
        tenths: (tenths,) largest statistic of each tenth of a second, newest last.
        sensors: what the cross-check keeps of the further sensors.
        motors: what the torque test keeps of the joints.
        margins: what is kept of how near each test comes to an alarm while nothing is wrong.
    """

    def __init__(self, n: int, p: int, changes: int, rows: int, sensors: int, motors: int, margins: int) -> None:
        """Make an empty one.

        Args:
            n: joints.
            p: parameters.
            changes: L.
            rows: torques that a rollout holds.
            sensors: numbers that the cross-check keeps.
            motors: numbers that the torque test keeps.
            margins: numbers that the margins of all tests keep.
        """
        sizes = [
            len(DriftEntry),
            TUNING.ring * ALARM_LOG_FIELDS,
            TUNING.ring * (len(Evidence) + n),
            p,
            n + 1,
            n + 1,
            2 * n,
            p,
        ]
        sizes += [rows * (n + 1), changes * n, 2 * changes, TUNING.tenths, sensors, motors, margins]
        ends = np.cumsum(sizes)
        self.vector: Any = np.zeros(ends[-1])
        parts = np.split(self.vector, ends[:-1])  # views
        self.header, log, evidence, self.checked, self.roll_mean, self.roll_squares = parts[:6]
        self.from_state, self.from_theta, torques, sums, learnt, self.tenths = parts[6:12]
        self.sensors, self.motors, self.margins = parts[12:]
        self.log: Array = log.reshape(TUNING.ring, ALARM_LOG_FIELDS)
        self.evidence: Array = evidence.reshape(TUNING.ring, len(Evidence) + n)
        self.torques: Array = torques.reshape(rows, n + 1)
        self.sums: Array = sums.reshape(changes, n)
        self.change: Array = learnt.reshape(2, changes)
        self.header[[DriftEntry.TIME, DriftEntry.SINCE, DriftEntry.STARTED, DriftEntry.RAISED, DriftEntry.QUIET]] = (
            NEVER
        )
        self.header[DriftEntry.SENSOR] = -1.0
        self.log[:, 0] = NEVER
