"""How far a camera is from what is told of it, drawn as the calibration errors of real ones are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class CameraError:
    """What is told, less what is true: a turn (3,) [rad] and shift (3,) [m] of X_WC; focal and depth scale as shares.

    `centre` (2,) is the principal point's [pixel].
    """

    turn: Array
    shift: Array
    focal: float
    centre: Array
    depth_scale: float

    @staticmethod
    def none() -> CameraError:
        """Return that of a camera that is as told."""
        return CameraError(np.zeros(3), np.zeros(3), 0.0, np.zeros(2), 0.0)

    @staticmethod
    def drawn(rng: np.random.Generator) -> CameraError:
        """Return one of RMS 5 mm and 0.5°, 0.3 % focal length, 1 pixel, 1 % depth."""
        return CameraError(
            rng.standard_normal(3) * np.radians(0.5) / np.sqrt(3),
            rng.standard_normal(3) * 0.005 / np.sqrt(3),
            float(0.003 * rng.standard_normal()),
            rng.standard_normal(2) / np.sqrt(2),
            float(0.01 * rng.standard_normal()),
        )

    @property
    def calibration(self) -> Array:
        """(10,) the true camera's place in what is told, in the order of `signals.calibration_error`."""
        return np.concatenate([-self.turn, -self.shift, [self.depth_scale, -self.focal], -self.centre])

    def told(self, true: ViewCamera, posed: bool = True) -> ViewCamera:
        """Return what is told of a camera; with `posed` its place is wrong, too."""
        lens = replace(
            true,
            fx=true.fx * (1 + self.focal),
            fy=true.fy * (1 + self.focal),
            cx=true.cx + float(self.centre[0]),
            cy=true.cy + float(self.centre[1]),
        )
        if not posed:
            return lens
        return lens.moved(rotations.matrix(rotations.exp(self.turn)) @ true.R_WC, true.p_WC + self.shift)
