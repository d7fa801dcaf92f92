"""Which points are near the robot, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled_in_place

SPHERE, CAPSULE, CYLINDER, BOX, ELLIPSOID, HULL = range(6)
"""Kinds of shapes."""


class RobotShapes(NamedTuple):
    """K shapes, each in a frame G of its own.

    Attributes:
        kinds: (K,) of each.
        sizes: (K, 3) [m]: a sphere's radius; radius and half the length along z of a capsule or a cylinder; half a
            box's edges; half an ellipsoid's axes.
        faces: (F, 4) planes of all hulls: normal · x + offset is 0 on them and more outside.
        starts: (K + 1,) where those of each begin.
    """

    kinds: npt.NDArray[np.int64]
    sizes: Array
    faces: Array
    starts: npt.NDArray[np.int64]


@compiled_in_place
def mark_near(
    points: Array, places: tuple[Array, Array, Array], shapes: RobotShapes, margin: float, near: npt.NDArray[np.bool_]
) -> None:
    """Write which points (N, 3) lie within a margin of shapes.

    Args:
        points: (N, 3) in W.
        places: R_WG (K, 3, 3), p_WG (K, 3), and the radius of a sphere about p_WG that holds the shape with its margin.
        shapes: K.
        margin: [m].
        near: (N,), filled.
    """
    R, p, reach = places
    for n in range(points.shape[0]):
        near[n] = False
        for k in range(p.shape[0]):
            x, y, z = points[n, 0] - p[k, 0], points[n, 1] - p[k, 1], points[n, 2] - p[k, 2]
            if x * x + y * y + z * z >= reach[k] * reach[k]:
                continue
            a = R[k, 0, 0] * x + R[k, 1, 0] * y + R[k, 2, 0] * z
            b = R[k, 0, 1] * x + R[k, 1, 1] * y + R[k, 2, 1] * z
            c = R[k, 0, 2] * x + R[k, 1, 2] * y + R[k, 2, 2] * z
            if distance_to(a, b, c, shapes, k) < margin:
                near[n] = True
                break


@compiled_in_place
def distance_to(x: float, y: float, z: float, shapes: RobotShapes, k: int) -> float:
    """Return the distance of a point in G to a shape, 0 or less inside; no more than that to an ellipsoid or hull."""
    kind, size = shapes.kinds[k], shapes.sizes[k]
    if kind == SPHERE:
        return np.sqrt(x * x + y * y + z * z) - size[0]
    if kind == CAPSULE:
        return np.sqrt(x * x + y * y + max(abs(z) - size[1], 0.0) ** 2) - size[0]
    if kind == CYLINDER:
        return from_box(np.hypot(x, y) - size[0], -np.inf, abs(z) - size[1])
    if kind == BOX:
        return from_box(abs(x) - size[0], abs(y) - size[1], abs(z) - size[2])
    if kind == ELLIPSOID:
        u, v, w = x / size[0], y / size[1], z / size[2]
        return (np.sqrt(u * u + v * v + w * w) - 1.0) * min(size[0], min(size[1], size[2]))
    # The largest distance to a plane is never more than the distance to the body.
    most = -np.inf
    for f in range(shapes.starts[k], shapes.starts[k + 1]):
        face = shapes.faces[f]
        most = max(most, x * face[0] + y * face[1] + z * face[2] + face[3])
    return most


@compiled_in_place
def from_box(x: float, y: float, z: float) -> float:
    """Return the distance to a box of what lies so far beyond its sides; negative inside."""
    a, b, c = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    return np.sqrt(a * a + b * b + c * c) + min(max(x, max(y, z)), 0.0)
