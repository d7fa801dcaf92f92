"""Periodic joint motions that start and end at rest: finite Fourier series whose free coefficients keep them so."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Harmonics:
    """Multiples of one frequency, after Swevers, Ganseman, Tükel, De Schutter and Van Brussel (1997, eq. 7).

    With ωₖ = 2πk/period, a joint moves by Σ aₖ sin ωₖt + bₖ cos ωₖt. Position, velocity and acceleration at both ends
    are zero where Σ bₖ = 0, Σ k aₖ = 0 and Σ k² bₖ = 0; `size` = 2K − 3 free numbers span what obeys these.

    Attributes:
        period: of the lowest one, and the motion's length [s].
        count: K, of them; at least 3.
    """

    period: float
    count: int

    @property
    def size(self) -> int:
        """How many numbers a joint's motion has."""
        return 2 * self.count - 3

    @cached_property
    def basis(self) -> Array:
        """(2K, size): sine and cosine coefficients [rad] per free number; each gives speeds of about 1 rad/s."""
        k = np.arange(1, self.count + 1)
        speed = 2.0 * np.pi * k / self.period
        zero = np.zeros(self.count)
        held = np.array([[*zero, *np.ones(self.count)], [*k, *zero], [*zero, *k**2]]) / np.tile(speed, 2)
        free: Array = scipy.linalg.null_space(held)
        return free / np.tile(speed, 2)[:, None]

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (N, size) at times (N,) [s] per free number."""
        w = 2.0 * np.pi * np.arange(1, self.count + 1) / self.period
        angle = np.asarray(time)[:, None] * w
        sine, cosine = np.sin(angle), np.cos(angle)
        q = np.hstack([sine, cosine]) @ self.basis
        v = np.hstack([cosine * w, -sine * w]) @ self.basis
        a = np.hstack([-sine * w**2, -cosine * w**2]) @ self.basis
        return q, v, a
