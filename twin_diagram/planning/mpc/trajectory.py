"""Joint motions whose acceleration is linear between evenly spaced knots and which end at rest.

Position is a cubic spline, twice continuously differentiable. Everything is linear in the knots' accelerations
A (N, n), with the same coefficients for each joint, which is what makes the optimiser's matrices constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Trajectory:
    """A motion of n joints over N knots; before its start and after its end it stands still.

    Attributes:
        start: time of the first knot [s].
        step: time between knots [s].
        q0: (n,) position at the first knot [rad].
        v0: (n,) velocity there [rad/s].
        accelerations: (N, n) at the knots [rad/s²].
    """

    start: float
    step: float
    q0: Array
    v0: Array
    accelerations: Array

    @staticmethod
    def at_rest(start: float, step: float, knots: int, q: Array) -> Trajectory:
        """Stand still at `q` (n,)."""
        return Trajectory(start, step, np.array(q, dtype=float), np.zeros(len(q)), np.zeros((knots, len(q))))

    @property
    def end(self) -> float:
        """Time of the last knot [s]."""
        return self.start + self.step * (len(self.accelerations) - 1)

    @property
    def knots(self) -> Array:
        """(N, n) positions at the knots [rad]."""
        return self._knots[0].copy()

    @cached_property
    def _knots(self) -> tuple[Array, Array]:
        """Positions and velocities at the knots, (N, n) each, not to be written to: a tick asks a dozen times."""
        a, h = self.accelerations, self.step
        v = np.vstack([self.v0, self.v0 + np.cumsum(h / 2 * (a[:-1] + a[1:]), axis=0)])
        rise = h * v[:-1] + h * h * (a[:-1] / 3 + a[1:] / 6)
        return np.vstack([self.q0, self.q0 + np.cumsum(rise, axis=0)]), v

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Return the position, velocity and acceleration at `times` (M,), each (M, n)."""
        q, v = self._knots
        last = len(self.accelerations) - 1
        passed = np.clip((np.asarray(times, dtype=float) - self.start) / self.step, 0.0, last)
        i = np.minimum(passed.astype(int), last - 1)
        s = ((passed - i) * self.step)[:, None]
        a, jerk = self.accelerations[i], (self.accelerations[i + 1] - self.accelerations[i]) / self.step
        over = (np.asarray(times) >= self.end)[:, None] | (np.asarray(times) < self.start)[:, None]
        position = q[i] + v[i] * s + a * s**2 / 2 + jerk * s**3 / 6
        velocity = np.where(over, 0.0, v[i] + a * s + jerk * s**2 / 2)
        return position, velocity, np.where(over, 0.0, a + jerk * s)

    def position(self, time: float) -> Array:
        """Return (n,) position at one time; quicker than `at`."""
        from twin_diagram.planning.mpc import motion_kernels  # compiled; not with every import

        passed = min(max((time - self.start) / self.step, 0.0), len(self.accelerations) - 1.0)
        return motion_kernels.position(passed, self.step, self.q0, self.v0, np.ascontiguousarray(self.accelerations))


def response(times: Array, step: float, knots: int) -> tuple[Array, Array]:
    """Return what a unit of acceleration at each knot adds to position and velocity.

    Args:
        times: (M,) from the first knot on, within the knots [s].
        step: between knots [s].
        knots: N.

    Returns:
        Position (M, N) [s²] and velocity (M, N) [s] per unit: first and second integrals of the hat about each knot.
    """
    back, middle, ahead = _ramps(times, step, knots)
    velocity = step * (back**2 - 2 * middle**2 + ahead**2) / 2
    first = middle[:, 0]
    after = ahead[:, 0]
    velocity[:, 0] = step * (first - first**2 / 2 + after**2 / 2)
    return _shift(back, middle, ahead, step), velocity


def _ramps(times: Array, step: float, knots: int) -> tuple[Array, Array, Array]:
    """Return the three ramps (M, N) of which a hat is the sum, of slopes 1, −2 and 1, in steps."""
    u = np.asarray(times, dtype=float)[:, None] / step - np.arange(knots)[None, :]
    return np.maximum(u + 1, 0.0), np.maximum(u, 0.0), np.maximum(u - 1, 0.0)


def _shift(back: Array, middle: Array, ahead: Array, step: float) -> Array:
    """Return the second integrals (M, N) of hats; of that at the first knot only its right half is in the motion."""
    position = step**2 * (back**3 - 2 * middle**3 + ahead**3) / 6
    first, after = middle[:, 0], ahead[:, 0]
    position[:, 0] = step**2 * (first**2 / 2 - first**3 / 6 + after**3 / 6)
    return np.asarray(position)
