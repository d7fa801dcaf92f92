"""What the filter needs of a sensor: what it should read, how that depends on the state, and when not to believe it.

z = h(x) + noise, as in sections 2.1 and 3.3 of Hybrid Reality Twins.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from twin_diagram.signals import chi_square
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """What a reading may be: chosen by hand."""

    gate_probability: float = 1.0 - 1e-6
    """A good reading passes the gate with this probability."""

    absurd: float = 1e6
    """No reading is larger than this, in whatever SI unit."""


TUNING = Tuning()


@dataclass(frozen=True)
class Instant:
    """What the filter knows of the moment of a reading besides its mean.

    Attributes:
        x: (N,) mean [q, v, disturbance, θ, sensors' own states] at that moment.
        n: number of joints.
        p: number of parameters.
        acceleration: (n,) of the joints over the step that led here, as the model has it [rad/s²].
        by_state: (n, N) its derivative with respect to x; None where no step led here.
        acceleration_noise: (n, n) covariance of its error besides x's: the unmodelled white torque [rad²/s⁴].
        covariance: (N, N) of x; None where x counts as known.
        steady: (n,) acceleration as observed, low-passed, for regressors: the noise of `acceleration` would seem to
            excite what it does not; None: `acceleration` [rad/s²].
    """

    x: Array
    n: int
    p: int
    acceleration: Array
    by_state: Array | None = None
    acceleration_noise: Array | None = None
    covariance: Array | None = None
    steady: Array | None = None

    @property
    def q(self) -> Array:
        """(n,) [rad]."""
        return self.x[: self.n]

    @property
    def v(self) -> Array:
        """(n,) [rad/s]."""
        return self.x[self.n : 2 * self.n]


@dataclass(frozen=True)
class Linear:
    """A sensor's model about one moment.

    Attributes:
        reading: h(x), in whatever form its readings have.
        jacobian: (m, N) of the innovation's prediction.
        noise: (m, m) R.
    """

    reading: Array
    jacobian: Array
    noise: Array


class Sensor(ABC):
    """One kind of measurement.

    Attributes:
        name: for messages and counters.
        size: m, degrees of freedom of a reading.
        length: how many numbers a reading has; `size` but for poses.
        gate: squared Mahalanobis distance above which a reading is refused: the χ² quantile of `size` degrees of
            freedom (the outline's algorithm A-EKF, step 4, which uses 95 % at 3 degrees for everything).
        own: where its own states (biases) lie in x, once declared to a filter; empty where it has none.
    """

    name: str
    size: int
    length: int
    gate: float
    own: slice

    def __init__(
        self, name: str, size: int, *, length: int | None = None, gate: float = TUNING.gate_probability
    ) -> None:
        """Make the sensor.

        Args:
            name: for messages and counters.
            size: m, degrees of freedom of a reading.
            length: how many numbers a reading has; None: `size`.
            gate: probability with which a good reading passes.
        """
        self.name = name
        self.size = size
        self.length = size if length is None else length
        self.gate = float(chi_square.quantile(gate, size))
        self.own = slice(0, 0)

    @abstractmethod
    def reading(self, x: Array) -> Array:
        """Return h(x) (m,)."""

    @abstractmethod
    def jacobian(self, x: Array) -> Array:
        """Return ∂h/∂x (m, N)."""

    @abstractmethod
    def noise(self, x: Array) -> Array:
        """Return R (m, m)."""

    def linear(self, now: Instant) -> Linear:
        """Return h, H and R at one moment."""
        return Linear(self.reading(now.x), self.jacobian(now.x), self.noise(now.x))

    def innovation(self, z: Array, reading: Array) -> Array:
        """Return (m,) what z (length,) says beyond the reading expected, h(x)."""
        return z - reading

    def sound(self, z: Array) -> bool:
        """Return whether z (length,) can be a reading at all."""
        return bool(np.all(np.abs(z) < TUNING.absurd))  # NaN compares false

    def declare(self, own: slice, payload: slice | None) -> None:
        """Keep where in the filter's x things lie.

        Args:
            own: the sensor's own states.
            payload: mass and first moment of what the last link carries; None: they are not learnt.
        """
        self.own = own

    # A sensor's own states.

    def own_labels(self) -> list[str]:
        """Return the names of its own states with units."""
        return []

    def own_std(self) -> Array:
        """Return the standard deviations that its own states start with; their mean is zero."""
        return np.zeros(0)

    def own_walk(self) -> Array:
        """Return the random walk of its own states [unit/√s]."""
        return np.zeros(0)
