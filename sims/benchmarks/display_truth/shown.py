"""Casts rays from a mesh to the camera, past the mesh itself and the hand: what a display shows, and what any could."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.mesh import parse_obj
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.native import import_open3d
from twin_diagram.runs.learning.seen_map import TUNING as SEEN
from twin_diagram.runs.learning.seen_map import SeenMap, Voxels, all_about

Array = npt.NDArray[np.float64]
SAMPLES = 3000
"""Of a mesh's surface, each as large as the others."""
FAR = 0.6
"""Distance from which an object may be looked at without a hand [m]."""


@dataclass
class Shown:
    """A mesh, samples of its surface with normals (N, 3), and in how many pictures each was seen."""

    corners: Array
    points: Array
    normals: Array
    frames: npt.NDArray[np.int64]

    @staticmethod
    def of(path: Path, R: Array, seed: int) -> Shown:
        """Return an OBJ file's mesh turned to how it lies, its lowest point at z = 0, and nothing of it seen."""
        text = parse_obj(path)
        corners = np.asarray(text.v)[text.corners[:, :, 0]] @ R.T
        return Shown.of_surface(corners - [0.0, 0.0, corners[..., 2].min()], seed)

    @staticmethod
    def of_surface(corners: Array, seed: int) -> Shown:
        """Return a mesh (F, 3, 3) of which nothing is seen."""
        rng = np.random.default_rng(seed)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(cross, axis=1)
        which = rng.choice(len(corners), SAMPLES, p=area / area.sum())
        a, b = np.sort(rng.uniform(size=(2, SAMPLES)), axis=0)
        points = np.einsum("nk,nki->ni", np.stack([a, b - a, 1.0 - b], axis=1), corners[which])
        return Shown(corners, points, cross[which] / area[which, None], np.zeros(SAMPLES, dtype=np.int64))

    def look(self, hand: Boxes, cameras_T: Array) -> None:
        """Count the pictures of a display in which each sample is seen, as the mesh and the hand's boxes hide it."""
        scene, o3d = _scene(self.corners), import_open3d()
        for low, high in zip(hand.low, hand.high, strict=True):
            box = o3d.t.geometry.TriangleMesh.create_box(*(high - low))
            box.translate(low).transform(hand.X_ST)
            scene.add_triangles(box)
        cameras = cameras_T @ hand.X_ST[:3, :3].T + hand.X_ST[:3, 3]
        self.frames = self.frames + np.sum([_open(scene, self.points, self.normals, c) for c in cameras], axis=0)

    def reachable(self) -> npt.NDArray[np.bool_]:
        """Return which samples a camera somewhere about the mesh sees, nothing holding it."""
        scene, middle = _scene(self.corners), self.points.mean(axis=0)
        found = np.zeros(len(self.points), dtype=bool)
        for direction in all_about(200):
            found |= _open(scene, self.points, self.normals, middle + FAR * direction)
        return found

    def as_map(self) -> SeenMap:
        """Return what pictures would tell of it: where it was seen, and what the mesh fills."""
        low, high = (edge(self.points, axis=0) for edge in (np.min, np.max))
        low, high = low - SEEN.room, high + SEEN.room
        shape = tuple(np.ceil((high - low) / SEEN.edge).astype(int))
        middles = Voxels(low, SEEN.edge, np.ones(shape, dtype=bool)).middles(np.argwhere(np.ones(shape)))
        full = np.asarray(_scene(self.corners).compute_occupancy(middles.astype(np.float32)).numpy() > 0.5)
        none, every = np.full(len(self.points), np.inf), np.ones(len(self.points))
        return SeenMap(
            self.points, self.normals, every, self.frames, none, none, self.reachable(),
            Voxels(low, SEEN.edge, full.reshape(shape)),
        )  # fmt: skip


def _scene(corners: Array) -> Any:
    scene = import_open3d().t.geometry.RaycastingScene(nthreads=1)
    vertices = corners.reshape(-1, 3).astype(np.float32)
    scene.add_triangles(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3))
    return scene


def _open(scene: Any, points: Array, normals: Array, camera: Array) -> npt.NDArray[np.bool_]:
    """Return which points (N, 3) a camera (3,) sees: near enough, not slanted too much, nothing before them."""
    line = camera - points
    distance = np.linalg.norm(line, axis=1)
    seen = np.einsum("ni,ni->n", line, normals) > distance * np.cos(np.deg2rad(SEEN.slant))
    seen &= distance < SEEN.farthest
    rays = np.concatenate([points + 5e-4 * normals, line], axis=1)[seen].astype(np.float32)
    seen[seen] = np.asarray(scene.cast_rays(rays)["t_hit"].numpy() >= 1.0)
    return seen
