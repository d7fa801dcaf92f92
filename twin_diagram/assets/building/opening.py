"""SyncTwin's support-plane denoising: a sphere of light grows from a cloud's centre and leaves where the cloud is open.

The open side of a thing that was scanned on a table is its bottom, and around the opening lies what is left of the
table. Equations (1) to (13) of SyncTwin (section III-B and appendix A), numbered below as there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from twin_diagram.signals.arrays import Array

Which = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of the method, where the paper leaves them open."""

    directions: int = 1500
    """K: one for each 6° or so."""

    tolerance: float = float(np.radians(5.0))
    """θ_tol: half again as wide as directions are apart, so that a closed surface leaves no bucket empty [rad]."""

    steps: int = 60
    """Growths of the sphere, up to the farthest point: Δr is that distance over these."""

    remembered: int = 5
    """k: growths over which the largest opening must stay as it is."""

    stable: float = 0.02
    """ε: by how much it may still change."""

    near_plane: float = 0.004
    """Distance from the opening's plane at which a point is the support's [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Opening:
    """The largest opening of a cloud.

    Attributes:
        centre: (3,) c of the cloud.
        axis: (3,) unit n_open, out through the opening.
        rim: (R, 3) points around it.
        plane: (4,) through the rim: n·p = d, n along the axis.
        share: of all directions that are open.
    """

    centre: Array
    axis: Array
    rim: Array
    plane: Array
    share: float


def fibonacci_sphere(count: int) -> Array:
    """Return unit directions (count, 3): equations (4) and (5), θ_i = arccos(1 − 2i/K), φ_i = π(1 + √5)i.

    Here i counts from ½, so that no pole comes twice.
    """
    i = np.arange(count) + 0.5
    theta, phi = np.arccos(1 - 2 * i / count), np.pi * (1 + np.sqrt(5)) * i
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


def nearest_in_direction(points: Array, centre: Array, directions: Array, tolerance: float) -> tuple[Array, Array]:
    """Return each bucket's least distance, equation (9), and its farthest point's index: inf and −1 where it is empty.

    A point's direction (6) is (p − c)/‖p − c‖; it falls into the buckets within the tolerance of it (7).
    """
    radius = np.linalg.norm(points - centre, axis=1)
    unit = (points - centre) / np.maximum(radius, 1e-12)[:, None]
    chord = 2 * np.sin(tolerance / 2)
    pairs = cKDTree(directions).sparse_distance_matrix(cKDTree(unit), chord, output_type="coo_matrix")
    bucket, point = pairs.row, pairs.col
    least = np.full(len(directions), np.inf)
    np.minimum.at(least, bucket, radius[point])
    order = np.argsort(radius[point], kind="stable")
    farthest = np.full(len(directions), -1)
    farthest[bucket[order]] = point[order]
    return least, farthest


def find_opening(points: Array) -> Opening | None:
    """Return the largest opening of points (N, 3), or None where they surround their centre."""
    if len(points) < 10:
        return None
    centre = points.mean(axis=0)  # (3)
    directions = fibonacci_sphere(TUNING.directions)
    least, farthest = nearest_in_direction(points, centre, directions, TUNING.tolerance)
    spacing = np.sqrt(4 * np.pi / len(directions))
    neighbours = np.array(sorted(cKDTree(directions).query_pairs(1.6 * spacing)))
    reach = float(np.linalg.norm(points - centre, axis=1).max())
    sizes: list[int] = []
    open_set = np.ones(len(directions), bool)
    for step in range(1, TUNING.steps + 1):  # (8): r grows by Δr
        hit = least <= step * reach / TUNING.steps
        open_set = _largest(~hit, neighbours)
        sizes.append(int(open_set.sum()))
        last = sizes[-TUNING.remembered :]
        steady = (
            len(last) == TUNING.remembered and max(last) > 0 and (max(last) - min(last)) / max(last) < TUNING.stable
        )  # (10)
        if steady and hit.any() and step * reach / TUNING.steps > np.median(least[np.isfinite(least)]):
            break
    hit = ~_with_smaller(open_set, least, step * reach / TUNING.steps)
    if open_set.sum() < 4:
        return None
    axis = directions[open_set].sum(axis=0)
    length = float(np.linalg.norm(axis))
    if length < 1e-6 * open_set.sum():
        return None
    axis = axis / length  # (13)
    a, b = neighbours.T
    beside = np.zeros(len(directions), bool)  # the hit neighbours of the boundary (2), (11): those have points
    beside[b[open_set[a] & hit[b]]] = True
    beside[a[open_set[b] & hit[a]]] = True
    chosen = farthest[beside | open_set]
    rim = points[np.unique(chosen[chosen >= 0])]  # (12)
    if len(rim) < 3:
        return None
    middle = rim.mean(axis=0)
    _, _, axes = np.linalg.svd(rim - middle, full_matrices=False)
    n = axes[2] if axes[2] @ axis > 0 else -axes[2]
    return Opening(centre, axis, rim, np.append(n, n @ middle), float(open_set.mean()))


def without_support(points: Array) -> Which:
    """Return (N,), which points are left without those on the plane of the largest opening and beyond it."""
    opening = find_opening(points)
    if opening is None:
        return np.ones(len(points), bool)
    return np.asarray(points @ opening.plane[:3] - opening.plane[3] < -TUNING.near_plane)


def _largest(which: Which, pairs: npt.NDArray[np.int64]) -> Which:
    """Return the largest connected set among directions."""
    inside = pairs[which[pairs].all(axis=1)]
    graph = coo_matrix((np.ones(len(inside)), (inside[:, 0], inside[:, 1])), shape=(len(which), len(which)))
    _, label = connected_components(graph, directed=False)
    sizes = np.bincount(label[which], minlength=1) if which.any() else np.zeros(1, int)
    return which & (label == int(np.argmax(sizes)))


def _with_smaller(open_set: Which, least: Array, radius: float) -> Which:
    return open_set | (least > radius)
