"""The compiled part of `flow`: places on a thing are laid on the surface that an image shows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def meet(
    places: Array, normals: Array, points: Array, facing: Array, shift: Array, reach: float, least: float
) -> Array:
    """Return (S, 2) of places shifted by `shift` (3): how far along its normal the surface is [m], and whether it is.

    The surface there is the nearest of the image's points; it does not count farther than `reach` [m], nor where it
    faces another way.

    Args:
        places: (S, 3) [m].
        normals: (S, 3) theirs.
        points: (N, 3) the image's [m].
        facing: (N, 3) theirs.
        shift: (3,) [m].
        reach: [m].
        least: cosine between two normals that face alike.
    """
    result = np.zeros((len(places), 2))
    for s in range(len(places)):
        x, y, z = places[s, 0] + shift[0], places[s, 1] + shift[1], places[s, 2] + shift[2]
        best, nearest = reach * reach, -1
        for k in range(len(points)):
            off = (points[k, 0] - x) ** 2
            if off >= best:
                continue
            off += (points[k, 1] - y) ** 2 + (points[k, 2] - z) ** 2
            if off < best:
                best, nearest = off, k
        if nearest < 0:
            continue
        a, b, c = normals[s, 0], normals[s, 1], normals[s, 2]
        if a * facing[nearest, 0] + b * facing[nearest, 1] + c * facing[nearest, 2] < least:
            continue
        result[s, 0] = a * (points[nearest, 0] - x) + b * (points[nearest, 1] - y) + c * (points[nearest, 2] - z)
        result[s, 1] = 1.0
    return result


@compiled
def laid(
    places: Array, normals: Array, points: Array, facing: Array, start: Array, reaches: Array, alike: float,
    noise: float, slant: float, tukey: float, still: float, fewest: int,
) -> tuple[float, Array, Array]:  # fmt: skip
    """Return what is left where places are laid on points, the shift (3) that does so, and its information (3, 3).

    Left is the sum of squares in the last round's reach, where what meets nothing counts as one; infinite where too
    few places meet anything.

    Args:
        places: (S, 3) [m].
        normals: (S, 3) theirs.
        points: (N, 3) the image's [m].
        facing: (N, 3) theirs.
        start: (3,) the shift that is begun with [m].
        reaches: (K,) how far a place's surface may be, round after round [m].
        alike: cosine between two normals that face alike.
        noise: standard deviation of how far apart two images show a place [m].
        slant: of a slide this share shows as a shift.
        tukey: residuals count down to nothing at so many standard deviations.
        still: information on the turn, that it is none [1/rad²].
        fewest: so many places must meet something.
    """
    count = len(places)
    lever = places.copy()
    for k in range(3):
        lever[:, k] -= places[:, k].mean()
    turn, shift = np.zeros(3), start.copy()
    share, left = np.zeros((6, 6)), 0.0
    for reach in reaches:
        n = turned(normals, normals, turn)
        met = meet(turned(places, lever, turn), n, points, facing, shift, reach, alike)
        there = met[:, 1] > 0.0
        off = met[:, 0][there]
        if len(off) < fewest:
            return np.inf, shift, share[3:, 3:].copy()
        left = float(((off / reach) ** 2).sum()) + count - len(off)
        least = np.hypot(noise, slant * np.sqrt((shift**2).sum()))
        scale = max(least, 1.4826 * np.median(np.abs(off - np.median(off))))
        weights = np.maximum(0.0, 1.0 - (off / max(tukey * scale, reach)) ** 2) ** 2 / scale**2
        share, right = sums(lever[there], n[there], off, weights)
        whole = share.copy()
        for k in range(3):
            whole[k, k] += still
            right[k] -= still * turn[k]
        values, vectors = np.linalg.eigh(whole)
        for k in range(6):
            if values[k] > 1e-6 * values[5]:  # none along what nothing is told of
                along = (vectors[:, k] * right).sum() / values[k]
                turn += along * vectors[:3, k]
                shift += along * vectors[3:, k]
    return left, shift, without_turn(share, still)


@compiled
def turned(places: Array, lever: Array, turn: Array) -> Array:
    """Return places (S, 3) turned a little, by turn (3,) [rad], about where lever (S, 3) begins."""
    result = places.copy()
    for s in range(len(places)):
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            result[s, k] += turn[i] * lever[s, j] - turn[j] * lever[s, i]
    return result


@compiled
def sums(lever: Array, normals: Array, off: Array, weights: Array) -> tuple[Array, Array]:
    """Return both sides, (6, 6) and (6,), of the equations for a turn, then a shift, that take places to a surface.

    Args:
        lever: (S, 3) from what they turn about [m].
        normals: (S, 3)
        off: (S,) how far the surface is along these [m].
        weights: (S,)
    """
    share, right, row = np.zeros((6, 6)), np.zeros(6), np.empty(6)
    for s in range(len(off)):
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            row[k] = lever[s, i] * normals[s, j] - lever[s, j] * normals[s, i]
            row[3 + k] = normals[s, k]
        for i in range(6):
            right[i] += weights[s] * row[i] * off[s]
            for j in range(6):
                share[i, j] += weights[s] * row[i] * row[j]
    return share, right


@compiled
def without_turn(share: Array, still: float) -> Array:
    """Return what (3, 3) is known of a shift where of turn and shift (6, 6) is, and of the turn so much, that it is 0.

    Args:
        share: information on the turn, then on the shift.
        still: more on the turn [1/rad²].
    """
    known = share.copy()
    for k in range(3):
        known[k, k] += still
    for k in range(3):  # eliminated one after another, which leaves Schur's complement
        for i in range(k + 1, 6):
            part = known[i, k] / known[k, k]
            for j in range(k + 1, 6):
                known[i, j] -= part * known[k, j]
    return 0.5 * (known[3:, 3:] + known[3:, 3:].T)


@compiled
def on_one_face(
    own: npt.NDArray[np.int64],
    cells: npt.NDArray[np.int64],
    normals: Array,
    width: int,
    size: int,
    r: int,
    least: float,
) -> npt.NDArray[np.bool_]:
    """Return (K,) which of a thing's points have neighbours, all of them its own, that face as they do.

    Args:
        own: (K,) which of the image's points they are.
        cells: (K,) of the grid they are in, row by row.
        normals: (N, 3) of all points.
        width: of the grid.
        size: how many cells it has.
        r: neighbours are so many cells off, on all four sides.
        least: cosine between two normals that face alike.
    """
    whose = np.full(size, -1)
    for k in range(len(own)):
        whose[cells[k]] = own[k]
    flat = np.ones(len(own), dtype=np.bool_)
    for k in range(len(own)):
        row, column = cells[k] // width, cells[k] % width
        for side in range(4):
            there, beside = row + (0, 0, -r, r)[side], column + (-r, r, 0, 0)[side]
            other = -1
            if 0 <= there < size // width and 0 <= beside < width:
                other = whose[there * width + beside]
            if other < 0:
                flat[k] = False
                break
            dot = 0.0
            for i in range(3):
                dot += normals[own[k], i] * normals[other, i]
            if dot <= least:
                flat[k] = False
                break
    return flat


@compiled
def cut_off(
    cells: npt.NDArray[np.int64],
    mine: npt.NDArray[np.bool_],
    labels: npt.NDArray[np.int16],
    robot: int,
    depth: npt.NDArray[np.float32],
    slack: Array,
    r: int,
) -> int:
    """Return how many of an edge's points are cut off by the image's border, what is nearer, or a robot before them.

    Args:
        cells: (K,) of the grid that the points are in, row by row.
        mine: (h · w,) which cells are the thing's own.
        labels: (h, w) what each cell shows: from 0 points of objects.
        robot: the robot's label.
        depth: (h, w) of the grid [m].
        slack: (K,) a surface within this along the line of sight is neither nearer nor farther [m].
        r: looked at is what is no more cells off.
    """
    height, width = labels.shape
    count = 0
    for k in range(len(cells)):
        row, column = cells[k] // width, cells[k] % width
        cut = row < r or row >= height - r or column < r or column >= width - r
        if not cut:
            here = float(depth[row, column])
            for i in range(row - r, row + r + 1):
                for j in range(column - r, column + r + 1):
                    farther = float(depth[i, j]) - here
                    other = labels[i, j] >= 0 and not mine[i * width + j] and farther < -slack[k]
                    cut = cut or other or (labels[i, j] == robot and farther < slack[k])
                if cut:
                    break
        count += cut
    return count
