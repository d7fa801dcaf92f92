"""How far volume, centre and moments of a reconstructed body may be off: by poses, by depth, by what no view told of.

All three move the surface along its normals. A move u(p) changes the volume by ∮ u dA, its first moments by ∮ u p dA,
its second ones by ∮ u p pᵀ dA: linear in the views' twists, so their covariances become that of the body's numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.colouring import worth
from twin_diagram.assets.building.depth_view import DepthView, Map, Mask
from twin_diagram.assets.building.fusion import DistanceField
from twin_diagram.assets.building.inertia import EvenBody, Hollow
from twin_diagram.assets.building.measured import SIX
from twin_diagram.assets.building.smoothing import vertex_normals
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    rounds: int = 60
    """Of means over neighbours, by which what is around closes what no view told of: it reaches 4 or 5 voxels in."""

    limit: float = 2.0
    """Distances from the surface that count most in such means [voxels]: as far in as out. A mean of as much is 1."""

    patches: float = 10.0
    """Patches of a view's surface with errors of their own: depth noise is correlated over many pixels."""


TUNING = Tuning()


@dataclass(frozen=True)
class Doubt:
    """What may move a reconstructed surface.

    Attributes:
        covariances: (n, 6, 6) of the views' twists about `centre` (rotation, translation), each beside the others
            [rad, m].
        together: (6 n, 6 n) of all of them.
        centre: (3,) in W [m].
        alike: whether what depth has wrong at the same pixels of all views was left in.
        places: (M, 3) in W of cells that no view told of, and that may be empty, or full [m].
        chance: (M,) that each is empty. They are so together: what ends at a cell is empty up to it, from the most
            likely one on.
        inside: (M,) which of them the surface holds.
        cell: volume of each [m³].
    """

    covariances: Array
    together: Array
    centre: Array
    alike: bool
    places: Array
    chance: Array
    inside: npt.NDArray[np.bool_]
    cell: float

    def hollow(self) -> Hollow:
        """Return what the body has less than its surface holds, in the mean; what it has more counts below 0."""
        return Hollow(self.places, self.cell * (self.chance - ~self.inside))


@dataclass(frozen=True)
class ShapeErrors:
    """Covariance (10, 10) of a body's volume [m³] and, about a point, first (3) [m⁴] and second moments (6) [m⁵]."""

    covariance: Array

    @property
    def volume_std(self) -> float:
        """Standard error of the volume [m³]."""
        return float(np.sqrt(self.covariance[0, 0]))

    def centre_std(self, volume: float) -> Array:
        """Return standard errors (3,) of the centre of a body of that volume, even within [m]."""
        return np.sqrt(np.diag(self.covariance)[1:4]) / volume

    def inertia_std(self, solid: EvenBody, mass: float, told: bool) -> Array:
        """Return standard errors (6,) of its moments [kg·m²]; `told`: the mass is known, else the density."""
        change = np.zeros((6, 10))
        for row, (i, j) in enumerate(SIX):
            change[row, 4 + row] -= 1.0
            if i == j:
                change[row, 4:7] += 1.0
        change *= mass / solid.volume
        if told:
            inertia = solid.inertia(mass)
            change[:, 0] -= np.array([inertia[i, j] for i, j in SIX]) / solid.volume
        return np.asarray(np.sqrt(np.einsum("ri,ij,rj->r", change, self.covariance, change)))


def unseen_cells(field: DistanceField, chance: Map) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return places (M, 3) of cells that may be empty though no view told so, the chance of it, and which are inside.

    Were those inside given the mean of their neighbours, over and over, they would be outside. The true surface lies
    somewhere between that one and the one that nothing contradicts, whose means are 0 and 1; with each mean as likely,
    a cell's own is its chance.

    Args:
        field: where what no view told of is inside, but for what was opened.
        chance: (nx, ny, nz) that a cell is empty by what else is known; 0 elsewhere. The greater of two counts.
    """
    chance, unknown = chance.copy(), ~field.known & (field.distance < 0)
    if unknown.any():
        at = np.argwhere(unknown)
        own = tuple(slice(max(a - 1, 0), b + 2) for a, b in zip(at.min(axis=0), at.max(axis=0), strict=True))
        limit = np.float32(TUNING.limit * field.grid.voxel)
        mean = _closed(np.clip(field.distance[own], -limit, limit), unknown[own])
        chance[own] = np.where(unknown[own], np.maximum(chance[own], mean / limit), chance[own])
    at = np.argwhere(chance > 0)
    which = tuple(at.T)
    return field.grid.origin + field.grid.voxel * at, chance[which].astype(float), field.distance[which] < 0


def _closed(distance: Map, which: Mask) -> Map:
    """Return a distance whose cells `which` have the mean of their neighbours."""
    for _ in range(TUNING.rounds):
        padded = np.pad(distance, 1, mode="edge")
        around = padded[2:, 1:-1, 1:-1] + padded[:-2, 1:-1, 1:-1]
        around += padded[1:-1, 2:, 1:-1] + padded[1:-1, :-2, 1:-1]
        around += padded[1:-1, 1:-1, 2:] + padded[1:-1, 1:-1, :-2]
        distance = np.where(which, around / np.float32(6.0), distance)
    return distance


def shape_errors(
    vertices: Array,
    faces: npt.NDArray[np.int64],
    views: Sequence[DepthView],
    noise: float,
    doubt: Doubt,
    about: Array,
    R: Array,
) -> ShapeErrors:
    """Return the errors of a body's numbers about a point, in axes turned by R (3, 3): p' = R p.

    Args:
        vertices: of its surface (V, 3) in W [m].
        faces: (F, 3), counter-clockwise from outside.
        views: n that showed it.
        noise: standard deviation of depth [m].
        doubt: what may move it.
        about: (3,) in W [m].
        R: of the axes in which numbers are told.
    """
    normals = vertex_normals(vertices, faces)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.bincount(faces.ravel(), np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6, 3), len(vertices))
    moved = area[:, None] * _numbers((vertices - about) @ R.T)  # (V, 10) by a metre along the normal
    J = np.hstack([np.cross(vertices - doubt.centre, normals), normals])
    shares = np.array([worth(view, vertices, normals) for view in views])
    for share, covariance in zip(shares, doubt.covariances, strict=True):
        share /= 1.0 + np.einsum("vi,ij,vj->v", J, covariance, J) / noise**2
    shares /= np.maximum(shares.sum(axis=0), 1e-300)
    G = np.hstack([moved.T @ (share[:, None] * J) for share in shares])
    total = G @ doubt.together @ G.T
    by_depth = np.zeros((10, 10))
    for share in shares:
        of_depth = moved * share[:, None]
        by_depth += of_depth.T @ of_depth * max(1, np.count_nonzero(share)) / TUNING.patches
    if doubt.alike:
        seen = moved[shares.sum(axis=0) > 0].sum(axis=0)
        by_depth += np.outer(seen, seen) / TUNING.patches
    return ShapeErrors(total + noise**2 * by_depth + _by_unseen(doubt, about, R))


def _by_unseen(doubt: Doubt, about: Array, R: Array) -> Array:
    """Return the covariance (10, 10) by what no view told of, about a point, in axes turned by R (3, 3).

    A level between 0 and 1, each as likely, parts those cells that are empty, with a greater chance, from full ones.
    """
    order = np.argsort(-doubt.chance, kind="stable")
    empty = doubt.cell * np.cumsum(_numbers((doubt.places[order] - about) @ R.T), axis=0)
    width = -np.diff(doubt.chance[order], append=0.0)[:, None]
    mean = (width * empty).sum(axis=0)
    return np.asarray((width * empty).T @ empty - np.outer(mean, mean))


def _numbers(points: Array) -> Array:
    """Return 1, p and the products of p (N, 10) in the order of `SIX`."""
    products = np.stack([points[:, i] * points[:, j] for i, j in SIX], axis=1)
    return np.hstack([np.ones((len(points), 1)), points, products])
