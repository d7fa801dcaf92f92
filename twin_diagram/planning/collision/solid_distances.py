"""Signed distances from points to convex solids, each point to a solid of its own, by closed forms. Pure functions.

All answer distances (M,) [m], negative inside, and outward unit gradients (M, 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints


@dataclass(frozen=True)
class Tuning:
    """Bounds against division by zero, far below any length that matters."""

    tiny: float = 1e-12
    """Lengths below this have no direction [m]: a picometre."""

    nowhere: float = 1e6
    """Where edges are that fill up a table [m]: never the nearest."""


TUNING = Tuning()


@dataclass(frozen=True)
class Faces:
    """One polytope's faces and edges, or several's, padded to the most that one has, behind an axis of their own.

    Attributes:
        normals: (F, 3) outward, of planes n · p + offset = 0.
        offsets: (F,)
        side_normals: (F, K, 3) of the planes through a face's edges, outward; its inside is n · p <= side_offset.
        side_offsets: (F, K)
        starts: (E, 3) one end of each edge [m].
        spans: (E, 3) from there to the other end.
    """

    normals: Array
    offsets: Array
    side_normals: Array
    side_offsets: Array
    starts: Array
    spans: Array

    @staticmethod
    def stacked(all_: Sequence[Faces]) -> Faces:
        """Return several polytopes' as one, in whose arrays the first axis tells them apart."""
        faces = max((len(one.normals) for one in all_), default=0)
        sides = max((one.side_normals.shape[1] for one in all_), default=0)
        edges = max((len(one.starts) for one in all_), default=0)

        def fill(parts: list[Array], shape: tuple[int, ...], value: float) -> Array:
            result = np.full((len(parts), *shape), value)
            for row, part in zip(result, parts, strict=True):
                row[tuple(slice(0, size) for size in part.shape)] = part
            return result

        return Faces(
            fill([one.normals for one in all_], (faces, 3), 0.0),
            fill([one.offsets for one in all_], (faces,), -np.inf),
            fill([one.side_normals for one in all_], (faces, sides, 3), 0.0),
            fill([one.side_offsets for one in all_], (faces, sides), np.inf),
            fill([one.starts for one in all_], (edges, 3), TUNING.nowhere),
            fill([one.spans for one in all_], (edges, 3), 1.0),
        )


def to_box(p_B: Array, half: Array) -> tuple[Array, Array]:
    """Return distances and gradients of points (M, 3) in boxes' axes, from their middles, to half edges (M, 3) [m]."""
    excess = np.abs(p_B) - half
    outside = np.maximum(excess, 0.0)
    norm = np.sqrt(np.einsum("mi,mi->m", outside, outside))
    out = norm > TUNING.tiny
    slope = outside / np.where(out, norm, 1.0)[:, None]
    if not out.all():
        inner = np.flatnonzero(~out)
        slope[inner] = 0.0
        slope[inner, excess[inner].argmax(axis=1)] = 1.0
    slope *= np.where(p_B < 0.0, -1.0, 1.0)
    return np.where(out, norm, excess.max(axis=1)), slope


def to_ball(offset: Array, size: Array) -> tuple[Array, Array]:
    """Return distances and gradients of points at `offset` (M, 3) from the centres of balls of radius `size` (M,)."""
    norm = np.sqrt(np.einsum("mi,mi->m", offset, offset))
    known = norm[:, None] > TUNING.tiny
    slope = np.where(known, offset / np.maximum(norm, TUNING.tiny)[:, None], [[0.0, 0.0, 1.0]])
    return norm - size, slope


def to_drum(offset: Array, axis: Array, size: Array, half: Array) -> tuple[Array, Array]:
    """Return distances and gradients of points to cylinders.

    Args:
        offset: (M, 3) from the cylinders' centres [m].
        axis: (M, 3) their axes.
        size: (M,) their radii [m].
        half: (M,) half of their lengths [m].
    """
    height = np.einsum("mi,mi->m", offset, axis)
    across = offset - height[:, None] * axis
    radius = np.sqrt(np.einsum("mi,mi->m", across, across))
    outward = across / np.maximum(radius, TUNING.tiny)[:, None]
    upward = np.where(height < 0.0, -1.0, 1.0)
    beside, beyond = radius - size, np.abs(height) - half
    out_beside, out_beyond = np.maximum(beside, 0.0), np.maximum(beyond, 0.0)
    norm = np.hypot(out_beside, out_beyond)
    out = norm > TUNING.tiny
    safe = np.where(out, norm, 1.0)
    sideways = np.where(out, out_beside / safe, beside >= beyond)
    endways = np.where(out, out_beyond / safe, beside < beyond)
    slope = sideways[:, None] * outward + (endways * upward)[:, None] * axis
    return np.where(out, norm, np.maximum(beside, beyond)), slope


def to_polytope(p: Array, which: Ints, faces: Faces) -> tuple[Array, Array]:
    """Return distances and gradients of points to polytopes.

    Outside, the nearest point lies inside a face, or else on an edge; inside, the nearest face is the one whose plane
    is nearest.

    Args:
        p: (M, 3) [m].
        which: (M,) the polytope that each is held against.
        faces: of several polytopes, see `Faces.stacked`.
    """
    height = np.einsum("mfi,mi->mf", faces.normals[which], p) + faces.offsets[which]
    top = height.argmax(axis=1)
    distance, slope = height[np.arange(len(p)), top], faces.normals[which, top]
    outside = np.flatnonzero(distance > 0.0)
    if not len(outside):
        return distance, slope
    # Most points lie above the face whose plane is farthest; the others are nearest to an edge or to another face.
    face = top[outside]
    above = _above(p[outside], which[outside], face, faces)
    rest = outside[~above]
    if not len(rest):
        return distance, slope
    point, own = p[rest], which[rest]
    spans = faces.spans[own]
    from_start = point[:, None] - faces.starts[own]
    along = np.einsum("mei,mei->me", from_start, spans)
    share = np.clip(along / np.einsum("mei,mei->me", spans, spans), 0.0, 1.0)
    away = from_start - share[..., None] * spans
    squares = np.einsum("mei,mei->me", away, away)
    here, nearest = np.arange(len(rest)), squares.argmin(axis=1)
    d = np.sqrt(squares[here, nearest])
    n = away[here, nearest] / np.maximum(d, TUNING.tiny)[:, None]
    # A face counts where the point is above it, within its sides and nearer to its plane than to any edge.
    row, flat = np.nonzero((height[rest] > 0.0) & (height[rest] < d[:, None]))
    inside = _above(point[row], own[row], flat, faces)
    row, flat = row[inside], flat[inside]
    d[row], n[row] = height[rest[row], flat], faces.normals[own[row], flat]
    distance[rest], slope[rest] = d, n
    return distance, slope


def _above(p: Array, which: Ints, face: Ints, faces: Faces) -> npt.NDArray[np.bool_]:
    """Return (M,) bool: whether points lie within the sides of one face each."""
    sides = np.einsum("mki,mi->mk", faces.side_normals[which, face], p)
    result: npt.NDArray[np.bool_] = (sides <= faces.side_offsets[which, face]).all(axis=1)
    return result
