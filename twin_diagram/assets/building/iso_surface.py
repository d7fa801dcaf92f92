"""The surface where a field on a regular grid is zero, by marching tetrahedra.

Each cell is cut along its main diagonal into six tetrahedra (Kuhn's), the same way in every cell, so neighbours agree
on the diagonals of their common faces. Within a tetrahedron the surface is one or two triangles and never ambiguous. A
field that is positive all around the grid's border therefore gives a closed manifold surface, thin walls and cavities
included.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """What keeps triangles from having no area."""

    margin: float = 0.02
    """How near a vertex may come to a grid point, as a share of the edge between two."""


TUNING = Tuning()
_STEP = np.array([[(bits >> axis) & 1 for axis in range(3)] for bits in range(8)])
"""Corner of a cell by its number: bit k is a step along axis k."""


def _tetrahedra() -> list[tuple[int, int, int, int]]:
    """Return the six tetrahedra of a cell as corner numbers, right-handed."""
    found = []
    for order in permutations(range(3)):
        path = np.cumsum([0, *(1 << axis for axis in order)])
        a, b, c, d = _STEP[path].astype(float)
        corners = [int(k) for k in path]
        if np.linalg.det([b - a, c - a, d - a]) < 0:
            corners[1], corners[2] = corners[2], corners[1]
        found.append((corners[0], corners[1], corners[2], corners[3]))
    return found


_CELLS = _tetrahedra()
"""The six tetrahedra of a cell."""


def _triangles_by_case() -> list[list[tuple[tuple[int, int], ...]]]:
    """Return for each set of negative corners (bits) the triangles, as edges (corner, corner), facing away from it."""
    table: list[list[tuple[tuple[int, int], ...]]] = [[] for _ in range(16)]
    place = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # right-handed, as those of `_tetrahedra`
    for case in range(1, 15):
        inside = [k for k in range(4) if case >> k & 1]
        outside = [k for k in range(4) if not case >> k & 1]
        if len(inside) == 2:
            (a, b), (c, d) = inside, outside
            polygon = [(a, c), (a, d), (b, d), (b, c)]
        else:
            polygon = [(i, o) for i in inside for o in outside]
        middle = np.array([(place[i] + place[o]) / 2 for i, o in polygon])
        normal = np.cross(middle[1] - middle[0], middle[2] - middle[0])
        if normal @ (place[outside].mean(axis=0) - place[inside].mean(axis=0)) < 0:
            polygon.reverse()
        table[case] = [(polygon[0], polygon[k], polygon[k + 1]) for k in range(1, len(polygon) - 1)]
    return table


_CASES = _triangles_by_case()
"""Triangles by set of negative corners."""


def zero_surface(field: npt.NDArray[np.float32]) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return the triangles of the surface between negative (inside) and other values.

    Args:
        field: (nx, ny, nz); its border should be positive, else the surface is open there.

    Returns:
        vertices (V, 3) in steps of the grid, and faces (F, 3), counter-clockwise from the positive side; both empty
        where the field has one sign.
    """
    sign = field < 0
    shape = np.array(field.shape)
    stride = np.array([shape[1] * shape[2], shape[2], 1])
    corner = [sign[_window(step, shape)] for step in _STEP]
    mixed = np.logical_or.reduce(corner) & ~np.logical_and.reduce(corner)
    base = np.stack(np.nonzero(mixed), axis=1) @ stride
    offset = _STEP @ stride
    flat = sign.reshape(-1)
    low, high = [], []
    for tetrahedron in _CELLS:
        at = offset[list(tetrahedron)]
        case = sum((flat[base + at[k]].astype(np.int64) << k for k in range(4)), np.zeros(len(base), np.int64))
        for number in range(1, 15):
            here = base[case == number]
            for triangle in _CASES[number]:
                i = np.stack([here + at[edge[0]] for edge in triangle], axis=1)
                o = np.stack([here + at[edge[1]] for edge in triangle], axis=1)
                low.append(np.minimum(i, o))
                high.append(np.maximum(i, o))
    if not low or not sum(map(len, low)):
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    a, b = np.concatenate(low), np.concatenate(high)
    # Of two points an edge apart the difference names the direction, one of seven.
    direction = np.searchsorted(np.sort(offset), b - a)
    key, faces = _numbered((a * 8 + direction).reshape(-1))
    start, end = key // 8, key // 8 + np.sort(offset)[key % 8]
    values = field.reshape(-1)
    share = values[start] / (values[start] - values[end]).astype(float)
    share = np.clip(share, TUNING.margin, 1 - TUNING.margin)[:, None]
    p, q = (np.stack(np.unravel_index(index, shape), axis=1).astype(float) for index in (start, end))
    return p + share * (q - p), faces.reshape(-1, 3).astype(np.int64)


def _numbered(keys: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the keys that occur, ascending, and each key's place among them; sorted, which is faster than hashed."""
    order = np.argsort(keys, kind="stable")
    ranked = keys[order]
    first = np.append(True, ranked[1:] != ranked[:-1])
    place = np.empty(len(keys), np.int64)
    place[order] = np.cumsum(first) - 1
    return ranked[first], place


def _window(step: Array, shape: Array) -> tuple[slice, ...]:
    return tuple(slice(int(s), int(n) - 1 + int(s)) for s, n in zip(step, shape, strict=True))
