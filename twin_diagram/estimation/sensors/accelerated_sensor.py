"""What sensors on a link have in common that feel how it accelerates: six readings, each with a bias that drifts."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.sensors.sensor import Instant, Sensor
from twin_diagram.signals.arrays import Array


class AcceleratedSensor(Sensor):
    """Six readings in a frame on a link; its own states are their biases, each a random walk.

    Attributes:
        frame: of the sensor.
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str | Frame,
        X_BS: RigidTransform | None,
        name: str,
        labels: tuple[str, str],
        figures: Array,
    ) -> None:
        """Make the sensor.

        Args:
            terms: the arm.
            body: the link or frame B that it is fixed to; by name, or the frame itself.
            X_BS: its pose there; B's own frame where None.
            name: for messages and counters.
            labels: of the biases of the first and of the last three readings; `{a}` stands for the axis.
            figures: (3, 2) of these: white noise, prior of the bias, random walk of the bias.

        Raises:
            ModelError: the plant has no such link or frame.
        """
        super().__init__(name, 6)
        self.frame = LinkFrame(terms, body, X_BS)
        std, self._bias_std, self._bias_walk = np.repeat(figures, 3, axis=1)
        self._noise: Array = np.diag(std**2)
        self._labels = labels
        self._gravity: Array = terms.plant.gravity_field().gravity_vector()

    def reading(self, x: Array) -> Array:
        """Return the reading as if no joint accelerated: `linear` knows how they do."""
        return self.linear(self._still(x)).reading

    def jacobian(self, x: Array) -> Array:  # noqa: D102
        return self.linear(self._still(x)).jacobian

    def noise(self, x: Array) -> Array:  # noqa: D102
        return self._noise

    def _still(self, x: Array) -> Instant:
        n = self.frame.terms.n
        return Instant(x, n, 0, np.zeros(n))

    def _bias(self, now: Instant, H: Array) -> Array:
        """Return (6,) its bias at one moment, whose derivative is entered in H (6, N); zero where not declared."""
        if self.own.stop <= self.own.start:
            return np.zeros(6)
        H[:, self.own] = np.eye(6)
        return now.x[self.own]

    def own_labels(self) -> list[str]:  # noqa: D102
        return [f"{self.name}.{label.format(a=axis)}" for label in self._labels for axis in "xyz"]

    def own_std(self) -> Array:  # noqa: D102
        return self._bias_std

    def own_walk(self) -> Array:  # noqa: D102
        return self._bias_walk
