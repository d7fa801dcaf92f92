"""How far a camera may be from what its calibration says, and what that does to all that is seen with it.

Errors of a calibration, in this order everywhere, (10,): turn (3) [rad] and shift (3) [m] of the camera in W, share by
which its depth is too long, share by which its focal lengths are too long, and the principal point's in u and v [px].
The true camera is at exp(turn) R_WC, p_WC + shift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.signals.arrays import Array

SIZE = 10
"""Of a calibration's errors."""
CALIBRATION_SIZE = SIZE + SIZE * SIZE
"""Of an estimate of them: errors, and their covariance row by row."""
RESTS_SIZE = 36 + 6
"""Of an object that several cameras see: what is left of their calibrations in its pose (6, 6), and the sum of the
shifts (6) by which corrections of them have moved it."""


@dataclass(frozen=True)
class CalibrationError:
    """What is told of the errors of a calibration, RMS; hashable.

    Attributes:
        shift: length of the error of p_WC [m].
        turn: angle of the error of R_WC [rad].
        focal: of the focal lengths, as a share.
        centre: length of the error of the principal point [px].
        depth_scale: of the scale of depth, as a share.
    """

    shift: float = 0.0
    turn: float = 0.0
    focal: float = 0.0
    centre: float = 0.0
    depth_scale: float = 0.0

    @property
    def variances(self) -> Array:
        """(10,) of the errors, alike along all axes."""
        axes = [self.turn**2 / 3.0] * 3 + [self.shift**2 / 3.0] * 3
        return np.array([*axes, self.depth_scale**2, self.focal**2, self.centre**2 / 2.0, self.centre**2 / 2.0])


def point_shifts(points_C: Array, R_WC: Array, fx: float, fy: float) -> Array:
    """Return (N, 3, 10): how points that are seen are shown aside in W by a calibration's errors.

    The derivative of (where a point is believed to be - where it is).

    Args:
        points_C: (N, 3) in the camera's frame [m].
        R_WC: (3, 3) the camera's axes in W.
        fx: focal length [px].
        fy: focal length [px].
    """
    J = np.empty((len(points_C), 3, SIZE))
    _fill(J, points_C, R_WC, fx, fy)
    return J


def _fill(J: Array, points_C: Array, R_WC: Array, fx: float, fy: float) -> None:
    """Enter `point_shifts` in J (N, 3, 10)."""
    from twin_diagram.signals import calibration_kernels  # compiled; not with every import

    R = np.ascontiguousarray(R_WC)
    calibration_kernels.fill(
        J, points_C @ R_WC.T, points_C[:, :2] @ R_WC[:, :2].T, points_C[:, 2] / fx, points_C[:, 2] / fy, R
    )


def pose_shifts(points_C: Array, R_WC: Array, fx: float, fy: float) -> Array:
    """Return (N, 6, 10): how objects seen at points_C (N, 3) are shown turned and shifted by calibration errors.

    Arguments as of `point_shifts`.
    """
    J = np.zeros((len(points_C), 6, SIZE))
    J[:, (0, 1, 2), (0, 1, 2)] = -1.0
    _fill(J[:, 3:], points_C, R_WC, fx, fy)
    return J


def shared_covariances(error: CalibrationError | Array, points_C: Array, R_WC: Array, fx: float, fy: float) -> Array:
    """Return (N, 6, 6): what a calibration's errors bring into the poses of objects seen at points_C (N, 3).

    The errors are told by their sizes, or by their covariance (10, 10).

    Covariances of rotation and translation in W about the objects' origins; all objects share these errors, and no
    averaging over images removes them.
    """
    J = pose_shifts(points_C, R_WC, fx, fy)
    covariance = np.diag(error.variances) if isinstance(error, CalibrationError) else error
    return np.asarray(J @ covariance @ J.transpose(0, 2, 1))
