"""What stands beside an object that is to be taken: how far it is from where fingers and palm come down.

Seen from above each thing is as wide as its convex pieces reach in so many directions; two convex things are as far
from each other as along the direction that parts them best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array

DIRECTIONS: Final = np.stack([np.cos(np.arange(32) * np.pi / 16), np.sin(np.arange(32) * np.pi / 16)])
"""(2, 32) in which reach is told. The best of them is off by 6° at most: 0.5 % of a distance between middles."""


@dataclass(frozen=True)
class Neighbours:
    """Things that stand beside another.

    Attributes:
        reach: (M, 32) how far each reaches in `DIRECTIONS` of W [m].
        top: (M,) its highest z [m].
    """

    reach: Array = field(default_factory=lambda: np.zeros((0, DIRECTIONS.shape[1])))
    top: Array = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of(things: Sequence[Array]) -> Neighbours:
        """Return the neighbours whose corners in W are given, (m, 3) each [m]."""
        if not things:
            return Neighbours()
        reach = np.stack([(points[:, :2] @ DIRECTIONS).max(axis=0) for points in things])
        return Neighbours(reach, np.array([points[:, 2].max() for points in things]))

    def discs(self, middles: Array, radius: float) -> float:
        """Return how far they reach into upright cylinders about `middles` (D, 2), at worst [m]; 0 where into none."""
        return max((self._into(middle @ DIRECTIONS + radius) for middle in middles), default=0.0)

    def body(self, corners: Array, room: float) -> float:
        """Return how far those that are as high reach into what is around a body, and above it, at worst [m]; 0: not.

        Args:
            corners: (C, 3) that hold it, in W [m].
            room: to keep about it [m].
        """
        return self._into((corners[:, :2] @ DIRECTIONS).max(axis=0) + room, float(corners[:, 2].min()) - room)

    def _into(self, reach: Array, above: float = -np.inf) -> float:
        """Return how far those higher than `above` reach into what reaches so far in `DIRECTIONS` (32,) [m]."""
        opposite = np.roll(reach, len(reach) // 2)
        apart = -(self.reach[self.top > above] + opposite).min(axis=1, initial=np.inf)
        return float(max(0.0, -apart.min(initial=0.0)))
