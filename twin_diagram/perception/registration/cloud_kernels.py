"""Finds the nearest points of a cloud, and what image points say of a pose by them, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.residual_kernels import screw_row, tukey_weight
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place

Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.int64]


class PointGrid(NamedTuple):
    """A cloud sorted into the cells of a grid.

    Attributes:
        points: (M, 3) in the order of their cells.
        order: (M,) their numbers.
        starts: (nx, ny, nz + 1) where each cell begins in them.
        empty: (nx, ny, nz) how many shells about each cell hold none.
        corner: (3,) of the first cell.
        cell: its edge [m].
    """

    points: Array
    order: Index
    starts: Index
    empty: npt.NDArray[np.int16]
    corner: Array
    cell: float


class SurfaceCloud(NamedTuple):
    """Points (M, 3) of a surface in O, their normals (M, 3), and the grid that finds them."""

    points: Array
    normals: Array
    grid: PointGrid


class PairRules(NamedTuple):
    """How image points are paired with a model's.

    Attributes:
        share: weight of point-to-point beside point-to-plane.
        deviation: of a pair [m].
        spacing: of the model's points: what is nearer along the surface need not be pulled [m].
    """

    share: float
    deviation: float
    spacing: float


@compiled_in_place
def nearest_one(x: float, y: float, z: float, grid: PointGrid, reach: float, first: bool = False) -> tuple[float, int]:
    """Return the distance to the nearest point and its number; infinity and -1 where none is within `reach`.

    Cells are searched in growing shells about the point's own, from the first that holds any, until what is found is
    nearer than any shell to come; of a shell, cells that begin farther off are left out. Where any will do, it is the
    `first` that is met.
    """
    points, starts, corner, cell = grid.points, grid.starts, grid.corner, grid.cell
    shape = grid.empty.shape
    gx, gy, gz = (x - corner[0]) / cell, (y - corner[1]) / cell, (z - corner[2]) / cell
    i0, j0, k0 = int(np.floor(gx)), int(np.floor(gy)), int(np.floor(gz))
    # To the nearest wall of its own cell: what later shells are farther away than, with their whole cells.
    slack = min(min(gx - i0, i0 + 1 - gx), min(min(gy - j0, j0 + 1 - gy), min(gz - k0, k0 + 1 - gz))) * cell
    best, found = reach * reach, -1
    # In cells, and by a hair more than rounding is: no cell is left out that holds a nearer one.
    scale = (1.0 + 1e-9) / (cell * cell)
    most = best * scale
    inside = i0 >= 0 and j0 >= 0 and k0 >= 0 and i0 < shape[0] and j0 < shape[1] and k0 < shape[2]
    for ring in range(grid.empty[i0, j0, k0] if inside else 0, int(reach / cell) + 2):
        if ring > 0 and ((ring - 1) * cell + slack) ** 2 >= best:
            break
        for i in range(max(i0 - ring, 0), min(i0 + ring, shape[0] - 1) + 1):
            beside = _beyond(gx, i) ** 2
            if beside > most:
                continue
            for j in range(max(j0 - ring, 0), min(j0 + ring, shape[1] - 1) + 1):
                aside = beside + _beyond(gy, j) ** 2
                if aside > most:
                    continue
                step = 1 if abs(i - i0) == ring or abs(j - j0) == ring else max(2 * ring, 1)
                for k in range(k0 - ring, k0 + ring + 1, step):
                    if k < 0 or k >= shape[2] or aside + _beyond(gz, k) ** 2 > most:
                        continue
                    for m in range(starts[i, j, k], starts[i, j, k + 1]):
                        dx, dy, dz = points[m, 0] - x, points[m, 1] - y, points[m, 2] - z
                        squared = dx * dx + dy * dy + dz * dz
                        if squared < best:
                            best, found = squared, m
                            most = squared * scale
                            if first:
                                return np.sqrt(best), grid.order[found]
    if found < 0:
        return np.inf, -1
    return np.sqrt(best), grid.order[found]


@compiled_in_place
def _beyond(place: float, cell: int) -> float:
    """Return how far a cell begins from a place along an axis [cells]; 0 within it."""
    return max(max(cell - place, place - cell - 1.0), 0.0)


@compiled_in_place
def nearest(local: Array, grid: PointGrid, reach: float, distance: Array, index: Index) -> None:
    """Fill in the distance (N,) to the nearest point and its number (N,), as `nearest_one` does."""
    for k in range(local.shape[0]):
        distance[k], index[k] = nearest_one(local[k, 0], local[k, 1], local[k, 2], grid, reach)


@compiled
def within(
    points_W: Array, pose: tuple[Array, Array], grid: PointGrid, radius: float, reach: float, most: int
) -> Index:
    """Return the numbers of points (N, 3) in W within `reach` of a cloud that is within `radius` of its origin.

    Of points that are near enough to the origin about `most` are looked at, evenly; -1: all.

    Args:
        points_W: (N, 3).
        pose: R (3, 3), p (3,).
        grid: of the cloud.
        radius: see there [m].
        reach: see there [m].
        most: see there.
    """
    near = np.empty(points_W.shape[0], dtype=np.int64)
    count = _all_near(points_W, pose[1], (radius + reach) ** 2, near)
    step = 1 if most < 0 else max(1, count // most)
    return near[: _keep_within(points_W, pose, grid, reach, (step, count), np.empty(3), near)]


@compiled_in_place
def _all_near(points_W: Array, p: Array, squared: float, near: Index) -> int:
    """Write the numbers of points whose squared distance to p (3,) is less; return how many there are."""
    count = 0
    for k in range(points_W.shape[0]):
        x, y, z = points_W[k, 0] - p[0], points_W[k, 1] - p[1], points_W[k, 2] - p[2]
        near[count] = k
        count += x * x + y * y + z * z < squared
    return count


@compiled_in_place
def _keep_within(
    points_W: Array,
    pose: tuple[Array, Array],
    grid: PointGrid,
    reach: float,
    steps: tuple[int, int],
    local: Array,
    near: Index,
) -> int:
    """Move those that are kept to the front of `near`; return how many there are; local (3,) is written over."""
    kept = 0
    for k in range(0, steps[1], steps[0]):
        into(points_W[near[k]], pose[0], pose[1], local)
        if nearest_one(local[0], local[1], local[2], grid, reach, True)[1] >= 0:
            near[kept] = near[k]
            kept += 1
    return kept


@compiled_in_place
def into(point: Array, R: Array, p: Array, local: Array) -> None:
    """Write a point (3,) in W as one of the object at R, p."""
    x, y, z = point[0] - p[0], point[1] - p[1], point[2] - p[2]
    for i in range(3):
        local[i] = R[0, i] * x + R[1, i] * y + R[2, i] * z


@compiled
def mean_costs(
    points_W: Array,
    R: Array,
    p: Array,
    sigma: Array,
    cloud: SurfaceCloud,
    cuts: tuple[float, float, float, float],
) -> Array:
    """Return (B,) the mean cost of image points: how far they are from a model at each pose.

    Args:
        points_W: (N, 3).
        R: (B, 3, 3).
        p: (B, 3).
        sigma: (N,) deviation of depth [m].
        cloud: the model's.
        cuts: reach [m]; how far aside nothing is meant by it [m]; deviation of an edge [m]; the largest deviation.
    """
    result = np.zeros(R.shape[0])
    _add_costs(points_W, (R, p), sigma, cloud, cuts, np.empty(3), result)
    return result


@compiled_in_place
def _add_costs(
    points_W: Array,
    poses: tuple[Array, Array],
    sigma: Array,
    cloud: SurfaceCloud,
    cuts: tuple[float, float, float, float],
    local: Array,
    result: Array,
) -> None:
    """Add what `mean_costs` returns; local (3,) is written over."""
    R, p = poses
    reach, aside, edge, most = cuts
    points, normals = cloud.points, cloud.normals
    for b in range(R.shape[0]):
        for k in range(points_W.shape[0]):
            into(points_W[k], R[b], p[b], local)
            _, m = nearest_one(local[0], local[1], local[2], cloud.grid, reach)
            far = most
            if m >= 0:
                along, squared = 0.0, 0.0
                for i in range(3):
                    apart = local[i] - points[m, i]
                    along += apart * normals[m, i]
                    squared += apart * apart
                slide = np.sqrt(max(squared - along * along, 0.0))
                beyond = max(slide - aside, 0.0) / edge
                far = min(np.sqrt((along / sigma[k]) ** 2 + beyond * beyond), most)
            result[b] += 0.5 * far * far / points_W.shape[0]


@compiled
def opposite(
    points_W: Array,
    pose: tuple[Array, Array],
    p_WC: Array,
    cloud: SurfaceCloud,
    reach: float,
    rules: PairRules,
    pairs: tuple[Array, Array, Array],
    sums: tuple[Array, Array],
) -> None:
    """Pair image points with the nearest points of a model, and add their normal equations.

    Args:
        points_W: (N, 3).
        pose: R (3, 3), p (3,).
        p_WC: (3,) where the camera is.
        cloud: the model's.
        reach: pairs farther apart are none [m].
        rules: of the pairs.
        pairs: J (N, 6), w (N,), n (N, 3) in W, filled; w is -1 where there is no pair.
        sums: H (6, 6), b (6,), added to.
    """
    room = (np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3))
    _add_pairs(points_W, pose, p_WC, cloud, reach, rules, pairs, sums, room)


@compiled_in_place
def _add_pairs(
    points_W: Array,
    pose: tuple[Array, Array],
    p_WC: Array,
    cloud: SurfaceCloud,
    reach: float,
    rules: PairRules,
    pairs: tuple[Array, Array, Array],
    sums: tuple[Array, Array],
    room: tuple[Array, Array, Array, Array, Array],
) -> None:
    """Do what `opposite` does; `room`, five times (3,), is written over."""
    R, p = pose
    J, weight, normal_W = pairs
    points, normals = cloud.points, cloud.normals
    local, seen, r, n, pull = room
    into(p_WC, R, p, seen)
    for k in range(points_W.shape[0]):
        weight[k] = -1.0
        into(points_W[k], R, p, local)
        distance, m = nearest_one(local[0], local[1], local[2], cloud.grid, reach)
        if m < 0:
            continue
        front, along = 0.0, 0.0
        for i in range(3):
            front += normals[m, i] * (seen[i] - points[m, i])
            along += normals[m, i] * (local[i] - points[m, i])
        if front <= 0.0:
            continue
        for i in range(3):
            r[i] = R[i, 0] * points[m, 0] + R[i, 1] * points[m, 1] + R[i, 2] * points[m, 2]
            n[i] = R[i, 0] * normals[m, 0] + R[i, 1] * normals[m, 1] + R[i, 2] * normals[m, 2]
            pull[i] = points_W[k, i] - p[i] - r[i] - along * n[i]
            normal_W[k, i] = n[i]
        w = tukey_weight(distance, reach) / rules.deviation**2
        weight[k] = w
        _add_plane(r, n, along, w, J[k], sums)
        slide = np.sqrt(pull[0] ** 2 + pull[1] ** 2 + pull[2] ** 2)
        # Where there is nothing to pull, nothing must hold either.
        if slide > rules.spacing:
            _add_pull(r, pull, 1.0 - rules.spacing / slide, rules.share * w, sums)


@compiled_in_place
def _add_plane(r: Array, n: Array, along: float, w: float, J: Array, sums: tuple[Array, Array]) -> None:
    """Add the equations of one point-to-plane distance; write its Jacobian."""
    H, b = sums
    screw_row(r, -n[0], -n[1], -n[2], J)
    for i in range(6):
        b[i] -= w * along * J[i]
        for j in range(6):
            H[i, j] += w * J[i] * J[j]


@compiled_in_place
def _add_pull(r: Array, pull: Array, share: float, w: float, sums: tuple[Array, Array]) -> None:
    """Add the equations that move a point r by `share` of `pull`: a turn a and a shift s move it by a x r + s."""
    H, b = sums
    squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for column in range(3):
            H[i, column] -= w * r[i] * r[column]
        H[i, i] += w * squared
        H[i, 3 + j] -= w * r[k]
        H[i, 3 + k] += w * r[j]
        H[3 + j, i] -= w * r[k]
        H[3 + k, i] += w * r[j]
        H[3 + i, 3 + i] += w
        b[i] += w * share * (r[j] * pull[k] - r[k] * pull[j])
        b[3 + i] += w * share * pull[i]
