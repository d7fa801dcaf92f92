"""What is not known of an object's pose, and how that grows ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.collision import forecast_growth
from twin_diagram.planning.collision.forecast_growth import TUNING as FORECAST_GROWTH
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Unsure:
    """What is not known of an object's pose, and how that grows.

    Attributes:
        spread: (S, 2) of its surface, see `forecast_growth.spread`.
        place, turn: variances of its place [m²] and its turn [rad²], of one coordinate each.
        moving: whether they grow.
        speed: variance of a coordinate of its velocity [m²/s²]; None: that of a filter that has settled.
    """

    spread: Array
    place: float
    turn: float
    moving: bool
    speed: float | None = None

    @staticmethod
    def of(covariance: Array, R_WO: Array, shape: Body | None, *, moving: bool) -> Unsure:
        """Return it for a pose's covariance (6, 6); without a shape, of an object that is a point."""
        if shape is None:
            worst = float(np.linalg.eigvalsh((covariance + covariance.T)[3:, 3:] / 2)[-1])
            rows = np.array([[max(worst, 0.0), 0.0]])
        else:
            rows = forecast_growth.outermost(forecast_growth.spread(shape.surface_O, covariance, R_WO))
        turn, axes = float(np.trace(covariance[:3, :3])), 3
        if shape is not None and shape.round_about_z:  # nothing is known of its turn about that axis, and nobody minds
            turn, axes = turn - float(R_WO[:, 2] @ covariance[:3, :3] @ R_WO[:, 2]), 2
        return Unsure(rows, float(np.trace(covariance[3:, 3:])) / 3, turn / axes, moving)

    @property
    def now(self) -> float:
        """How much larger it is taken to be now [m]."""
        return float(forecast_growth.growth(self.spread, np.zeros(1), np.zeros(1))[0])

    def growth(self, times: Array) -> Array:
        """Return (N,) how much larger it is taken to be at `times` (N,) from now on [s]."""
        if not self.moving:
            return np.full(len(times), self.now)
        if self.speed is None:
            shift = forecast_growth.added_variance(self.place, FORECAST_GROWTH.unsteady, times)
        else:
            ahead = np.minimum(times, FORECAST_GROWTH.reaction)
            shift = self.speed * ahead**2 + FORECAST_GROWTH.unsteady * ahead**3 / 3.0
        turn = forecast_growth.added_variance(self.turn, FORECAST_GROWTH.unsteady_spin, times)
        return forecast_growth.growth(self.spread, shift, turn)
