"""What a log must know of an arm to be held against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand, so that arms as they are sold pass."""

    degrees: float = 1.5
    """Beyond its limits by more than this, a joint's position is no longer a robot that is described too tightly
    [rad]."""

    tight: float = 0.1
    """By this much a description's limits may be too tight [rad]."""


TUNING = Tuning()


@dataclass(frozen=True)
class JointLimits:
    """An arm's joints and what their description allows; infinite where it says nothing.

    Attributes:
        joints: names, in the arm's order; n is their number.
        revolute: (n,) which of them turn; the others slide, and what is theirs is in m and N.
        lower, upper: (n,) positions [rad].
        effort: (n,) largest torque, joint side [N·m].
    """

    joints: tuple[str, ...]
    revolute: npt.NDArray[np.bool_]
    lower: Array
    upper: Array
    effort: Array

    def in_degrees(self, position: Array) -> bool:
        """Return whether positions (N, n) are far outside, and inside if they are degrees."""
        far = self.revolute & (self.outside(position) > TUNING.degrees)
        return bool(np.any(far) and np.all((self.outside(np.radians(position)) < TUNING.tight) | ~self.revolute))

    def outside(self, position: Array) -> Array:
        """Return by how much each joint leaves its limits (n,) in positions (N, n)."""
        return np.maximum(np.max(position - self.upper, axis=0), np.max(self.lower - position, axis=0)).clip(min=0.0)
