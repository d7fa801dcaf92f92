"""Things on a table, ray-cast by Open3D: depth, whose pixel it is, and noise that neighbouring pixels share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import trimesh
from real_data import DATA

from twin_diagram.assets import Asset
from twin_diagram.native import import_open3d
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.scenario.resources import models_dir

o3d = import_open3d()
Array = npt.NDArray[np.float64]


def meshes() -> dict[str, trimesh.Trimesh]:
    """Return closed meshes by name, each about its middle; a vessel's hollow is filled."""
    found = {
        "box 20×15×8": trimesh.creation.box([0.2, 0.15, 0.08]),
        "box 6×16×21": trimesh.creation.box([0.06, 0.16, 0.21]),
        "cube 5": trimesh.creation.box([0.05, 0.05, 0.05]),
        "can 7×10": trimesh.creation.cylinder(0.035, 0.1),
        "tin 15×6": trimesh.creation.cylinder(0.075, 0.06),
        "ball 10": trimesh.creation.icosphere(4, 0.05),
    }
    for name in ("mug", "bottle"):
        found[name] = _of_hulls(list(Asset.load(models_dir() / "objects" / name).convex_pieces))
    for file in sorted((DATA / "ycb").glob("*_textured.gltf")):
        one = trimesh.load(file, force="mesh")
        found[file.name.removesuffix("_textured.gltf")] = one.convex_hull
    return {name: _centred(one) for name, one in found.items()}


def _of_hulls(pieces: list[Array]) -> trimesh.Trimesh:
    """Return hulls together as one: a mug is a full cylinder and the hull of its handle."""
    return trimesh.util.concatenate([trimesh.convex.convex_hull(piece) for piece in pieces])


def bodies(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Return a mesh's closed bodies."""
    label = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    return [mesh.submesh([np.flatnonzero(label == k)], append=True, repair=False) for k in range(label.max() + 1)]


def _centred(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh = mesh.copy()
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return mesh


@dataclass(frozen=True)
class Table:
    """Things (meshes in W) on the plane z = 0, and a camera that sees them."""

    things: list[trimesh.Trimesh]
    view: Pinhole

    @property
    def thing(self) -> trimesh.Trimesh:
        """The first of them."""
        return self.things[0]

    @staticmethod
    def with_one(mesh: trimesh.Trimesh, rng: np.random.Generator) -> Table:
        """Put one thing down upright or on a side, anyhow turned, before a camera from anywhere above."""
        return Table([_put(mesh, rng, np.array([0.55, 0.0]), 0.1)], _camera(rng))

    @staticmethod
    def with_some(all_: list[trimesh.Trimesh], count: int, rng: np.random.Generator) -> Table:
        """Put several down that do not touch, before a camera from anywhere above."""
        spots = np.array([[0.35, -0.25], [0.35, 0.25], [0.55, 0.0], [0.75, -0.3], [0.75, 0.3], [0.25, 0.0]])
        chosen = rng.permutation(len(spots))[:count]
        return Table([_put(all_[rng.integers(len(all_))], rng, spots[k], 0.02) for k in chosen], _camera(rng))

    def shot(self, rng: np.random.Generator, sigma: float) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        """Return a grey colour image and depth with noise sigma · z² [m]."""
        depth, _ = self.cast()
        white, wide = rng.standard_normal((2, *depth.shape))
        wide = cv2.GaussianBlur(wide, (0, 0), 2.5)
        noise = np.sqrt(0.5) * (white + wide / wide.std())
        depth = np.where(depth > 0, depth + sigma * depth**2 * noise, 0.0).astype(np.float32)
        return np.full((*depth.shape, 3), 128, dtype=np.uint8), depth

    def cast(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
        """Return exact depth (H, W) [m], 0 beyond 3 m, and whose it is: a thing's number, -1 the table, -3 nothing."""
        scene = o3d.t.geometry.RaycastingScene()
        plate = trimesh.creation.box(
            [1.6, 1.6, 0.02], transform=trimesh.transformations.translation_matrix([0.5, 0, -0.01])
        )
        for mesh in [plate, *self.things]:
            scene.add_triangles(
                o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.faces.astype(np.uint32))
            )
        rays = self.view.rays()
        origin = np.broadcast_to(self.view.p_WC, rays.shape)
        answer: dict[str, Any] = scene.cast_rays(
            o3d.core.Tensor(np.concatenate([origin, rays], axis=-1).astype(np.float32)), nthreads=1
        )
        depth, owner = answer["t_hit"].numpy(), answer["geometry_ids"].numpy().astype(np.int64)
        there = depth < 3.0
        return np.where(there, depth, 0.0).astype(np.float32), np.where(there, owner - 1, -3)


def _put(mesh: trimesh.Trimesh, rng: np.random.Generator, at: Array, spread: float) -> trimesh.Trimesh:
    result = mesh.copy()
    # Upright as often as on one of its sides.
    axis, quarters = [([1, 0, 0], 0), ([1, 0, 0], 0), ([1, 0, 0], 1), ([0, 1, 0], 1)][rng.integers(4)]
    result.apply_transform(trimesh.transformations.rotation_matrix(quarters * np.pi / 2, axis))
    result.apply_transform(trimesh.transformations.rotation_matrix(rng.uniform(-np.pi, np.pi), [0, 0, 1]))
    low, high = result.bounds
    shift = [*(at + rng.uniform(-spread, spread, 2) - (low + high)[:2] / 2), -low[2]]
    result.apply_translation(shift)
    return result


def _camera(rng: np.random.Generator) -> Pinhole:
    angle, rise, away = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(30.0, 65.0)), rng.uniform(0.8, 1.1)
    eye = np.array([0.55, 0.0, 0.05]) + away * np.array(
        [np.cos(rise) * np.cos(angle), np.cos(rise) * np.sin(angle), np.sin(rise)]
    )
    z = (np.array([0.55, 0.0, 0.05]) - eye) / away
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return Pinhole(640, 480, 600.0, np.column_stack([x, np.cross(z, x), z]), eye)
