"""Metric scale from a cube of known edge, as SyncTwin's appendix B.

Found by its green, measured on its upright faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from twin_diagram.errors import FramesError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the search."""

    hue: tuple[float, float] = (80.0, 165.0)
    """Hues that are green [deg]."""

    saturation: float = 0.4
    """Least saturation: paler things are not painted green."""

    value: float = 0.12
    """Least brightness: darker pixels have no hue."""

    least_points: int = 200
    """Fewer points do not measure a cube."""

    looked_at: int = 3000
    """Points by which green things are told apart."""

    gap: float = 3.0
    """Gap between two things, in distances of neighbours in one."""

    sheet: float = 0.02
    """What is green is mostly the support if half of it lies within this share of its extent of the plane: of a cube
    that is half its height."""

    on: float = 15.0
    """Then what is no farther from the plane than this times the quarter that is nearest to it is the support's: five
    standard deviations. In no unit, as the scene has none yet."""

    unequal: float = 0.08
    """By how much its edges may differ, as a share; more is no cube, …"""

    roughly: float = 0.4
    """… but of views that do not agree yet, whose faces are smeared."""


TUNING = Tuning()


@dataclass(frozen=True)
class Cube:
    """What was measured: mean `edge` in the cloud's unit, `centre` (3,), `axes` (3, 3) rows, the last one up."""

    edge: float
    centre: Array
    axes: Array

    def holds(self, points: Array, growth: float = 1.25) -> npt.NDArray[np.bool_]:
        """Return (N,), which points lie in the cube grown by that factor."""
        return np.asarray((np.abs((points - self.centre) @ self.axes.T) <= growth * self.edge / 2).all(axis=1))


def is_green(rgb: Array) -> npt.NDArray[np.bool_]:
    """Return (…,), where colours (…, 3) in [0, 1] are green by hue, saturation and brightness."""
    if not rgb.size:  # of a view without depth, which OpenCV would not take
        return np.zeros(rgb.shape[:-1], dtype=bool)
    flat = np.ascontiguousarray(rgb.reshape(-1, 1, 3), dtype=np.float32)
    hue, saturation, value = np.moveaxis(cv2.cvtColor(flat, cv2.COLOR_RGB2HSV).reshape(*rgb.shape), -1, 0)
    low, high = TUNING.hue
    return np.asarray((hue > low) & (hue < high) & (saturation > TUNING.saturation) & (value > TUNING.value))


def measure_cube(points: Array, colours: Array, plane: Array, where: str) -> Cube:
    """Return the green cube that stands on a plane; other green things may be there, too.

    Args:
        points: (N, 3) of the scene, in any unit.
        colours: (N, 3) RGB in [0, 1].
        plane: (4,) on which it stands: n·p = d, n up.
        where: begins the message of an error.

    Raises:
        FramesError: there is no green cube.
    """
    return _cubes(points, colours, plane, where, TUNING.unequal)[0]


def rough_cubes(points: Array, colours: Array, plane: Array, where: str) -> list[Cube]:
    """Return what may be the green cube, as far as views tell that do not agree yet; the largest thing first.

    Args and errors as of `measure_cube`.
    """
    return _cubes(points, colours, plane, where, TUNING.roughly)


def _cubes(points: Array, colours: Array, plane: Array, where: str, unequal: float) -> list[Cube]:
    """Return all green things that are cubes, their edges different by no more than a share."""
    green = points[is_green(colours)]
    green = green[~_of_green_support(green, plane)]
    if len(green) < TUNING.least_points:
        raise FramesError(
            f"{where}: no green cube: {len(green)} green points, {TUNING.least_points} are needed for --cube-edge"
        )
    wrong: FramesError | None = None
    found = []
    for thing in _things(green):
        try:
            found.append(_measured(thing, plane, where, unequal))
        except FramesError as error:
            wrong = wrong or error
    if not found:
        raise wrong or FramesError(f"{where}: no green cube: what is green is scattered")
    return found


def _of_green_support(green: Array, plane: Array) -> npt.NDArray[np.bool_]:
    """Return (N,), which green points (N, 3) are the support's own; none, where it is not most of what is green."""
    if not len(green):
        return np.zeros(0, dtype=bool)
    height = np.abs(green @ plane[:3] - plane[3])
    if np.median(height) > TUNING.sheet * float(np.ptp(green, axis=0).max()):
        return np.zeros(len(green), dtype=bool)
    return np.asarray(height < TUNING.on * float(np.quantile(height, 0.25)))


def _things(points: Array) -> list[Array]:
    """Return points (N, 3) thing by thing, the largest first; things are apart by more than points of one are."""
    rng = np.random.default_rng(0)
    some = points[rng.permutation(len(points))[: TUNING.looked_at]]
    tree = cKDTree(some)
    spacing = float(np.quantile(tree.query(some, 2)[0][:, 1], 0.9))
    pairs = tree.query_pairs(TUNING.gap * spacing, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(some), len(some)))
    label = connected_components(graph, directed=False)[1][tree.query(points)[1]]
    sizes = np.bincount(label)
    order = [int(k) for k in np.argsort(-sizes, kind="stable") if sizes[k] >= TUNING.least_points]
    return [points[label == k] for k in order]


def _measured(green: Array, plane: Array, where: str, unequal: float) -> Cube:
    """Return the cube that green points (N, 3) are, or refuse them."""
    n, d = plane[:3], plane[3]
    middle = np.median(green, axis=0)
    distance = np.linalg.norm(green - middle, axis=1)
    green = green[distance < 3 * np.median(distance)]
    x = np.cross(n, [1.0, 0, 0] if abs(n[0]) < 0.9 else [0, 1.0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(n, x)
    flat = np.stack([green @ x, green @ y], axis=1)
    height = green @ n - d
    top = float(np.quantile(height, 0.98))
    turns = np.radians(np.arange(0, 90, 0.5))
    extents = [np.ptp(np.quantile(_turned(flat, a), [0.01, 0.99], axis=0), axis=0).sum() for a in turns]
    angle = float(turns[int(np.argmin(extents))])
    upright = (height > 0.15 * top) & (height < 0.85 * top)
    sides = []
    for a in np.radians(np.arange(-2, 2.01, 0.25)) + angle:  # the upright faces are flattest where it is turned right
        sides.append((*_sides(_turned(flat, a), upright), a))
    low, high, _, angle = min(sides, key=lambda found: found[2])
    widths = high - low
    if not np.isfinite(widths).all() or widths.min() <= 0 or np.ptp(widths) > unequal * widths.mean():
        raise FramesError(
            f"{where}: what is green is no cube: {widths[0]:.3g} by {widths[1]:.3g} across, {top:.3g} high"
        )
    if abs(top / widths.mean() - 1) > 2 * unequal:
        raise FramesError(f"{where}: what is green is no cube: {widths.mean():.3g} across, {top:.3g} high")
    c, s = np.cos(angle), np.sin(angle)
    u, v = c * x + s * y, -s * x + c * y
    at = (low + high) / 2
    edge = float(widths.mean())
    return Cube(edge, at[0] * u + at[1] * v + (d + edge / 2) * n, np.stack([u, v, n]))


def _turned(flat: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return flat @ np.array([[c, -s], [s, c]])


def _sides(flat: Array, upright: npt.NDArray[np.bool_]) -> tuple[Array, Array, float]:
    """Return where the upright faces lie along both axes, low and high (2,), and how far points spread about them."""
    low, high = np.quantile(flat, 0.02, axis=0), np.quantile(flat, 0.98, axis=0)
    own, spread = flat[upright], 0.0
    found = np.zeros((2, 2))
    for axis in range(2):
        reach = 0.08 * (high[axis] - low[axis])
        other = 1 - axis
        middle = (own[:, other] > low[other] + reach) & (own[:, other] < high[other] - reach)
        for end, edge in enumerate((low[axis], high[axis])):
            near = own[middle & (np.abs(own[:, axis] - edge) < reach), axis]
            found[end, axis] = np.median(near) if len(near) > 20 else edge
            spread += float(np.mean(np.abs(near - found[end, axis]))) if len(near) > 20 else reach
    return found[0], found[1], spread
