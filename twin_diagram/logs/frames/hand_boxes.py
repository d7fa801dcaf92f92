"""Boxes that a hand filled while it held an object: nothing of the object is in there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Boxes:
    """Boxes of a hand in one of its grasps: X_ST (4, 4) of its frame in S, lowest and highest corners (b, 3) in T."""

    X_ST: Array
    low: Array
    high: Array

    def hold(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return which points (N, 3) in S are within one of them."""
        p = (points - self.X_ST[:3, 3]) @ self.X_ST[:3, :3]
        within = np.asarray(((p[:, None] >= self.low) & (p[:, None] <= self.high)).all(axis=2))
        return np.asarray(within.any(axis=1))
