"""Sets down what the hand holds, standing as it stood when it was taken: on the platform, or in the other bin."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from twin_diagram.runs.learning.cell import Cell
from twin_diagram.runs.learning.easing import release
from twin_diagram.runs.learning.motion import TUNING as MOTION
from twin_diagram.runs.learning.motion import Mover, NoWay, cloud_cells, pose
from twin_diagram.runs.learning.picking import go
from twin_diagram.runs.learning.steadiness import STEADY, levelled, steadiness
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    above: tuple[float, ...] = (0.10, 0.20)
    """Heights from which it goes straight down [m]: what is held low is brought over a bin's walls first."""

    grazing: float = -0.003
    """Clearance of the hand's balls on that line and back [m]: tips that held something low stand 2 mm deep in a bin's
    bottom, for their balls stand out by 13 mm. With -8 mm the hand met a wall."""

    beside: float = 0.004
    """The same down to some 8 mm over where it ends [m]: as far from walls as the arm sags and lags. With -3 mm a
    finger of a hand that held something low met one."""

    gaps: tuple[float, ...] = (0.003, 0.009)
    """Left under the object where the fingers open [m]: what poses and sag are off; more where tips held it so low that
    they would stand on what it is set upon. A ring of 35 mm was shown in one grasp for that."""

    turns: int = 12
    """Turns about the vertical that are tried: every 30°."""

    retreats: tuple[float, ...] = (0.10, 0.15, 0.20, 0.06)
    """Back along the approach, or up, after the fingers are open [m]: the first that leads away from everything. After
    10 cm tips that let go of something low beside a wall are no higher than it."""

    spot: float = 0.02
    """Between places in the bin that are tried [m]."""

    room: float = 0.01
    """Between what is set down beside one another [m]."""

    wide: float = 0.08
    """More than this between them is no better [m]: the hand has room beside what is taller."""

    hand: float = 0.03
    """Off the walls there is room for the hand [m]."""

    cell: float = 0.01
    """Edge of the squares in which a bin's bottom is looked at [m]."""

    places: int = 150
    """In a bin that are tried: 50 ms each. Beside tall things the hand finds no room at most of those on the floor."""

    apart: float = 0.03
    """Between places that are tried at the same turn [m]."""

    one_side: float = 0.97
    """Cosine of normals from which faces of a hull are one side: 14°."""

    leaning: float = 0.25
    """An object whose nearest side is so far from level does not stand on it [rad]: as far as normals of one side are
    apart."""

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
    """Something that was set down.

    Attributes:
        place: (2,) its middle in W [m].
        radius: of the circle about it [m].
        top: height of its highest point [m].
        cells: (x, y) of points all over what is below it [m]; none: all of the circle is.
    """

    place: tuple[float, float]
    radius: float
    top: float
    cells: tuple[tuple[float, float], ...] = ()

    @staticmethod
    def standing(points_T: Array, R_WT: Array, place: Array) -> PutDown:
        """Return it of what was set down.

        Args:
            points_T: (N, 3) of it in the tool's frame [m].
            R_WT: (3, 3) the tool's axes in which it stands, but for the turn about the vertical.
            place: (4,) where, of `places_in`.
        """
        under = footprint(points_T, turned(R_WT, float(place[3]))) + place[:2]
        radius = 0.5 * float(np.hypot(*np.ptp(under, axis=0)))
        top = float(place[2] + np.ptp(points_T @ R_WT[2]))
        return PutDown((float(place[0]), float(place[1])), radius, top, tuple((float(x), float(y)) for x, y in under))

    def numbers(self) -> list[float]:
        """Return it as a row, for a file."""
        return [*self.place, self.radius, self.top, *(value for cell in self.cells for value in cell)]

    @staticmethod
    def of_numbers(row: Sequence[float]) -> PutDown:
        """Return the inverse of `numbers`."""
        return PutDown((row[0], row[1]), row[2], row[3], tuple(zip(row[4::2], row[5::2], strict=True)))


def footprint(points_T: Array, R_WT: Array) -> Array:
    """Return (x, y) of cells (N, 2) below what is held, about the middle of the box about it [m].

    Args:
        points_T: (N, 3) of it in the tool's frame [m].
        R_WT: (3, 3) the tool's axes.
    """
    flat = (points_T @ R_WT.T)[:, :2]
    flat = flat - 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    cells = np.unique(np.round(flat / TUNING.cell).astype(np.int64), axis=0)
    span = int(np.abs(cells).max(initial=0)) + 1
    full = np.zeros((2 * span + 1, 2 * span + 1), dtype=bool)
    full[tuple((cells + span).T)] = True
    # What lies in between was not seen, or is hollow: nothing else goes there.
    full = ndimage.binary_fill_holes(ndimage.binary_closing(np.pad(full, 3), iterations=3))
    return np.asarray((np.argwhere(full) - span - 3) * TUNING.cell)


def outline(one: PutDown) -> Array:
    """Return points (N, 3) at the top of something that was set down, all over what is below it [m]."""
    if one.cells:
        return np.array([[x, y, one.top] for x, y in one.cells])
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

    What leant on others as it stood is levelled. By more than sides are alike, it has turned in the hand, or lay on
    something: it comes last.

    Args:
        points_T: (N, 3) of the object in the tool's frame [m].
        R_WT: (3, 3) in which it stood.
    """
    sides = hull_sides(points_T)
    found = [R for R in (downwards(R_WT, normal) for normal in sides) if -R[2, 2] > TUNING.steepest]
    lean = [float(np.arccos(np.clip(-(R_WT @ normal)[2], -1.0, 1.0))) for normal in sides]
    down = R_WT.T @ [0.0, 0.0, -1.0]
    if steadiness(points_T, down) < STEADY and (level := levelled(points_T, down)) is not None:
        return [downwards(R_WT, level), *found, R_WT]
    if min(lean, default=0.0) <= TUNING.leaning:
        return [R_WT, *found]
    turned_by = [float(np.arccos(np.clip((np.trace(R_WT.T @ R) - 1.0) / 2.0, -1.0, 1.0))) for R in found]
    return [*(found[k] for k in np.argsort(turned_by)), R_WT]


def hull_sides(points: Array) -> list[Array]:
    """Return the outward normals (3,) of sides on which points (N, 3) can stand, the largest first.

    They are those of their hull; its middle is over each of them.
    """
    sides: list[tuple[Array, float]] = []
    with contextlib.suppress(QhullError, ValueError):
        hull = ConvexHull(points)
        corners = points[hull.simplices]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        for k in np.argsort(-areas):
            normal = hull.equations[k, :3]
            if all(float(normal @ other) < TUNING.one_side for other, _ in sides):
                alike = hull.equations[:, :3] @ normal > TUNING.one_side
                sides.append((normal, float(areas[alike].sum())))
    largest = sorted(sides, key=lambda side: -side[1])[: TUNING.sides]
    return [normal for normal, area in largest if area > TUNING.least_side]


def downwards(R_WT: Array, normal_T: Array) -> Array:
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
        places: (3,) each: x, y and the support's height [m]; (4,): and the one turn about the vertical that may be.
        yaws: turns about the vertical that may be [rad]; None: any.

    Returns:
        X_WT (4, 4) of the tool when the fingers opened, and the place.

    Raises:
        NoWay: none is reached.
    """
    every = np.arange(TUNING.turns) * (2.0 * np.pi / TUNING.turns) if yaws is None else np.asarray(yaws)
    last = NoWay("no place to set it down is reached")
    for place in places:
        for yaw in every if len(place) == 3 else place[3:]:
            X = pose_over(points_T, turned(R_WT, float(yaw)), place[:2], float(place[2]))
            for q_above in _over(mover, X, cell.commanded):
                try:
                    line = line_down(mover, q_above, X)
                    with mover.as_if(points_T @ X[:3, :3].T + X[:3, 3], float(place[2])):
                        back = way_back(mover, line[-1])
                    way = mover.path(cell.commanded, line[:1])
                except NoWay as why:
                    last = why
                    continue
                go(cell, mover.timed(way))
                return release(mover, cell, line, back), place
    raise last


def line_down(mover: Mover, q: Array, X_WT: Array) -> Array:
    """Return the line (W, n) straight down to where the fingers open, by a gap above a pose (4, 4).

    The hand keeps clear on it; at its last point the tips may be at what the object is set upon.

    Raises:
        NoWay: something is in the way, or no such line.
    """
    for gap in TUNING.gaps:
        line = mover.line(q, X_WT + np.outer([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, gap]))
        beside = mover.bare_free(line[:-1], TUNING.beside, standing=True)
        if beside and mover.bare_free(line[-1:], TUNING.grazing, standing=True):
            return line
    raise NoWay("something is in the way of setting it down")


def _over(mover: Mover, X_WT: Array, q: Array) -> Array:
    """Return joint angles (G, n) over where something is set down (4, 4), from the lowest height that is free."""
    goals = np.zeros((0, len(q)))
    for height in TUNING.above:
        above = X_WT.copy()
        above[2, 3] += height
        goals = mover.goals(above, q)[:2]
        if len(goals):
            break
    return np.asarray(goals)


def way_back(mover: Mover, q: Array) -> Array:
    """Return the line (W, n) from joint angles (n,) away from what was set down: along the approach, or upwards.

    It ends where there is room to go on from, beside what stands there too, if any does.

    Raises:
        NoWay: each is barred.
    """
    X, spare = mover.tool(q), None
    for direction in (-X[:3, 2], np.array([0.0, 0.0, 1.0])):
        for back in TUNING.retreats:
            away = X.copy()
            away[:3, 3] += back * direction
            with contextlib.suppress(NoWay):
                line = mover.line(q, away)
                if not mover.bare_free(line, TUNING.grazing):
                    continue
                if mover.bare_free(line[-1:], MOTION.clearance, standing=True):
                    return line
                spare = line if spare is None else spare
    if spare is None:
        raise NoWay("no way back from where it would be set down")
    return spare


def places_in(low: Array, high: Array, standing: Sequence[PutDown], points_T: Array, R_WT: Array) -> list[Array]:
    """Return places (4,) in a bin for what is held, the best first: x, y, height of the support [m], turn [rad].

    Beside others before upon them, there where what it stands on is even; far from the middle, to leave room for more.

    Args:
        low: (3,) lowest corner of the bin's inside [m].
        high: (3,) its highest.
        standing: what was set down there.
        points_T: (N, 3) of what is held in the tool's frame [m].
        R_WT: (3, 3) the tool's axes in which it stands, but for the turn about the vertical.
    """
    held, edge = cloud_cells(points_T, TUNING.cell), int(np.ceil(TUNING.room / TUNING.cell))
    count = np.floor((high - low)[:2] / TUNING.cell).astype(np.int64) + 1
    height = np.full(count, low[2])
    for one in standing:
        at = np.round((outline(one)[:, :2] - low[:2]) / TUNING.cell).astype(np.int64)
        at = at[((at >= 0) & (at < count)).all(axis=1)]
        height[tuple(at.T)] = np.maximum(height[tuple(at.T)], one.top)
    far = TUNING.cell * ndimage.distance_transform_edt(height <= low[2]) if standing else np.full(count, TUNING.wide)
    height = ndimage.maximum_filter(height, 2 * edge + 1)
    middle = 0.5 * (low + high)[:2]
    ranked: list[tuple[float, int, Array]] = []
    for k in range(TUNING.turns):
        yaw = k * (2.0 * np.pi / TUNING.turns)
        cells = np.round(footprint(held, turned(R_WT, yaw)) / TUNING.cell).astype(np.int64)
        span = np.abs(cells).max(axis=0)
        mask = np.zeros(2 * span + 1, dtype=bool)
        mask[tuple((cells + span).T)] = True
        support = ndimage.maximum_filter(height, footprint=mask, mode="constant", cval=np.inf)
        room = np.minimum(ndimage.minimum_filter(far, footprint=mask), TUNING.wide)
        hollow = support - ndimage.minimum_filter(height, footprint=mask)
        inside = np.isfinite(support)
        wall = TUNING.cell * ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1]
        at = np.argwhere(inside)
        places = np.column_stack([low[:2] + TUNING.cell * at, support[inside], np.full(len(at), yaw)])
        cost = 10.0 * (support - low[2] + hollow)[inside] - (room + np.minimum(wall, TUNING.hand))[inside]
        cost -= 0.05 * np.linalg.norm(places[:, :2] - middle, axis=1)
        order = np.argsort(cost, kind="stable")
        # Which turns the arm reaches nobody knows: each has its best places tried, in turn.
        few = spread_out(places[order])
        level = {tuple(place): float(c) for place, c in zip(places[order], cost[order], strict=True)}
        ranked += [(round(level[tuple(place)]), rank, place) for rank, place in enumerate(few)]
    return [place for _, _, place in sorted(ranked, key=lambda entry: entry[:2])][: TUNING.places]


def spread_out(places: Sequence[Array] | Array) -> list[Array]:
    """Return the first few of places (4,) that are not nearly another one at the same turn: one tells of both."""
    kept: list[Array] = []
    for place in places:
        off = [float(np.hypot(*(place - other)[:2])) for other in kept if other[3] == place[3]]
        if min(off, default=np.inf) >= TUNING.apart - 1e-9:
            kept.append(place)
        if len(kept) == TUNING.places // TUNING.turns:
            break
    return kept
