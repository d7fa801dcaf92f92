"""Compiled loops that draw triangles: which is seen where, and what colour it has there.

A point at depth z on a triangle with corners P_i in the camera's frame is seen along d = (x, y, 1), x and y normalised
coordinates. What is linear on the triangle is there (A · d) / (M · d), M · d = 1 / z, with A = Σ a_i P_j × P_k / det
and M the same for a_i = 1: no projection is needed, and no corner before the camera.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.signals.compiled import compiled, compiled_in_place

Floats32 = npt.NDArray[np.float32]
Ints32 = npt.NDArray[np.int32]
Bytes = npt.NDArray[np.uint8]


@compiled
def moved(points: Array, frame: Ints, R: Array, p: Array) -> Array:
    """Return points (V, 3) of frames (V,), each of which is turned by R (B, 3, 3) and shifted by p (B, 3)."""
    result = np.empty_like(points)
    _move(points, frame, R, p, result)
    return result


@compiled_in_place
def _move(points: Array, frame: Ints, R: Array, p: Array, result: Array) -> None:
    """Write what `moved` returns."""
    for k in range(len(points)):
        turn, shift, x, y, z = R[frame[k]], p[frame[k]], points[k, 0], points[k, 1], points[k, 2]
        for i in range(3):
            result[k, i] = turn[i, 0] * x + turn[i, 1] * y + turn[i, 2] * z + shift[i]


@compiled
def lit(normals: Array, lights: Array) -> Array:
    """Return how bright white surfaces with normals (V, 3) are before and behind, (V, 2).

    Args:
        normals: unit, in W.
        lights: (L, 3) towards each light, as long as it is strong.
    """
    result = np.zeros((len(normals), 2))
    for k in range(len(normals)):
        for light in lights:
            fall = normals[k, 0] * light[0] + normals[k, 1] * light[1] + normals[k, 2] * light[2]
            if fall > 0.0:
                result[k, 0] += fall
            else:
                result[k, 1] -= fall
    return result


@compiled_in_place
def planes(corners: Array, values: Array, plane: Array) -> bool:
    """Write the rows A (K, 3) of values (3, K) at a triangle's corners (3, 3), and say whether it can be seen.

    Args:
        corners: in the camera's frame.
        values: of anything that is linear on the triangle; ones give M.
        plane: (K, 3) is written.
    """
    P = corners
    det = (
        P[0, 0] * (P[1, 1] * P[2, 2] - P[1, 2] * P[2, 1])
        + P[0, 1] * (P[1, 2] * P[2, 0] - P[1, 0] * P[2, 2])
        + P[0, 2] * (P[1, 0] * P[2, 1] - P[1, 1] * P[2, 0])
    )
    if abs(det) < 1e-15:
        return False
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        a, b, c = (
            P[1, j] * P[2, k] - P[1, k] * P[2, j],
            P[2, j] * P[0, k] - P[2, k] * P[0, j],
            P[0, j] * P[1, k] - P[0, k] * P[1, j],
        )
        for n in range(values.shape[1]):
            plane[n, i] = (values[0, n] * a + values[1, n] * b + values[2, n] * c) / det
    return True


@compiled_in_place
def clipped(corners: Array, near: float, polygon: Array) -> int:
    """Write what of a triangle (3, 3) is farther than `near`, as up to 4 corners (4, ≥ 3); return how many."""
    count = 0
    for i in range(3):
        a, b = corners[i], corners[(i + 1) % 3]
        if a[2] >= near:
            for j in range(3):
                polygon[count, j] = a[j]
            count += 1
        if (a[2] >= near) != (b[2] >= near):
            # From the same end whichever triangle asks: neighbours keep meeting.
            if a[2] > b[2]:
                a, b = b, a
            share = (near - a[2]) / (b[2] - a[2])
            for j in range(3):
                polygon[count, j] = a[j] + share * (b[j] - a[j])
            count += 1
    return count


@compiled_in_place
def fill(
    polygon: Array, M: Array, number: int, lens: Array, samples: Array, edges: Array, nearest: Floats32, who: Ints32
) -> None:
    """Draw one convex polygon (K, 5) where it is nearer than what is there.

    Args:
        polygon: corners in the camera's frame, before the camera, then where they are in the image [px].
        M: (3,) of its plane.
        number: of the triangle.
        lens: fx, fy, cx, cy.
        samples: (S, 2) places within a pixel, from its centre.
        edges: (K, 4) written: where an edge begins and ends [rows], the column at its begin, columns a row.
        nearest: (S, H, W) 1 / z of what is there, written.
        who: (S, H, W) triangles that are there, written.
    """
    height, width = nearest.shape[1:]
    count = len(polygon)
    low, high = polygon[0, 4], polygon[0, 4]
    for i in range(1, count):
        low, high = min(low, polygon[i, 4]), max(high, polygon[i, 4])
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        # From the upper end whichever triangle asks: neighbours leave no gap and draw nothing twice.
        a, b = (i, j) if polygon[i, 4] <= polygon[j, 4] else (j, i)
        edges[i, 0], edges[i, 1], edges[i, 2] = polygon[a, 4], polygon[b, 4], polygon[a, 3]
        edges[i, 3] = (polygon[b, 3] - polygon[a, 3]) / max(polygon[b, 4] - polygon[a, 4], 1e-12)
    across, along = M[0] / lens[0], M[1] / lens[1]
    middle = M[2] - across * lens[2] - along * lens[3]
    slope, mine = np.float32(across), np.int32(number)
    for s in range(len(samples)):
        aside, down = samples[s, 0], samples[s, 1]
        first, last = max(0.0, np.ceil(low - down)), min(float(height), np.ceil(high - down))
        for row in range(int(first), int(last)):
            left, right = np.inf, -np.inf
            y = row + down
            for i in range(count):
                if edges[i, 0] <= y < edges[i, 1]:
                    x = edges[i, 2] + (y - edges[i, 0]) * edges[i, 3]
                    left, right = min(left, x), max(right, x)
            begin = int(max(0.0, np.ceil(left - aside)))
            end = int(min(float(width), np.ceil(right - aside)))
            if begin >= end:
                continue
            start = np.float32(across * (begin + aside) + along * y + middle)
            # Something is written whether it is nearer or not: so eight pixels are compared at once.
            there, seen = nearest[s, row, begin:end], who[s, row, begin:end]
            for k in range(len(there)):
                w, old = start + slope * np.float32(np.int32(k)), there[k]
                nearer = w > old
                seen[k] = mine if nearer else seen[k]
                there[k] = w if nearer else old


@compiled
def draw(
    points: Array, faces: Ints, closed: npt.NDArray[np.bool_], lens: Array, near: float, samples: Array,
    nearest: Floats32, who: Ints32,
) -> None:  # fmt: skip
    """Draw triangles: see `fill`.

    Args:
        points: (V, 3) in the camera's frame.
        faces: (F, 3) corners, counter-clockwise from outside.
        closed: (F,) whether its back is never seen.
        lens: fx, fy, cx, cy.
        near: what is nearer is not drawn [m].
        samples: (S, 2) places within a pixel, from its centre.
        nearest: (S, H, W) written.
        who: (S, H, W) written.
    """
    room = (np.empty((3, 3)), np.empty((4, 5)), np.empty((1, 3)), np.ones((3, 1)), np.empty((4, 4)))
    _draw_all(points, faces, closed, lens, near, samples, nearest, who, room)


@compiled_in_place
def _draw_all(
    points: Array, faces: Ints, closed: npt.NDArray[np.bool_], lens: Array, near: float, samples: Array,
    nearest: Floats32, who: Ints32, room: tuple[Array, Array, Array, Array, Array],
) -> None:  # fmt: skip
    """Do what `draw` does; `room` is written over, but for its ones."""
    height, width = nearest.shape[1:]
    corners, polygon, M, ones, edges = room
    for f in range(len(faces)):
        far = -np.inf
        for i in range(3):
            for j in range(3):
                corners[i, j] = points[faces[f, i], j]
            far = max(far, corners[i, 2])
        if far <= near or (closed[f] and behind(corners)):
            continue
        count = clipped(corners, near, polygon)
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        for i in range(count):
            polygon[i, 3] = lens[0] * polygon[i, 0] / polygon[i, 2] + lens[2]
            polygon[i, 4] = lens[1] * polygon[i, 1] / polygon[i, 2] + lens[3]
            left, right = min(left, polygon[i, 3]), max(right, polygon[i, 3])
            top, bottom = min(top, polygon[i, 4]), max(bottom, polygon[i, 4])
        if right < -1.0 or bottom < -1.0 or left > width or top > height or not planes(corners, ones, M):
            continue
        fill(polygon[:count], M[0], f, lens, samples, edges, nearest, who)


@compiled_in_place
def behind(corners: Array) -> bool:
    """Return whether a triangle (3, 3) in the camera's frame turns its back on the camera."""
    a, b, c = corners[0], corners[1], corners[2]
    x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return bool(x * a[0] + y * a[1] + z * a[2] > 0.0)
