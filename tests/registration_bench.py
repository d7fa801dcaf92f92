"""A small made-up model in a small made-up image, for laws of registration that are worked out point by point."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
from pydrake.math import RollPitchYaw
from scipy.spatial import cKDTree

from twin_diagram.assets import Asset
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud

Array = npt.NDArray[np.float64]
COUNT = 120
"""Of the model's points."""
WIDTH, HEIGHT, FOCAL = 160, 120, 250.0
TABLE = np.array([0.1, -0.15, 0.003])


def turn(*rpy: float) -> Array:
    return np.asarray(RollPitchYaw(*rpy).ToRotationMatrix().matrix())


@functools.cache
def view() -> Pinhole:
    """Looks down at the origin from 0.6 m away."""
    eye = np.array([0.35, 0.1, 0.5])
    z = -eye / np.linalg.norm(eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return Pinhole(WIDTH, HEIGHT, FOCAL, np.column_stack([x, np.cross(z, x), z]), eye)


@functools.cache
def model() -> ModelCloud:
    """Points on a ball of 6 cm, slightly off, with normals that are not quite its own."""
    rng = np.random.default_rng(2071)
    normals = rng.normal(size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = 0.06 * normals * rng.uniform(0.9, 1.1, (COUNT, 1))
    normals = normals + rng.normal(0.0, 0.1, (COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions = np.concatenate([np.eye(3), -np.eye(3)])
    views, counts = np.zeros((6, 40), dtype=np.int64), np.zeros(6, dtype=np.int64)
    for k, way in enumerate(directions):
        seen = np.flatnonzero(normals @ way > 0.1)[: 30 + k]
        views[k], counts[k] = np.resize(seen, 40), len(seen)
    colours = rng.uniform(0.25, 0.65, (2, COUNT, 3))
    asset = Asset("ball", None, points, normals, colours[0], None, (points,), 0.1, np.full(3, 0.12))  # type: ignore[arg-type]
    tree, steep, none = cKDTree(points), np.full(COUNT, 1e9), np.zeros((0, 3, 3))
    return ModelCloud(asset, points, normals, colours, directions, views, counts, tree, 0.01, 0.066, steep, none)


@functools.cache
def frame() -> Frame:
    """The table and the ball on it, with holes, a robot at the left, a screen before its top, a dent at its right."""
    rng = np.random.default_rng(2072)
    camera = view()
    rays = camera.rays()
    a, b, c = TABLE
    table = (a * camera.p_WC[0] + b * camera.p_WC[1] + c - camera.p_WC[2]) / (
        rays[..., 2] - a * rays[..., 0] - b * rays[..., 1]
    )
    off = camera.p_WC - [0.0, 0.0, 0.02]
    square, along = np.einsum("hwi,hwi->hw", rays, rays), rays @ off
    root = along**2 - square * (off @ off - 0.06**2)
    ball = root > 0.0
    depth = np.where(ball, (-along - np.sqrt(np.maximum(root, 0.0))) / square, table)
    depth += rng.normal(0.0, 0.002, depth.shape) * ball
    depth[:47] -= 0.05
    depth[50:70, 85:] += 0.045
    depth[rng.random(depth.shape) < 0.1] = 0.0
    robot = np.zeros(depth.shape, dtype=bool)
    robot[55:80, 54:66] = True
    normals = np.zeros((HEIGHT // 2, WIDTH // 2, 3), dtype=np.float32)
    some = rng.normal(size=(50, 70, 3)) * 0.35 + [0.5, 0.1, 0.9]
    normals[5:55, 5:75] = some / np.linalg.norm(some, axis=2, keepdims=True)
    normals[32:36, 34:42] = 0.0
    colours = tuple(rng.uniform(0.35, 0.6, (100, 140, 3)).astype(np.float32) for _ in range(2))
    past = ~ball[::2, ::2]
    return Frame(camera, depth.astype(np.float32), robot, normals, 2, colours, (9, 5), TABLE, past)


@functools.cache
def poses() -> Poses:
    """Four poses near the bump."""
    rng = np.random.default_rng(2073)
    R = np.stack([turn(*rng.normal(0.0, 0.5, 3)) for _ in range(4)])
    return Poses(R, np.array([0.0, 0.0, 0.02]) + rng.normal(0.0, 0.003, (4, 3)))
