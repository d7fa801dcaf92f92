"""Cuts out of an image what lies around an object, and what is seen past it, compiled; `silhouette` says what for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.point_kernels import LooksFrom
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled_in_place


@compiled_in_place
def window(
    p: Array, camera: LooksFrom, radius: float, beyond: float, stride: int, shape: tuple[int, int]
) -> tuple[float, int, int, int, int]:
    """Return the least depth of an object at poses, and first and last row and column of the cells around it.

    Args:
        p: (B, 3) its places [m].
        camera: from where.
        radius: of the object [m]; where it reaches behind the camera the least depth is not above 0, cells are none.
        beyond: how far about it [m].
        stride: pixels of a cell.
        shape: rows and columns of cells.
    """
    R, p_WC = camera.R_WC, camera.p_WC
    nearest = np.inf
    for b in range(p.shape[0]):
        x, y, z = p[b, 0] - p_WC[0], p[b, 1] - p_WC[1], p[b, 2] - p_WC[2]
        nearest = min(nearest, R[0, 2] * x + R[1, 2] * y + R[2, 2] * z - radius)
    if nearest <= 0.0:
        return nearest, 0, 0, 0, 0
    left = top = np.inf
    right = bottom = -np.inf
    for b in range(p.shape[0]):
        x, y, z = p[b, 0] - p_WC[0], p[b, 1] - p_WC[1], p[b, 2] - p_WC[2]
        ahead = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
        u = (R[0, 0] * x + R[1, 0] * y + R[2, 0] * z) * (camera.fx / max(ahead, 1e-6)) + camera.cx
        v = (R[0, 1] * x + R[1, 1] * y + R[2, 1] * z) * (camera.fy / max(ahead, 1e-6)) + camera.cy
        reach = radius / max(ahead, nearest) * max(camera.fx, camera.fy) + beyond * camera.fx / ahead
        left, right = min(left, u - reach), max(right, u + reach)
        top, bottom = min(top, v - reach), max(bottom, v + reach)
    r0, r1 = _cell(top / stride, shape[0]), _cell((bottom + stride) / stride, shape[0])
    return nearest, r0, r1, _cell(left / stride, shape[1]), _cell((right + stride) / stride, shape[1])


@compiled_in_place
def _cell(place: float, count: int) -> int:
    """Return the cell of a place, or the end that it is beyond."""
    return int(min(max(place, 0.0), float(count)))


@compiled_in_place
def see_past(
    past: npt.NDArray[np.bool_],
    depth: npt.NDArray[np.float32],
    stride: int,
    corner: tuple[int, int],
    nearest: np.float32,
    free: npt.NDArray[np.uint8],
) -> bool:
    """Write in which cells (h, w) of a cut-out the image shows what is past an object; return whether in all.

    Args:
        past: (H, W) cells where nothing stands and something is seen.
        depth: (H · stride, W · stride) [m].
        stride: pixels of a cell.
        corner: row and column of the cut-out's first cell.
        nearest: what is no deeper is not past it [m].
        free: (h, w), filled with 0 and 1.
    """
    every = True
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            row, column = corner[0] + i, corner[1] + j
            one = past[row, column] and depth[row * stride, column * stride] > nearest
            free[i, j] = one
            every = every and one
    return every


@compiled_in_place
def place_labels(
    free: npt.NDArray[np.uint8],
    label: npt.NDArray[np.int32],
    corner: tuple[int, int],
    table: npt.NDArray[np.float32],
) -> None:
    """Write column and row, in the whole grid, of each cell (h, w) that is not free, by its label, into (T, 2)."""
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            if not free[i, j]:
                table[label[i, j], 0], table[label[i, j], 1] = corner[1] + j, corner[0] + i
