"""The compiled part of `calibration_error`: enters derivatives, which take a microsecond each as array operations."""

from __future__ import annotations

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def fill(J: Array, from_camera: Array, across: Array, u: Array, v: Array, R_WC: Array) -> None:
    """Enter in J (N, 3, 10) how points are shown aside by a calibration's errors: see `point_shifts`.

    Args:
        J: to be filled.
        from_camera: (N, 3) from the camera to the points, in W [m].
        across: (N, 3) what of that is across the camera's axis [m].
        u: (N,) how far a pixel is along its x there [m].
        v: (N,) the same along its y [m].
        R_WC: (3, 3) the camera's axes in W.
    """
    for k in range(len(J)):
        x, y, z = from_camera[k, 0], from_camera[k, 1], from_camera[k, 2]
        for i in range(3):
            for j in range(6):
                J[k, i, j] = -1.0 if j == 3 + i else 0.0
            J[k, i, 6], J[k, i, 7] = from_camera[k, i], across[k, i]
            J[k, i, 8], J[k, i, 9] = u[k] * R_WC[i, 0], v[k] * R_WC[i, 1]
        # turn × point, the other way round: the camera turned, and nobody knows.
        J[k, 0, 1], J[k, 0, 2], J[k, 1, 2] = -z, y, -x
        J[k, 1, 0], J[k, 2, 0], J[k, 2, 1] = z, -y, x
