"""Points and normals of a depth image, compiled."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.signals.compiled import compiled, compiled_in_place

Depth = npt.NDArray[np.float32]


@compiled
def points_with_normals(
    depth: Depth, rays: Array, row: Ints, column: Ints, p_WC: Array, jump: float, points: Array, normals: Array
) -> None:
    """Fill in points (N, 3) and normals (N, 3) at pixels of a depth image, as `pinhole.surface_at` says.

    Args:
        depth: (h, w) [m], 0 where there is none.
        rays: (h, w, 3) where pixels look.
        row: (N,) of the pixels.
        column: (N,).
        p_WC: (3,) the camera's place.
        jump: a neighbour that is farther away belongs to another surface [m], unless pixels are that wide there.
        points: filled.
        normals: filled.
    """
    _fill(depth, rays, (row, column), p_WC, jump, (np.empty(3), np.empty(3)), (points, normals))


@compiled_in_place
def _fill(
    depth: Depth,
    rays: Array,
    pixels: tuple[Ints, Ints],
    p_WC: Array,
    jump: float,
    room: tuple[Array, Array],
    filled: tuple[Array, Array],
) -> None:
    """Do what `points_with_normals` does; `room`, twice (3,), is written over."""
    row, column = pixels
    points, normals = filled
    height, width = depth.shape
    across, down = room
    for k in range(row.shape[0]):
        r, c = row[k], column[k]
        _difference(depth, rays, (r, c), (r, min(c + 2, width - 1)), (r, max(c - 2, 0)), jump, across)
        _difference(depth, rays, (r, c), (min(r + 2, height - 1), c), (max(r - 2, 0), c), jump, down)
        x = down[1] * across[2] - down[2] * across[1]
        y = down[2] * across[0] - down[0] * across[2]
        z = down[0] * across[1] - down[1] * across[0]
        length = np.sqrt(x * x + y * y + z * z)
        here = np.float64(depth[r, c])
        u, v, w = -here * rays[r, c, 0], -here * rays[r, c, 1], -here * rays[r, c, 2]
        if length <= 1e-9:
            x, y, z = u, v, w
            length = max(np.sqrt(u * u + v * v + w * w), 1e-9)
        if x * u + y * v + z * w < 0.0:
            length = -length
        normals[k, 0], normals[k, 1], normals[k, 2] = x / length, y / length, z / length
        points[k, 0], points[k, 1], points[k, 2] = p_WC[0] - u, p_WC[1] - v, p_WC[2] - w


@compiled_in_place
def _difference(
    depth: Depth,
    rays: Array,
    at: tuple[int, int],
    high: tuple[int, int],
    low: tuple[int, int],
    jump: float,
    out: Array,
) -> None:
    """Write the difference (3,) of two pixels' points, either being the middle one's where it is of no use.

    Of a surface seen square on, neighbours are as far apart as their rays; of one that leans by 60°, twice as far: 2.2
    times is no jump. With three times steps of 2 to 4 cm in noisy pictures passed for a surface.
    """
    here = np.float64(depth[at])
    for i in range(3):
        out[i] = 0.0
    for cell, sign in ((high, 1.0), (low, -1.0)):
        there = np.float64(depth[cell])
        if there <= 0.0:
            continue
        x = there * rays[cell][0] - here * rays[at][0]
        y = there * rays[cell][1] - here * rays[at][1]
        z = there * rays[cell][2] - here * rays[at][2]
        u, v, w = rays[cell][0] - rays[at][0], rays[cell][1] - rays[at][1], rays[cell][2] - rays[at][2]
        wide = 4.84 * here * here * (u * u + v * v + w * w)
        if x * x + y * y + z * z < max(jump * jump, wide):
            out[0] += sign * x
            out[1] += sign * y
            out[2] += sign * z
