"""Slow, plain geometry that the search is compared with: rays against triangles, and what is inside of a surface."""

from __future__ import annotations

import numpy as np

from twin_diagram.planning.grasps import Gripper
from twin_diagram.signals.arrays import Array


def box_triangles(x: float, y: float, z: float) -> Array:
    """Return the twelve triangles of a box about the origin, facing outwards."""
    from scipy.spatial import ConvexHull

    corners = np.array([[a, b, c] for a in (-x, x) for b in (-y, y) for c in (-z, z)]) / 2
    return outward(corners[ConvexHull(corners).simplices])


def cylinder_triangles(radius: float, length: float, sides: int = 64) -> Array:
    """Return the triangles of a prism along z about the origin."""
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low, high = (np.insert(ring, 2, z, axis=1) for z in (-length / 2, length / 2))
    next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    caps = [
        np.stack([np.full_like(a, 0) + [0, 0, a[0, 2]], a, b], axis=1) for a, b in ((low, next_low), (high, next_high))
    ]
    walls = [np.stack([low, next_low, next_high], axis=1), np.stack([low, next_high, high], axis=1)]
    return outward(np.concatenate([*caps, *walls]))


def outward(triangles: Array) -> Array:
    """Return triangles of a surface that is star-shaped about the origin, counter-clockwise from outside."""
    flat = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inside = np.einsum("fi,fi->f", flat, triangles.mean(axis=1)) < 0
    return np.where(inside[:, None, None], triangles[:, ::-1], triangles)


def unit_normals(triangles: Array) -> Array:
    flat = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return flat / np.linalg.norm(flat, axis=1, keepdims=True)


def first_hits(triangles: Array, origins: Array, direction: Array) -> tuple[Array, Array]:
    """Return how far (S,) each ray goes to its first triangle, and that one's unit normal (S, 3) (Möller, Trumbore)."""
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    h = np.cross(direction, e2)
    det = np.einsum("fi,fi->f", e1, h)
    s = origins[:, None] - a[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("sfi,fi->sf", s, h) / det
        q = np.cross(s, e1[None])
        v = q @ direction / det
        t = np.einsum("sfi,fi->sf", q, e2) / det
        t = np.where((np.abs(det) > 1e-15) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0), t, np.inf)
    first = t.argmin(axis=1)
    return t.min(axis=1), unit_normals(triangles)[first]


def inside(triangles: Array, points: Array) -> Array:
    """Return which points (S,) a closed surface encloses, by its winding number."""
    found = []
    for part in np.array_split(points, max(1, len(points) // 500)):
        a, b, c = (triangles[None, :, k] - part[:, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        top = np.einsum("sfi,sfi->sf", a, np.cross(b, c))
        below = la * lb * lc + np.einsum("sfi,sfi->sf", a, b) * lc
        below += np.einsum("sfi,sfi->sf", b, c) * la + np.einsum("sfi,sfi->sf", c, a) * lb
        found.append(np.abs(2 * np.arctan2(top, below).sum(axis=1)) > 2 * np.pi)
    return np.concatenate(found)


def grid_in(low: Array, high: Array, step: float) -> Array:
    """Return points (S, 3) that fill a box, its faces included."""
    axes = [np.linspace(a, b, int(np.ceil((b - a) / step)) + 1) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def dense_points(triangles: Array, step: float) -> Array:
    """Return points on triangles no further than `step` apart."""
    found = []
    for a, b, c in triangles:
        n = int(np.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - a), np.linalg.norm(c - b)) / step)) + 1
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        keep = i + j <= n
        found.append(a + np.outer(i[keep] / n, b - a) + np.outer(j[keep] / n, c - a))
    return np.concatenate(found)


def collides(triangles: Array, points: Array, gripper: Gripper, R: Array, p: Array, retreat: float = 0.0) -> bool:
    """Return whether gripper and object share a place: by points of each (`dense_points`) that the other encloses."""
    low, high = gripper.boxes(retreat=retreat)
    local = (points - p) @ R
    if any(((local > a + 1e-5) & (local < b - 1e-5)).all(axis=1).any() for a, b in zip(low, high, strict=True)):
        return True
    filled = np.concatenate([grid_in(a, b, 0.016) for a, b in zip(*gripper.boxes(), strict=True)])
    return bool(inside(triangles, filled @ R.T + p).any())


def pad_contacts(triangles: Array, gripper: Gripper, R: Array, p: Array) -> tuple[float, Array, Array]:
    """Return what closing meets: the width between first contacts, and how square (2,) the patches' normals are.

    Rays go from each open pad's face across to the other; a patch is what lies within 2 mm of the first contact.

    Returns:
        width [m]; mean cosine between outward normal and the direction to the pad; share of rays that meet anything.
    """
    half = gripper.opening_most / 2
    x = np.linspace(-gripper.pad_width / 2, gripper.pad_width / 2, 9) * 0.99
    z = np.linspace(gripper.pad_back, gripper.pad_front, 9) * 0.99
    reach, square, share = [], [], []
    for sign in (1.0, -1.0):
        start = np.stack(np.meshgrid(x, [sign * half], z, indexing="ij"), axis=-1).reshape(-1, 3)
        far, normal = first_hits(triangles, start @ R.T + p, -sign * R[:, 1])
        reach.append(far.min())
        patch = far <= far.min() + 0.002
        square.append(float((normal[patch] @ (sign * R[:, 1])).mean()))
        share.append(float(np.isfinite(far).mean()))
    return gripper.opening_most - reach[0] - reach[1], np.array(square), np.array(share)
