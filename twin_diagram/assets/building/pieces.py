"""Convex pieces that together hold an object: its hull where it is nearly convex, else V-HACD's, made to hold it."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from twin_diagram.assets.building.inertia import hull_of, spread
from twin_diagram.assets.building.surface import Faces
from twin_diagram.errors import AssetError
from twin_diagram.runtime.child_process import environment
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    full: float = 0.85
    """Share of its hull that an object fills to count as convex: scanned boxes have 0.84 at least, mugs 0.2."""

    dent: float = 0.06
    """Or else how deep the surface lies below the hull, 99 % of it, as a share of the object's size, …"""

    least_dent: float = 0.003
    """… no less than this [m], which does not matter to a planner that keeps centimetres, …"""

    most_dent: float = 0.01
    """… and no more [m]."""

    hollow: float = 0.08
    """Share of the surface that faces more of the hull's inside than `most_dent`, from which it is a hollow, thin
    though its walls are: of a bowl it is 0.45, of scanned boxes and cans up to 0.04."""

    products: int = 100_000_000
    """Points times planes of a hull, of which the depth below it is asked: a second; of a smooth body's hull, which may
    have 30,000 planes, some thousand of the points tell it as well."""

    asked: int = 2000
    """Triangles of which that is asked, about, …"""

    sights: int = 60
    """… and of those that face the hull's inside, how many are asked whether the surface itself is before them."""

    step: float = 0.02
    """Distance of the points that are looked at on the surface, as a share of the object's size."""

    most: int = 12
    """Pieces: the planner's work grows with them, and a mug shows its hollow and its handle with twelve."""

    many: int = 500_000
    """Points on the surface; a mesh that would be looked at in more has one in each little cube."""

    cells: int = 30_000
    """V-HACD's voxels: a mug takes some 4 s; with 100,000 it takes 12 s, and pieces are 8 % smaller."""

    corners: int = 48
    """Vertices of a piece of V-HACD's."""

    patience: float = 60.0
    """Time after which the hull is taken instead [s]."""

    turn: float = 20.0
    """Faces of a hull whose normals differ by less count as one where it is made simpler [deg]."""

    simple: int = 64
    """A hull with no more vertices is left as it is."""


TUNING = Tuning()


@dataclass(frozen=True)
class Pieces:
    """Convex pieces' vertices, each (m, 3) [m], and a note on how they came about."""

    vertices: tuple[Array, ...]
    how: str


def pieces_of(vertices: Array, faces: Faces, volume: float) -> Pieces:
    """Return convex pieces that hold a surface.

    Args:
        vertices: of the surface (V, 3) [m].
        faces: its triangles (F, 3).
        volume: within it [m³].
    """
    size = float(np.ptp(vertices, axis=0).max())
    hull = hull_of(vertices)
    points = spread(vertices[faces], TUNING.step * size)
    if len(points) > TUNING.many:  # of long thin triangles there are a hundred where one would do
        points = np.concatenate([vertices, thinned(points, TUNING.step * size / 4)])
    else:  # each corner came once a triangle: six times
        points = np.unique(points, axis=0)
    allowed = float(np.clip(TUNING.dent * size, TUNING.least_dent, TUNING.most_dent))
    full = volume >= TUNING.full * hull.volume
    if full or (dent(hull, points) <= allowed and hollow(hull, vertices[faces]) <= TUNING.hollow):
        return Pieces((simplified(hull),), "its convex hull")
    found = taken_apart(vertices, faces)
    if not found:
        return Pieces((simplified(hull),), "its convex hull, for it could not be taken apart")
    return Pieces(tuple(holding(found, points)), f"{len(found)} pieces of V-HACD")


def thinned(points: Array, edge: float) -> Array:
    """Return one of the points (N, 3) in each cube of that edge [m] that has any."""
    x, y, z = np.floor((points - points.min(axis=0)) / edge).astype(np.int64).T
    return points[np.unique((x << 42) + (y << 21) + z, return_index=True)[1]]


def dent(hull: ConvexHull, points: Array) -> float:
    """Return how deep points (N, 3) lie below a hull [m], but for the deepest hundredth."""
    planes = np.unique(np.round(hull.equations, 9), axis=0)
    some = points[:: max(1, len(points) * len(planes) // TUNING.products)]
    depth = np.full(len(some), np.inf)
    for plane in planes:
        depth = np.minimum(depth, -(some @ plane[:3] + plane[3]))
    return float(np.quantile(depth, 0.99))


def hollow(hull: ConvexHull, corners: Array) -> float:
    """Return the share of a surface, triangles (F, 3, 3), from which one sees out, through more than `most_dent`.

    How deep it lies below the hull does not tell: the floor of a bowl is as near to it as the bowl is thick. What faces
    a cavity that is closed sees the surface.
    """
    some = corners[:: max(1, len(corners) // TUNING.asked)]
    across = np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0])
    twice = np.linalg.norm(across, axis=1)
    way = across / np.maximum(twice, 1e-30)[:, None]
    middle = some.mean(axis=1)
    leave = np.full(len(some), np.inf)
    for plane in np.unique(np.round(hull.equations, 9), axis=0):
        out = way @ plane[:3]
        left = -(middle @ plane[:3] + plane[3])
        leave = np.where(out > 1e-6, np.minimum(leave, left / np.maximum(out, 1e-6)), leave)
    deep = np.flatnonzero(leave > TUNING.most_dent)
    share = float(twice[deep].sum() / max(float(twice.sum()), 1e-30))
    if share <= TUNING.hollow:
        return share
    sights = deep[:: max(1, len(deep) // TUNING.sights)]
    return share * float(np.mean([not _meets(middle[k], way[k], corners) for k in sights]))


def _meets(start: Array, way: Array, corners: Array) -> bool:
    """Return whether a ray, from just off its start, meets a triangle of (F, 3, 3) (Möller and Trumbore, 1997)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    side = np.cross(way, b)
    det = np.einsum("fi,fi->f", a, side)
    inverse = 1.0 / np.where(np.abs(det) > 1e-15, det, np.inf)
    off = start - corners[:, 0]
    u = np.einsum("fi,fi->f", off, side) * inverse
    turned = np.cross(off, a)
    v, t = turned @ way * inverse, np.einsum("fi,fi->f", b, turned) * inverse
    return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-5) & (np.abs(det) > 1e-15)).any())


def simplified(hull: ConvexHull) -> Array:
    """Return the vertices of a polytope of few faces that holds the hull, and hardly more.

    Its planes are those of the hull's faces, the large ones first, that differ from one another, moved out until they
    hold it.
    """
    own = hull.points[hull.vertices]
    if len(own) <= TUNING.simple:
        return np.asarray(own)
    corners = hull.points[hull.simplices]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    planes, inverse = np.unique(np.round(hull.equations[:, :3], 4), axis=0, return_inverse=True)
    total = np.bincount(inverse.reshape(-1), weights=areas)
    left, chosen = planes[np.argsort(-total)], []
    while len(left):  # each largest one takes away all that are like it, so a million faces take seconds
        chosen.append(left[0] / np.linalg.norm(left[0]))
        left = left[1:][left[1:] @ chosen[-1] < np.cos(np.deg2rad(TUNING.turn))]
    normals = np.array(chosen)
    reach = (own @ normals.T).max(axis=0)
    try:
        met = HalfspaceIntersection(np.column_stack([normals, -reach]), own.mean(axis=0)).intersections
    except (QhullError, ValueError):
        return np.asarray(own)
    kept = met[np.isfinite(met).all(axis=1)]
    _, first = np.unique(np.round(kept, 7), axis=0, return_index=True)
    return np.asarray(kept[np.sort(first)])


def holding(pieces: list[Array], points: Array) -> list[Array]:
    """Return the pieces, each grown by those of the points that lie outside of all of them and nearest to it."""
    hulls = [ConvexHull(piece) for piece in pieces]
    beyond = np.stack([farthest_out(points, h) for h in hulls])
    nearest, outside = beyond.argmin(axis=0), beyond.min(axis=0) > 0
    grown = [ConvexHull(np.concatenate([piece, points[outside & (nearest == k)]])) for k, piece in enumerate(pieces)]
    return [simplified(hull) for hull in grown]


def farthest_out(points: Array, hull: ConvexHull) -> Array:
    """Return how far points (N, 3) lie beyond the plane of a hull's that each is farthest beyond [m].

    Within the hull it is negative. Plane by plane: numbers that lie side by side are compared the fastest.
    """
    planes = np.unique(hull.equations, axis=0)
    return np.asarray((planes[:, :3] @ points.T + planes[:, 3:]).max(axis=0))


def taken_apart(
    vertices: Array, faces: Faces, method: Literal["vhacd", "coacd"] = "vhacd", patience: float | None = None
) -> list[Array]:
    """Return the pieces' vertices, each (m, 3) [m], that V-HACD or CoACD finds; none where it fails or takes too long.

    It runs in a process of its own: it meets meshes of all kinds, and neither its end nor a signal may wait for it.

    Args:
        vertices: of the surface (V, 3) [m].
        faces: its triangles (F, 3).
        method: of `apart_process.METHODS`.
        patience: time after which it is ended [s]; None: `TUNING.patience`.

    Raises:
        AssetError: its package is not installed.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "mesh.npz"), Path(folder, "pieces.npz")
        np.savez(given, vertices=vertices, faces=faces)
        try:
            done = subprocess.run(
                [sys.executable, "-m", "twin_diagram.assets.building.apart_process", method, str(given), str(made)],
                env=environment(),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=TUNING.patience if patience is None else patience,
            )
        except subprocess.TimeoutExpired:
            return []
        if lacking := re.search(rb"No module named '(vhacdx|coacd)'", done.stderr):
            package = lacking.group(1).decode()
            raise AssetError(f"taking an object apart needs the package {package}: pip install {package}")
        if done.returncode != 0 or not made.is_file():
            return []
        with np.load(made, allow_pickle=False) as data:
            found = [np.array(data[name]) for name in data.files]
    return [piece for piece in found if _has_volume(piece)]


def _has_volume(piece: Array) -> bool:
    """Return whether a piece (m, 3) has one: slivers are flat but for rounding."""
    try:
        return hull_of(piece).volume > 0.0
    except AssetError:
        return False
