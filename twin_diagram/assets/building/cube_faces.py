"""A cube's edge from its faces: where each view shows each face, then all views together, with the edge's deviation.

Points of all views in one heap make a cube too large or too small: views that disagree smear its faces, and what is cut
off on one side only moves them. So each view tells where a face is by a window that lies even about it, views are
averaged by what they are known to, and width against width, height above the table and the outlines give the edge. The
height is each view's own, from the table that it shows beside the cube: no pose has a part in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.assets.building.cube_outline import outlined_edges
from twin_diagram.assets.building.cube_scale import Cube, is_green
from twin_diagram.assets.building.depth_view import DepthView, view_points
from twin_diagram.errors import FramesError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the fit."""

    inner: float = 0.4
    """Half the width of the inner part of a face, by which it is placed, as a share of the edge: rims are rounded."""

    window: tuple[float, ...] = (0.16, 0.12, 0.09, 0.07, 0.06, 0.05, 0.05, 0.05)
    """Half the window about a face in which its points are looked for, round by round, as a share of the edge."""

    cosine: float = 0.7
    """Least cosine between the normals of a point and of its face."""

    about: float = 2.0
    """Size of what is looked at, in edges: what is taller or wider than a cube is to be noticed."""

    least: int = 12
    """Fewer points of a view do not place a face."""

    beside: tuple[float, float] = (0.75, 2.0)
    """Where the table beside the cube is looked for, from the cube's axis, in edges."""

    independent: float = 40.0
    """How many points' errors are one and the same: depth noise is correlated over pixels."""

    bent: float = 0.0004
    """Standard deviation of where one view places a face that more points do not lower [m]: depth is bent."""

    apart: float = 0.0006
    """The same of what a view's height over the table is off by, seen beside itself [m], …"""

    aside: float = 0.0012
    """… and of what refined poses are off by sideways [m], where few views hold each other."""

    outlines: float = 0.003
    """Standard deviation of what outlines tell together, as a share: blur makes all of them larger or smaller."""

    unequal: float = 0.08
    """By how much width, depth and height may differ, as a share; more is no cube."""


TUNING = Tuning()
_FACES = ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0))
"""Axis and side of what is seen of a cube on a table."""


def fit_cube(views: Sequence[DepthView], first: Cube, plane: Array, where: str) -> Cube:
    """Return the cube that views show, in about metres.

    Args:
        views: with colours, whose surfaces agree as far as they do.
        first: about where it is.
        plane: (4,) on which it stands: n·p = d, n up.
        where: begins the message of an error.

    Raises:
        FramesError: width, depth and height differ too much for a cube.
    """
    green, table = _points(views, first, plane)
    cube = first
    sizes, weights = np.full(3, first.edge), np.ones(3)
    for window in TUNING.window:
        placed = _placed(green, cube, window)
        if not placed:
            break
        cube, sizes, weights = _improved(placed, table, cube, plane)
    _check(green, cube, sizes, weights, where)
    return _with_outlines(views, cube, float(weights.sum()), plane)


def _check(green: Sequence[tuple[Array, Array]], cube: Cube, sizes: Array, weights: Array, where: str) -> None:
    """Refuse what is green where its sizes (3,), 0 of weight where unknown [1/m²], differ, or it is taller or lower."""
    q, m = (np.concatenate([(one[k] - (0, cube.centre)[k == 0]) @ cube.axes.T for one in green]) for k in range(2))
    top = q[(m[:, 2] > TUNING.cosine) & (np.abs(q[:, :2]) < TUNING.inner * cube.edge).all(axis=1), 2]
    height = float(np.median(top)) + cube.edge / 2 if len(top) >= TUNING.least else cube.edge
    if abs(height / cube.edge - 1) > TUNING.unequal:
        raise FramesError(f"{where}: what is green is no cube: {cube.edge:.3g} across, {height:.3g} high")
    known = weights > 0
    if known.sum() < 2:
        return
    allowed = max(TUNING.unequal * sizes[known].mean(), 4 * float(np.sqrt((1 / weights[known]).sum())))
    if np.ptp(sizes[known]) > allowed:
        said = " by ".join(f"{size:.3g}" for size in sizes[known])
        raise FramesError(f"{where}: what is green is no cube: {said}")


def _with_outlines(views: Sequence[DepthView], cube: Cube, weight: float, plane: Array) -> Cube:
    """Return the cube with the edge that faces, whose edge has that weight [1/m²], and outlines tell together."""
    by_faces, edge = cube.edge, cube.edge
    for _ in range(3):
        edges, variances = outlined_edges(views, _as_large(cube, edge, plane))
        if not len(edges):
            return cube
        middle, variance = _mean(edges, variances)
        own = 1 / (variance + (TUNING.outlines * middle) ** 2)
        edge = (own * middle + weight * by_faces) / (own + weight)
    return _as_large(cube, edge, plane)


def _as_large(cube: Cube, edge: float, plane: Array) -> Cube:
    """Return a cube of that edge that stands on the plane where the other one does."""
    n = plane[:3]
    return replace(cube, edge=edge, centre=cube.centre + (plane[3] + edge / 2 - cube.centre @ n) * n)


@dataclass(frozen=True)
class _Place:
    """Where one view shows a face: how far out of the cube's as it is known [m], with its variance, and its turn.

    `turn` is the slope along the face's horizontal edge [rad], with its weight; 0 for the top.
    """

    view: int
    axis: int
    side: float
    out: float
    variance: float
    turn: float
    turn_weight: float


def _points(
    views: Sequence[DepthView], cube: Cube, plane: Array
) -> tuple[list[tuple[Array, Array]], list[tuple[float, float]]]:
    """Return each view's green points and normals (N, 3) at the cube, and its table's height there with its variance.

    The height is over the plane [m]; where a view shows no table beside the cube, it is 0 with the variance of a pose.
    """
    green, table = [], []
    for view in views:
        points, normals, at = view_points(view, 1, None)
        assert view.rgb is not None
        painted = is_green(view.rgb[at[:, 0], at[:, 1]] / 255.0)
        own = painted & cube.holds(points, TUNING.about)
        green.append((points[own], normals[own]))
        height = points @ plane[:3] - plane[3]
        across = np.abs((points - cube.centre) @ cube.axes[:2].T).max(axis=1) / cube.edge
        flat = (np.abs(height) < 0.1 * cube.edge) & (normals @ plane[:3] > 0.94) & ~painted
        beside = height[flat & (across > TUNING.beside[0]) & (across < TUNING.beside[1])]
        if len(beside) >= TUNING.least:
            table.append(_middle(beside))
        else:
            table.append((0.0, 4 * TUNING.apart**2))
    return green, table


def _middle(values: Array) -> tuple[float, float]:
    """Return the median and its variance [m, m²]."""
    middle = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    return middle, 1.57 * spread**2 * TUNING.independent / len(values) + TUNING.bent**2


def _placed(green: Sequence[tuple[Array, Array]], cube: Cube, window: float) -> list[_Place]:
    """Return where each view shows each face."""
    found = []
    for k, (points, normals) in enumerate(green):
        q, m = (points - cube.centre) @ cube.axes.T, normals @ cube.axes.T
        for axis, side in _FACES:
            out = side * q[:, axis] - cube.edge / 2
            others = np.delete(q, axis, axis=1)
            inner = (np.abs(others) < TUNING.inner * cube.edge).all(axis=1)
            chosen = inner & (side * m[:, axis] > TUNING.cosine) & (np.abs(out) < window * cube.edge)
            if np.count_nonzero(chosen) < TUNING.least:
                continue
            middle, variance = _middle(out[chosen])
            turn, weight = 0.0, 0.0
            if axis < 2:
                along = q[chosen, 1 - axis] - q[chosen, 1 - axis].mean()
                weight = float((along**2).sum())
                # A turn ω about the axis moves +x faces by −ω y, and +y faces by +ω x, in their own direction out.
                turn = float((along * out[chosen]).sum()) / max(weight, 1e-12) * side * (-1.0 if axis == 0 else 1.0)
            found.append(_Place(k, axis, side, middle, variance, turn, weight))
    return found


def _mean(values: Array, total: Array) -> tuple[float, float]:
    """Return a mean weighted by variances, without what stands far off, and its variance."""
    middle = float(np.median(values))
    for _ in range(5):
        w = 1 / total / (1 + (values - middle) ** 2 / (6.25 * total)) ** 2
        middle = float((w * values).sum() / w.sum())
    return middle, float(1 / w.sum())


def _improved(
    placed: Sequence[_Place], table: Sequence[tuple[float, float]], cube: Cube, plane: Array
) -> tuple[Cube, Array, Array]:
    """Return the cube after one step, its three sizes and their weights (3,), 0 where a size was not measured."""
    faces = {}
    for axis, side in _FACES:
        own = [one for one in placed if (one.axis, one.side) == (axis, side)]
        if own:
            off = [0.0 if axis < 2 else table[one.view][0] for one in own]
            more = [0.0 if axis < 2 else table[one.view][1] for one in own]
            values, variances = np.array([one.out for one in own]), np.array([one.variance for one in own])
            apart = TUNING.aside if axis < 2 else TUNING.apart
            faces[axis, side] = _mean(values - off, variances + more + apart**2)
    sizes, weights = np.full(3, cube.edge), np.zeros(3)
    for axis in range(2):
        if (axis, 1.0) in faces and (axis, -1.0) in faces:
            (a, va), (b, vb) = faces[axis, 1.0], faces[axis, -1.0]
            sizes[axis], weights[axis] = cube.edge + a + b, 1 / (va + vb)
    if (2, 1.0) in faces:
        sizes[2], weights[2] = cube.edge + faces[2, 1.0][0], 1 / faces[2, 1.0][1]
    edge = float((weights * sizes).sum() / weights.sum()) if weights.any() else cube.edge
    shift = np.zeros(2)
    for axis in range(2):
        at = [side * (cube.edge / 2 + faces[axis, side][0]) for side in (1.0, -1.0) if (axis, side) in faces]
        sides = [side for side in (1.0, -1.0) if (axis, side) in faces]
        if len(at) == 2:
            shift[axis] = sum(at) / 2
        elif at:
            shift[axis] = at[0] - sides[0] * edge / 2
    total = sum(one.turn_weight for one in placed)
    turn = sum(one.turn * one.turn_weight for one in placed) / total if total > 0 else 0.0
    c, s = np.cos(turn), np.sin(turn)
    u, v, n = cube.axes
    turned = replace(cube, centre=cube.centre + shift @ cube.axes[:2], axes=np.stack([c * u + s * v, c * v - s * u, n]))
    return _as_large(turned, edge, plane), sizes, weights
