"""The cameras' poses refined together: each view against the mean surface of all, and against the support plane.

What a view says of the surface is what faces it, and its outline (`outlines.py`).
The mean surface is a cloud of cells, each with the mean place and normal of what all views have in it that faces the
same way; so both sides of a thin wall are kept apart. All views are moved at once, by Gauss-Newton steps on point-to-
plane distances (Chen and Medioni, 1992) to the nearest cells; then the surface is formed anew. Where a cell lies
along its normal is solved for with the poses: held fast, it would hold back what all views have to do together, such
as stepping away from a mug whose walls they make too thin. The mean over a cell of distances to its own plane is
zero, so views that agree already stay where they are, whatever the surface's curvature. Where depth is a network's,
each view's scale of depth is solved for, too: a point then moves along its ray.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from twin_diagram.assets.building.depth_view import DepthView, view_points
from twin_diagram.assets.building.outlines import outline_near
from twin_diagram.assets.building.poses_together import all_together
from twin_diagram.assets.building.support_plane import settled
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the refinement."""

    cells: tuple[float, ...] = (0.006, 0.004, 0.003, 0.003, 0.003)
    """Edge of a cell in each round [m]: at first as wide as poses are off, at last finer than a handle."""

    length: float = 4.0
    """Length of a cell along the way that it faces, in edges."""

    steps: int = 2
    """Gauss-Newton steps against one choice of cells."""

    points: int = 1500
    """About how many points of a view are used on the object; as many on the support."""

    enough_around: float = 0.2
    """Of so many, this share beside the object tells of the support: a tray's floor of 3 mm drew it up by 0.7 mm."""

    trusted: float = 0.5
    """Least trust of a point of the object: it faces the camera within 53°. What is seen more from the side has errors
    along the picture in it, which on round things are inwards alone; no step of its own view takes them away, and all
    the others' steps, each towards the object, follow: walls of mugs came out 0.15 mm thinner."""

    flat_trusted: float = 0.15
    """Least trust of a point of what surrounds it, which is flat: low views see a table from the side alone. …"""

    fewest: int = 30
    """… And of the object in a view that has fewer points of it that are `trusted`, five for each number of a pose: a
    dish seen by low cameras shows nothing else."""

    turned: float = 0.012
    """Distance that a normal turned by 60° counts as, when the nearest cell is sought [m]."""

    reach: float = 0.008
    """Distance beyond which a cell does not explain a point [m]."""

    near: float = 0.002
    """Distance from the plane of its cell within which a point is explained [m], or else five times the noise."""

    on_support: float = 0.003
    """Height below which a point of the object's surroundings is the support's [m]."""

    prior_rotation: float = 0.0035
    """Standard deviation of a told pose's rotation, each axis [rad]: 0.2°."""

    prior_translation: float = 0.003
    """Standard deviation of a told pose's place, each axis [m]: 2 mm, and what the rotation does at the object."""

    independent: float = 150.0
    """How many points' errors are one and the same: depth noise is correlated over pixels, and in part stays where
    it is in the picture; what is left of a view's points then weighs as a few do."""

    noise_floor: float = 0.0002
    """Least standard deviation of a depth point [m]."""

    first_noise: float = 0.002
    """What residuals are compared with in the first round [m]: poses' errors, not depth's."""


TUNING = Tuning()

Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Sample:
    """Points of one view in C: on and about the object, and on what surrounds it; (N, 3) each [m]."""

    points: Array
    normals: Array
    around: Array
    around_normals: Array

    def beside(self) -> tuple[Array, Array]:
        """Return places and normals (N, 3) of what may be its support: its own points where there are few others."""
        if len(self.around) >= TUNING.enough_around * TUNING.points:
            return self.around, self.around_normals
        return np.concatenate([self.points, self.around]), np.concatenate([self.normals, self.around_normals])

    def joined(self, points: Array, normals: Array) -> Sample:
        """Return it with further points (N, 3) of the object, and their normals, behind its own."""
        own, facing = np.concatenate([self.points, points]), np.concatenate([self.normals, normals])
        return replace(self, points=own, normals=facing)


@dataclass(frozen=True)
class AlignedViews:
    """What came out.

    Attributes:
        views: at poses that agree.
        plane: (4,) under them, n·p = d, or None.
        residuals: (n,) each view's spread about the mean surface [m].
        explained: (n,) share of each view's points that lie on it.
        noise: standard deviation of depth at the object [m].
        covariances: (n, 6, 6) of each view's pose as a twist about `centre` (rotation, translation) [rad, m].
        centre: (3,) of the box that was given.
        twists: (n, 6), or (n, 7) with a scale of depth: from where each view was told to where it is, step by step.
        together: (6 n, 6 n) covariance of all those poses (`poses_together.py`).
    """

    views: list[DepthView]
    plane: Array | None
    residuals: Array
    explained: Array
    noise: float
    covariances: Array
    centre: Array
    twists: Array
    together: Array


def moved(view: DepthView, twist: Array, about: Array) -> DepthView:
    """Return a view turned about a point (3,) of W by `twist[:3]` [rad] and then shifted by `twist[3:6]` [m].

    Its depth grows by exp(`twist[6]`), where there is a seventh.
    """
    R = rotations.matrix(rotations.exp(twist[:3]))
    camera = view.camera
    if len(twist) > 6:
        view = replace(view, depth=(view.depth * np.exp(twist[6])).astype(np.float32))
    return view.at(camera.moved(R @ camera.R_WC, R @ (camera.p_WC - about) + about + twist[3:6]))


def surface_cells(points: Array, normals: Array, cell: float, shift: Array) -> tuple[Array, Array, Numbers]:
    """Return places and unit normals (M, 3) of cells, and which cell each point is in (N,), −1 where that has too few.

    A cell's are the means of the points in it that face one of six ways. Cells are long the way they face. Were they
    not, views a little apart would fall into cells behind one another, and each view agree with its own.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit.
        cell: edge across the way that is faced [m].
        shift: (3,) in [0, 1), of the cells' borders.
    """
    if not len(points):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    main = np.argmax(np.abs(normals), axis=1)
    rows = np.arange(len(normals))
    way = 2 * main + (normals[rows, main] < 0)
    edges = np.full(points.shape, cell)
    edges[rows, main] = TUNING.length * cell
    index = np.floor(points / edges + shift).astype(np.int64)
    index -= index.min(axis=0)
    size = index.max(axis=0) + 1
    key = ((index[:, 0] * size[1] + index[:, 1]) * size[2] + index[:, 2]) * 6 + way
    order = np.argsort(key, kind="stable")
    first = np.append(True, np.diff(key[order]) != 0)
    starts = np.flatnonzero(first)
    count = np.diff(np.append(starts, len(order)))[:, None]
    place = np.add.reduceat(points[order], starts, axis=0) / count
    normal = np.add.reduceat(normals[order], starts, axis=0)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    kept = (count[:, 0] >= 3) & (length[:, 0] > 0.5 * count[:, 0])
    of = np.empty(len(order), dtype=np.int64)
    of[order] = np.where(kept, np.cumsum(kept) - 1, -1)[np.cumsum(first) - 1]
    return place[kept], (normal / np.maximum(length, 1e-12))[kept], of


def mean_surface(points: Array, normals: Array, cell: float, shift: Array) -> tuple[Array, Array]:
    """Return places and unit normals (M, 3) of the cells that points (N, 3) form, as of `surface_cells`."""
    place, normal, _ = surface_cells(points, normals, cell, shift)
    return place, normal


def align(
    views: Sequence[DepthView],
    low: Array,
    high: Array,
    plane: Array | None,
    seed: int = 0,
    prior_scale: float | None = None,
) -> AlignedViews:
    """Return all views at poses that agree; as they were told where none shows anything of the object.

    Args:
        views: as told.
        low: (3,) least corner of a box about the object [m].
        high: (3,) its greatest corner.
        plane: (4,) under it, n·p = d, or None.
        seed: of the choice of points.
        prior_scale: standard deviation of a view's scale of depth, as a share; None: depth is a camera's, with none.
    """
    now = list(views)
    centre = (low + high) / 2
    above = np.mean([view.camera.p_WC for view in now], axis=0)
    rng = np.random.default_rng(seed)
    samples = [sampled(view, low, high, rng) for view in now]
    inner = [len(sample.points) for sample in samples]
    samples = [s.joined(*outline_near(view, low, high, rng)) for s, view in zip(samples, now, strict=True)]
    shown = any(len(sample.points) for sample in samples)
    residuals, explained = np.zeros(len(now)), np.full(len(now), float(shown))
    prior = _prior(prior_scale)
    twists, covariances = np.zeros((len(now), len(prior))), np.tile(np.diag(1.0 / prior[:6]), (len(now), 1, 1))
    noise, seen_of = TUNING.first_noise, np.zeros((twists.size, twists.size))
    for cell in TUNING.cells if shown else ():
        if plane is not None:
            plane = _support(now, samples, plane, above)
        seen = [_in_W(view, s.points, s.normals) for view, s in zip(now, samples, strict=True)]
        surface = mean_surface(
            np.concatenate([p for p, _ in seen]), np.concatenate([n for _, n in seen]), cell, rng.random(3)
        )
        tree = cKDTree(np.hstack([surface[0], TUNING.turned * surface[1]]))
        matches = [_matched(tree, surface, *own, plane) for own in seen]
        for _ in range(TUNING.steps):
            steps, covariances, seen_of = _steps(now, samples, matches, plane, twists, prior, noise, centre)
            twists = twists + steps
            now = [moved(view, step, centre) for view, step in zip(now, steps, strict=True)]
            samples = [_grown(sample, step) for sample, step in zip(samples, steps, strict=True)]
        for k, view in enumerate(now):
            residuals[k], near = _spread(view, samples[k], matches[k], noise, inner[k])
            explained[k] = matches[k].explained * near
        noise = max(float(np.median(residuals)), TUNING.noise_floor)
    told = all_together(seen_of, prior, twists)
    return AlignedViews(now, plane, residuals, explained, noise, covariances, centre, twists, told)


@dataclass(frozen=True)
class _Match:
    """Which of a view's points (indices) lie on which cells (indices; place, normal), what share of the object's do."""

    which: npt.NDArray[np.int64]
    cell: npt.NDArray[np.int64]
    place: Array
    normal: Array
    explained: float


def sampled(view: DepthView, low: Array, high: Array, rng: np.random.Generator, points: int = TUNING.points) -> Sample:
    """Return so many points of a view on what lies in a box about the object, and beside it."""
    place, normals, at = view_points(view, 1, TUNING.flat_trusted)
    near = ((place > low - 0.01) & (place < high + 0.01)).all(axis=1)
    surely = near & (view.trust[at[:, 0], at[:, 1]] > TUNING.trusted)
    own = surely if np.count_nonzero(surely) >= TUNING.fewest else near
    chosen = [rng.permutation(np.flatnonzero(which))[:points] for which in (own, ~near)]
    c = view.camera
    p_C, n_C = (place - c.p_WC) @ c.R_WC, normals @ c.R_WC
    return Sample(p_C[chosen[0]], n_C[chosen[0]], p_C[chosen[1]], n_C[chosen[1]])


def _prior(scale: float | None) -> Array:
    """Return the inverse variances (6,) of a told pose's twist, or (7,) with that of a scale of depth."""
    deviations = [TUNING.prior_rotation] * 3 + [TUNING.prior_translation] * 3 + ([] if scale is None else [scale])
    return np.array(deviations) ** -2.0


def _grown(sample: Sample, step: Array) -> Sample:
    """Return a sample whose depth grew by exp(`step[6]`), where there is a seventh."""
    if len(step) < 7:
        return sample
    return replace(sample, points=sample.points * np.exp(step[6]), around=sample.around * np.exp(step[6]))


def _in_W(view: DepthView, points: Array, normals: Array) -> tuple[Array, Array]:
    R = view.camera.R_WC
    return points @ R.T + view.camera.p_WC, normals @ R.T


def _support(views: Sequence[DepthView], samples: Sequence[Sample], plane: Array, above: Array) -> Array:
    """Return the support plane from all views' points near the last one."""
    points, normals = zip(*(_in_W(view, *own.beside()) for view, own in zip(views, samples, strict=True)), strict=True)
    return settled(np.concatenate(points), np.concatenate(normals), plane, above)


def _matched(tree: cKDTree, surface: tuple[Array, Array], points: Array, normals: Array, plane: Array | None) -> _Match:
    rise = np.full(len(points), np.inf) if plane is None else points @ plane[:3] - plane[3]
    own = np.flatnonzero(rise > TUNING.on_support)
    distance, cell = tree.query(np.hstack([points[own], TUNING.turned * normals[own]]), workers=1)
    good = distance < TUNING.reach
    share = float(good.mean()) if len(own) else 1.0
    return _Match(own[good], cell[good], surface[0][cell[good]], surface[1][cell[good]], share)


def _spread(view: DepthView, sample: Sample, match: _Match, noise: float, inner: int) -> tuple[float, float]:
    """Return the spread of matched points about their planes [m], by the median, and the share that is near them.

    Only the first `inner` points count: those on the outline have the picture's errors, not depth's.
    """
    own = match.which < inner
    if not own.any():
        return 0.0, 0.0
    p, _ = _in_W(view, sample.points[match.which[own]], sample.normals[match.which[own]])
    off = np.abs(np.einsum("ni,ni->n", p - match.place[own], match.normal[own]))
    return 1.4826 * float(np.median(off)), float((off < max(TUNING.near, 5 * noise)).mean())


def _steps(
    views: Sequence[DepthView],
    samples: Sequence[Sample],
    matches: Sequence[_Match],
    plane: Array | None,
    twists: Array,
    prior: Array,
    noise: float,
    centre: Array,
) -> tuple[Array, Array, Array]:
    """Return one Gauss-Newton step of all views (n, 6), or (n, 7) with a scale of depth, covariances, and all of H.

    Covariances (n, 6, 6) are each one's beside the others: what all may do together moves no surface across another.
    `twists` are all steps so far, which `prior` holds back; of H it is left out.

    The cells' offsets o along their normals are eliminated: of Σ w (e + J x − o)² the least over o leaves the normal
    matrix H − Sᵀ S / s, with sums S = Σ w J and s = Σ w over each cell.
    """
    count, cells = len(views), 1 + max((int(m.cell.max()) for m in matches if len(m.cell)), default=0)
    size = len(prior)
    H, g = np.zeros((size * count, size * count)), np.zeros(size * count)
    S, weight, off = np.zeros((cells, size * count)), np.full(cells, 1e-12), np.zeros(cells)
    for k, (view, sample, match) in enumerate(zip(views, samples, matches, strict=True)):
        own = slice(size * k, size * k + size)
        p, _ = _in_W(view, sample.points[match.which], sample.normals[match.which])
        J, e = _rows(p, match.place, match.normal, centre, view.camera.p_WC, size)
        w = _weights(e, noise)
        H[own, own] = (J * w[:, None]).T @ J + np.diag(prior)
        g[own] = J.T @ (w * e) + prior * twists[k]
        for column in range(size):
            S[:, size * k + column] = np.bincount(match.cell, w * J[:, column], cells)
        weight += np.bincount(match.cell, w, cells)
        off += np.bincount(match.cell, w * e, cells)
        if plane is not None:
            J, e = _support_rows(view, sample, plane, centre, size)
            w = _weights(e, noise)
            H[own, own] += (J * w[:, None]).T @ J
            g[own] += J.T @ (w * e)
    blocks = H.reshape(count, size, count, size)[np.arange(count), :, np.arange(count)]
    H -= S.T @ (S / weight[:, None])
    g -= S.T @ (off / weight)
    steps: Array = np.asarray(-np.linalg.solve(H, g).reshape(count, size), dtype=np.float64)
    return steps, np.asarray(np.linalg.inv(blocks))[:, :6, :6], H - np.diag(np.tile(prior, count))


def _rows(points: Array, place: Array, normal: Array, centre: Array, lens: Array, size: int) -> tuple[Array, Array]:
    """Return J (N, size) and e (N,) of points' distances to planes, by a twist about the centre.

    The seventh column is by a growth of the points' distances from the lens (3,).
    """
    J = np.hstack([np.cross(points - centre, normal), normal])
    if size > 6:
        J = np.hstack([J, np.einsum("ni,ni->n", points - lens, normal)[:, None]])
    return J, np.einsum("ni,ni->n", points - place, normal)


def _support_rows(view: DepthView, sample: Sample, plane: Array, centre: Array, size: int) -> tuple[Array, Array]:
    """Return J and e of those of a view's points that lie on the support."""
    q, m = _in_W(view, *sample.beside())
    on = (np.abs(q @ plane[:3] - plane[3]) < 3 * TUNING.on_support) & (m @ plane[:3] > 0.94)
    normal = np.broadcast_to(plane[:3], (int(np.count_nonzero(on)), 3))
    return _rows(q[on], plane[3] * plane[:3], normal, centre, view.camera.p_WC, size)


def _weights(e: Array, noise: float) -> Array:
    """Return Geman and McClure's weights: what is several standard deviations off belongs to something else."""
    return np.asarray((1.0 + (e / (2.5 * noise)) ** 2) ** -2.0 / (noise**2 * TUNING.independent))


def doubted(view: DepthView, covariance: Array, centre: Array, noise: float) -> DepthView:
    """Return a view that is trusted less where its pose's uncertainty moves surfaces across themselves.

    A pixel with place p and normal n moves by J δ with J = [(p − c) × n, n], so its trust is divided by 1 + J Σ Jᵀ/σ²;
    votes for free space, whose edges move sideways, by one plus the largest variance of a shift over σ².
    """
    c = view.camera
    p = view.camera.rays() * view.depth[..., None] @ c.R_WC.T + (c.p_WC - centre)
    n = view.normals @ c.R_WC.T
    J = np.concatenate([np.cross(p, n), n], axis=-1)
    variance = np.einsum("hwi,hwi->hw", J @ covariance, J)
    sway = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])
    trust = (view.trust / (1 + variance / noise**2)).astype(np.float32)
    return replace(view, trust=trust, vote=1 / (1 + sway / noise**2))
