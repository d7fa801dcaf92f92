"""The cameras' poses refined together: each view against the distance field of all, and against the support plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.fusion import Fused, Grid, fuse
from twin_diagram.assets.building.support_plane import fit_plane
from twin_diagram.assets.building.view import View, view_points
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the refinement."""

    rounds: int = 6
    """Times that all views are fused and each is aligned to the sum."""

    steps: int = 2
    """Gauss-Newton steps of a view against one sum."""

    points: int = 2500
    """About how many points of a view are used on the object; as many on the support."""

    prior_rotation: float = 0.0035
    """Standard deviation of a told pose's rotation, each axis [rad]: 0.2°."""

    prior_translation: float = 0.002
    """Standard deviation of a told pose's place, each axis [m]."""

    independent: float = 30.0
    """How many neighbouring points' errors are one and the same, as depth noise is correlated over pixels."""

    noise_floor: float = 0.0003
    """Least standard deviation of a depth point [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Alignment:
    """Refined views, the plane (4,) under them or None, each view's residual RMS [m] and share of points explained, noise [m]."""

    views: list[View]
    plane: Array | None
    residuals: Array
    explained: Array
    noise: float


def field_at(fused: Fused, points: Array) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return distance [m] (N,), its gradient (N, 3) and whether there is evidence all around, at points (N, 3)."""
    grid = fused.grid
    x = (points - grid.origin) / grid.voxel
    cell = np.floor(x).astype(np.int64)
    good = ((cell >= 0) & (cell < np.array(grid.shape) - 1)).all(axis=1)
    cell = np.where(good[:, None], cell, 0)
    f = x - cell
    distance, gradient = np.zeros(len(points)), np.zeros((len(points), 3))
    for corner in np.ndindex(2, 2, 2):
        at = (cell[:, 0] + corner[0], cell[:, 1] + corner[1], cell[:, 2] + corner[2])
        value = fused.distance[at].astype(float)
        good &= fused.weight[at] > 0
        share = [f[:, k] if corner[k] else 1 - f[:, k] for k in range(3)]
        distance += value * share[0] * share[1] * share[2]
        for k in range(3):
            others = share[(k + 1) % 3] * share[(k + 2) % 3]
            gradient[:, k] += value * others * (1 if corner[k] else -1) / grid.voxel
    return distance, gradient, good


def moved(view: View, twist: Array) -> View:
    """Return a view turned about the origin of W by `twist[:3]` [rad] and then shifted by `twist[3:]` [m]."""
    R = rotations.matrix(rotations.exp(twist[:3]))
    camera = view.camera
    return view.at(camera.moved(R @ camera.R_WC, R @ camera.p_WC + twist[3:]))


def align(
    views: Sequence[View], grid: Grid, plane: Array | None, centre: Array, noise: float, rounds: int = TUNING.rounds
) -> Alignment:
    """Return all views at poses that agree.

    Args:
        views: as told.
        grid: about the object.
        plane: (4,) under it, n·p = d, or None.
        centre: (3,) the object's place, about which poses turn [m].
        noise: a first guess of depth's standard deviation at the object [m].
        rounds: of fusion and alignment.
    """
    told = [view.camera for view in views]
    now = [_about(view, -centre) for view in views]
    local = Grid(grid.origin - centre, grid.voxel, grid.shape)
    level = None if plane is None else np.append(plane[:3], plane[3] - plane[:3] @ centre)
    above = np.mean([view.camera.p_WC for view in now], axis=0)
    residuals, explained = np.zeros(len(now)), np.ones(len(now))
    twists = np.zeros((len(now), 6))
    low, high = local.origin, local.origin + local.voxel * (np.array(local.shape) - 1)
    samples = [_samples(view, low, high) for view in now]
    for turn in range(rounds):
        if level is not None:
            level = _support(now, samples, level, above)
        wide = max(noise, 0.002) if turn < 2 else noise
        fused = fuse(now, local, wide, level)
        for k, view in enumerate(now):
            now[k], twists[k], residuals[k], explained[k] = _aligned(view, samples[k], fused, level, twists[k], wide)
        if turn >= 1:
            noise = max(float(np.sqrt(np.median(residuals**2))), TUNING.noise_floor)
    refined = [_about(view, centre) for view in now]
    assert len(told) == len(refined)
    out = None if level is None else np.append(level[:3], level[3] + level[:3] @ centre)
    return Alignment(refined, out, residuals, explained, noise)


def _about(view: View, shift: Array) -> View:
    return moved(view, np.concatenate([np.zeros(3), shift]))


def _samples(view: View, low: Array, high: Array) -> tuple[Array, Array, Array, Array]:
    """Return points and normals of a view in C: of the object's surroundings, and of all else."""
    points, normals, pixels = view_points(view, 2)
    reach = 0.02
    near = ((points > low - reach) & (points < high + reach)).all(axis=1)
    if view.mask is not None:
        u, v, _ = view.colour.project(points)
        row, column = (np.clip(np.rint(x), 0, n - 1).astype(int) for x, n in zip((v, u), view.mask.shape, strict=True))
        near &= view.mask[row, column]
    c = view.camera
    p_C, n_C = (points - c.p_WC) @ c.R_WC, normals @ c.R_WC
    out = []
    for chosen in (np.flatnonzero(near), np.flatnonzero(~near)):
        chosen = chosen[:: max(1, len(chosen) // TUNING.points)]
        out += [p_C[chosen], n_C[chosen]]
    return out[0], out[1], out[2], out[3]


def _support(views: Sequence[View], samples: Sequence[tuple[Array, Array, Array, Array]], level: Array, above: Array) -> Array:
    """Return the support plane from all views' points near the last one."""
    kept = []
    for view, (p, n, q, m) in zip(views, samples, strict=True):
        points = np.concatenate([p, q]) @ view.camera.R_WC.T + view.camera.p_WC
        normals = np.concatenate([n, m]) @ view.camera.R_WC.T
        near = (np.abs(points @ level[:3] - level[3]) < 0.008) & (normals @ level[:3] > 0.94)
        kept.append(points[near][::4])
    points = np.concatenate(kept)
    return level if len(points) < 200 else fit_plane(points, above)


def _aligned(
    view: View, sample: tuple[Array, Array, Array, Array], fused: Fused, level: Array | None, twist: Array, noise: float
) -> tuple[View, Array, float, float]:
    """Return a view after Gauss-Newton steps, its twist from where it was told to be, residual RMS and share explained."""
    scale = np.array([TUNING.prior_rotation] * 3 + [TUNING.prior_translation] * 3)
    rms, share = 0.0, 1.0
    for _ in range(TUNING.steps):
        R, p_WC = view.camera.R_WC, view.camera.p_WC
        p, n = sample[0] @ R.T + p_WC, sample[1] @ R.T
        on_support = np.zeros(len(p), bool) if level is None else np.abs(p @ level[:3] - level[3]) < 0.004
        r, gradient, good = field_at(fused, p)
        length = np.linalg.norm(gradient, axis=1)
        g = gradient / np.maximum(length, 1e-9)[:, None]
        good &= (np.einsum("ni,ni->n", g, n) > 0.6) & (length > 0.3) & (length < 3) & ~on_support
        share = float(np.count_nonzero(good) / max(1, np.count_nonzero(~on_support)))
        rows, residual = [np.hstack([np.cross(p[good], g[good]), g[good]])], [r[good]]
        if level is not None:
            q = np.concatenate([p[on_support], sample[2] @ R.T + p_WC])
            facing = np.concatenate([n[on_support], sample[3] @ R.T]) @ level[:3] > 0.94
            height = q @ level[:3] - level[3]
            table = facing & (np.abs(height) < 0.012)
            normal = np.broadcast_to(level[:3], (np.count_nonzero(table), 3))
            rows.append(np.hstack([np.cross(q[table], normal), normal]))
            residual.append(height[table])
        J, e = np.concatenate(rows), np.concatenate(residual)
        w = 1.0 / (1.0 + (e / (2.5 * noise)) ** 2) ** 2 / (noise**2 * TUNING.independent)
        A = (J * w[:, None]).T @ J + np.diag(scale**-2.0)
        step = -np.linalg.solve(A, J.T @ (w * e) + twist / scale**2)
        view, twist = moved(view, step), twist + step
        kept = np.abs(r[good]) < 5 * noise
        rms = 1.4826 * float(np.median(np.abs(r[good][kept]))) if kept.any() else 0.0
    return view, twist, rms, share
