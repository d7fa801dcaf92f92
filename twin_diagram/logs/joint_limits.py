"""What a log must know of an arm to be held against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


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

    def outside(self, position: Array) -> Array:
        """Return by how much each joint leaves its limits (n,) in positions (N, n)."""
        return np.maximum(np.max(position - self.upper, axis=0), np.max(self.lower - position, axis=0)).clip(min=0.0)
