"""Torque that waits, in steps of a simulator and shares of them."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array


class Line:
    """The last torques of n motors, newest first, as a vector of state.

    Attributes:
        size: of the vector.
    """

    def __init__(self, steps: float, n: int) -> None:
        """`steps`: that the torque waits, whole or not."""
        self._whole = int(np.floor(steps + 1e-9))
        self._share = max(0.0, steps - self._whole)
        self._n = n
        self.size = n * (self._whole + 2)

    def _rows(self, state: Array) -> Array:
        return state.reshape(-1, self._n)

    def end(self, state: Array, now: Array) -> Array:
        """Return (n,) what comes out while `now` goes in."""
        rows = np.vstack([now, self._rows(state)])
        return (1.0 - self._share) * rows[self._whole] + self._share * rows[self._whole + 1]

    def last(self, state: Array) -> Array:
        """Return (n,) what came out in the step before."""
        rows = self._rows(state)
        return (1.0 - self._share) * rows[self._whole] + self._share * rows[self._whole + 1]

    def newest(self, state: Array) -> Array:
        """Return (n,) what went in in the step before."""
        return self._rows(state)[0].copy()

    def moved(self, state: Array, now: Array) -> Array:
        """Return the state after `now` went in."""
        return np.vstack([now, self._rows(state)[:-1]]).ravel()
