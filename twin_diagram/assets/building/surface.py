"""Triangles as a surface: which vertices are one, whether it is closed, which side is out, where it is smooth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from twin_diagram.assets.mesh import Mesh
from twin_diagram.signals.arrays import Array

Faces = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    weld: float = 1e-5
    """Vertices nearer than this share of the object's size are one: beyond single precision, below any detail."""

    crease: float = 40.0
    """Angle between neighbouring triangles from which their edge is sharp [deg]; 12 sides make a smooth cylinder."""


TUNING = Tuning()


@dataclass(frozen=True)
class Surface:
    """Welded triangles.

    Attributes:
        vertices: (V, 3), each once.
        faces: (F, 3) indices.
        kept: (F,) which of the triangles given these are; those without area are left out, unless they close it.
        turned: (F,) whether their corners run the other way round than was given.
        closed: whether each edge has exactly two triangles, which run through it in opposite directions.
    """

    vertices: Array
    faces: Faces
    kept: npt.NDArray[np.int64]
    turned: npt.NDArray[np.bool_]
    closed: bool

    def of_corners(self, values: Array) -> Array:
        """Return what belongs to the corners (F, 3, k) of the triangles given, for those kept, as they are now."""
        own = values[self.kept]
        return np.where(self.turned[:, None, None], own[:, ::-1], own)


def weld(corners: Array) -> Surface:
    """Return triangles (F, 3, 3) with shared vertices and their outside out.

    Triangles that disagree with their neighbours are turned, all of them where the whole is inside out, and a closed
    body beside others that is: inside another one it is a cavity.
    """
    points = corners.reshape(-1, 3)
    step = TUNING.weld * max(float(np.ptp(points, axis=0).max()), 1e-300)
    # Each place as one number, which sorts like its three and many times as quickly.
    x, y, z = np.round((points - points.min(axis=0)) / step).astype(np.int64).T
    _, first, inverse = np.unique((x << 42) + (y << 21) + z, return_index=True, return_inverse=True)
    vertices, given = points[first], inverse.reshape(-1, 3)
    apart = (given != np.roll(given, 1, axis=1)).all(axis=1)
    kept = np.flatnonzero(apart)
    if not _is_closed(given[kept]):  # slivers may close a surface, or be left over beside it
        kept = np.flatnonzero(apart & (_heights(vertices[given]) > step))
    given = faces = given[kept]
    if len(faces) and not _is_consistent(faces):
        faces = _consistent(faces)
    if len(faces) and signed_volume(vertices, faces) < 0:
        faces = faces[:, ::-1]
    if len(faces):
        faces = _bodies_outward(vertices, faces)
    turned = faces[:, 0] != given[:, 0]
    return Surface(vertices, faces, kept, turned, len(faces) > 0 and _is_closed(faces))


def _heights(corners: Array) -> Array:
    """Return the least height of triangles (F, 3, 3)."""
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.asarray(doubled / np.maximum(edges, 1e-300))


def signed_volume(vertices: Array, faces: Faces) -> float:
    """Return what the triangles enclose, seen from their middle; positive where they face outwards."""
    a, b, c = (vertices[faces[:, k]] - vertices[faces].mean(axis=(0, 1)) for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def _edges(faces: Faces) -> tuple[Faces, npt.NDArray[np.bool_], Faces]:
    """Return the triangles' edges, lower vertex first (3F, 2); whether they run upwards; and whose they are."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    upwards = directed[:, 0] < directed[:, 1]
    return np.where(upwards[:, None], directed, directed[:, ::-1]), upwards, np.tile(np.arange(len(faces)), 3)


def _pairs(faces: Faces) -> tuple[Faces, Faces, npt.NDArray[np.bool_]]:
    """Return the two triangles at each edge that has exactly two, and whether they run through it in opposite ways."""
    edges, upwards, owner = _edges(faces)
    numbers = edges[:, 0] * (int(edges.max(initial=0)) + 1) + edges[:, 1]
    order = np.argsort(numbers)
    same = np.diff(numbers[order], prepend=-1, append=-1) == 0  # as the one before it
    at = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:])
    # Which of two that are the same comes first is chance: the one that was given first.
    first, second = np.sort([order[at], order[at + 1]], axis=0)
    return owner[first], owner[second], upwards[first] != upwards[second]


def edge_pairs(faces: Faces) -> tuple[Faces, Faces]:
    """Return the two triangles at each edge that has exactly two."""
    return _pairs(faces)[:2]


def _is_consistent(faces: Faces) -> bool:
    return bool(_pairs(faces)[2].all())


def _is_closed(faces: Faces) -> bool:
    one, _, opposite = _pairs(faces)
    return 2 * len(one) == 3 * len(faces) and bool(opposite.all())


def _consistent(faces: Faces) -> Faces:
    """Return the triangles turned so that neighbours agree; where none can (a Möbius strip), as they were.

    Each triangle counts twice, as it is and turned; those that agree are connected, and one of two halves is taken.
    """
    one, two, opposite = _pairs(faces)
    count = len(faces)
    other = np.where(opposite, two, two + count)
    mirrored = np.where(opposite, two + count, two)
    rows, columns = np.concatenate([one, one + count]), np.concatenate([other, mirrored])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    return np.where((label[count:] < label[:count])[:, None], faces[:, ::-1], faces)


def _bodies_outward(vertices: Array, faces: Faces) -> Faces:
    """Return the triangles, those of closed bodies turned that face inwards and lie within no other body."""
    one, two, opposite = _pairs(faces)
    graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(faces), len(faces)))
    count, body = connected_components(graph, directed=False)
    if count == 1:
        return faces
    corners = vertices[faces] - vertices[faces].mean(axis=(0, 1))
    volumes = np.bincount(body, np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))
    closed = 2 * np.bincount(body[one][opposite], minlength=count) == 3 * np.bincount(body)
    inward = np.flatnonzero(closed & (volumes < 0))
    if not len(inward):
        return faces
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, body, corners.min(axis=1))
    np.maximum.at(high, body, corners.max(axis=1))
    wrong = np.zeros(count, dtype=bool)
    for k in inward:
        around = closed & (volumes > 0) & (low < low[k]).all(axis=1) & (high > high[k]).all(axis=1)
        place = corners[np.argmax(body == k), 0]
        wrong[k] = not around.any() or windings(place[None], corners[around[body]])[0] < 0.5
    return np.where(wrong[body][:, None], faces[:, ::-1], faces)


def outer_faces(surface: Surface) -> Faces:
    """Return the triangles of a closed surface without those of its cavities, which nothing outside can meet."""
    one, two, _ = _pairs(surface.faces)
    graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(surface.faces), len(surface.faces)))
    _, body = connected_components(graph, directed=False)
    a, b, c = np.moveaxis(surface.vertices[surface.faces] - surface.vertices.mean(axis=0), 1, 0)
    volumes = np.bincount(body, np.einsum("fi,fi->f", a, np.cross(b, c)))
    return surface.faces[volumes[body] > 0]


def windings(places: Array, corners: Array) -> Array:
    """Return (N,) how often triangles (F, 3, 3) wind around places: 1 inside, 0 outside (van Oosterom, 1983)."""
    a, b, c = np.moveaxis(corners - places[:, None, None], 2, 0)
    x, y, z = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    volume = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
    along = x * y * z + np.einsum("nfi,nfi->nf", a, b) * z + np.einsum("nfi,nfi->nf", b, c) * x
    angle = np.arctan2(volume, along + np.einsum("nfi,nfi->nf", c, a) * y)
    return np.asarray(angle.sum(axis=1) / (2.0 * np.pi))


def with_normals(surface: Surface, uv: Array) -> Mesh:
    """Return a mesh whose normals are smooth across edges that are not sharp.

    Triangles count by their angle at the vertex, so that it does not matter how a side is cut into triangles.

    Args:
        surface: V vertices, F triangles.
        uv: (F, 3, 2) of the triangles' corners.
    """
    vertices, faces = surface.vertices, surface.faces
    corners = vertices[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
    one, two, _ = _pairs(faces)
    smooth = np.einsum("ei,ei->e", unit[one], unit[two]) > np.cos(np.deg2rad(TUNING.crease))
    graph = coo_matrix((np.ones(int(smooth.sum())), (one[smooth], two[smooth])), shape=(len(faces), len(faces)))
    group = connected_components(graph, directed=False)[1]
    keys = np.repeat(group, 3).astype(np.int64) * len(vertices) + faces.reshape(-1)
    found, which = np.unique(keys, return_inverse=True)
    turned = (_angles(corners)[:, :, None] * unit[:, None]).reshape(-1, 3)
    summed = np.stack([np.bincount(which, turned[:, k]) for k in range(3)], axis=1)
    length = np.linalg.norm(summed, axis=1)
    none = np.flatnonzero(length[which] == 0.0)  # corners that have their triangle's own normal
    which[none] = len(found) + np.arange(len(none))
    places = vertices[np.concatenate([found % len(vertices), faces.reshape(-1)[none]])]
    normals = np.concatenate([summed / np.maximum(length, 1e-300)[:, None], unit[none // 3]])
    return _shared(np.concatenate([places, normals], axis=1), which, uv.reshape(-1, 2))


def _shared(points: Array, which: Faces, uv: Array) -> Mesh:
    """Return the mesh of which each vertex, with its normal and texture coordinates, is there once.

    Args:
        points: (N, 6) places and normals.
        which: (3F,) of them each corner of the triangles has.
        uv: (3F, 2) of the corners.
    """
    rank, _ = _ranked(points)
    rank_uv, count = _ranked(uv)
    _, first, index = np.unique(rank[which] * count + rank_uv, return_index=True, return_inverse=True)
    own = points[which[first]]
    return Mesh(own[:, :3], own[:, 3:], uv[first], index.reshape(-1, 3))


def _ranked(rows: Array) -> tuple[Faces, int]:
    """Return where each of the rows (N, k) comes among the different ones in order (N,), and how many there are."""
    order = np.lexsort(rows.T[::-1])
    new = (np.diff(rows[order], axis=0, prepend=rows[order[:1]]) != 0.0).any(axis=1)
    rank = np.empty(len(rows), dtype=np.int64)
    rank[order] = np.cumsum(new)
    return rank, int(new.sum()) + 1


def _angles(corners: Array) -> Array:
    """Return the angles (F, 3) of triangles (F, 3, 3) at their corners [rad]."""
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(ahead, back), axis=2)
    return np.asarray(np.arctan2(sine, np.einsum("fki,fki->fk", ahead, back)))
