"""Volume, centre and inertia of a body of even density: by its surface where that is closed, else by filling it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.assets.building.overlap import balanced, overlap, united
from twin_diagram.assets.building.surface import Faces, Surface
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    cells: int = 80
    """Cells along the longest edge where an open surface is filled: a mug's wall is two or three of them."""

    leak: int = 1
    """Holes of up to twice so many cells in an open surface are closed before it is filled."""

    least_inside: float = 0.02
    """Share of its hull that must be inside of an open surface; less: it holds nothing, and its hull is taken."""

    most_filled: float = 1.1
    """Times its hull: of a sheet thinner than a cell more is filled, and its hull is taken; of a ball it is 1.02."""

    overlap: float = 0.005
    """Share of a closed surface's inside from which bodies that overlap are filled as one, not added up."""

    flat: float = 1e-4
    """A hull with less volume than this share of its size, cubed, is a sheet."""


TUNING = Tuning()


@dataclass(frozen=True)
class EvenBody:
    """A body of density 1.

    Attributes:
        volume: [m³]
        centre: (3,) of mass [m].
        second: (3, 3) second moments ∫ r rᵀ about the centre [m⁵].
        by: `surface`, `filling` or `hull`: what it was computed from.
    """

    volume: float
    centre: Array
    second: Array
    by: str

    def inertia(self, mass: float) -> Array:
        """Return moments (3, 3) about the centre [kg·m²] of the body with that mass [kg]."""
        second = self.second * (mass / self.volume)
        return np.trace(second) * np.eye(3) - second


def solid_of(surface: Surface) -> EvenBody:
    """Return the body within a surface.

    A closed surface is exact, also with cavities, whose walls face inwards. Bodies that overlap or touch are filled as
    one, along rays. An open surface is filled, with small holes closed; where it holds nothing, its convex hull counts.

    Raises:
        AssetError: a sheet, without volume.
    """
    hull = hull_of(surface.vertices)
    if surface.closed and overlap(surface) < TUNING.overlap:
        solid = enclosed(surface.vertices, surface.faces, "surface")
        if solid.volume > TUNING.flat * hull.volume:
            return solid
    if len(surface.faces) and balanced(surface.faces):
        origin = surface.vertices.mean(axis=0)
        volume, first, second = united(surface.vertices - origin, surface.faces)
        if volume > TUNING.flat * hull.volume:
            centre = first / volume
            return EvenBody(volume, origin + centre, second - volume * np.outer(centre, centre), "filling")
    filled = filling(surface.vertices, surface.faces)
    if filled is not None and filled[1] >= TUNING.least_inside * hull.volume:
        if filled[0].volume <= TUNING.most_filled * hull.volume:
            return filled[0]
    return enclosed(surface.vertices, outward(hull), "hull")


@dataclass(frozen=True)
class Hollow:
    """What within a surface may be empty: places (M, 3) [m] and how much is in the mean, of each (M,) [m³]."""

    places: Array
    volumes: Array


def less(solid: EvenBody, hollow: Hollow) -> EvenBody:
    """Return a body without what of it is empty in the mean."""
    volume = solid.volume - float(hollow.volumes.sum())
    centre = (solid.volume * solid.centre - hollow.volumes @ hollow.places) / volume
    own, gone = solid.centre - centre, hollow.places - centre
    second = solid.second + solid.volume * np.outer(own, own)
    return EvenBody(volume, centre, second - np.einsum("n,ni,nj->ij", hollow.volumes, gone, gone), solid.by)


def hull_of(vertices: Array) -> ConvexHull:
    """Return the convex hull of points (V, 3).

    Raises:
        AssetError: they lie in a plane, or nearly.
    """
    size = float(np.ptp(vertices, axis=0).max())
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        hull = None
    if hull is None or hull.volume < TUNING.flat * size**3 * 1e-2:
        raise AssetError("all vertices lie in a plane, so the object has no volume; give it its thickness")
    return hull


def outward(hull: ConvexHull) -> Faces:
    """Return a hull's triangles (F, 3), counter-clockwise from outside."""
    corners = hull.points[hull.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside = np.einsum("fi,fi->f", normal, hull.equations[:, :3]) < 0
    return np.where(inside[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)


def enclosed(vertices: Array, faces: Faces, by: str) -> EvenBody:
    """Return the body within triangles that face outwards, as the sum of tetrahedra from a point inside.

    For one with the corners 0, a, b, c: volume det(a, b, c)/6, centre (a + b + c)/4, and second moments
    volume/20 · (aaᵀ + bbᵀ + ccᵀ + ssᵀ) with s = a + b + c.
    """
    origin = vertices.mean(axis=0)
    a, b, c = (vertices[faces[:, k]] - origin for k in range(3))
    volumes = np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0
    total, s = float(volumes.sum()), a + b + c
    centre = np.einsum("f,fi->i", volumes, s) / (4.0 * total)
    second = sum(np.einsum("f,fi,fj->ij", volumes / 20.0, e, e) for e in (a, b, c, s))
    return EvenBody(total, origin + centre, second - total * np.outer(centre, centre), by)


def filling(vertices: Array, faces: Faces) -> tuple[EvenBody, float] | None:
    """Return the body within an open surface, by cells, and the volume of those wholly inside; None: none is.

    Cells on the surface count half, but for those of a wall inside of the body.
    """
    edge = float(np.ptp(vertices, axis=0).max()) / TUNING.cells
    pad = TUNING.leak + 2
    points = spread(vertices[faces], edge)
    count = np.ceil(np.ptp(vertices, axis=0) / edge).astype(int) + 1
    # Both ends of each axis lie alike in their cells, so that the centre is not drawn to one side.
    low = (vertices.min(axis=0) + vertices.max(axis=0) - count * edge) / 2
    shape = count + 2 * pad
    wall = np.zeros(shape, dtype=bool)
    wall[tuple((np.floor((points - low) / edge).astype(int) + pad).T)] = True
    reach = 2 * TUNING.leak + 1
    thick = ndimage.maximum_filter(wall, reach)
    outside, _ = ndimage.label(~thick)
    body = ndimage.minimum_filter(outside != outside[0, 0, 0], reach)
    inside = body & ~wall
    if not inside.any():
        return None
    # Of walls that lie within, where one body goes on in another, the whole cell is full.
    within = wall & ~ndimage.maximum_filter(~body, 3)
    weight = inside + 0.5 * wall + 0.5 * within
    at = np.argwhere(weight > 0)
    share = weight[tuple(at.T)] * edge**3
    r = low + (at - pad + 0.5) * edge
    volume = float(share.sum())
    centre = share @ r / volume
    second = np.einsum("n,ni,nj->ij", share, r - centre, r - centre) + np.eye(3) * volume * edge**2 / 12.0
    return EvenBody(volume, centre, second, "filling"), float(inside.sum()) * edge**3


def spread(corners: Array, distance: float) -> Array:
    """Return points (N, 3) on triangles (F, 3, 3), their corners and more, no further apart than `distance`."""
    found = []
    while len(corners):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = edges.max(axis=1) > distance
        found.append(corners[~long].reshape(-1, 3))
        # Halved at the middle of their longest edge, which is brought to the front.
        order = (edges[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[long], order[:, :, None], axis=1), 1, 0)
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(found)
