"""How much of a thing lies inside convex pieces, and how much else they take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial import ConvexHull

from tabletop.casting import bodies, o3d

Array = npt.NDArray[np.float64]


def inside_and_excess(
    thing: trimesh.Trimesh, pieces: Sequence[Array], rng: np.random.Generator, samples: int = 40_000
) -> tuple[float, float]:
    """Return the share of a thing's volume inside pieces, and the volume of all pieces over the thing's."""
    corners = np.concatenate([thing.vertices, *pieces])
    low, high = corners.min(axis=0), corners.max(axis=0)
    points = rng.uniform(low, high, (samples, 3))
    true = np.zeros(samples, dtype=bool)
    for part in bodies(thing):
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            o3d.core.Tensor(part.vertices.astype(np.float32)), o3d.core.Tensor(part.faces.astype(np.uint32))
        )
        true |= scene.compute_occupancy(o3d.core.Tensor(points.astype(np.float32)), nthreads=1).numpy() > 0.5
    held = np.zeros(samples, dtype=bool)
    for piece in pieces:
        sides = ConvexHull(piece).equations
        held |= (points @ sides[:, :3].T + sides[:, 3] <= 1e-9).all(axis=1)
    return float((true & held).sum() / true.sum()), float(held.sum() / true.sum())
