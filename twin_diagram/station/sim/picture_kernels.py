"""Compiled loops over pixels of what a real camera makes of a picture; in single precision, as NumPy would do it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.compiled import compiled

Floats32 = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]


@compiled
def scattered(colour: Bytes, level: Floats32, std: Floats32, noise: Floats32, result: Bytes) -> None:
    """Write colours (N, 4) as they are seen: each at its level and with noise of its spread, alpha 255.

    Args:
        colour: (N, 4).
        level: (256,) of each brightness.
        std: (256,) of each brightness.
        noise: (4 N,) normal numbers.
        result: (N, 4) written.
    """
    for k in range(len(colour)):
        for i in range(3):
            shown = std[colour[k, i]] * noise[4 * k + i] + level[colour[k, i]]
            result[k, i] = np.uint8(min(max(np.rint(shown), np.float32(0.0)), np.float32(255.0)))
        result[k, 3] = 255


@compiled
def cosines(depth: Floats32, u: Floats32, v: Floats32, fx: np.float32, fy: np.float32, result: Floats32) -> None:
    """Write the cosines (H, W) of `camera_materials.incidence_cosine`.

    Args:
        depth: (H, W) [m].
        u: (W,) columns from the principal point [px].
        v: (H,) rows from it [px].
        fx: focal length [px].
        fy: focal length [px].
        result: (H, W) written.
    """
    height, width = depth.shape
    least, one = np.float32(1e-12), np.float32(1.0)
    for row in range(height):
        up, down = max(row - 1, 0), min(row, height - 2)
        y = v[row] / fy
        for column in range(width):
            left, right = max(column - 1, 0), min(column, width - 2)
            before, after = depth[row, left + 1] - depth[row, left], depth[row, right + 1] - depth[row, right]
            z_u = after if abs(after) < abs(before) else before
            before, after = depth[up + 1, column] - depth[up, column], depth[down + 1, column] - depth[down, column]
            z_v = after if abs(after) < abs(before) else before
            z, x = depth[row, column], u[column] / fx
            across, along = fx * z_u, fy * z_v
            length = z + u[column] * z_u + v[row] * z_v
            length = (length * length + across * across + along * along) * (x * x + y * y + one)
            result[row, column] = z / np.sqrt(max(length, least))
