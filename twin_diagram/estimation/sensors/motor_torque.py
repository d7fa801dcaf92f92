"""Motor torque from currents, for a filter that is driven by the torque commanded."""

from __future__ import annotations

import numpy as np

from twin_diagram.estimation.sensors.sensor import Instant, Linear, Sensor
from twin_diagram.signals.arrays import Array


class MotorTorque(Sensor):
    """What the motors gave beyond what they were told, (n,) [N·m]: the torque measured less the torque predicted with.

    A filter that predicts with the measured torque has used this reading already: then leave it out. In the filter's
    equation of motion such a difference is part of the disturbance d, which besides holds the model's errors
    `model_std`, so the reading is d with both noises.
    """

    def __init__(self, n: int, std: Array | float = 0.1, model_std: Array | float = 0.3, name: str = "torque") -> None:
        """Make the sensor.

        Args:
            n: number of joints.
            std: of the torque from currents, one or (n,) [N·m].
            model_std: torque that the model does not know of and the motors do not give, such as friction [N·m].
            name: for messages and counters.
        """
        super().__init__(name, n)
        self._noise: Array = np.eye(n) * (np.square(std) + np.square(model_std))

    def reading(self, x: Array) -> Array:  # noqa: D102
        return x[2 * self.size : 3 * self.size]

    def jacobian(self, x: Array) -> Array:  # noqa: D102
        H = np.zeros((self.size, len(x)))
        H[:, 2 * self.size : 3 * self.size] = np.eye(self.size)
        return H

    def noise(self, x: Array) -> Array:  # noqa: D102
        return self._noise

    def linear(self, now: Instant) -> Linear:  # noqa: D102
        return Linear(self.reading(now.x), self.jacobian(now.x), self._noise)
