"""What the filter knows, in one flat vector.

A vector copies at once, lives in a Diagram's discrete state, and compares to the bit.

Layout: header, memory (per joint, then per parameter), mean x = [q, v, disturbance, θ, sensors' own states],
covariance P, and a track record per further sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import Any

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER


class Entry(IntEnum):
    """Entries of a belief's header."""

    TIME = 0
    """Measurement time of the newest message used [s]; `NEVER` before the first."""
    NIS = 1
    """Normalised innovation squared of the newest message; encoder and velocity together, so 2n on average."""
    NIS_MEAN = 2
    """NIS over its degrees of freedom, averaged over a tenth of a second."""
    QUIET = 3
    """Until this time the parameter covariance is not opened again [s]."""
    STREAK = 4
    """Messages refused in a row."""
    FRESH = 5
    """1 until the first message after a start, else 0."""
    SPAN = 6
    """Length of the newest prediction [s]."""
    RELEASED = 7
    """When the physics last took over the parameters learnt [s]."""
    ALARM = 8
    """Until this time the noise is not adapted: what is wrong is not noise [s]."""
    HEARD = 9
    """Time of the newest reading of the arm's own that was used [s]; `NEVER` before the first."""
    HEEDED = 10
    """When the newest alarm about the joints that the filter heeded was raised [s]; 0 before the first."""
    COUNTED = 11
    """Messages by which the noise has settled: the more, the slower it follows."""
    MESSAGE = 12
    """Time of the newest message of the arm that could be read, used or not [s]; `NEVER` before the first."""
    ACCEPTED = 13
    REFUSED = 14
    """Messages with a reading outside its gate."""
    SURPRISES = 15
    """Messages that only an unmodelled torque explains."""
    STALE = 16
    """Messages seen before, or too old to be fused at their own time."""
    INVALID = 17
    """Messages with a NaN, an infinity or an absurd value."""
    RESTARTS = 18
    """State taken anew from a message after a gap in time or a run of refusals."""
    OPENINGS = 19
    """Times that an abrupt change opened the parameter covariance."""
    LATE = 20
    """Messages that arrived after newer ones and were fused at their own time."""
    GATHERED = 21
    """Messages of the arm since trouble began, whose innovations `troubled` sums; 0 while all is well."""
    CALM = 22
    """Of these, the newest ones in a row that were neither refused nor a surprise."""


class SensorTrack(IntEnum):
    """Entries of a further sensor's track record."""

    LAST = 0
    """Time of its newest reading used [s]; `NEVER` before the first."""
    STREAK = 1
    """Readings refused in a row."""
    NIS = 2
    """Of its newest reading."""
    NIS_MEAN = 3
    """NIS over its degrees of freedom, averaged over some tens of readings; refused ones left out."""
    ACCEPTED = 4
    REFUSED = 5
    """Outside the gate."""
    INVALID = 6
    """Not finite, or no reading at all."""
    STALE = 7
    """Too old to be fused at their own time."""
    LATE = 8
    """Fused at their own, past time."""
    REACQUIRED = 9
    """Times that a run of refusals was ended by opening what only this sensor tells."""
    RUN = 10
    """Sum of squares of the mean whitened innovation over its variance: about `size` while it agrees with the rest."""
    COUNTED = 11
    """Readings by which its noise has settled: the more, the slower it follows."""


HEADER = len(Entry)
"""Numbers of the header, which the vector begins with."""


@dataclass(frozen=True)
class Tuning:
    """The vector's layout, and how far a state is carried on: chosen by hand."""

    memory: int = 17
    """Numbers kept per joint besides the state."""

    longest_look: float = 0.02
    """A state is carried on no further than this beyond its message: after it, the sensors have fallen silent [s]."""


TUNING = Tuning()


class Belief:
    """Views into one flat vector.

    Attributes:
        vector: all of it; writing to the views writes here.
        header: by `Entry`.
        torque: (n,) last measured motor torque [N·m].
        drift: (n,) low-passed velocity, which tells motion from noise [rad/s].
        regime: (n,) −1, 0, +1: which way each joint slides, 0 at rest.
        innovation: (n,) newest velocity innovation, whitened in joint torque.
        before: (n,) velocity before the newest prediction [rad/s].
        noise: (3, n) ln of the factors by which the variances of encoders, speeds and white torque were adapted.
        steady: (n,) ln of the factor by which the variance of a sliding joint's disturbance was adapted.
        told: (n,) how many independent values of it have told that.
        troubled: (3, 2n) of the innovations since trouble began, positions, then speeds: their sum, their differences'
            sum of squares, the newest.
        acceleration: (n,) low-passed, as observed, not as predicted [rad/s²].
        model: (p,) θ as the physics has it; the difference to θ acts through its derivatives.
        gradient: (p,) gathered since then, where the gradient rule adapts θ.
        freed: (p,) 1 where a parameter was opened beyond its prior, which then says nothing of it any more; 2 while
            what made it open may still go on.
        score: (p, p + 1) of recent innovations by θ: their information matrix and their gradient, with forgetting.
        x: (N,) mean, N = 3n + p + own; q, v, disturbance, theta, own are views of it.
        P: (N, N) covariance.
        tracks: one record per further sensor, by `SensorTrack`, followed by its mean whitened innovation.
        levels: per further sensor, (m,) ln of the factors by which its variances were adapted.
    """

    def __init__(self, n: int, p: int, own: int = 0, sensors: tuple[int, ...] = ()) -> None:
        """Make an empty one.

        Args:
            n: joints.
            p: parameters.
            own: states of all further sensors together.
            sensors: degrees of freedom of each further sensor.
        """
        self.n, self.p = n, p
        self.size = 3 * n + p + own
        start = HEADER + TUNING.memory * n
        mean = start + 3 * p + p * (p + 1)
        end = mean + self.size + self.size**2
        self.vector: Any = np.zeros(end + sum(len(SensorTrack) + 2 * size for size in sensors))
        self.header = self.vector[:HEADER]
        memory = self.vector[HEADER:start].reshape(TUNING.memory, n)
        self.torque, self.drift, self.regime, self.innovation, self.before, self.acceleration = memory[:6]
        self.noise = memory[6:9]
        self.troubled = memory[9:15].reshape(3, 2 * n)
        self.steady, self.told = memory[15:17]
        self.model, self.gradient, self.freed = self.vector[start : start + 3 * p].reshape(3, p)
        self.score = self.vector[start + 3 * p : mean].reshape(p, p + 1)
        self.x = self.vector[mean : mean + self.size]
        self.P = self.vector[mean + self.size : end].reshape(self.size, self.size)
        self.q, self.v, self.disturbance = self.x[:n], self.x[n : 2 * n], self.x[2 * n : 3 * n]
        self.theta, self.own = self.x[3 * n : 3 * n + p], self.x[3 * n + p :]
        ends = end + np.cumsum([0, *(len(SensorTrack) + size for size in sensors), *sensors])
        parts = [self.vector[a:b] for a, b in pairwise(ends)]
        self.tracks, self.levels = parts[: len(sensors)], parts[len(sensors) :]
        self.header[Entry.TIME] = NEVER
        self.header[[Entry.HEARD, Entry.MESSAGE]] = NEVER
        for track in self.tracks:
            track[SensorTrack.LAST] = NEVER
            track[SensorTrack.NIS_MEAN] = 1.0
        self._outside: np.ndarray = np.r_[0 : 2 * n, 3 * n : 3 * n + p]

    @property
    def time(self) -> float:
        """Of the state [s]; `NEVER` before the first message."""
        return float(self.header[Entry.TIME])

    @property
    def valid(self) -> bool:
        """Whether a message was ever used."""
        return self.time >= 0.0

    def sound(self, largest: float) -> bool:
        """Return whether all of it is finite, and nothing of x larger than that."""
        return bool(np.all(np.isfinite(self.vector))) and bool(np.all(np.abs(self.x) < largest))

    def state_at(self, t: float) -> Array:
        """Return x̂ = [q, v] (2n,) carried on from the newest message to time t [rad, rad/s].

        Args:
            t: [s]; carried on by `longest_look` at most, and never back.
        """
        ahead = min(max(t - self.time, 0.0), TUNING.longest_look) if self.valid else 0.0
        v = self.v + ahead * self.acceleration
        return np.concatenate([self.q + (0.5 * ahead) * (self.v + v), v])

    def outside_covariance(self) -> Array:
        """Return (2n + p, 2n + p) covariance of [q, v, θ]: the disturbance is nobody else's concern."""
        return self.P[np.ix_(self._outside, self._outside)]
