"""The arm's own sensors: encoders, the drive's speeds, and both as one message brings them."""

from __future__ import annotations

import numpy as np

from twin_diagram.estimation.sensors.sensor import Sensor
from twin_diagram.signals.arrays import Array


class StateSensor(Sensor):
    """Reads some entries of the state directly, with white noise."""

    def __init__(self, name: str, entries: slice, size: int, std: Array | float) -> None:
        """Make the sensor.

        Args:
            name: for messages and counters.
            entries: of x that it reads.
            size: how many they are.
            std: standard deviation, one or (size,) [unit of the entries].
        """
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
        """Make the sensor of n joints; `std` of a position [rad]."""
        super().__init__("encoder", slice(0, n), n, std)


class JointVelocity(StateSensor):
    """Joint velocities as the drive estimates them [rad/s]."""

    def __init__(self, n: int, std: float) -> None:
        """Make the sensor of n joints; `std` of a velocity [rad/s]."""
        super().__init__("velocity", slice(n, 2 * n), n, std)


class JointState(StateSensor):
    """Positions and velocities of one message together: what explains one of them must explain the other."""

    def __init__(self, n: int, position_std: float, velocity_std: float) -> None:
        """Make the sensor of n joints; standard deviations of a position [rad] and of a velocity [rad/s]."""
        super().__init__("joints", slice(0, 2 * n), 2 * n, np.repeat([position_std, velocity_std], n))
