"""Triangles: a cloud on them, and whether boxes cut them, the exact check of a gripper against a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.grasps.slab import Flags, Indices, in_frames, slab_of
from twin_diagram.signals.arrays import Array

ROUNDING = 1e-6
"""Added where places are in single precision, before the exact check [m]."""

CELLS = 4096
"""Into about so many cells the box about more triangles than this is cut: what is far from the gripper is left out
cell by cell, and the check takes 0.1 s less with 80,000 triangles."""


@dataclass(frozen=True)
class LaidOut:
    """Triangles (F) where they are, each in a ball, and many of them sorted into C cells.

    Attributes:
        corners: (F, 3, 3) in O [m].
        centre: (F, 3) of the ball about each [m].
        radius: (F,) [m].
        order: (F,) triangles, cell by cell.
        start: (C,) where in that order each cell begins.
        count: (C,) how many triangles are in it.
        middle: (C, 3) of the ball about what is in a cell [m].
        around: (C,) its radius [m]. Without cells all four are empty.
    """

    corners: Array
    centre: Array
    radius: Array
    order: Indices
    start: Indices
    count: Indices
    middle: Array
    around: Array


def laid_out(triangles: Array) -> LaidOut:
    """Return triangles (F, 3, 3) [m] laid out, to be looked through more than once."""
    low_corner, high_corner = triangles.min(axis=1), triangles.max(axis=1)
    centre = (low_corner + high_corner) / 2
    radius = np.linalg.norm(high_corner - low_corner, axis=1) / 2
    if len(triangles) <= CELLS:
        none = np.zeros(0, dtype=np.intp)
        return LaidOut(triangles, centre, radius, none, none, none, np.zeros((0, 3)), np.zeros(0))
    least, size = centre.min(axis=0), np.ptp(centre, axis=0)
    along = np.maximum(np.round(size / size.max() * CELLS ** (1 / 3)), 1).astype(np.intp)
    place = ((centre - least) * ((along - 1e-6) / np.maximum(size, ROUNDING))).astype(np.intp)
    cell = (place[:, 0] * along[1] + place[:, 1]) * along[2] + place[:, 2]
    order = np.argsort(cell, kind="stable")
    start = np.flatnonzero(np.diff(cell[order], prepend=-1))
    count = np.diff(start, append=len(order))
    middle = least + (place[order[start]] + 0.5) * (size / along)
    around = np.linalg.norm(size / along) / 2 + np.maximum.reduceat(radius[order], start) + ROUNDING
    return LaidOut(triangles, centre, radius, order, start, count, middle, around)


def meets_triangles(laid: LaidOut, R: Array, p: Array, low: Array, high: Array) -> Flags:
    """Return whether any of a gripper's boxes touches a surface, for K poses.

    Args:
        laid: the surface's triangles in O.
        R: (K, 3, 3) axes of the poses in O, as columns.
        p: (K, 3) origins in O [m].
        low: (B, 3) the boxes' lower corners in G [m].
        high: (B, 3) their upper corners.
    """
    met = np.zeros(len(R), dtype=bool)
    if len(laid.start):
        pose, box, triangle = _near_by_cells(laid, R, p, low, high)
    else:
        pose, box, triangle = _near(laid.centre, laid.radius, R, p, low, high)
    if not len(pose):
        return met
    middle, half = ((low + high) / 2)[box], ((high - low) / 2)[box]
    corners = np.einsum("mci,mij->mcj", laid.corners[triangle] - p[pose][:, None], R[pose]) - middle[:, None]
    met[pose[_overlaps(corners, half)]] = True
    return met


def _near_by_cells(laid: LaidOut, R: Array, p: Array, low: Array, high: Array) -> tuple[Indices, Indices, Indices]:
    """Return what `_near` does, of many triangles: of the cells in which they lie, then of those in near ones."""
    count, start = laid.count, laid.start
    pose, box, of = _near(laid.middle, laid.around, R, p, low, high)
    every = np.repeat(np.arange(len(of)), count[of])
    at = np.arange(len(every)) - np.repeat(np.cumsum(count[of]) - count[of], count[of]) + start[of[every]]
    pose, box, triangle = pose[every], box[every], laid.order[at]
    place_G = np.einsum("mi,mij->mj", laid.centre[triangle] - p[pose], R[pose])
    reach = ((high - low) / 2)[box] + laid.radius[triangle][:, None]
    near = (np.abs(place_G - ((low + high) / 2)[box]) <= reach).all(axis=1)
    return pose[near], box[near], triangle[near]


def _near(
    centre: Array, radius: Array, R: Array, p: Array, low: Array, high: Array
) -> tuple[Indices, Indices, Indices]:
    """Return the (pose, box, triangle) of which the triangle's sphere reaches into the box drawn out by its radius."""
    q = in_frames(centre, R, p)
    wide = float(np.abs([low[:, 0].min(), high[:, 0].max()]).max())
    before = slab_of(q, np.abs(q[:, 0]) <= wide + radius + ROUNDING)
    r = radius[before.point] + ROUNDING
    found = []
    for a, b in zip(low, high, strict=True):
        inside = np.ones(len(r), dtype=bool)
        for along, least, most in zip(before.q, a, b, strict=True):
            inside &= np.abs(along - (least + most) / 2) <= (most - least) / 2 + r
        found.append(np.flatnonzero(inside))
    at = np.concatenate(found)
    return before.pose[at], np.repeat(np.arange(len(low)), [len(part) for part in found]), before.point[at]


def _overlaps(corners: Array, half: Array) -> Flags:
    """Return whether triangles (M, 3, 3) meet boxes about the origin of half edges (M, 3): no axis parts them.

    The thirteen axes of Akenine-Möller: the box's three, the triangle's normal, and the products of their edges.
    """
    met = np.zeros(len(corners), dtype=bool)
    left = np.flatnonzero(((corners.min(axis=1) <= half) & (corners.max(axis=1) >= -half)).all(axis=1))
    corners, half = corners[left], half[left]
    edges = np.roll(corners, -1, axis=1) - corners
    axes = [np.cross(edges[:, 0], edges[:, 1])]
    axes += [np.cross(edges[:, k], axis) for k in range(3) for axis in np.eye(3)]
    apart = np.zeros(len(corners), dtype=bool)
    for axis in axes:
        along = np.einsum("mci,mi->mc", corners, axis)
        reach = (np.abs(axis) * half).sum(axis=1)
        apart |= (along.min(axis=1) > reach) | (along.max(axis=1) < -reach)
    met[left[~apart]] = True
    return met


def surface_cloud(triangles: Array, count: int, seed: int) -> tuple[Array, Array]:
    """Return points (count, 3) spread evenly over triangles (F, 3, 3) in random order, and the faces' normals there."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    flat = np.cross(b - a, c - a)
    doubled = np.linalg.norm(flat, axis=1)
    rng = np.random.default_rng(seed)
    position = (np.arange(count) + rng.random(count)) / count * doubled.sum()
    face = np.minimum(np.searchsorted(np.cumsum(doubled), position), len(doubled) - 1)
    r1, r2 = np.sqrt(rng.random(count)), rng.random(count)
    share = np.stack([1 - r1, r1 * (1 - r2), r1 * r2], axis=1)
    points = np.einsum("nc,nci->ni", share, triangles[face])
    order = rng.permutation(count)
    return points[order], (flat[face] / doubled[face, None])[order]
