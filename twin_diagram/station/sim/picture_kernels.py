"""Compiled loops over pixels of what a real camera makes of a picture; in single precision, as NumPy would do it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.compiled import compiled, compiled_in_place

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
    for row in range(height):
        up, down = max(row - 1, 0), min(row, height - 2)
        lines = (depth[up], depth[up + 1], depth[down], depth[down + 1], depth[row])
        y = v[row] / fy
        for column in (0, width - 1):
            left, right = max(column - 1, 0), min(column, width - 2)
            result[row, column] = _cosine(lines, column, left, right, u, v[row], y, fx, fy)
        for column in range(1, width - 1):
            result[row, column] = _cosine(lines, column, column - 1, column, u, v[row], y, fx, fy)


@compiled_in_place
def _cosine(
    lines: tuple[Floats32, ...], column: int, left: int, right: int, u: Floats32, v: np.float32, y: np.float32,
    fx: np.float32, fy: np.float32,
) -> np.float32:  # fmt: skip
    """Return one of `cosines`, by two lines above, two below and its own, and by steps that begin left and right."""
    above, above_end, below, below_end, own = lines
    least, one = np.float32(1e-12), np.float32(1.0)
    before, after = own[left + 1] - own[left], own[right + 1] - own[right]
    z_u = after if abs(after) < abs(before) else before
    before, after = above_end[column] - above[column], below_end[column] - below[column]
    z_v = after if abs(after) < abs(before) else before
    z, x = own[column], u[column] / fx
    across, along = fx * z_u, fy * z_v
    length = z + u[column] * z_u + v * z_v
    length = (length * length + across * across + along * along) * (x * x + y * y + one)
    return z / np.sqrt(max(length, least))


@compiled_in_place
def delivered(
    depth: Floats32, error: Floats32, law: tuple[np.float32, np.float32, np.float32],
    reach: tuple[np.float32, np.float32], scale: np.float32, units: tuple[np.float32, float, np.float32],
) -> None:  # fmt: skip
    """Turn depth (N,) into what a camera delivers: with its error, within its range, in whole units; 0 stays 0.

    Args:
        depth: [m], written over.
        error: (N,) in units of its RMS.
        law: of the RMS: where it begins [m], what it grows by [1/m], its floor [m].
        reach: nearest and farthest depth [m].
        scale: what depth is multiplied by.
        units: how many there are in a metre, how long one is [m], the most that are told.
    """
    start, growth, floor = law
    nearest, farthest = reach
    each, unit, most = units
    for k in range(depth.shape[0]):
        z = depth[k]
        beyond = z - start
        beyond = z + (beyond * beyond * growth + floor) * error[k]
        kept = z > np.float32(0.0) and beyond >= nearest and beyond <= farthest
        count = min(np.rint(beyond * scale * each), most) if kept else np.float32(0.0)
        depth[k] = np.float32(float(count) * unit)
