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
from twin_diagram.assets.building.depth_view import DepthView
from twin_diagram.assets.building.inertia import EvenBody, Hollow
from twin_diagram.assets.building.measured import SIX
from twin_diagram.assets.building.smoothing import vertex_normals
from twin_diagram.assets.building.unseen_places import Unseen
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    elsewhere: float = 0.25
    """Share of the variance of an empty volume that lies anywhere among its places, beside that which is so together:
    below a cap, plates and legs it is not what is nearest to where views looked past."""

    least_left: float = 0.1
    """Of its volume a body keeps this share at least, in how far its centre may be off."""

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
        unseen: cells that no view told of, each of these beside the others.
        cell: volume of each [m³].
    """

    covariances: Array
    together: Array
    centre: Array
    alike: bool
    unseen: tuple[Unseen, ...]
    cell: float

    def hollow(self) -> Hollow:
        """Return what the body has less than its surface holds, in the mean; what it has more counts below 0."""
        places = np.concatenate([np.zeros((0, 3)), *(one.places for one in self.unseen)])
        less = [self.cell * (one.expected - ~one.inside) for one in self.unseen]
        return Hollow(places, np.concatenate([np.zeros(0), *less]))


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
    volume = float(np.einsum("fi,fi->", a - about, np.cross(b - about, c - about)) / 6)
    volume -= float(doubt.hollow().volumes.sum())
    by_unseen = sum((_by_unseen(one, doubt.cell, about, R, volume) for one in doubt.unseen), np.zeros((10, 10)))
    return ShapeErrors(total + noise**2 * by_depth + by_unseen)


def _by_unseen(unseen: Unseen, cell: float, about: Array, R: Array, volume: float) -> Array:
    """Return the covariance (10, 10) by what no view told of, about a point, in axes turned by R (3, 3).

    A level between 0 and 1, each as likely, parts those cells that are empty, with a greater chance, from full ones.
    As much as that may be empty in some of these places and not in others, by `TUNING.elsewhere`. First moments are
    those that a body of the told `volume` [m³] needs for its centre to move as far as that of one so much smaller does.
    """
    chance = unseen.chance
    numbers = _numbers((unseen.places - about) @ R.T)
    order = np.argsort(-chance, kind="stable")
    likely = -np.diff(np.concatenate([[1.0], chance[order], [0.0]]))  # that none is, the first one alone, the first two
    more = cell * (unseen.expected @ numbers - np.concatenate([np.zeros((1, 10)), np.cumsum(numbers[order], axis=0)]))
    more[:, 1:4] *= (volume / np.maximum(volume + more[:, 0], TUNING.least_left * volume))[:, None]
    together = (likely[:, None] * more).T @ more
    if not len(chance):
        return np.asarray(together)
    aside = numbers - np.average(numbers, axis=0, weights=chance)
    spread = (chance[:, None] * aside).T @ aside / chance.sum()
    return np.asarray(together + TUNING.elsewhere * together[0, 0] * spread)


def _numbers(points: Array) -> Array:
    """Return 1, p and the products of p (N, 10) in the order of `SIX`."""
    products = np.stack([points[:, i] * points[:, j] for i, j in SIX], axis=1)
    return np.hstack([np.ones((len(points), 1)), points, products])
