"""Fewer triangles, and the mesh as closed as before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the decimation."""

    eagerness: tuple[float, ...] = (5, 7, 3)
    """`fast_simplification`'s aggressiveness, in the order tried: with less it stops far above the target on rough
    surfaces, with more it can ruin smooth ones."""

    factors: tuple[int, ...] = (1, 2, 4, 10)
    """Times the target that are tried one after the other: what is rough all over keeps its shape with more alone."""

    volume_off: float = 0.01
    """How much of its volume a closed mesh may gain or lose; ruined ones change by a half."""

    weld: float = 3e-5
    """Vertices nearer than this share of the object's size are one, three times what a mesh is welded with later."""

    mends: int = 20
    """Times that folds and pinches are taken out; one or two do."""


TUNING = Tuning()
Faces = npt.NDArray[np.int64]


def is_closed(faces: Faces) -> bool:
    """Return whether each edge is shared by exactly two triangles, once in each direction."""
    if not len(faces):
        return False
    ahead = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(faces.max()) + 1
    key, back = ahead[:, 0] * count + ahead[:, 1], ahead[:, 1] * count + ahead[:, 0]
    key.sort()
    back.sort()
    return bool((key[1:] != key[:-1]).all() and (key == back).all())


def enclosed_volume(vertices: Array, faces: Faces) -> float:
    """Return the signed volume of a closed mesh [m³]: Σ a·(b × c)/6 by the divergence theorem."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def decimated(vertices: Array, faces: Faces, target: int) -> tuple[Array, Faces]:
    """Return about `target` triangles by quadric edge collapse (Garland and Heckbert, 1997), closed where it was.

    Collapses at thin places fold triangles onto one another and pinch edges; `unfolded` mends that. Where it does not,
    or the volume would change, more triangles are left; at worst the mesh is returned as it came.
    """
    for factor in TUNING.factors:
        if len(faces) <= factor * target:
            break
        found = _decimated(vertices, faces, factor * target)
        if found is not None:
            return found
    return vertices, faces


def _decimated(vertices: Array, faces: Faces, target: int) -> tuple[Array, Faces] | None:
    """Return about `target` triangles, or None where the shape would be ruined."""
    import fast_simplification

    centre, size = vertices.mean(axis=0), np.ptp(vertices, axis=0).max()
    closed, volume = is_closed(faces), enclosed_volume(vertices, faces)
    gentler = np.inf
    for eagerness in TUNING.eagerness:
        if eagerness >= gentler:
            continue
        points, triangles = fast_simplification.simplify(
            (vertices - centre) / size, faces.astype(np.int32), target_count=target, agg=eagerness
        )
        found, kept = np.asarray(points, dtype=float) * size + centre, np.asarray(triangles, dtype=np.int64)
        if closed:
            kept = unfolded(_welded(found)[kept])
            off = abs(enclosed_volume(found, kept) / volume - 1) if len(kept) else 1.0
            if off > TUNING.volume_off:
                gentler = eagerness  # what ruins the shape does so the more, the more eager it is
                continue
            if not is_closed(kept) or len(kept) > 2 * target:
                continue
        used, kept = np.unique(kept, return_inverse=True)
        return found[used], kept.reshape(-1, 3)
    return None


def _welded(vertices: Array) -> Faces:
    """Return for each vertex (V,) the first one at its place.

    Collapses leave copies, which others would weld anyway.
    """
    step = TUNING.weld * np.ptp(vertices, axis=0).max()
    _, first, inverse = np.unique(np.round(vertices / step), axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.reshape(-1)], dtype=np.int64)


def unfolded(faces: Faces) -> Faces:
    """Return a closed mesh's triangles without pairs that lie back to back, and without edges that four of them share.

    Such an edge is drawn together to one vertex: what meets there still closes.
    """
    for _ in range(TUNING.mends):
        faces = _without_flaps(faces)
        if not len(faces) or is_closed(faces):
            break
        ahead = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        count = int(faces.max()) + 1
        key, often = np.unique(ahead[:, 0] * count + ahead[:, 1], return_counts=True)
        goes_to = np.arange(count)
        for edge in key[often > 1]:
            a, b = goes_to[edge // count], goes_to[edge % count]
            goes_to[goes_to == b] = a
        faces = goes_to[faces]
    return faces


def _without_flaps(faces: Faces) -> Faces:
    """Return triangles without those of no extent and without pairs of equal corners and opposite sense."""
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (a != c)]
    if not len(faces):
        return faces
    _, same = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True)
    same = same.reshape(-1)
    first = np.argmin(faces, axis=1)
    rows = np.arange(len(faces))
    sense = np.where(faces[rows, (first + 1) % 3] < faces[rows, (first + 2) % 3], 1, -1)
    balance = np.bincount(same, sense).astype(int)
    # Of each set of corners as many stay as one sense outnumbers the other.
    left = np.abs(balance)[same]
    stays = np.zeros(len(faces), bool)
    of_sense = np.flatnonzero(sense == np.sign(balance)[same])
    order = of_sense[np.argsort(same[of_sense], kind="stable")]
    place = np.arange(len(order)) - np.searchsorted(same[order], same[order])
    stays[order[place < left[order]]] = True
    return faces[stays]
