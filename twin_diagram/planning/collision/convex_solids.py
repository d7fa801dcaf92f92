"""Convex solids: boxes, balls, drums, and polytopes as faces and edges, each with its exact distance from points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.errors import AssetError
from twin_diagram.planning.collision import solid_distances
from twin_diagram.planning.collision.solid_distances import Faces
from twin_diagram.signals.arrays import Array

_ROUND: Final = 16
"""Points around a drum's rim that stand for it."""


class Solid(ABC):
    """A convex solid, fixed in some frame G."""

    @abstractmethod
    def distance(self, p_G: Array) -> tuple[Array, Array]:
        """Return signed distances (M,) [m] of points (M, 3), negative inside, and outward unit gradients (M, 3)."""

    @property
    @abstractmethod
    def box(self) -> Box:
        """A box that holds the solid, as close as its axes allow."""

    @property
    @abstractmethod
    def surface(self) -> tuple[Array, Array]:
        """Outermost points (S, 3) and unit normals there (S, 3), of faces and, at corners, of what lies between."""

    @property
    @abstractmethod
    def ball(self) -> tuple[Array, float]:
        """Centre (3,) and radius of a ball that holds the solid [m]."""


@dataclass(frozen=True)
class Box(Solid):
    """A box with half edge lengths `half` (3,), its axes the columns of `R_GB` (3, 3), centred at `p_GB` (3,)."""

    half: Array
    R_GB: Array
    p_GB: Array

    def distance(self, p_G: Array) -> tuple[Array, Array]:
        """Return signed distances and gradients, see `Solid`."""
        distance, slope_B = solid_distances.to_box((p_G - self.p_GB) @ self.R_GB, self.half)
        return distance, slope_B @ self.R_GB.T

    @property
    def box(self) -> Box:
        """See `Solid`."""
        return self

    @property
    def surface(self) -> tuple[Array, Array]:
        """See `Solid`."""
        signs = np.array(list(product((-1.0, 1.0), repeat=3)))
        faces = np.concatenate([np.eye(3) * sign for sign in signs])
        normals = np.concatenate([faces, signs / np.sqrt(3.0)])
        points = np.concatenate([np.repeat(signs, 3, axis=0), signs]) * self.half
        return points @ self.R_GB.T + self.p_GB, normals @ self.R_GB.T

    @property
    def ball(self) -> tuple[Array, float]:
        """See `Solid`."""
        return self.p_GB, float(np.linalg.norm(self.half))

    @property
    def vertices(self) -> Array:
        """The corners, (8, 3)."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return (signs * self.half) @ self.R_GB.T + self.p_GB


@dataclass(frozen=True)
class Ball(Solid):
    """A ball; also the end of whatever is rounded."""

    centre: Array
    size: float

    def distance(self, p_G: Array) -> tuple[Array, Array]:
        """Return signed distances and gradients, see `Solid`."""
        return solid_distances.to_ball(p_G - self.centre, np.full(len(p_G), self.size))

    @property
    def box(self) -> Box:
        """See `Solid`."""
        return Box(np.full(3, self.size), np.eye(3), self.centre)

    @property
    def surface(self) -> tuple[Array, Array]:
        """See `Solid`."""
        normals = np.concatenate([np.eye(3), -np.eye(3)])
        return self.centre + self.size * normals, normals

    @property
    def ball(self) -> tuple[Array, float]:
        """See `Solid`."""
        return self.centre, self.size


@dataclass(frozen=True)
class Drum(Solid):
    """A cylinder of radius `size` and half length `half` about the axis `axis` (3,), centred at `centre` (3,)."""

    centre: Array
    axis: Array
    size: float
    half: float

    def distance(self, p_G: Array) -> tuple[Array, Array]:
        """Return signed distances and gradients, see `Solid`."""
        axis, one = np.broadcast_to(self.axis, p_G.shape), np.ones(len(p_G))
        return solid_distances.to_drum(p_G - self.centre, axis, self.size * one, self.half * one)

    @property
    def box(self) -> Box:
        """See `Solid`."""
        side = np.cross(self.axis, np.eye(3)[np.abs(self.axis).argmin()])
        side = side / np.linalg.norm(side)
        R_GB = np.column_stack([side, np.cross(self.axis, side), self.axis])
        return Box(np.array([self.size, self.size, self.half]), R_GB, self.centre)

    @property
    def surface(self) -> tuple[Array, Array]:
        """See `Solid`."""
        angles = np.arange(_ROUND) * (2.0 * np.pi / _ROUND)
        out = np.cos(angles)[:, None] * self.box.R_GB[:, 0] + np.sin(angles)[:, None] * self.box.R_GB[:, 1]
        points, normals = [], []
        for end in (self.axis, -self.axis):
            for normal in (out, np.broadcast_to(end, out.shape), (out + end) / np.sqrt(2.0)):
                points.append(self.centre + self.size * out + self.half * end)
                normals.append(normal)
        return np.concatenate(points), np.concatenate(normals)

    @property
    def ball(self) -> tuple[Array, float]:
        """See `Solid`."""
        return self.centre, float(np.hypot(self.size, self.half))


class Polytope(Solid):
    """The convex hull of points.

    Attributes:
        faces: of it, with its edges.

    Args:
        points: (V, 3) [m], not all in a plane.

    Raises:
        AssetError: the points span no volume.
    """

    def __init__(self, points: Array) -> None:
        try:
            hull = ConvexHull(np.asarray(points, dtype=float))
        except (QhullError, ValueError) as error:
            raise AssetError(f"a convex piece of {len(points)} points spans no volume") from error
        self._points = hull.points[hull.vertices]
        # Qhull gives triangles: those in one plane are one face.
        faces = _in_one_plane(np.round(hull.equations, 9), float(np.ptp(self._points, axis=0).max()))
        normals = np.array([hull.equations[members[0], :3] for members in faces])
        offsets = np.array([hull.equations[members[0], 3] for members in faces])
        edges: set[tuple[int, int]] = set()
        sides: list[list[tuple[Array, float]]] = []
        for face, members in enumerate(faces):
            count: dict[tuple[int, int], int] = {}
            for row in members:
                a, b, c = map(int, hull.simplices[row])
                for i, j in ((a, b), (b, c), (c, a)):
                    key = (min(i, j), max(i, j))
                    count[key] = count.get(key, 0) + 1
            border = [key for key, times in count.items() if times == 1]
            edges.update(border)
            centre = hull.points[[k for key in border for k in key]].mean(axis=0)
            sides.append([])
            for i, j in border:
                side = np.cross(hull.points[j] - hull.points[i], normals[face])
                side /= np.linalg.norm(side)
                if side @ (centre - hull.points[i]) > 0:
                    side = -side
                sides[face].append((side, float(side @ hull.points[i])))
        ordered = sorted(edges)
        starts = hull.points[[i for i, _ in ordered]]
        most = max(map(len, sides))
        side_normals = np.zeros((len(faces), most, 3))
        side_offsets = np.full((len(faces), most), np.inf)
        for face, borders in enumerate(sides):
            for k, (normal, offset) in enumerate(borders):
                side_normals[face, k], side_offsets[face, k] = normal, offset
        spans = hull.points[[j for _, j in ordered]] - starts
        self.faces = Faces(normals, offsets, side_normals, side_offsets, starts, spans)
        self._alone = Faces.stacked([self.faces])
        self._box = bounding_box(self._points)
        self._surface = _corners(hull)

    def distance(self, p_G: Array) -> tuple[Array, Array]:
        """Return signed distances and gradients, see `Solid`."""
        return solid_distances.to_polytope(p_G, np.zeros(len(p_G), dtype=int), self._alone)

    @property
    def box(self) -> Box:
        """See `Solid`."""
        return self._box

    @property
    def surface(self) -> tuple[Array, Array]:
        """See `Solid`."""
        return self._surface

    @property
    def ball(self) -> tuple[Array, float]:
        """See `Solid`."""
        centre = self._box.p_GB
        return centre, float(np.linalg.norm(self._points - centre, axis=1).max())


def _corners(hull: ConvexHull) -> tuple[Array, Array]:
    """Return each corner of each triangle with its normal, and each corner with the mean of its faces'."""
    corner, face = hull.simplices.ravel(), np.repeat(np.arange(len(hull.simplices)), 3)
    normals = hull.equations[face, :3]
    mean = np.zeros_like(hull.points)
    np.add.at(mean, corner, normals)
    between = mean[hull.vertices] / np.linalg.norm(mean[hull.vertices], axis=1, keepdims=True)
    return np.concatenate([hull.points[corner], hull.points[hull.vertices]]), np.concatenate([normals, between])


def bounding_box(points: Array) -> Box:
    """Return a box around points (V, 3), along the axes of their frame."""
    low, high = points.min(axis=0), points.max(axis=0)
    return Box((high - low) / 2, np.eye(3), (high + low) / 2)


def _in_one_plane(planes: Array, scale: float) -> list[list[int]]:
    """Return the rows of planes (T, 4), normal and offset, that are alike, in the order of the first of each.

    Args:
        planes: as Qhull has them.
        scale: of the solid [m].
    """
    faces: list[list[int]] = []
    known = np.empty_like(planes)  # of each face the first plane: one by one they took a tick of the planner
    for row, plane in enumerate(planes):
        off = np.abs(known[: len(faces)] - plane)
        alike = (off[:, :3] <= 1e-6 + 1e-5 * np.abs(plane[:3])).all(axis=1) & (off[:, 3] < 1e-7 * (1 + scale))
        if alike.any():
            faces[int(alike.argmax())].append(row)
        else:
            known[len(faces)] = plane
            faces.append([row])
    return faces


def solid_of(points: Array) -> Solid:
    """Return a solid that holds points (V, 3): their hull as a `Box` or `Polytope`, or the `Drum` around a prism.

    Prisms of 12 sides or more stand for cylinders; the drum around one is larger by up to 3.5 % of the radius.
    """
    points = np.asarray(points, dtype=float)
    if len(points) == 8:
        box = _box_of(points)
        if box is not None:
            return box
    if len(points) >= 24 and len(points) % 2 == 0:
        drum = _drum_of(points)
        if drum is not None:
            return drum
    return Polytope(points)


def _box_of(points: Array) -> Box | None:
    centre, corner = points.mean(axis=0), points[0]
    order = np.argsort(np.linalg.norm(points - corner, axis=1))
    # The two nearest corners are along edges; the third edge may be longer than the diagonal of these two.
    for k in (3, 4):
        edges = points[order[[1, 2, k]]] - corner
        lengths = np.linalg.norm(edges, axis=1)
        if lengths.min() < 1e-9:
            continue
        axes = edges / lengths[:, None]
        if np.allclose(axes @ axes.T, np.eye(3), atol=1e-9):
            box = Box(lengths / 2, axes.T.copy(), centre)
            near = np.linalg.norm(box.vertices[:, None] - points[None], axis=2).min(axis=1)
            if near.max() < 1e-9:
                return box
    return None


def _drum_of(points: Array) -> Drum | None:
    centre = points.mean(axis=0)
    count = len(points) // 2
    _, axes = np.linalg.eigh(np.cov((points - centre).T))
    for axis in axes.T:
        height = (points - centre) @ axis
        across = points - centre - height[:, None] * axis
        radius = np.linalg.norm(across, axis=1)
        half = np.abs(height).max()
        if np.ptp(radius) > 1e-6 * radius.max() or np.ptp(np.abs(height)) > 1e-9 or (height > 0).sum() != count:
            continue
        # Evenly spread around the axis?
        side = np.cross(axis, across[0])
        angle = np.sort(np.arctan2(across[height > 0] @ side, across[height > 0] @ across[0]))
        if np.allclose(np.diff(angle), 2 * np.pi / count, atol=1e-4):
            return Drum(centre, axis, float(radius.max()), float(half))
    return None
