"""Looks a model's points up in an image, point by point, compiled.

`data_association` says what the numbers mean. All arrays are contiguous; B poses, P points each.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place

Mask = npt.NDArray[np.bool_]

R_AT, N_AT, FACING, U, V, Z, DISTANCE, DEEPER, TEXTURE, COLOUR = 0, 3, 6, 7, 8, 9, 10, 11, 12, 13
"""Columns of what is looked up."""
COLUMNS: Final = 16
"""How many there are."""
COUNTED, SEEN, NEAR, MATCHED, ROBOT, BURIED = 1, 2, 4, 8, 16, 32
"""Bits of its flags."""
UNPAINTED: Final = 1e12
"""Texture [1/m²] of points whose colours no picture showed: far above what black beside white in a millimetre makes,
a million."""
FINE, COARSE = 0, 1
"""Scales of colour; indices of `Frame.colours` and `ModelCloud.colours`."""


class PointTable(NamedTuple):
    """A model's points, and which of them are seen from where.

    Attributes:
        rows: (M, 13) points, normals, texture, fine and coarse colours.
        directions: (D, 3) towards a far camera.
        views: (D, P) rows that such a camera sees, repeated to fill it.
        counts: (D,) how many of a view are not repeated.
    """

    rows: Array
    directions: Array
    views: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int64]


class Images(NamedTuple):
    """What an image shows.

    Attributes:
        depth: (H, W) [m], 0 where there is none.
        robot: (H, W) whether a pixel shows the robot.
        any_robot: whether any does.
        normals: (h, w, 3) in W of every so many pixels.
        stride: how many.
    """

    depth: npt.NDArray[np.float32]
    robot: Mask
    any_robot: bool
    normals: npt.NDArray[np.float32]
    stride: int


class LooksFrom(NamedTuple):
    """The camera's lens and pose, and the table: z = a x + b y + c in W."""

    fx: float
    fy: float
    cx: float
    cy: float
    R_WC: Array
    p_WC: Array
    table: Array


class NoiseLaw(NamedTuple):
    """The deviation of depth z [m]: floor + growth (z - start)²."""

    floor: float
    growth: float
    start: float


class LookLimits(NamedTuple):
    """What counts as a pair.

    Attributes:
        table: a point of the image this near to the table's top is the table's [m].
        cosine: the least between a model point's normal and the image's.
        facing: the least cosine between a normal and the line of sight.
        buried: a model point so far below the table's top, where what is seen is not, is nowhere [m].
    """

    table: float
    cosine: float
    facing: float
    buried: float


@compiled_in_place
def best_view(direction: Array, directions: Array) -> int:
    """Return the row of `directions` (D, 3) that is nearest to a direction (3,)."""
    best, most = 0, -np.inf
    for k in range(directions.shape[0]):
        along = direction[0] * directions[k, 0] + direction[1] * directions[k, 1] + direction[2] * directions[k, 2]
        if along > most:
            best, most = k, along
    return best


@compiled_in_place
def cell_at(u: float, v: float, height: int, width: int) -> tuple[int, int]:
    """Return row and column nearest to (u, v), clamped to a grid."""
    column = min(max(np.rint(u), 0.0), width - 1.0)
    row = min(max(np.rint(v), 0.0), height - 1.0)
    return int(row), int(column)


@compiled
def look_up(
    R: Array,
    p: Array,
    model: PointTable,
    images: Images,
    camera: LooksFrom,
    limits: LookLimits,
    count: int,
    level: int,
    told: Array,
    flags: npt.NDArray[np.uint8],
) -> None:
    """Look the visible points of a model up in an image, for each pose.

    Args:
        R: (B, 3, 3).
        p: (B, 3) [m].
        model: the points.
        images: what is seen.
        camera: from where.
        limits: of what counts as a pair.
        count: points used per pose.
        level: of the colours.
        told: (B, P, COLUMNS), filled.
        flags: (B, P), filled.
    """
    for b in range(R.shape[0]):
        towards = np.zeros(3)
        for i in range(3):
            for j in range(3):
                towards[i] += (camera.p_WC[j] - p[b, j]) * R[b, j, i]
        view = best_view(towards, model.directions)
        _look_up_view((R[b], p[b]), model, view, (images, camera, limits), count, level, (told[b], flags[b]))


@compiled_in_place
def _look_up_view(
    pose: tuple[Array, Array],
    model: PointTable,
    view: int,
    looked: tuple[Images, LooksFrom, LookLimits],
    count: int,
    level: int,
    filled: tuple[Array, npt.NDArray[np.uint8]],
) -> None:
    """Look up the points of a model's view, for one pose."""
    R, p = pose
    images, camera, limits = looked
    told, flags = filled
    for k in range(count):
        _look_up_point(R, p, model.rows[model.views[view, k]], camera, level, told[k])
        flags[k] = _flags(told[k], p, images, camera, limits, k < model.counts[view])


@compiled_in_place
def _look_up_point(R: Array, p: Array, point: Array, camera: LooksFrom, level: int, row: Array) -> None:
    """Write where a point (13,) of the model lies, in W and in the image."""
    R_WC, p_WC = camera.R_WC, camera.p_WC
    for i in range(3):
        row[R_AT + i] = R[i, 0] * point[0] + R[i, 1] * point[1] + R[i, 2] * point[2]
        row[N_AT + i] = R[i, 0] * point[3] + R[i, 1] * point[4] + R[i, 2] * point[5]
        row[COLOUR + i] = point[7 + 3 * level + i]
    row[TEXTURE] = point[6]
    x, y, z = row[0] + p[0] - p_WC[0], row[1] + p[1] - p_WC[1], row[2] + p[2] - p_WC[2]
    row[FACING] = -(row[3] * x + row[4] * y + row[5] * z) / np.sqrt(x * x + y * y + z * z)
    right = R_WC[0, 0] * x + R_WC[1, 0] * y + R_WC[2, 0] * z
    down = R_WC[0, 1] * x + R_WC[1, 1] * y + R_WC[2, 1] * z
    ahead = R_WC[0, 2] * x + R_WC[1, 2] * y + R_WC[2, 2] * z
    near = max(ahead, 1e-6)
    row[U] = right * (camera.fx / near) + camera.cx
    row[V] = down * (camera.fy / near) + camera.cy
    row[Z] = ahead


@compiled_in_place
def _flags(
    row: Array,
    p: Array,
    images: Images,
    camera: LooksFrom,
    limits: LookLimits,
    counted: bool,
) -> int:
    """Look at what the image shows at one point's pixel; write how far off it is, return its flags."""
    R_WC, p_WC, table = camera.R_WC, camera.p_WC, camera.table
    height, width = images.depth.shape
    u, v = row[U], row[V]
    inside = u > -0.5 and u < width - 0.5 and v > -0.5 and v < height - 0.5
    line, column = cell_at(u, v, height, width)
    z = float(images.depth[line, column]) if inside else 0.0
    right, down = (column - camera.cx) / camera.fx * z, (line - camera.cy) / camera.fy * z
    y0 = R_WC[0, 0] * right + R_WC[0, 1] * down + R_WC[0, 2] * z + p_WC[0]
    y1 = R_WC[1, 0] * right + R_WC[1, 1] * down + R_WC[1, 2] * z + p_WC[1]
    y2 = R_WC[2, 0] * right + R_WC[2, 1] * down + R_WC[2, 2] * z + p_WC[2]
    distance = row[N_AT] * (y0 - row[R_AT] - p[0])
    distance += row[N_AT + 1] * (y1 - row[R_AT + 1] - p[1])
    distance += row[N_AT + 2] * (y2 - row[R_AT + 2] - p[2])
    row[DISTANCE], row[DEEPER] = distance, z - row[Z]
    result = COUNTED if counted else 0
    shows_robot = images.any_robot and images.robot[line, column]
    if shows_robot and counted:
        result |= ROBOT
    if not (inside and z > 0.0 and counted) or shows_robot or row[FACING] <= limits.facing:
        return result
    result |= SEEN
    above = y2 - table[0] * y0 - table[1] * y1 - table[2]
    x = row[2] + p[2] - table[0] * (row[0] + p[0]) - table[1] * (row[1] + p[1]) - table[2]
    if x < -limits.buried and above > -limits.buried:
        return result | BURIED
    if abs(above) < limits.table and x > 2.0 * limits.table:
        return result
    result |= NEAR
    line, column = cell_at(u / images.stride, v / images.stride, images.normals.shape[0], images.normals.shape[1])
    along, length = 0.0, 0.0
    for i in range(3):
        n = float(images.normals[line, column, i])
        along += row[N_AT + i] * n
        length += n * n
    return result | MATCHED if along > limits.cosine or length == 0.0 else result
