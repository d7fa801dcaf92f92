"""Sensor models: what a sensor should read, and when not to believe it.

z = h(x) + noise, as in sections 2.1 and 3.3 of Hybrid Reality Twins.

A sensor sees the filter's mean x = [q (n), v (n), disturbance (n), θ (p)] and gives its reading, its Jacobian, its
noise and the gate of its innovation. Further sensors subclass `Sensor`; the filter needs nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

import numpy as np
from scipy.stats import chi2

from twin_diagram.signals import Array

GATE_PROBABILITY: Final = 1.0 - 1e-6
"""A good reading passes the gate with this probability."""


class Sensor(ABC):
    """One kind of measurement.

    Attributes:
        name: for messages and counters.
        size: degrees of freedom of a reading.
        gate: squared Mahalanobis distance above which a reading is refused: the χ² quantile of `size` degrees of
            freedom (the outline's algorithm A-EKF, step 4, which uses 95 % at 3 degrees for everything).
    """

    name: str
    size: int
    gate: float

    def __init__(self, name: str, size: int) -> None:
        self.name = name
        self.size = size
        self.gate = float(chi2.ppf(GATE_PROBABILITY, size))

    @abstractmethod
    def reading(self, x: Array) -> Array:
        """h(x) (m,)."""

    @abstractmethod
    def jacobian(self, x: Array) -> Array:
        """∂h/∂x (m, N)."""

    @abstractmethod
    def noise(self, x: Array) -> Array:
        """R (m, m)."""


class StateSensor(Sensor):
    """Reads some entries of the state directly, with white noise."""

    def __init__(self, name: str, entries: slice, size: int, std: Array | float) -> None:
        super().__init__(name, size)
        self.entries = entries
        self._noise: Array = np.eye(size) * np.square(std)
        self._jacobian: Array = np.zeros((size, 0))

    def reading(self, x: Array) -> Array:  # noqa: D102
        return x[self.entries]

    def jacobian(self, x: Array) -> Array:  # noqa: D102
        if self._jacobian.shape[1] != len(x):
            self._jacobian = np.zeros((self.size, len(x)))
            self._jacobian[:, self.entries] = np.eye(self.size)
        return self._jacobian

    def noise(self, x: Array) -> Array:  # noqa: D102
        return self._noise


class JointEncoder(StateSensor):
    """Joint positions [rad]; quantisation counts as white noise."""

    def __init__(self, n: int, std: float) -> None:
        super().__init__("encoder", slice(0, n), n, std)


class JointVelocity(StateSensor):
    """Joint velocities as the drive estimates them [rad/s]."""

    def __init__(self, n: int, std: float) -> None:
        super().__init__("velocity", slice(n, 2 * n), n, std)


class JointState(StateSensor):
    """Positions and velocities of one message together: what explains one of them must explain the other."""

    def __init__(self, n: int, position_std: float, velocity_std: float) -> None:
        super().__init__("joints", slice(0, 2 * n), 2 * n, np.repeat([position_std, velocity_std], n))
