"""What a method says about a run, in one form for all of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
from filter_truth import told
from hrt_truth.hidden import LAST

from twin_diagram.estimation.dynamics.link_frame import LinkFrame

Array = npt.NDArray[np.float64]

AHEAD: Final = (0.1, 0.2)
"""Horizons of predictions [s]."""
STRIDE: Final = 10
"""Messages from one prediction to the next."""


@dataclass
class Estimate:
    """Of one method on one run.

    Attributes:
        hand: (N, 7) pose of the hand as known when message k had come.
        hand_speed: (N, 3) [m/s].
        ahead: by horizon, (K, 3) position of the hand that was predicted at message `STRIDE` · k; NaN beyond the run.
        mass: (N,) payload [kg], NaN where the method has none.
        alarms: (time, what) of each alarm that was raised.
        extra: further columns (N, …) that one experiment needs.
    """

    hand: Array
    hand_speed: Array
    ahead: dict[float, Array]
    mass: Array
    alarms: list[tuple[float, str]] = field(default_factory=list)
    extra: dict[str, Array] = field(default_factory=dict)


class Kinematics:
    """The hand of the arm as described."""

    def __init__(self) -> None:
        self.terms = told()
        self._frame = LinkFrame(self.terms, LAST)

    def poses(self, q: Array) -> Array:
        """(N, 7) from (N, n)."""
        result = np.empty((len(q), 7))
        for k, row in enumerate(q):
            R, p = self._frame.pose(row)
            result[k] = np.concatenate([wxyz(R), p])
        return result

    def positions(self, q: Array) -> Array:
        """(N, 3) from (N, n); NaN stays NaN."""
        return np.array([self._frame.pose(row)[1] if np.isfinite(row).all() else np.full(3, np.nan) for row in q])

    def jacobian(self, q: Array) -> Array:
        """(6, n): rotation, translation."""
        return self._frame.jacobian(q)[2]

    def speeds(self, q: Array, v: Array) -> Array:
        """(N, 3) [m/s]."""
        return np.array([self._frame.jacobian(a)[2][3:] @ b for a, b in zip(q, v, strict=True)])


def wxyz(R: Array) -> Array:
    """Quaternion of a rotation matrix."""
    from pydrake.math import RotationMatrix

    return np.asarray(RotationMatrix(R).ToQuaternion().wxyz())
