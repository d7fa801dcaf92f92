"""Looks a model's points up in an image and sums their normal equations, point by point, compiled.

`data_association`, `residuals` and `silhouette` say what the numbers mean. All arrays are contiguous; B poses, P points
each.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled

Mask = npt.NDArray[np.bool_]

R_AT, N_AT, FACING, U, V, Z, DISTANCE, DEEPER, TEXTURE, COLOUR = 0, 3, 6, 7, 8, 9, 10, 11, 12, 13
"""Columns of what is looked up."""
COLUMNS: Final = 16
"""How many there are."""
COUNTED, SEEN, NEAR, MATCHED, ROBOT, BURIED = 1, 2, 4, 8, 16, 32
"""Bits of its flags."""
FINE, COARSE = 0, 1
"""Scales of colour; indices of `Frame.colours` and `ModelCloud.colours`."""


@compiled
def best_view(direction: Array, directions: Array) -> int:
    """Return the row of `directions` (D, 3) that is nearest to a direction (3,)."""
    best, most = 0, -np.inf
    for k in range(directions.shape[0]):
        along = direction[0] * directions[k, 0] + direction[1] * directions[k, 1] + direction[2] * directions[k, 2]
        if along > most:
            best, most = k, along
    return best


@compiled
def cell_at(u: float, v: float, height: int, width: int) -> tuple[int, int]:
    """Return row and column nearest to (u, v), clamped to a grid."""
    column = min(max(np.rint(u), 0.0), width - 1.0)
    row = min(max(np.rint(v), 0.0), height - 1.0)
    return int(row), int(column)


@compiled
def look_up(
    R: Array,
    p: Array,
    model: tuple[Any, ...],
    images: tuple[Any, ...],
    camera: tuple[Any, ...],
    limits: tuple[float, float, float, float],
    count: int,
    level: int,
    told: Array,
    flags: npt.NDArray[np.uint8],
) -> None:
    """Look the visible points of a model up in an image, for each pose.

    Args:
        R: (B, 3, 3).
        p: (B, 3) [m].
        model: table (M, 13) of points, normals, texture, colours; directions; views; how many of each count.
        images: depth (H, W) [m], robot (H, W), whether any is in view, normals (h, w, 3), their stride.
        camera: fx, fy, cx, cy, R_WC, p_WC, table's (a, b, c).
        limits: the table's thickness [m], the least cosine between normals, the least facing, how far below it [m].
        count: points used per pose.
        level: of the colours.
        told: (B, P, COLUMNS), filled.
        flags: (B, P), filled.
    """
    table, directions, views, counts = model
    for b in range(R.shape[0]):
        towards = np.zeros(3)
        for i in range(3):
            for j in range(3):
                towards[i] += (camera[5][j] - p[b, j]) * R[b, j, i]
        view = best_view(towards, directions)
        for k in range(count):
            _look_up_point(R[b], p[b], table[views[view, k]], images, camera, limits, level, told[b, k])
            flags[b, k] = _flags(told[b, k], p[b], images, camera, limits, k < counts[view])


@compiled
def _look_up_point(
    R: Array,
    p: Array,
    point: Array,
    images: tuple[Any, ...],
    camera: tuple[Any, ...],
    limits: tuple[float, float, float, float],
    level: int,
    row: Array,
) -> None:
    fx, fy, cx, cy, R_WC, p_WC, _ = camera
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
    row[U], row[V], row[Z] = right * (fx / near) + cx, down * (fy / near) + cy, ahead


@compiled
def _flags(
    row: Array,
    p: Array,
    images: tuple[Any, ...],
    camera: tuple[Any, ...],
    limits: tuple[float, float, float, float],
    counted: bool,
) -> int:
    """Look at what the image shows at one point's pixel; write how far off it is, return its flags."""
    depth, robot, any_robot, normals, stride = images
    fx, fy, cx, cy, R_WC, p_WC, table = camera
    height, width = depth.shape
    u, v = row[U], row[V]
    inside = u > -0.5 and u < width - 0.5 and v > -0.5 and v < height - 0.5
    line, column = cell_at(u, v, height, width)
    z = float(depth[line, column]) if inside else 0.0
    right, down = (column - cx) / fx * z, (line - cy) / fy * z
    y0 = R_WC[0, 0] * right + R_WC[0, 1] * down + R_WC[0, 2] * z + p_WC[0]
    y1 = R_WC[1, 0] * right + R_WC[1, 1] * down + R_WC[1, 2] * z + p_WC[1]
    y2 = R_WC[2, 0] * right + R_WC[2, 1] * down + R_WC[2, 2] * z + p_WC[2]
    distance = row[N_AT] * (y0 - row[R_AT] - p[0])
    distance += row[N_AT + 1] * (y1 - row[R_AT + 1] - p[1])
    distance += row[N_AT + 2] * (y2 - row[R_AT + 2] - p[2])
    row[DISTANCE], row[DEEPER] = distance, z - row[Z]
    result = COUNTED if counted else 0
    shows_robot = any_robot and robot[line, column]
    if shows_robot and counted:
        result |= ROBOT
    if not (inside and z > 0.0 and counted) or shows_robot or row[FACING] <= limits[2]:
        return result
    result |= SEEN
    above = y2 - table[0] * y0 - table[1] * y1 - table[2]
    x = row[2] + p[2] - table[0] * (row[0] + p[0]) - table[1] * (row[1] + p[1]) - table[2]
    if x < -limits[3] and above > -limits[3]:
        return result | BURIED
    if abs(above) < limits[0] and x > 2.0 * limits[0]:
        return result
    result |= NEAR
    line, column = cell_at(u / stride, v / stride, normals.shape[0], normals.shape[1])
    along, length = 0.0, 0.0
    for i in range(3):
        n = float(normals[line, column, i])
        along += row[N_AT + i] * n
        length += n * n
    return result | MATCHED if along > limits[1] or length == 0.0 else result


@compiled
def tukey_weight(residual: float, cut: float) -> float:
    """Return Tukey's weight: 1 at no residual, 0 from `cut` on."""
    left = 1.0 - (residual / cut) ** 2
    return left * left if left > 0.0 else 0.0


@compiled
def add_row(H: Array, J: Array, w: float) -> None:
    """Add w J Jᵀ to the upper half of H (6, 6)."""
    for i in range(6):
        for j in range(i, 6):
            H[i, j] += w * J[i] * J[j]


@compiled
def mirror(H: Array) -> None:
    """Copy the upper half of (6, 6) to the lower."""
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]


@compiled
def screw_row(r: Array, a: float, b: float, c: float, J: Array) -> None:
    """Write r x way and way (6,), the way being (a, b, c)."""
    J[0], J[1], J[2] = r[1] * c - r[2] * b, r[2] * a - r[0] * c, r[0] * b - r[1] * a
    J[3], J[4], J[5] = a, b, c


@compiled
def depth_normal(
    told: Array,
    flags: npt.NDArray[np.uint8],
    noise: tuple[float, float, float],
    cuts: tuple[float, float, float],
    H: Array,
    b: Array,
) -> None:
    """Add the normal equations of the point-to-plane distances, for each pose.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        noise: of depth: floor, growth, start.
        cuts: reach [m], how much deeper at most [m], the model's own noise [m].
        H: (B, 6, 6), added to.
        b: (B, 6), added to.
    """
    J = np.empty(6)
    for pose in range(told.shape[0]):
        for k in range(told.shape[1]):
            row = told[pose, k]
            if not flags[pose, k] & MATCHED or abs(row[DEEPER]) >= cuts[1] or abs(row[DISTANCE]) >= cuts[0]:
                continue
            sigma = (noise[0] + noise[1] * (row[Z] - noise[2]) ** 2) * max(row[FACING], 0.2)
            w = tukey_weight(row[DISTANCE], cuts[0]) / (sigma * sigma + cuts[2] * cuts[2])
            screw_row(row, row[N_AT], row[N_AT + 1], row[N_AT + 2], J)
            add_row(H[pose], J, w)
            for i in range(6):
                b[pose, i] += w * row[DISTANCE] * J[i]
        mirror(H[pose])


@compiled
def colour_weights(told: Array, flags: npt.NDArray[np.uint8], cuts: tuple[float, float]) -> Array:
    """Return how much the colours of points count (B, P), before they are looked at.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        cuts: how much deeper [m] and how far off [m] a point may be.
    """
    weight = np.zeros(flags.shape)
    for b in range(flags.shape[0]):
        for k in range(flags.shape[1]):
            row = told[b, k]
            if flags[b, k] & MATCHED and row[FACING] > 0.25 and abs(row[DEEPER]) < cuts[0]:
                if abs(row[DISTANCE]) < cuts[1]:
                    weight[b, k] = row[FACING]
    return weight


@compiled
def colour_normal(
    told: Array,
    found: Array,
    weight: Array,
    gain: Array,
    camera: tuple[Any, ...],
    cuts: tuple[float, float, float],
    sums: tuple[Array, Array, Array, Array, Array],
) -> None:
    """Add the normal equations of colours, for each pose.

    Args:
        told: (B, P, COLUMNS).
        found: (B, P, 9) colours with derivatives.
        weight: (B, P).
        gain: (B, P) brightness.
        camera: as for `look_up`.
        cuts: a colour farther off is another thing's; how much steeper, squared, the image's may be than the model's;
            squared slopes that noise makes [1/px²].
        sums: H (B, 6, 6), b (B, 6), cross (B, 6, 2), H_shift (B, 2, 2), b_shift (B, 2), added to.
    """
    A_u, A_v = np.empty(6), np.empty(6)
    for b in range(weight.shape[0]):
        for k in range(weight.shape[1]):
            if weight[b, k] == 0.0:
                continue
            row, seen = told[b, k], found[b, k]
            uu = uv = vv = ru = rv = size = 0.0
            for i in range(3):
                off = seen[i] - min(row[COLOUR + i] * gain[b, k], 1.0)
                du, dv = seen[3 + i], seen[6 + i]
                uu, uv, vv = uu + du * du, uv + du * dv, vv + dv * dv
                ru, rv, size = ru + du * off, rv + dv * off, size + off * off
            model_slope = cuts[1] * row[TEXTURE] * (row[Z] / camera[0]) ** 2
            steep = max(uu + vv, 1e-12)
            told_share = min(max(min(steep - cuts[2], model_slope) / steep, 0.0), 1.0)
            w = weight[b, k] * tukey_weight(np.sqrt(size), cuts[0]) * told_share
            if w > 0.0:
                _pixel_rows(row, camera, A_u, A_v)
                _add_colour(A_u, A_v, (w * uu, w * uv, w * vv), (w * ru, w * rv), b, sums)
        mirror(sums[0][b])


@compiled
def _pixel_rows(row: Array, camera: tuple[Any, ...], A_u: Array, A_v: Array) -> None:
    """Write by how much a pose's steps (6,) move a point's pixel to the right and down [px]."""
    fx, fy, cx, cy, R_WC = camera[:5]
    x, y = (row[U] - cx) / fx, (row[V] - cy) / fy
    s, t = fx / row[Z], fy / row[Z]
    a, b, c = R_WC[0, 2], R_WC[1, 2], R_WC[2, 2]
    screw_row(row, (R_WC[0, 0] - x * a) * s, (R_WC[1, 0] - x * b) * s, (R_WC[2, 0] - x * c) * s, A_u)
    screw_row(row, (R_WC[0, 1] - y * a) * t, (R_WC[1, 1] - y * b) * t, (R_WC[2, 1] - y * c) * t, A_v)


@compiled
def _add_colour(
    A_u: Array,
    A_v: Array,
    slopes: tuple[float, float, float],
    pull: tuple[float, float],
    b: int,
    sums: tuple[Array, Array, Array, Array, Array],
) -> None:
    H, right, cross, H_shift, b_shift = sums
    uu, uv, vv = slopes
    for i in range(6):
        along_u, along_v = uu * A_u[i] + uv * A_v[i], uv * A_u[i] + vv * A_v[i]
        cross[b, i, 0] += along_u
        cross[b, i, 1] += along_v
        right[b, i] -= A_u[i] * pull[0] + A_v[i] * pull[1]
        for j in range(i, 6):
            H[b, i, j] += along_u * A_u[j] + along_v * A_v[j]
    H_shift[b, 0, 0] += uu
    H_shift[b, 0, 1] += uv
    H_shift[b, 1, 0] += uv
    H_shift[b, 1, 1] += vv
    b_shift[b, 0] -= pull[0]
    b_shift[b, 1] -= pull[1]


@compiled
def inward_normal(
    told: Array,
    flags: npt.NDArray[np.uint8],
    silhouette: tuple[Any, ...],
    camera: tuple[Any, ...],
    cuts: tuple[float, float, float, float],
    H: Array,
    b: Array,
) -> None:
    """Add the normal equations that draw what sticks out of a silhouette into it, for each pose.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        silhouette: row and column of the first cell, distances (h, w), numbers of the nearest (h, w), their cells
            (T, 2) as column and row, pixels of a cell.
        camera: as for `look_up`.
        cuts: how much deeper what is seen past a point is [m]; cells outside that are none; the farthest [m]; the
            deviation of an edge [m].
        H: (B, 6, 6), added to.
        b: (B, 6), added to.
    """
    r0, c0, away, nearest, target, stride = silhouette
    R_WC = camera[4]
    J = np.empty(6)
    for pose in range(told.shape[0]):
        for k in range(told.shape[1]):
            row = told[pose, k]
            if not flags[pose, k] & COUNTED or row[DEEPER] <= cuts[0]:
                continue
            column, line = int(np.rint(row[U] / stride)) - c0, int(np.rint(row[V] / stride)) - r0
            if column < 0 or line < 0 or column >= away.shape[1] or line >= away.shape[0] or away[line, column] <= 0.0:
                continue
            goal = target[nearest[line, column]]
            x = (goal[0] * stride - row[U]) * row[Z] / camera[0]
            y = (goal[1] * stride - row[V]) * row[Z] / camera[1]
            length = np.sqrt(x * x + y * y)
            beyond = length - cuts[1] * stride * row[Z] / camera[0]
            if beyond <= 0.0:
                continue
            x, y = x / length, y / length
            w = max(row[FACING], 0.0) * tukey_weight(beyond, cuts[2]) / cuts[3] ** 2
            way = (x * R_WC[0, 0] + y * R_WC[0, 1], x * R_WC[1, 0] + y * R_WC[1, 1], x * R_WC[2, 0] + y * R_WC[2, 1])
            screw_row(row, way[0], way[1], way[2], J)
            add_row(H[pose], J, w)
            for i in range(6):
                b[pose, i] += w * beyond * J[i]
        mirror(H[pose])
