"""Sets down what the hand holds, standing as it stood when it was taken: on the platform, or in the other bin."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from twin_diagram.runs.learning.cell import RELEASE, Cell
from twin_diagram.runs.learning.motion import Mover, NoWay, cloud_cells, pose
from twin_diagram.runs.learning.picking import go
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    above: float = 0.10
    """Height from which it goes straight down [m]."""

    gap: float = 0.003
    """Left under the object where the fingers open [m]: what poses and sag are off."""

    turns: int = 12
    """Turns about the vertical that are tried: every 30°."""

    speed: float = 0.08
    """Of the way down [m/s]."""

    retreat: float = 0.10
    """Back along the approach after the fingers are open [m]."""

    spot: float = 0.02
    """Between places in the bin that are tried [m]."""

    room: float = 0.01
    """Between what is set down beside one another [m]."""

    one_side: float = 0.97
    """Cosine of normals from which faces of a hull are one side: 14°."""

    sides: int = 8
    """Of a hull, on which it is tried."""

    least_side: float = 2e-4
    """Area on which something stands [m²]: 14 mm square."""

    steepest: float = 0.5
    """Least share of the tool's axis that points down while it is set down on another side."""

    tall: float = 0.05
    """By how much things set down may stand above where the palm comes down beside them [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class PutDown:
    """Something that was set down: its middle (2,), radius and top in W [m]."""

    place: tuple[float, float]
    radius: float
    top: float


def outline(one: PutDown) -> Array:
    """Return points (N, 3) at the top of something that was set down, all over the circle that holds it [m]."""
    across = np.arange(-one.radius, one.radius + 1e-9, TUNING.spot)
    x, y = (grid.ravel() for grid in np.meshgrid(across, across))
    inside = np.hypot(x, y) <= one.radius
    return np.column_stack([one.place[0] + x[inside], one.place[1] + y[inside], np.full(inside.sum(), one.top)])


def turned(R_WT: Array, yaw: float) -> Array:
    """Return the axes (3, 3) of a tool turned about the vertical [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R_WT)


def pose_over(points_T: Array, R_WT: Array, place: Array, height: float) -> Array:
    """Return the tool's pose (4, 4) at which what it holds stands with its middle over a place.

    Args:
        points_T: (N, 3) of the object in the tool's frame [m].
        R_WT: (3, 3) the tool's axes.
        place: (2,) x and y of the middle of the box about it [m].
        height: of its lowest point [m].
    """
    rows = points_T @ R_WT.T
    low, high = rows.min(axis=0), rows.max(axis=0)
    middle = 0.5 * (low[:2] + high[:2])
    return pose(R_WT, np.array([place[0] - middle[0], place[1] - middle[1], height - low[2]]))


def resting(points_T: Array, R_WT: Array) -> list[Array]:
    """Return axes (3, 3) of the tool in which what it holds stands, the surest first: as it stood, then on other sides.

    The sides are those of the hull of what was seen of it, by their area; its middle is over each of them.

    Args:
        points_T: (N, 3) of the object in the tool's frame [m].
        R_WT: (3, 3) in which it stood.
    """
    found = [R_WT]
    with contextlib.suppress(QhullError, ValueError):
        hull = ConvexHull(points_T)
        sides: list[tuple[Array, float]] = []
        corners = points_T[hull.simplices]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        for k in np.argsort(-areas):
            normal = hull.equations[k, :3]
            if all(float(normal @ other) < TUNING.one_side for other, _ in sides):
                alike = hull.equations[:, :3] @ normal > TUNING.one_side
                sides.append((normal, float(areas[alike].sum())))
        for normal, area in sorted(sides, key=lambda side: -side[1])[: TUNING.sides]:
            R = _downwards(R_WT, normal)
            if area > TUNING.least_side and -R[2, 2] > TUNING.steepest:
                found.append(R)
    return found


def _downwards(R_WT: Array, normal_T: Array) -> Array:
    """Return the tool's axes (3, 3) nearest to some in which a direction (3,) of its frame points down."""
    now = R_WT @ normal_T
    turn, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [now])
    return np.asarray(turn.as_matrix() @ R_WT)


def set_down(
    mover: Mover, cell: Cell, points_T: Array, R_WT: Array, places: Sequence[Array], yaws: Sequence[float] | None = None
) -> tuple[Array, Array]:
    """Set down what is held at the first of some places that the arm reaches, and go back.

    Args:
        mover: knows what is held.
        cell: whose arm holds it.
        points_T: (N, 3) of it in the tool's frame [m].
        R_WT: (3, 3) the tool's axes in which it stood; turns about the vertical are free.
        places: (3,) each: x, y and the support's height [m].
        yaws: turns about the vertical that may be [rad]; None: any.

    Returns:
        X_WT (4, 4) of the tool when the fingers opened, and the place.

    Raises:
        NoWay: none is reached.
    """
    every = np.arange(TUNING.turns) * (2.0 * np.pi / TUNING.turns) if yaws is None else np.asarray(yaws)
    last = NoWay("no place to set it down is reached")
    for place in places:
        for yaw in every:
            X = pose_over(points_T, turned(R_WT, float(yaw)), place[:2], float(place[2]) + TUNING.gap)
            above = X.copy()
            above[2, 3] += TUNING.above
            for q_above in mover.goals(above, cell.commanded)[:2]:
                try:
                    line = mover.line(q_above, X)
                    if not mover.bare_free(line, 0.0, standing=True):
                        raise NoWay("something is in the way of setting it down")
                    back = way_back(mover, line[-1])
                    way = mover.path(cell.commanded, line[:1])
                except NoWay as why:
                    last = why
                    continue
                go(cell, mover.timed(way))
                return release(mover, cell, line, back), place
    raise last


def release(mover: Mover, cell: Cell, line: Array, back: Array) -> Array:
    """Go down a line (W, n), open the fingers and go back along another; return X_WT (4, 4) when they opened."""
    with cell.about(RELEASE, mover.tool(line[-1])[:3, 3]):
        go(cell, mover.timed_line(line, TUNING.speed))
        cell.wait(0.2)
        X_WT = mover.tool(cell.q)
        cell.grip(1.0)
        mover.hold(None)
        go(cell, mover.timed_line(back, 2.0 * TUNING.speed))
    return X_WT


def way_back(mover: Mover, q: Array) -> Array:
    """Return the line (W, n) from joint angles (n,) away from what was set down: along the approach, or upwards.

    Raises:
        NoWay: each is barred.
    """
    X = mover.tool(q)
    for direction in (-X[:3, 2], np.array([0.0, 0.0, 1.0])):
        for back in (TUNING.retreat, 0.6 * TUNING.retreat):
            away = X.copy()
            away[:3, 3] += back * direction
            with contextlib.suppress(NoWay):
                line = mover.line(q, away)
                if mover.bare_free(line, 0.0):
                    return line
    raise NoWay("no way back from where it would be set down")


def places_in(low: Array, high: Array, standing: Sequence[PutDown], points_T: Array, R_WT: Array) -> list[Array]:
    """Return places (3,) in a bin for what is held, the best first: beside others before upon them.

    Args:
        low: (3,) lowest corner of the bin's inside [m].
        high: (3,) its highest.
        standing: what was set down there.
        points_T: (N, 3) of what is held in the tool's frame [m].
        R_WT: (3, 3) the tool's axes in which it stands.
    """
    extent = np.ptp(cloud_cells(points_T @ R_WT.T, 0.01), axis=0)
    radius = 0.5 * float(np.hypot(extent[0], extent[1]))
    inner = min(radius, 0.45 * float(min(high[0] - low[0], high[1] - low[1])))
    xs = np.arange(low[0] + inner, high[0] - inner + 1e-9, TUNING.spot)
    ys = np.arange(low[1] + inner, high[1] - inner + 1e-9, TUNING.spot)
    found: list[tuple[float, Array]] = []
    for x in xs:
        for y in ys:
            support = low[2]
            room = 1.0
            for one in standing:
                apart = float(np.hypot(x - one.place[0], y - one.place[1])) - one.radius - radius
                room = min(room, apart)
                if apart < TUNING.room:
                    support = max(support, one.top)
            middle = float(np.hypot(x - 0.5 * (low[0] + high[0]), y - 0.5 * (low[1] + high[1])))
            found.append((10.0 * (support - low[2]) - 0.2 * min(room, 0.1) + 0.05 * middle, np.array([x, y, support])))
    found.sort(key=lambda entry: entry[0])
    return [place for _, place in found[:12]]
