"""Least squares for poses, cells of the mean surface, and an error that lies at the same pixels of all pictures.

What a point of view k is off its cell's plane is e + J δ_k + d B g − o: δ_k moves the view, g are the error's values
at nodes over the picture (B interpolates, d turns an inverse depth into a distance across the surface), o is where
the cell lies. Cells' offsets are eliminated, then the poses; what is left tells g, and how likely each strength is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg, sparse

from twin_diagram.assets.building.depth_view import DepthView
from twin_diagram.assets.building.view_poses import TUNING as POSES
from twin_diagram.assets.building.view_poses import AlignedViews, Sample, surface_cells
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the equations."""

    wave: float = 1.25
    """σ of the Gaussian that makes the error of white noise, in distances of nodes: 15 px, as depth cameras have it."""

    nugget: float = 1e-3
    """Share of the variance that neighbouring nodes do not share, so that the prior can be inverted."""

    nodes: int = 1000
    """About how many nodes there may be: time grows with their cube."""

    strengths: tuple[float, ...] = (0.1, 0.2, 0.35, 0.6, 1.0, 1.7)
    """Standard deviations of the error that are tried, in those of a point."""

    cell: float = 0.004
    """Edge of a cell [m]: a handle's width at most."""

    cosine: float = 0.2
    """Least cosine of incidence with which a point counts."""

    least: float = 1e-6
    """No depth is more exact: standard deviation of its inverse [1/m]."""

    level: float = 0.94
    """Least cosine between the normals of the support and of a point of it."""

    patch: float = 0.17
    """Noise is correlated over pixels: points of a view that lie within such an area err as one, at least, as a share
    of that between four nodes: 25 px². A D415's patches have 78 px²; a good part of their noise looks like poses and
    shape. How many really do is found in what is left, …"""

    most: float = 4.0
    """… which is cut off there [standard deviations], …"""

    enough: int = 8
    """… in bins with so many points of a view and more."""

    half: float = 0.455
    """Median of the square of a unit normal number."""


TUNING = Tuning()


@dataclass(frozen=True)
class Nodes:
    """Nodes over a picture: `count` (rows, columns) of them, the first at `first` (2,) [px], `step` apart [px]."""

    first: Array
    count: tuple[int, int]
    step: float

    @staticmethod
    def over(pixels: Array, step: float) -> Nodes:
        """Return nodes about pixels (N, 2; row, column), farther apart where they would be too many."""
        step = max(step, float(np.sqrt(np.prod(np.ptp(pixels, axis=0)) / TUNING.nodes)))
        first = pixels.min(axis=0) - step
        rows, columns = np.ceil((pixels.max(axis=0) - first) / step).astype(int) + 2
        return Nodes(first, (int(rows), int(columns)), step)

    @property
    def size(self) -> int:
        """Return how many there are."""
        return self.count[0] * self.count[1]

    def interpolation(self, pixels: Array) -> sparse.csr_matrix:
        """Return B (N, size), which takes values at the nodes to those at pixels (N, 2)."""
        at = (pixels - self.first) / self.step
        corner = np.floor(at).astype(int)
        down, right = (at - corner).T
        start = corner[:, 0] * self.count[1] + corner[:, 1]
        columns = start[:, None] + np.array([0, 1, self.count[1], self.count[1] + 1])
        share = np.stack([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right], axis=1)
        ends = np.arange(0, 4 * len(at) + 1, 4)
        return sparse.csr_matrix((share.ravel(), columns.ravel(), ends), shape=(len(at), self.size))

    def precision(self) -> tuple[Array, float]:
        """Return the inverse covariance (size, size) of waves of variance 1, and the logarithm of its determinant."""
        rows, columns = np.indices(self.count).reshape(2, -1)
        apart = (rows[:, None] - rows) ** 2 + (columns[:, None] - columns) ** 2
        covariance = np.exp(-apart / (4 * TUNING.wave**2)) + TUNING.nugget * np.eye(self.size)
        factor = linalg.cho_factor(covariance, lower=True)
        return np.asarray(linalg.cho_solve(factor, np.eye(self.size))), -2 * float(np.log(np.diag(factor[0])).sum())


@dataclass(frozen=True)
class Sightings:
    """Points of all views, as they were measured.

    Attributes:
        view: (N,) whose each is.
        ray: (N, 3) in C, at depth 1 m.
        inverse: (N,) of depth [1/m].
        normal: (N, 3) in C.
        around: (N,) of what surrounds the object.
        B: (N, nodes) of `Nodes.interpolation`.
    """

    view: npt.NDArray[np.int64]
    ray: Array
    inverse: Array
    normal: Array
    around: npt.NDArray[np.bool_]
    B: sparse.csr_matrix

    @staticmethod
    def of(views: Sequence[DepthView], samples: Sequence[Sample], step: float) -> tuple[Sightings, Nodes]:
        """Return the points, and nodes that cover them, `step` apart [px]."""
        points = [np.concatenate([s.points, s.around]) for s in samples]
        pixels = [_pixels(view, p) for view, p in zip(views, points, strict=True)]
        nodes = Nodes.over(np.concatenate(pixels), step)
        p = np.concatenate(points)
        return Sightings(
            np.repeat(np.arange(len(views)), [len(own) for own in points]),
            p / p[:, 2:],
            1 / p[:, 2],
            np.concatenate([np.concatenate([s.normals, s.around_normals]) for s in samples]),
            np.concatenate([np.arange(len(s.points) + len(s.around)) >= len(s.points) for s in samples]),
            nodes.interpolation(np.concatenate(pixels)),
        ), nodes


@dataclass(frozen=True)
class Problem:
    """The equations, linear about what was known: X (rows, 6 n + nodes) x + e is what is left, cells aside.

    Attributes:
        X: of steps of the views and of the error.
        e: (rows,) [m].
        deviation: (rows,) what a point scatters by [m].
        spread: its standard deviation of inverse depth [1/m].
        weight: (rows,) inverse variance, less for what belongs to something else.
        member: (cells, rows), one where a row is of a cell; those of the support are of none.
        view: (rows,) whose each is.
        B: (rows, nodes).
    """

    X: sparse.csr_matrix
    e: Array
    deviation: Array
    spread: float
    weight: Array
    member: sparse.csr_matrix
    view: npt.NDArray[np.int64]
    B: sparse.csr_matrix

    def nearest_node(self) -> npt.NDArray[np.int64]:
        """Return the node (rows,) with the largest share in each row; there are four in each, by growing number."""
        share, node = self.B.data.reshape(-1, 4), self.B.indices.reshape(-1, 4)
        return np.asarray(np.take_along_axis(node, share.argmax(axis=1)[:, None], axis=1)[:, 0], dtype=np.int64)

    def cell_weight(self) -> Array:
        """Return the sum of weights (cells,) in each cell."""
        return np.asarray(np.maximum(self.member @ self.weight, 1e-12))

    def apart(self, values: Array) -> Array:
        """Return values (rows,) less their weighted mean over their cell."""
        mean = self.member @ (self.weight * values) / self.cell_weight()
        return np.asarray(values - self.member.T @ mean)


def problem(seen: Sightings, found: AlignedViews, views: Sequence[DepthView], values: Array, shift: Array) -> Problem:
    """Return the equations about an error's values (nodes,) and views; `shift` (3,) is of the cells' borders."""
    R = np.array([view.camera.R_WC for view in views])[seen.view]
    lens = np.array([view.camera.p_WC for view in views])[seen.view]
    z = 1 / np.maximum(seen.inverse + seen.B @ values, 0.5 * seen.inverse)
    ray = np.einsum("nij,nj->ni", R, seen.ray)
    p, facing = lens + z[:, None] * ray, np.einsum("nij,nj->ni", R, seen.normal)
    plane = found.plane
    rise = np.full(len(p), np.inf) if plane is None else p @ plane[:3] - plane[3]
    own = np.flatnonzero(~seen.around & (rise > POSES.on_support))
    place, normal, cell = surface_cells(p[own], facing[own], TUNING.cell, shift)
    own, cell = own[cell >= 0], cell[cell >= 0]
    place, normal, cells = place[cell], normal[cell], len(place)
    if plane is not None:
        level = facing @ plane[:3] > TUNING.level
        on = np.flatnonzero(seen.around & level & (np.abs(rise) < 3 * POSES.on_support))
        own, cell = np.append(own, on), np.append(cell, np.full(len(on), -1))
        place = np.concatenate([place, np.broadcast_to(plane[3] * plane[:3], (len(on), 3))])
        normal = np.concatenate([normal, np.broadcast_to(plane[:3], (len(on), 3))])
    e = np.einsum("ni,ni->n", p[own] - place, normal)
    J = np.hstack([np.cross(p[own] - found.centre, normal), normal])
    d = -(z[own] ** 2) * np.einsum("ni,ni->n", ray[own], normal)
    unit = np.maximum(d, TUNING.cosine * z[own] ** 2)
    spread = max(1.4826 * float(np.median(np.abs(e / unit))), TUNING.least)
    view, rows = seen.view[own], np.arange(len(own))
    columns = 6 * view[:, None] + np.arange(6)
    starts = 6 * np.append(rows, len(rows))
    moving = sparse.csr_matrix((J.ravel(), columns.ravel(), starts), shape=(len(rows), 6 * len(views)))
    B = seen.B[own]
    deviation = spread * unit
    weight = (1 + (e / (2.5 * deviation)) ** 2) ** -2.0 / deviation**2
    of_cell = np.flatnonzero(cell >= 0)
    member = sparse.csr_matrix((np.ones(len(of_cell)), (cell[of_cell], of_cell)), (cells, len(rows)))
    X = sparse.hstack([moving, sparse.diags(d) @ B]).tocsr()
    return Problem(X, e, deviation, spread, weight, member, view, B)


def likeliest(
    told: Problem, nodes: Nodes, prior: tuple[Array, float], values: Array, twists: Array, alike: float
) -> tuple[Array, Array, float]:
    """Return the error's values (nodes,), the views' steps (n, 6), and how much likelier it is than none (logarithm).

    Args:
        told: about `values`.
        nodes: where they are.
        prior: of `Nodes.precision`.
        values: (nodes,) so far [1/m].
        twists: (n, 6) of the views so far.
        alike: how many points err as one.
    """
    count = twists.size
    scaled = sparse.diags(told.weight / alike) @ told.X
    # Σ w (x − mean x)² over a cell is Σ w x² − (Σ w x)² / Σ w.
    H = (told.X.T @ scaled).toarray()
    S = (sparse.diags(np.sqrt(alike / told.cell_weight())) @ (told.member @ scaled)).toarray()
    H -= S.T @ S
    g = np.asarray(told.X.T @ (told.weight / alike * told.apart(told.e)))
    held = np.tile(np.array([POSES.prior_rotation] * 3 + [POSES.prior_translation] * 3) ** -2.0, count // 6)
    H[:count, :count] += np.diag(held)
    g[:count] += held * twists.ravel()
    poses = linalg.cho_factor(H[:count, :count])
    A = H[count:, count:] - H[count:, :count] @ linalg.cho_solve(poses, H[:count, count:])
    right = A @ values - g[count:] + H[count:, :count] @ linalg.cho_solve(poses, g[:count])
    best, evidence = np.zeros(nodes.size), 0.0
    precision, determinant = prior
    for strength in TUNING.strengths:
        variance = (strength * told.spread) ** 2
        factor = linalg.cho_factor(A + precision / variance, lower=True)
        now = linalg.cho_solve(factor, right)
        volume = 2 * float(np.log(np.diag(factor[0])).sum()) + nodes.size * np.log(variance) - determinant
        likely = 0.5 * float(right @ now - volume)
        if likely > evidence:
            best, evidence = now, likely
    steps = -linalg.cho_solve(poses, g[:count] + H[:count, count:] @ (best - values))
    return best, np.asarray(steps).reshape(-1, 6), evidence


def alike(told: Problem, nodes: Nodes, left: Array | None = None) -> float:
    """Return how many of a view's points err as one.

    Args:
        told: the equations.
        nodes: one bin of the picture about each.
        left: (rows,) of `left_of`, whose means scatter more within bins than those of independent points do.
    """
    bins = told.view * nodes.size + told.nearest_node()
    count = np.bincount(bins)
    some = count >= TUNING.enough
    if not some.any():
        return 1.0
    least = 1.0 + TUNING.patch * float(np.median(count[some]))
    if left is None:
        return least
    mean = np.bincount(bins, np.clip(left / told.deviation, -TUNING.most, TUNING.most))[some] / count[some]
    return max(least, float(np.median(count[some] * mean**2)) / TUNING.half)


def left_of(told: Problem, change: Array, steps: Array) -> Array:
    """Return what is left of each row [m], by a change of the error (nodes,) and steps of the views (n, 6)."""
    return told.apart(told.e + told.X @ np.concatenate([steps.ravel(), change]))


def _pixels(view: DepthView, points: Array) -> Array:
    """Return the pixels (N, 2; row, column) of the whole picture that show points (N, 3) in C."""
    c = view.camera
    at = points[:, :2] / points[:, 2:] * [c.fx, c.fy] + [c.cx, c.cy]
    return at[:, ::-1] + view.corner
