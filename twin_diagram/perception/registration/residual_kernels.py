"""Sums the normal equations of the points looked up, compiled.

`residuals` and `silhouette` say what the numbers mean. All arrays are contiguous; B poses, P points each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.point_kernels import (
    COLOUR,
    COUNTED,
    DEEPER,
    DISTANCE,
    FACING,
    MATCHED,
    N_AT,
    TEXTURE,
    UNPAINTED,
    LooksFrom,
    NoiseLaw,
    U,
    V,
    Z,
)
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place


class ColourSums(NamedTuple):
    """Normal equations of colours, of poses and of the colours' shift.

    Attributes:
        H: (B, 6, 6).
        b: (B, 6).
        cross: (B, 6, 2) between pose and shift.
        H_shift: (B, 2, 2) [1/px²].
        b_shift: (B, 2).
    """

    H: Array
    b: Array
    cross: Array
    H_shift: Array
    b_shift: Array


class OutlineCells(NamedTuple):
    """Where an image may show an object, in cells of so many pixels.

    Attributes:
        row: of the first cell.
        column: of it.
        away: (h, w) distance to the nearest cell that may show it [cells].
        nearest: (h, w) number of that cell.
        target: (T, 2) those cells' column and row.
        stride: pixels of a cell.
    """

    row: int
    column: int
    away: npt.NDArray[np.float32]
    nearest: npt.NDArray[np.int32]
    target: npt.NDArray[np.float32]
    stride: int


class OutlineCuts(NamedTuple):
    """What sticks out of an outline.

    Attributes:
        behind: what is seen so much deeper than a point was seen past it [m].
        rim: cells outside that are none.
        farthest: what is farther outside is no matter of an edge [m].
        deviation: of an edge [m].
    """

    behind: float
    rim: float
    farthest: float
    deviation: float


@compiled_in_place
def tukey_weight(residual: float, cut: float) -> float:
    """Return Tukey's weight: 1 at no residual, 0 from `cut` on."""
    left = 1.0 - (residual / cut) ** 2
    return left * left if left > 0.0 else 0.0


@compiled_in_place
def add_row(H: Array, J: Array, w: float) -> None:
    """Add w J Jᵀ to the upper half of H (6, 6)."""
    for i in range(6):
        for j in range(i, 6):
            H[i, j] += w * J[i] * J[j]


@compiled_in_place
def mirror(H: Array) -> None:
    """Copy the upper half of (6, 6) to the lower."""
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]


@compiled_in_place
def screw_row(r: Array, a: float, b: float, c: float, J: Array) -> None:
    """Write r x way and way (6,), the way being (a, b, c)."""
    J[0], J[1], J[2] = r[1] * c - r[2] * b, r[2] * a - r[0] * c, r[0] * b - r[1] * a
    J[3], J[4], J[5] = a, b, c


@compiled
def depth_normal(
    told: Array,
    flags: npt.NDArray[np.uint8],
    noise: NoiseLaw,
    cuts: tuple[float, float, float],
    H: Array,
    b: Array,
) -> None:
    """Add the normal equations of the point-to-plane distances, for each pose.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        noise: of depth.
        cuts: reach [m], how much deeper at most [m], the model's own noise [m].
        H: (B, 6, 6), added to.
        b: (B, 6), added to.
    """
    _add_depths(told, flags, noise, cuts, np.empty(6), H, b)


@compiled_in_place
def _add_depths(
    told: Array,
    flags: npt.NDArray[np.uint8],
    noise: NoiseLaw,
    cuts: tuple[float, float, float],
    J: Array,
    H: Array,
    b: Array,
) -> None:
    """Do what `depth_normal` does; J (6,) is written over."""
    reach, deepest, model_noise = cuts
    for pose in range(told.shape[0]):
        for k in range(told.shape[1]):
            row = told[pose, k]
            if not flags[pose, k] & MATCHED or abs(row[DEEPER]) >= deepest or abs(row[DISTANCE]) >= reach:
                continue
            sigma = (noise.floor + noise.growth * (row[Z] - noise.start) ** 2) * max(row[FACING], 0.2)
            w = tukey_weight(row[DISTANCE], reach) / (sigma * sigma + model_noise * model_noise)
            screw_row(row, row[N_AT], row[N_AT + 1], row[N_AT + 2], J)
            add_row(H[pose], J, w)
            for i in range(6):
                b[pose, i] += w * row[DISTANCE] * J[i]
        mirror(H[pose])


@compiled
def colour_weights(told: Array, flags: npt.NDArray[np.uint8], cuts: tuple[float, float]) -> Array:
    """Return how much the colours of points count (B, P), before they are looked at; nothing where none were seen.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        cuts: how much deeper [m] and how far off [m] a point may be.
    """
    weight = np.zeros(flags.shape)
    _weigh_colours(told, flags, cuts, weight)
    return weight


@compiled_in_place
def _weigh_colours(told: Array, flags: npt.NDArray[np.uint8], cuts: tuple[float, float], weight: Array) -> None:
    """Write what `colour_weights` returns where it is not 0."""
    deepest, farthest = cuts
    for b in range(flags.shape[0]):
        for k in range(flags.shape[1]):
            row = told[b, k]
            if flags[b, k] & MATCHED and row[FACING] > 0.25 and abs(row[DEEPER]) < deepest:
                if abs(row[DISTANCE]) < farthest and row[TEXTURE] < UNPAINTED:
                    weight[b, k] = row[FACING]


@compiled
def colour_normal(
    told: Array,
    found: Array,
    weight: Array,
    gain: Array,
    camera: LooksFrom,
    cuts: tuple[float, float, float],
    sums: ColourSums,
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
        sums: added to.
    """
    _add_colours(told, (found, weight, gain), camera, cuts, (np.empty(6), np.empty(6)), sums)


@compiled_in_place
def _add_colours(
    told: Array,
    looked: tuple[Array, Array, Array],
    camera: LooksFrom,
    cuts: tuple[float, float, float],
    rows: tuple[Array, Array],
    sums: ColourSums,
) -> None:
    """Do what `colour_normal` does; both rows (6,) are written over."""
    found, weight, gain = looked
    cut, steeper, noise_slopes = cuts
    A_u, A_v = rows
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
            model_slope = steeper * row[TEXTURE] * (row[Z] / camera.fx) ** 2
            steep = max(uu + vv, 1e-12)
            told_share = min(max(min(steep - noise_slopes, model_slope) / steep, 0.0), 1.0)
            w = weight[b, k] * tukey_weight(np.sqrt(size), cut) * told_share
            if w > 0.0:
                _pixel_rows(row, camera, A_u, A_v)
                _add_colour(A_u, A_v, (w * uu, w * uv, w * vv), (w * ru, w * rv), b, sums)
        mirror(sums.H[b])


@compiled_in_place
def _pixel_rows(row: Array, camera: LooksFrom, A_u: Array, A_v: Array) -> None:
    """Write by how much a pose's steps (6,) move a point's pixel to the right and down [px]."""
    R_WC = camera.R_WC
    x, y = (row[U] - camera.cx) / camera.fx, (row[V] - camera.cy) / camera.fy
    s, t = camera.fx / row[Z], camera.fy / row[Z]
    a, b, c = R_WC[0, 2], R_WC[1, 2], R_WC[2, 2]
    screw_row(row, (R_WC[0, 0] - x * a) * s, (R_WC[1, 0] - x * b) * s, (R_WC[2, 0] - x * c) * s, A_u)
    screw_row(row, (R_WC[0, 1] - y * a) * t, (R_WC[1, 1] - y * b) * t, (R_WC[2, 1] - y * c) * t, A_v)


@compiled_in_place
def _add_colour(
    A_u: Array,
    A_v: Array,
    slopes: tuple[float, float, float],
    pull: tuple[float, float],
    b: int,
    sums: ColourSums,
) -> None:
    """Add one point's squared slopes and pulls, weighed, to the sums of a pose."""
    H_shift, b_shift = sums.H_shift, sums.b_shift
    uu, uv, vv = slopes
    for i in range(6):
        along_u, along_v = uu * A_u[i] + uv * A_v[i], uv * A_u[i] + vv * A_v[i]
        sums.cross[b, i, 0] += along_u
        sums.cross[b, i, 1] += along_v
        sums.b[b, i] -= A_u[i] * pull[0] + A_v[i] * pull[1]
        for j in range(i, 6):
            sums.H[b, i, j] += along_u * A_u[j] + along_v * A_v[j]
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
    outline: OutlineCells,
    camera: LooksFrom,
    cuts: OutlineCuts,
    H: Array,
    b: Array,
) -> None:
    """Add the normal equations that draw what sticks out of a silhouette into it, for each pose.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        outline: where the image may show it.
        camera: as for `look_up`.
        cuts: what sticks out.
        H: (B, 6, 6), added to.
        b: (B, 6), added to.
    """
    _add_outline(told, flags, outline, camera, cuts, np.empty(6), H, b)


@compiled_in_place
def _add_outline(
    told: Array,
    flags: npt.NDArray[np.uint8],
    outline: OutlineCells,
    camera: LooksFrom,
    cuts: OutlineCuts,
    J: Array,
    H: Array,
    b: Array,
) -> None:
    """Do what `inward_normal` does; J (6,) is written over."""
    away, stride, R_WC = outline.away, outline.stride, camera.R_WC
    for pose in range(told.shape[0]):
        for k in range(told.shape[1]):
            row = told[pose, k]
            if not flags[pose, k] & COUNTED or row[DEEPER] <= cuts.behind:
                continue
            column = int(np.rint(row[U] / stride)) - outline.column
            line = int(np.rint(row[V] / stride)) - outline.row
            if column < 0 or line < 0 or column >= away.shape[1] or line >= away.shape[0] or away[line, column] <= 0.0:
                continue
            goal = outline.target[outline.nearest[line, column]]
            x = (goal[0] * stride - row[U]) * row[Z] / camera.fx
            y = (goal[1] * stride - row[V]) * row[Z] / camera.fy
            length = np.sqrt(x * x + y * y)
            beyond = length - cuts.rim * stride * row[Z] / camera.fx
            if beyond <= 0.0:
                continue
            x, y = x / length, y / length
            w = max(row[FACING], 0.0) * tukey_weight(beyond, cuts.farthest) / cuts.deviation**2
            way = (x * R_WC[0, 0] + y * R_WC[0, 1], x * R_WC[1, 0] + y * R_WC[1, 1], x * R_WC[2, 0] + y * R_WC[2, 1])
            screw_row(row, way[0], way[1], way[2], J)
            add_row(H[pose], J, w)
            for i in range(6):
                b[pose, i] += w * beyond * J[i]
        mirror(H[pose])
