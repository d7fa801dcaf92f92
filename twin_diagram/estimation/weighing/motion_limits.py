"""What a joint motion may ask of an arm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.estimation.weighing.held import WeighingError
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    share: float = 0.9
    """Of speeds and torques in the description; the rest is for the controller."""

    margin: float = 0.05
    """Kept from position limits [rad]."""

    quickness: float = 7.0
    """Acceleration over speed limit where none is told [1/s]: 22 rad/s² for an iiwa's wrist, which its motors reach."""


TUNING = Tuning()


@dataclass(frozen=True)
class MotionLimits:
    """Per joint of the arm, (n,), in the model's order.

    Attributes:
        lower, upper: positions [rad]; infinite where a joint turns on and on: `near` a posture they are finite.
        velocity: [rad/s]
        acceleration: [rad/s²]
        torque: of the motors, with the object [N·m].
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    torque: Array

    @staticmethod
    def of(model: Model, acceleration: Array | None = None) -> MotionLimits:
        """Return those of a model's description, with a margin.

        Args:
            model: with its rotors (motor side), whose torques are limited.
            acceleration: (n,) [rad/s²]; None: what such joints do.

        Raises:
            WeighingError: the description lacks a limit.
        """
        for name, limit in (("velocity", model.velocity_limit), ("effort", model.effort_limit)):
            for joint, value in zip(model.joints, limit, strict=True):
                if not np.isfinite(value):
                    raise WeighingError(f"{joint}: the description states no {name} limit; give MotionLimits yourself")
        quick = TUNING.quickness * model.velocity_limit if acceleration is None else np.asarray(acceleration)
        return MotionLimits(
            model.lower + TUNING.margin,
            model.upper - TUNING.margin,
            TUNING.share * model.velocity_limit,
            quick,
            TUNING.share * model.effort_limit,
        )

    def near(self, posture: Array, reach: Array | float) -> MotionLimits:
        """Return the same with positions within `reach` [rad] of a posture (n,)."""
        return replace(
            self, lower=np.maximum(self.lower, posture - reach), upper=np.minimum(self.upper, posture + reach)
        )

    def of_joints(self, rows: npt.NDArray[np.int64]) -> MotionLimits:
        """Return those of some joints."""
        return MotionLimits(
            self.lower[rows], self.upper[rows], self.velocity[rows], self.acceleration[rows], self.torque[rows]
        )
