"""What goes over the wires about the hand: what it holds, and what may be touched."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import POSE_SIZE

NOTHING: Final = -1
"""In the place of an object's number in the library."""
HAND_SIZE: Final = 3 + POSE_SIZE + 36 + 3
"""A packed `Hand`."""


@dataclass(frozen=True)
class Hand:
    """What the fingers are about.

    Attributes:
        held: which of the library's objects is held, or `NOTHING`.
        touched: which of them the gripper may touch, or `NOTHING`: about to be taken, or just let go.
        on_support: what is held may touch what stands still: it is being lifted or put down.
        X_TO: (7) of what is held in the tool's frame.
        covariance: (6, 6) of X_TO, rotation [rad] then translation [m]: a left perturbation in T about the object's
            origin.
        around: the fingers are around what may be touched, and open or close: an arm that gave way to what passes by
            would throw it. Whatever moves is the stop monitor's alone.
        support: which of the library's objects bears what is held, or is to bear it, or `NOTHING`: while `on_support`
            that may be touched as well.
        since: since when the fingers have been about it [s]: what was seen before that beside it is no part of it. 0:
            nobody knows.
    """

    held: int = NOTHING
    touched: int = NOTHING
    on_support: bool = False
    X_TO: Array = field(default_factory=lambda: np.array([1.0, 0, 0, 0, 0, 0, 0]))
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))
    around: bool = False
    support: int = NOTHING
    since: float = 0.0

    def pack(self) -> Array:
        """Return it as a vector of `HAND_SIZE`."""
        numbers = [float(self.held), float(self.touched), float(self.on_support)]
        more = [float(self.around), float(self.support), self.since]
        return np.concatenate([numbers, self.X_TO, self.covariance.ravel(), more])

    @staticmethod
    def unpack(vector: Array) -> Hand:
        """Return the inverse of `pack`; copies. What is not finite is an empty hand."""
        if not np.isfinite(vector).all():
            return Hand()
        X_TO, covariance = vector[3 : 3 + POSE_SIZE].copy(), vector[3 + POSE_SIZE : -3].reshape(6, 6).copy()
        told = bool(vector[2] > 0.5), X_TO, covariance, bool(vector[-3] > 0.5)
        return Hand(int(vector[0]), int(vector[1]), *told, int(vector[-2]), float(vector[-1]))
