"""What the filter knows, in one flat vector.

A vector copies at once, lives in a Diagram's discrete state, and compares to the bit.

Layout: header, memory (per joint), mean x = [q, v, disturbance, θ], covariance P.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import numpy as np

from twin_diagram.signals import NEVER, Array


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
    ACCEPTED = 7
    REFUSED = 8
    """Messages with a reading outside its gate."""
    SURPRISES = 9
    """Messages that only an unmodelled torque explains."""
    STALE = 10
    """Messages not newer than the last, or going back in time."""
    INVALID = 11
    """Messages with a NaN, an infinity or an absurd value."""
    RESTARTS = 12
    """State taken anew from a message after a gap in time or a run of refusals."""
    OPENINGS = 13
    """Times that an abrupt change opened the parameter covariance."""


HEADER = len(Entry)
LONGEST_LOOK: Final = 0.02
"""A state is carried on no further than this beyond its message: after it, the sensors have fallen silent [s]."""


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
        acceleration: (n,) low-passed, as observed, not as predicted [rad/s²].
        x: (N,) mean, N = 3n + p; q, v, disturbance, theta are views of it.
        P: (N, N) covariance.
    """

    def __init__(self, n: int, p: int) -> None:
        self.n, self.p = n, p
        self.size = 3 * n + p
        start = HEADER + 6 * n
        self.vector: Any = np.zeros(start + self.size + self.size**2)
        self.header = self.vector[:HEADER]
        memory = self.vector[HEADER:start].reshape(6, n)
        self.torque, self.drift, self.regime, self.innovation, self.before, self.acceleration = memory
        self.x = self.vector[start : start + self.size]
        self.P = self.vector[start + self.size :].reshape(self.size, self.size)
        self.q, self.v, self.disturbance = self.x[:n], self.x[n : 2 * n], self.x[2 * n : 3 * n]
        self.theta = self.x[3 * n :]
        self.header[Entry.TIME] = NEVER
        self._outside: np.ndarray = np.r_[0 : 2 * n, 3 * n : self.size]

    @property
    def time(self) -> float:
        """Of the state [s]; `NEVER` before the first message."""
        return float(self.header[Entry.TIME])

    @property
    def valid(self) -> bool:
        """Whether a message was ever used."""
        return self.time >= 0.0

    def state_at(self, t: float) -> Array:
        """x̂ = [q, v] (2n,) carried on from the newest message to time t [rad, rad/s].

        Args:
            t: [s]; carried on by `LONGEST_LOOK` at most, and never back.
        """
        ahead = min(max(t - self.time, 0.0), LONGEST_LOOK) if self.valid else 0.0
        v = self.v + ahead * self.acceleration
        return np.concatenate([self.q + (0.5 * ahead) * (self.v + v), v])

    def outside_covariance(self) -> Array:
        """(2n + p, 2n + p) covariance of [q, v, θ]: the disturbance is nobody else's concern."""
        return self.P[np.ix_(self._outside, self._outside)]
