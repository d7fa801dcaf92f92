"""Finds the flat faces of a surface that was measured: its noise makes a heap of facets of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.opening import fibonacci_sphere
from twin_diagram.assets.description import TUNING as SDF
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module; "bin 21" are the five objects that were learned there, four with flat faces."""

    points: int = 20000
    """Drawn on the surface: two hundred on the least face."""

    directions: int = 500
    """Of which one is begun with: 9° apart."""

    cone: float = float(np.radians(15.0))
    """Angle within which normals are one face's [rad]: those of bin 21 scatter by 3°."""

    least: float = 0.01
    """Of the surface, that a face has."""

    share: float = 0.5
    """Of what looks along it from its height: 0.85 and more of bin 21's flat faces, a third of a drawn cylinder's."""

    spreads: float = 3.0
    """Standard deviations from its plane within which a point is the face's."""

    beyond: float = 40.0
    """The same for the highest bump on it: up to 26 in bin 21; what a hand left on one of its boxes has 530."""

    turn: float = float(np.radians(6.0))
    """By which its normals may turn from end to end [rad]: up to 2.6° on bin 21's flat faces, from 32° on its round
    ones."""

    exact: float = 1e-6
    """Standard deviation that even a surface without noise is taken to have [m]: files keep that many digits."""

    rounds: int = 10
    """Of fitting: what is the face's, then its plane."""

    block: int = 256
    """Normals that are compared with all directions at a time: their cosines, 1 MB, stay in the cache."""


TUNING = Tuning()


def flat_faces(corners: Array, seed: int = 0) -> Array:
    """Return the planes (k, 4) of a surface's flat faces, n·p + d = 0, n outwards; all of it lies below, but for noise.

    Args:
        corners: (F, 3, 3) of its triangles, counter-clockwise from outside [m].
        seed: of the points that are drawn on it.
    """
    points, normals = _drawn(corners, seed)
    left, directions = np.ones(len(points), bool), fibonacci_sphere(TUNING.directions)
    along = _along(normals, directions)
    alike = along.sum(axis=0)
    planes: list[Array] = []
    while True:
        if alike.max() < TUNING.least * len(points):
            return np.array(planes).reshape(-1, 4)
        n = first = directions[int(alike.argmax())]
        for _ in range(TUNING.rounds):
            some = left & (normals @ n > np.cos(TUNING.cone))
            n = normals[some].mean(axis=0) if some.any() else first
            n /= np.linalg.norm(n)
        cone = normals @ n > np.cos(TUNING.cone)
        gone = left & (cone | (normals @ first > np.cos(TUNING.cone)))
        left &= ~gone
        alike -= along[gone].sum(axis=0)
        plane = _face(points, points[cone], normals[cone], n)
        if plane is not None and all(plane[:3] @ other[:3] < np.cos(TUNING.cone) for other in planes):
            planes.append(plane)


def flattened(vertices: Array, planes: Array) -> Array:
    """Return vertices (V, 3) of which those beyond a plane of (k, 4) lie on it."""
    for plane in planes:
        vertices = vertices - np.maximum(vertices @ plane[:3] + plane[3], 0.0)[:, None] * plane[:3]
    return vertices


def _along(normals: Array, directions: Array) -> npt.NDArray[np.bool_]:
    """Return which normals (N, 3) look along which directions (D, 3): (N, D)."""
    blocks = np.array_split(normals, max(1, len(normals) // TUNING.block))
    return np.concatenate([block @ directions.T > np.cos(TUNING.cone) for block in blocks])


def _face(points: Array, own: Array, normals: Array, n: Array) -> Array | None:
    """Return the plane (4,) of the outermost of the points (N, 3) that look along n; None: no flat face.

    Args:
        points: (M, 3) of all the surface.
        own: (N, 3) that look about along n, with normals (N, 3).
        normals: of them.
        n: (3,) unit.
    """
    height = own @ n
    on = np.abs(height - np.quantile(height, 0.98)) < SDF.foot
    least = max(TUNING.least * len(points), TUNING.share * on.sum())
    for _ in range(TUNING.rounds):
        if on.sum() < len(n):  # too few for a plane: the end of something thin
            return None
        middle = own[on].mean(axis=0)
        axes = np.linalg.svd(own[on] - middle, full_matrices=False)[2]
        up = axes[2] * np.sign(axes[2] @ n)
        if up @ n < np.cos(TUNING.cone):  # a strip that is thinner than it is high, as a handle's outermost is
            return None
        off = (own - middle) @ up
        noise = max(1.4826 * float(np.median(np.abs(off[on] - np.median(off[on])))), TUNING.exact)
        on = np.abs(off) < TUNING.spreads * noise
        if on.sum() < least:
            return None
    # Normals of what is round turn as one goes along it, and fill the cone from end to end.
    across = (own[on] - middle) @ axes[:2].T
    slope = np.linalg.lstsq(np.column_stack([across, np.ones(len(across))]), normals[on] @ axes[:2].T, rcond=None)[0]
    turn = float(np.linalg.norm(slope[:2], 2) * np.ptp(across, axis=0).max())
    highest = float(((points - middle) @ up).max())
    if turn > TUNING.turn or highest > TUNING.beyond * noise:
        return None
    return np.append(up, -up @ middle)


def _drawn(corners: Array, seed: int) -> tuple[Array, Array]:
    """Return points and normals (N, 3), evenly over triangles (F, 3, 3)."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(cross, axis=1)
    rng = np.random.default_rng(seed)
    which = rng.choice(len(corners), TUNING.points, p=twice / twice.sum())
    a, b = np.sort(rng.uniform(size=(2, TUNING.points)), axis=0)
    share = np.column_stack([a, b - a, 1.0 - b])
    return np.einsum("nk,nki->ni", share, corners[which]), cross[which] / twice[which, None]
