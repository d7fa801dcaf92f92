"""Signed distances from points to convex solids, exact and for many points at once.

Boxes have a closed form. Any other polytope is a set of faces and edges: outside, the nearest point lies inside a
face, or else on an edge; inside, the nearest face is the one whose plane is nearest.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Bounds against division by zero, far below any length that matters."""

    tiny: float = 1e-12
    """Lengths below this have no direction [m]: a picometre."""


TUNING = Tuning()


class Solid(ABC):
    """A convex solid, fixed in some frame G."""

    @abstractmethod
    def distance(self, p_G: Array) -> tuple[Array, Array]:
        """Return signed distances (M,) [m] of points (M, 3), negative inside, and outward unit gradients (M, 3)."""

    @abstractmethod
    def lower_bound(self, p_G: Array) -> Array:
        """Return something cheap, (M,), that is never above the distance of a point outside."""

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
        p_B = (p_G - self.p_GB) @ self.R_GB
        excess = np.abs(p_B) - self.half
        outside = np.maximum(excess, 0.0)
        norm = np.sqrt(np.einsum("mi,mi->m", outside, outside))
        depth = excess.max(axis=1)
        out = norm > TUNING.tiny
        slope = outside / np.where(out, norm, 1.0)[:, None]
        if not out.all():
            inner = np.flatnonzero(~out)
            slope[inner] = 0.0
            slope[inner, excess[inner].argmax(axis=1)] = 1.0
        slope *= np.where(p_B < 0.0, -1.0, 1.0)
        return np.where(out, norm, depth), slope @ self.R_GB.T

    def lower_bound(self, p_G: Array) -> Array:
        """Return bounds from below, see `Solid`."""
        p_B = (p_G - self.p_GB) @ self.R_GB
        outside = np.maximum(np.abs(p_B) - self.half, 0.0)
        return np.sqrt(np.einsum("mi,mi->m", outside, outside))

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
        offset = p_G - self.centre
        norm = np.linalg.norm(offset, axis=1)
        slope = np.where(
            norm[:, None] > TUNING.tiny, offset / np.maximum(norm, TUNING.tiny)[:, None], [[0.0, 0.0, 1.0]]
        )
        return norm - self.size, slope

    def lower_bound(self, p_G: Array) -> Array:
        """Return bounds from below, see `Solid`."""
        return np.linalg.norm(p_G - self.centre, axis=1) - self.size

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
        offset = p_G - self.centre
        height = offset @ self.axis
        across = offset - height[:, None] * self.axis
        radius = np.sqrt(np.einsum("mi,mi->m", across, across))
        outward = across / np.maximum(radius, TUNING.tiny)[:, None]
        upward = np.where(height < 0.0, -1.0, 1.0)
        beside, beyond = radius - self.size, np.abs(height) - self.half
        out_beside, out_beyond = np.maximum(beside, 0.0), np.maximum(beyond, 0.0)
        norm = np.hypot(out_beside, out_beyond)
        out = norm > TUNING.tiny
        safe = np.where(out, norm, 1.0)
        sideways = np.where(out, out_beside / safe, beside >= beyond)
        endways = np.where(out, out_beyond / safe, beside < beyond)
        slope = sideways[:, None] * outward + (endways * upward)[:, None] * self.axis
        return np.where(out, norm, np.maximum(beside, beyond)), slope

    def lower_bound(self, p_G: Array) -> Array:
        """Return bounds from below, see `Solid`."""
        return np.linalg.norm(p_G - self.centre, axis=1) - self.ball[1]

    @property
    def ball(self) -> tuple[Array, float]:
        """See `Solid`."""
        return self.centre, float(np.hypot(self.size, self.half))


class Polytope(Solid):
    """The convex hull of points.

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
        planes = np.round(hull.equations, 9)
        scale = np.ptp(self._points, axis=0).max()
        faces: list[tuple[Array, list[int]]] = []
        for row, equation in enumerate(planes):
            for known, members in faces:
                if np.allclose(known[:3], equation[:3], atol=1e-6) and abs(known[3] - equation[3]) < 1e-7 * (1 + scale):
                    members.append(row)
                    break
            else:
                faces.append((equation, [row]))
        self._normals = np.array([hull.equations[members[0], :3] for _, members in faces])
        self._offsets = np.array([hull.equations[members[0], 3] for _, members in faces])
        edges: set[tuple[int, int]] = set()
        sides: list[list[tuple[Array, float]]] = []
        for face, (_, members) in enumerate(faces):
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
                side = np.cross(hull.points[j] - hull.points[i], self._normals[face])
                side /= np.linalg.norm(side)
                if side @ (centre - hull.points[i]) > 0:
                    side = -side
                sides[face].append((side, float(side @ hull.points[i])))
        ordered = sorted(edges)
        self._starts = hull.points[[i for i, _ in ordered]]
        span = hull.points[[j for _, j in ordered]] - self._starts
        self._spans, self._span_squares = span, np.einsum("ei,ei->e", span, span)
        self._start_squares = np.einsum("ei,ei->e", self._starts, self._starts)
        self._span_starts = np.einsum("ei,ei->e", span, self._starts)
        most = max(map(len, sides))
        self._side_normals = np.zeros((len(faces), most, 3))
        self._side_offsets = np.full((len(faces), most), np.inf)
        for face, borders in enumerate(sides):
            for k, (normal, offset) in enumerate(borders):
                self._side_normals[face, k], self._side_offsets[face, k] = normal, offset
        self._box = bounding_box(self._points)

    def distance(self, p_G: Array) -> tuple[Array, Array]:
        """Return signed distances and gradients, see `Solid`."""
        height = p_G @ self._normals.T + self._offsets
        top = height.argmax(axis=1)
        rows = np.arange(len(p_G))
        distance, slope = height[rows, top], self._normals[top].copy()
        outside = np.flatnonzero(distance > 0.0)
        if not len(outside):
            return distance, slope
        # Most points lie above the face whose plane is farthest; the others are nearest to an edge or to another face.
        face = top[outside]
        above = np.einsum("mki,mi->mk", self._side_normals[face], p_G[outside]) <= self._side_offsets[face]
        rest = outside[~above.all(axis=1)]
        if not len(rest):
            return distance, slope
        p = p_G[rest]
        here = np.arange(len(rest))
        along = p @ self._spans.T - self._span_starts
        share = np.clip(along / self._span_squares, 0.0, 1.0)
        from_start = np.einsum("mi,mi->m", p, p)[:, None] - 2 * (p @ self._starts.T) + self._start_squares
        squares = from_start + share * (share * self._span_squares - 2 * along)
        nearest = squares.argmin(axis=1)
        away = p - self._starts[nearest] - share[here, nearest][:, None] * self._spans[nearest]
        d = np.sqrt(np.einsum("mi,mi->m", away, away))
        n = away / np.maximum(d, TUNING.tiny)[:, None]
        # A face counts where the point is above it, within its sides and nearer to its plane than to any edge.
        which, flat = np.nonzero((height[rest] > 0.0) & (height[rest] < d[:, None]))
        sides = np.einsum("mki,mi->mk", self._side_normals[flat], p[which]) <= self._side_offsets[flat]
        inside = sides.all(axis=1)
        which, flat = which[inside], flat[inside]
        d[which], n[which] = height[rest[which], flat], self._normals[flat]
        distance[rest], slope[rest] = d, n
        return distance, slope

    def lower_bound(self, p_G: Array) -> Array:
        """Return bounds from below, see `Solid`."""
        return self._box.lower_bound(p_G)

    @property
    def ball(self) -> tuple[Array, float]:
        """See `Solid`."""
        centre = self._box.p_GB
        return centre, float(np.linalg.norm(self._points - centre, axis=1).max())


def bounding_box(points: Array) -> Box:
    """Return a box around points (V, 3), along the axes of their frame."""
    low, high = points.min(axis=0), points.max(axis=0)
    return Box((high - low) / 2, np.eye(3), (high + low) / 2)


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
