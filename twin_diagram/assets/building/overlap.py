"""What closed bodies that overlap or touch hold together, each place once, and how much of it two hold: along rays.

Along a ray each triangle that faces it leads into a body, and each that faces away out of one. So the number of bodies
about every place of the ray is known: 1 inside, 2 and more where bodies overlap, as a handle that goes on within its
mug, 0 outside and in a cavity. Along rays that is exact; they lie closely side by side. It asks that each edge is run
through as often one way as the other, which two boxes that share a face do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from twin_diagram.assets.building.surface import Faces, Surface, edge_pairs, weld
from twin_diagram.assets.mesh import Cloud, Image, Mesh, sample
from twin_diagram.native import import_open3d
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    columns: int = 160
    """Rays along the longer edge of what they cross: a ball's volume is right to 1e-4."""

    aside: tuple[float, float] = (0.0131, 0.0073)
    """By how much rays are beside the middle of their columns, in columns: made things have edges in the middle."""

    pairs: int = 2_000_000
    """Rays and triangles that are compared at a time."""

    aloof: float = 1e-4
    """A point is judged so far above its surface, as a share of the object's size: far below any label's thickness."""


TUNING = Tuning()


def balanced(faces: Faces) -> bool:
    """Return whether triangles (F, 3) run through each edge as often one way as the other."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low, high = directed.min(axis=1), directed.max(axis=1)
    _, edge = np.unique(low * (int(faces.max()) + 1) + high, return_inverse=True)
    ways = np.where(directed[:, 0] < directed[:, 1], 1.0, -1.0)
    return bool((np.bincount(edge.reshape(-1), ways) == 0).all())


def overlap(surface: Surface) -> float:
    """Return the share of what a closed surface holds that lies in two bodies or more; 0 of a single body."""
    one, two = edge_pairs(surface.faces)
    graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(surface.faces), len(surface.faces)))
    if connected_components(graph, directed=False)[0] == 1:
        return 0.0
    _, length, bodies, _ = _stretches(_along_rays(surface.vertices)[0][surface.faces])
    held = float(length.sum())
    return float(length[bodies > 1.5].sum()) / held if held > 0.0 else 0.0


def united(vertices: Array, faces: Faces) -> tuple[float, Array, Array]:
    """Return volume [m³], first moments (3,) [m⁴] and second moments (3, 3) [m⁵] of what balanced triangles hold.

    Moments are about the origin of the vertices (V, 3).
    """
    turned, axes = _along_rays(vertices)
    p, length, _, edge = _stretches(turned[faces])
    first = length @ p
    second = np.einsum("n,ni,nj->ij", length, p, p)
    second += np.diag([*(length.sum() * edge**2 / 12), float((length**3).sum()) / 12])
    back, area = np.argsort(axes), float(edge.prod())
    return area * float(length.sum()), area * first[back], area * second[np.ix_(back, back)]


def in_view(mesh: Mesh, texture: Image, count: int) -> Cloud:
    """Return `count` points of a surface without those within another of its bodies, which no camera can see.

    A label may be a body half a millimetre proud of a box's side: the side below it would mix into its colours.
    """
    cloud, surface = sample(mesh, texture, count), weld(mesh.vertices[mesh.faces])
    hidden = buried(cloud, surface)
    if not hidden.any() or hidden.all():
        return cloud
    left = float(np.mean(~hidden))
    # A quarter more than should do: which points are hidden is chance.
    cloud = sample(mesh, texture, int(np.ceil(1.25 * count / left)))
    open_ = np.flatnonzero(~buried(cloud, surface))[:count]
    return Cloud(cloud.points[open_], cloud.normals[open_], cloud.colours[open_])


def buried(cloud: Cloud, surface: Surface) -> npt.NDArray[np.bool_]:
    """Return (N,) which points of a surface's cloud lie within another of its bodies; none where it is not closed."""
    hidden = np.zeros(len(cloud.points), dtype=bool)
    if not surface.closed:
        return hidden
    one, two = edge_pairs(surface.faces)
    graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(surface.faces), len(surface.faces)))
    count, body = connected_components(graph, directed=False)
    if count == 1:
        return hidden
    size = float(np.ptp(surface.vertices, axis=0).max())
    places = cloud.points + TUNING.aloof * size * cloud.normals
    for k in range(count):
        corners = surface.vertices[surface.faces[body == k]]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        near = np.flatnonzero(~hidden & ((places > low) & (places < high)).all(axis=1))
        if len(near):
            hidden[near] = _inside(places[near], surface.vertices, surface.faces[body == k])
    return hidden


def _inside(places: Array, vertices: Array, faces: Faces) -> npt.NDArray[np.bool_]:
    """Return (N,) which places a closed body holds: by most of three rays, whose cost hardly grows with its faces."""
    geometry = import_open3d().t.geometry
    scene = geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    held = scene.compute_occupancy(places.astype(np.float32), nthreads=1, nsamples=3)
    return np.asarray(held.numpy() > 0.5)


def _along_rays(vertices: Array) -> tuple[Array, list[int]]:
    """Return vertices with their longest axis last, that of rays, which then are the closest; and the order of axes."""
    along = int(np.argmax(np.ptp(vertices, axis=0)))
    axes = [(along + 1) % 3, (along + 2) % 3, along]
    return vertices[:, axes], axes


def _stretches(corners: Array) -> tuple[Array, Array, Array, Array]:
    """Return middles (N, 3), lengths and numbers of bodies (N,) of stretches of rays inside, and columns' edges (2,).

    Args:
        corners: (F, 3, 3), the third axis along the rays.
    """
    low, size = corners[..., :2].min(axis=(0, 1)), np.ptp(corners[..., :2].reshape(-1, 2), axis=0)
    count = np.maximum(np.ceil(TUNING.columns * size / max(float(size.max()), 1e-300)), 1).astype(np.int64)
    edge = size / count
    ray, at, way = _crossings(corners, low + TUNING.aside * edge, edge, count)
    order = np.lexsort((at, ray))
    ray, at, total = ray[order], at[order], np.r_[0.0, np.cumsum(way[order])]
    # A ray that just touches an edge may miss what it meets there: that is not to count in the rays after it.
    bodies = np.abs(total[1:] - total[np.searchsorted(ray, ray)])
    inside = (bodies[:-1] > 0.5) & (ray[1:] == ray[:-1])
    a, b, ray = at[:-1][inside], at[1:][inside], ray[:-1][inside]
    middle = low + (np.stack([ray // count[1], ray % count[1]], axis=1) + 0.5) * edge
    return np.column_stack([middle, (a + b) / 2]), b - a, bodies[:-1][inside], edge


def _crossings(corners: Array, low: Array, edge: Array, count: Faces) -> tuple[Faces, Array, Array]:
    """Return of each meeting of a ray with a triangle the ray's number, where along it, and 1 for in or −1 for out.

    Args:
        corners: (F, 3, 3), the third axis along the rays.
        low: (2,) the lowest corner of the columns.
        edge: (2,) of a column.
        count: (2,) of columns.
    """
    flat = (corners[..., :2] - low) / edge - 0.5  # rays are at whole numbers
    first = np.clip(np.ceil(flat.min(axis=1)), 0, None).astype(np.int64)
    last = np.minimum(np.floor(flat.max(axis=1)), count - 1).astype(np.int64)
    spans = np.maximum(last - first + 1, 0)
    asked = spans.prod(axis=1)
    ends = np.cumsum(asked)
    found: list[tuple[Faces, Array, Array]] = []
    start = 0
    while start < len(corners):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + TUNING.pairs, side="right")))
        own = slice(start, stop)
        which = np.repeat(np.arange(start, stop), asked[own])
        place = np.arange(len(which)) - np.repeat(ends[own] - asked[own] - before, asked[own])
        cell = first[which] + np.stack([place // spans[which, 1], place % spans[which, 1]], axis=1)
        side = np.roll(flat[which], -1, axis=1) - flat[which]
        to = cell[:, None] - flat[which]
        cross = side[..., 0] * to[..., 1] - side[..., 1] * to[..., 0]
        hit = (cross > 0.0).all(axis=1) | (cross < 0.0).all(axis=1)
        cross, which, cell = cross[hit], which[hit], cell[hit]
        # The share of each corner is the area across from it.
        at = (cross[:, [1, 2, 0]] * corners[which, :, 2]).sum(axis=1) / cross.sum(axis=1)
        found.append((cell[:, 0] * count[1] + cell[:, 1], at, -np.sign(cross[:, 0])))
        start = stop
    ray, at, way = (np.concatenate([one[k] for one in found]) for k in range(3))
    return ray, at, way
