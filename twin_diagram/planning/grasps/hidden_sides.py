"""Guesses the sides of a thing that one camera did not see.

One picture shows a shell, and a shell can be pinched like a sheet of paper. What is behind it nobody knows. The
plainest guess: what stands on a table is at each height as wide as what is seen there and above, looks the same from
behind, and is not where the camera looked through. Boxes, cans and bottles come out as they are, and a cup's hollow
stays open. Without a table it is the convex hull of what is seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from twin_diagram.planning.grasps.slab import Flags
from twin_diagram.planning.grasps.target import GraspTarget
from twin_diagram.planning.grasps.triangles import surface_cloud
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    behind: float = 0.003
    """A place is hidden that is farther behind what is seen than this [m]: a cloud's noise."""

    gaps: float = 2.0
    """Rays that pass a seen point within so many times the cloud's usual spacing, as the camera sees it, end there."""

    finest: float = 0.003
    """Guessed points are as dense as seen ones, but no nearer to one another than this [m]: a seventh of a pad."""

    noise: float = 0.0015
    """The outermost of some thousand points lie so far outside of what they are of [m]: twice a camera's noise."""

    ends: int = 5
    """Points that are the end of an outline, at the least, …"""

    end_share: float = 0.005
    """… or this share of them: those within 1 mm of a can's edge already lie 4 mm before its middle."""

    ground: float = 0.002
    """Sides are guessed from so far over the table on [m]."""


TUNING = Tuning()


def with_hidden_sides(target: GraspTarget, seed: int) -> GraspTarget:
    """Return what one camera saw of a thing with a guess at the rest, as a thing that is seen from all sides.

    Args:
        target: with a viewpoint.
        seed: of the guessed points' places.
    """
    assert target.viewpoint is not None
    points, others = target.points[: target.own], slice(target.own, None)
    spacing = max(float(np.median(cKDTree(points).query(points, k=2)[0][:, 1])), TUNING.finest)
    if target.table is None:
        sides, outward = _hull(points, spacing, seed)
    else:
        sides, outward = _standing(points, target.table, target.viewpoint, spacing)
    hidden = _behind(target.points, target.viewpoint, sides)
    sides, outward = sides[hidden], outward[hidden]
    count, own = len(target.points) - target.own, target.own + len(sides)
    order = np.random.default_rng(seed).permutation(own)
    guessed = np.arange(own)[order] >= target.own
    return replace(
        target,
        points=np.concatenate([np.concatenate([points, sides])[order], target.points[others]]),
        normals=np.concatenate(
            [np.concatenate([target.normals[: target.own], outward])[order], target.normals[others]]
        ),
        own=own,
        viewpoint=None,
        guessed=np.concatenate([guessed, np.zeros(count, dtype=bool)]),
    )


def _standing(points: Array, table: Array, viewpoint: Array, spacing: float) -> tuple[Array, Array]:
    """Return points (M, 3) on the sides of what stands on a table (4,), from it up to its top, and normals."""
    up = table[:3]
    level = np.linalg.svd(up[None])[2][1:]
    flat, height = points @ level.T, points @ up - table[3]
    ahead = flat.mean(axis=0) - viewpoint @ level.T
    ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
    sides, outward = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for low in np.arange(TUNING.ground, float(height.max()), spacing):
        above = flat[height >= low]
        above = np.concatenate([above, 2 * _middle(above, ahead) - above])
        try:
            ring = above[ConvexHull(above).vertices]
        except (QhullError, ValueError):  # too few, or in a line: the very top
            break
        edge = np.roll(ring, -1, axis=0) - ring
        length = np.linalg.norm(edge, axis=1)
        count = np.maximum(np.ceil(length / spacing), 1.0).astype(int)
        of = np.repeat(np.arange(len(ring)), count)
        share = (np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[of]
        # Counter-clockwise as they come, a ring's outside is on the right of its edges.
        right = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length[:, None]
        inside = ring[of] + share[:, None] * edge[of] - TUNING.noise * right[of]
        sides.append(inside @ level + (low + table[3]) * up)
        outward.append(right[of] @ level)
    return np.concatenate(sides), np.concatenate(outward)


def _middle(outline: Array, ahead: Array) -> Array:
    """Return the middle (2,) between the ends of an outline (m, 2), seen from the side along `ahead` (2,).

    What is seen of a round post, or of a square one over its edge, is half of it, and lies before its middle.
    """
    order = np.argsort(outline @ np.array([-ahead[1], ahead[0]]), kind="stable")
    few = min(max(TUNING.ends, round(TUNING.end_share * len(order))), len(order))
    return np.asarray(0.5 * (outline[order[:few]].mean(axis=0) + outline[order[-few:]].mean(axis=0)))


def _hull(points: Array, spacing: float, seed: int) -> tuple[Array, Array]:
    """Return points (M, 3) on the convex hull of points, and normals; none where these lie in a plane."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return np.zeros((0, 3)), np.zeros((0, 3))
    triangles = points[hull.simplices]
    a, b, c = (triangles[:, k] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return surface_cloud(triangles, int(np.ceil(hull.area / spacing**2)), seed)


def _behind(points: Array, viewpoint: Array, places: Array) -> Flags:
    """Return which places (M,) a camera does not see for the points that are before them."""
    axis = points.mean(axis=0) - viewpoint
    axis = axis / np.linalg.norm(axis)
    across = np.linalg.svd(axis[None])[2][1:]

    def on_image(at: Array) -> tuple[Array, Array]:
        ray = at - viewpoint
        along = ray @ axis
        return ray @ across.T / np.maximum(along, 1e-3)[:, None], along

    image, depth = on_image(points)
    tree = cKDTree(image)
    usual = float(np.median(tree.query(image, k=2)[0][:, 1]))
    seen, far = on_image(places)
    off, nearest = tree.query(seen, distance_upper_bound=TUNING.gaps * usual)
    hit = np.isfinite(off)
    result = np.zeros(len(places), dtype=bool)
    result[hit] = far[hit] > depth[nearest[hit]] + TUNING.behind
    return result
