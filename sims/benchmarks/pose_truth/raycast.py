"""Depth, colour and labels of meshes on a table, by ray casting: exact, and independent of the station's renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pose_truth.things import Thing
from twin_diagram.assets.mesh import bilinear
from twin_diagram.native import import_open3d
from twin_diagram.perception.pinhole import Pinhole

o3d = import_open3d()
Array = npt.NDArray[np.float64]
LIGHT = np.array([-0.4, 0.3, 0.85]) / np.linalg.norm([-0.4, 0.3, 0.85])
AMBIENT = 0.45
TABLE = (0.62, 0.55, 0.47)


@dataclass(frozen=True)
class Picture:
    """What an ideal camera sees.

    Attributes:
        depth: (H, W) [m], 0 where nothing is.
        rgb: (H, W, 3).
        label: (H, W): number of the thing, -1 table, -2 occluder, -3 nothing.
        facing: (H, W) cosine between surface normal and line of sight.
    """

    depth: npt.NDArray[np.float32]
    rgb: npt.NDArray[np.uint8]
    label: npt.NDArray[np.int16]
    facing: npt.NDArray[np.float32]


def look_at(eye: Array, target: Array, width: int = 640, height: int = 480, focal: float = 600.0) -> Pinhole:
    """Return a camera at `eye` that looks at `target`, upright."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return Pinhole(width, height, focal, np.column_stack([x, np.cross(z, x), z]), eye)


def _surface(vertices: Array, faces: npt.NDArray[np.int64]) -> tuple[Any, Any]:
    return o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))


def take(
    camera: Pinhole,
    things: Sequence[tuple[Thing, Array, Array]],
    occluder: tuple[Array, npt.NDArray[np.int64]] | None = None,
) -> Picture:
    """Return the ideal picture of things (thing, R_WO, p_WO) on the table z = 0, with something before them or not."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for one, R, p in things:
        scene.add_triangles(*_surface(one.mesh.vertices @ R.T + p, one.mesh.faces))
    wide = np.array([[-3.0, -3.0, 0.0], [3.0, -3.0, 0.0], [3.0, 3.0, 0.0], [-3.0, 3.0, 0.0]])
    table = scene.add_triangles(*_surface(wide, np.array([[0, 1, 2], [0, 2, 3]])))
    if occluder is not None:
        scene.add_triangles(*_surface(*occluder))
    rays_W = camera.rays()
    rays = np.concatenate([np.broadcast_to(camera.p_WC, rays_W.shape), rays_W], axis=-1).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor(rays))
    depth = hit["t_hit"].numpy()
    which = hit["geometry_ids"].numpy().astype(np.int64)
    face = hit["primitive_ids"].numpy().astype(np.int64)
    bary = hit["primitive_uvs"].numpy().astype(float)
    normal = hit["primitive_normals"].numpy().astype(float)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-9)
    there = np.isfinite(depth)
    sight = -rays_W / np.linalg.norm(rays_W, axis=2, keepdims=True)
    facing = np.einsum("hwi,hwi->hw", normal, sight)
    normal = normal * np.where(facing < 0, -1.0, 1.0)[..., None]
    colour = np.full((*depth.shape, 3), 0.75)
    label = np.full(depth.shape, -3, dtype=np.int16)
    label[there & (which == table)] = -1
    label[there & (which == table + 1)] = -2
    points = camera.p_WC + depth[..., None] * rays_W
    on_table = label == -1
    wood = 1.0 + 0.08 * np.sin(points[on_table] @ np.array([[90.0], [17.0], [0.0]]))
    colour[on_table] = np.array(TABLE) * wood
    colour[label == -2] = (0.85, 0.85, 0.87)
    for k, (one, _, _) in enumerate(things):
        at = there & (which == k)
        if not at.any():
            continue
        label[at] = k
        u, v = bary[at].T
        corner = one.mesh.faces[face[at]]
        uv = one.mesh.uv[corner]
        colour[at] = bilinear(
            one.texture, uv[:, 0] * (1 - u - v)[:, None] + uv[:, 1] * u[:, None] + uv[:, 2] * v[:, None]
        )
    shade = AMBIENT + (1 - AMBIENT) * np.maximum(normal @ LIGHT, 0.0)
    shade[~there] = 1.0
    rgb = np.clip(colour * shade[..., None] * 255.0, 0, 255).astype(np.uint8)
    depth = np.where(there, depth, 0.0).astype(np.float32)
    return Picture(depth, rgb, label, np.abs(facing).astype(np.float32))
