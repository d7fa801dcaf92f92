"""The filter's recent past, so that a reading which arrives late is fused at its own time.

Each step of the filter is kept as it was linearised, x_k = f_k + F_k (x_{k−1} − x̂_{k−1}) + w_k with covariance Q_k, and
its readings as rows of unit noise, z̃ = H̃ x. A late reading joins the rows of its step; the steps after it are then run
again as a linear filter. For a linear arm the result is what order of arrival never changes; for this one it differs
by the linearisation over the correction that the late reading made.

Memory is a ring of fixed size. Rows that no longer fit are compressed exactly: a QR factorisation keeps as many rows as
there are states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lapack

from twin_diagram.estimation.dynamics.positive_definite import joseph
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """The history's layout and its start: chosen by hand."""

    header: int = 2
    """Numbers before the ring: index of the newest step, and steps held."""

    unknown: float = 10.0
    """Standard deviation of a joint's acceleration at a start, before any step was made [rad/s²]."""


TUNING = Tuning()


class History:
    """A ring of the filter's newest steps, all in one flat vector.

    Attributes:
        capacity: steps kept.
        vector: all of it.
        whole: whether steps are kept as they were linearised, with their readings. Else their times alone are, by which
            a message seen before is told from a new one: where no reading can be late nobody asks for more.
    """

    def __init__(self, n: int, p: int, size: int, capacity: int) -> None:
        """Make an empty one.

        Args:
            n: joints.
            p: parameters.
            size: N, of x.
            capacity: steps kept.
        """
        self.n, self.p, self.size, self.capacity = n, p, size, capacity
        self.whole = True
        N, L = size, capacity
        shapes = [(L,), (L,), (L,), (L, n), (L, n), (L, n, N), (L, p), (L, N), (L, N), (L, N, N), (L, N, N), (L, N, N)]
        shapes.append((L, N, N + 1))
        ends = TUNING.header + np.cumsum([int(np.prod(shape)) for shape in shapes])
        self.vector: Any = np.zeros(ends[-1])
        self._at = self.vector[: TUNING.header]  # newest, count
        parts = [
            part.reshape(shape)
            for part, shape in zip(
                np.split(self.vector[TUNING.header :], ends[:-1] - TUNING.header), shapes, strict=True
            )
        ]
        self._time, self._dt, self._rows = parts[:3]
        self._acceleration, self._steady, self._by, self._room, self._predicted = parts[3:8]
        self._x, self._P, self._F, self._Q, self._z = parts[8:]

    def clear(self) -> None:
        """Forget all steps."""
        self._at[:] = 0.0

    @property
    def count(self) -> int:
        """Steps held."""
        return int(self._at[1])

    @property
    def oldest(self) -> float:
        """Time of the oldest step [s]; infinite where there is none."""
        return float(self._time[self._index(self.count - 1)]) if self.count else np.inf

    def _index(self, back: int) -> int:
        return (int(self._at[0]) - back) % self.capacity

    def begin(self, t: float, x: Array, P: Array) -> None:
        """Start anew from a state."""
        self.clear()
        none = np.zeros(self.n)
        self.push(t, 0.0, x, none, none, None, None, None)
        self.settle(x, P)

    def push(
        self,
        t: float,
        dt: float,
        x: Array,
        acceleration: Array,
        steady: Array,
        by: Array | None,
        F: Array | None,
        Q: Array | None,
    ) -> None:
        """Add a step.

        Args:
            t: its end [s].
            dt: its length [s]; 0 for a start.
            x: (N,) predicted mean.
            acceleration: (n,) of the joints in it, carried back along its derivative `by` to x = 0 [rad/s²].
            steady: (n,) the same as observed, low-passed, and zero where a joint rests [rad/s²].
            by: (n, N) that derivative; None for a start.
            F: (N, N) derivative of the prediction; None for a start.
            Q: (N, N) noise that it adds; None for a start.
        """
        at = self._index(-1)
        self._at[0], self._at[1] = at, min(self._at[1] + 1, self.capacity)
        self._time[at] = t
        if not self.whole:
            return
        self._dt[at], self._rows[at] = dt, 0.0
        self._predicted[at], self._acceleration[at], self._steady[at], self._room[at] = x, acceleration, steady, 0.0
        if by is not None and F is not None and Q is not None:
            self._by[at], self._F[at], self._Q[at] = by, F, Q

    def retime(self, t: float) -> None:
        """Set the newest step's end [s], where rounding moved it."""
        self._time[int(self._at[0])] = t

    def settle(self, x: Array, P: Array) -> None:
        """Store the mean (N,) and covariance (N, N) after all that the newest step's readings said."""
        if self.whole:
            at = int(self._at[0])
            self._x[at], self._P[at] = x, P

    def widen(self, added: Array) -> None:
        """Add noise (N, N) in the newest step than its prediction knew."""
        if self.whole:
            self._Q[int(self._at[0])] += added

    def opened(self, room: Array) -> None:
        """Keep that the parameters' covariance was opened after the newest step, by prior ∘ room roomᵀ, room (p,)."""
        if self.whole:
            self._room[int(self._at[0])] = room

    def read(self, H: Array, R: Array, linear: Array, back: int = 0) -> None:
        """Add a reading to a step.

        Args:
            H: (m, N).
            R: (m, m) noise.
            linear: (m,) innovation + H x̂: the reading, had the sensor been linear.
            back: which step; 0 is the newest.
        """
        if not self.whole:
            return
        at = self._index(back)
        factor, _ = lapack.dpotrf(R, lower=1)
        white, _ = lapack.dtrtrs(factor, np.column_stack([H, linear]), lower=1)
        used, m = int(self._rows[at]), len(linear)
        if used + m > self.size:
            whole = np.vstack([self._z[at, :used], white])
            white = np.linalg.qr(whole, mode="r")[: self.size]
            used, m = 0, len(white)
        self._z[at, used : used + m] = white
        self._rows[at] = used + m

    def find(self, t: float) -> int | None:
        """Return how many steps back the step lies that is nearest to t; None where t is older than all of them."""
        if not self.count or t < self.oldest - 1e-9:
            return None
        order = (int(self._at[0]) - np.arange(self.count)) % self.capacity
        return int(np.argmin(np.abs(self._time[order] - t)))

    def knows(self, t: float) -> bool:
        """Return whether a step ended at t already."""
        order = (int(self._at[0]) - np.arange(self.count)) % self.capacity
        return bool(np.any(np.abs(self._time[order] - t) < 1e-6))

    def state(self, back: int) -> tuple[float, Array, Array]:
        """Return the time [s], mean (N,) and covariance (N, N) of a step after its readings; views."""
        at = self._index(back)
        return float(self._time[at]), self._x[at], self._P[at]

    def motion(self, back: int) -> tuple[Array, Array, Array]:
        """Return a step's acceleration (n,) at x = 0, its derivative by x (n, N), its noise (n, n); unknown at a start.

        Linear like the step, so that what readings have said of θ and the disturbance since counts at once.
        """
        at, n = self._index(back), self.n
        dt = float(self._dt[at])
        if dt <= 0.0:
            return self._acceleration[at], np.zeros((n, self.size)), np.eye(n) * TUNING.unknown**2
        return self._acceleration[at], self._by[at], self._Q[at, n : 2 * n, n : 2 * n] / dt**2

    def steady(self, back: int) -> Array:
        """Return (n,) acceleration of a step as observed, low-passed, zero where a joint rests [rad/s²]; a view."""
        return self._steady[self._index(back)]

    def rerun(self, back: int, x: Array, P: Array, prior: Array, clip: Callable[[Array], None]) -> tuple[Array, Array]:
        """Run the steps after one again, from a better state of that one.

        Args:
            back: the step; it gets this state.
            x: (N,) its mean.
            P: (N, N) its covariance.
            prior: (p, p) of the parameters, for openings.
            clip: moves θ (p,) into its bounds, in place.

        Returns:
            x (N,), P (N, N) of the newest step.
        """
        n, p = self.n, self.p
        for k in range(back - 1, -1, -1):
            before, at = self._index(k + 1), self._index(k)
            F = self._F[at]
            moved = self._predicted[at] + F @ (x - self._x[before])
            self._x[before], self._P[before] = x, P
            P = F @ P @ F.T + self._Q[at]
            P = 0.5 * (P + P.T)
            self._predicted[at] = moved
            x, used = moved, int(self._rows[at])
            if used:
                H = self._z[at, :used, :-1]
                x, P = joseph(x, P, H, np.eye(used), self._z[at, :used, -1] - H @ x)
            clip(x[3 * n : 3 * n + p])
            if np.any(self._room[at]):
                P[3 * n : 3 * n + p, 3 * n : 3 * n + p] += prior * np.outer(self._room[at], self._room[at])
        newest = self._index(0)
        self._x[newest], self._P[newest] = x, P
        return x, P
