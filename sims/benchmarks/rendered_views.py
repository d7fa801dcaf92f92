"""Pictures of an object on a table as a depth camera takes them: exact by ray casting, then with seeded defects."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import trimesh
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from twin_diagram.assets.mesh import bilinear, read_obj, read_png
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.native import import_open3d
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class TrueObject:
    """A textured mesh that stands on z = 0: vertices (V, 3) [m], faces, per-vertex uv and the texture's RGB."""

    name: str
    vertices: Array
    faces: npt.NDArray[np.int64]
    uv: Array
    texture: npt.NDArray[np.uint8]

    def parts(self) -> list[npt.NDArray[np.bool_]]:
        """Return which faces belong together, part by part: places shared, whatever the texture's seams."""
        _, place = np.unique(np.round(self.vertices, 6), axis=0, return_inverse=True)
        corner = place.reshape(-1)[self.faces]
        rows, columns = corner.ravel(), corner[:, [1, 2, 0]].ravel()
        size = int(corner.max()) + 1
        _, label = connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), (size, size)), directed=False)
        return [label[corner[:, 0]] == k for k in np.unique(label[corner[:, 0]])]


@dataclass(frozen=True)
class Picture:
    """One picture: the pose that is told and the true one, depth [m], RGB, and where the object shows."""

    told: ViewCamera
    true: ViewCamera
    depth: npt.NDArray[np.float32]
    rgb: npt.NDArray[np.uint8]
    mask: npt.NDArray[np.bool_]


def load(path: Path) -> TrueObject:
    """Return an object of the library (`visual.obj`) or a glTF file, set down on z = 0 about the z axis."""
    if path.is_dir():
        mesh = read_obj(path / "visual.obj")
        v, f, uv, texture = mesh.vertices, mesh.faces, mesh.uv, read_png(path / "visual.png")
        name = path.name
    else:
        geometry = trimesh.load(path, force="mesh", process=False)
        v, f, uv = np.array(geometry.vertices), np.array(geometry.faces), np.array(geometry.visual.uv)
        v = v @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T  # glTF is Y-up
        texture, name = read_png(path.with_suffix(".png")), path.stem.removesuffix("_textured")
    middle = (v.min(axis=0) + v.max(axis=0)) / 2
    v = v - [middle[0], middle[1], v[:, 2].min()]
    return TrueObject(name, v, f.astype(np.int64), uv, texture)


OTHERS = (30, 170, 50)
"""Colour of what stands beside: green, as SyncTwin's cube."""


def orbit(count: int, look_at: Array, distance: float = 0.6, seed: int = 0) -> list[ViewCamera]:
    """Return `count` cameras, 640×480, on a spiral about an object, from 10° to 82° above its middle."""
    rng = np.random.default_rng([seed, 1])
    cameras = []
    for k in range(count):
        azimuth = 2 * np.pi * (k * 0.381966 + 0.02 * rng.standard_normal())
        height = np.radians(10 + 72 * ((k + 0.5) / count) + 2 * rng.standard_normal())
        away = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
        cameras.append(looking(look_at + away * distance, -away))
    return cameras


def rings(count: int, look_at: Array, elevations: Sequence[float], distance: float = 0.6) -> list[ViewCamera]:
    """Return about `count` cameras, 640×480, evenly around an object at each elevation above its middle [deg]."""
    cameras = []
    each = max(1, count // len(elevations))
    for height in np.radians(elevations):
        for azimuth in 2 * np.pi * np.arange(each) / each:
            away = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
            cameras.append(looking(look_at + away * distance, -away))
    return cameras


def looking(p_WC: Array, z: Array) -> ViewCamera:
    """Return a camera, 640×480, that looks along a unit vector with the ground below."""
    x = np.cross(z, [0.0, 0, 1])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z], axis=1)
    return ViewCamera(640, 480, 600.0, 600.0, 319.5, 239.5, R, p_WC)


class Studio:
    """Renders one object on a table, 1.2 m square, whose top is z = 0."""

    def __init__(self, item: TrueObject, others: list[TrueObject] | None = None) -> None:
        self._o3d = import_open3d()
        self._item = item
        self._scene = self._o3d.t.geometry.RaycastingScene(nthreads=1)
        self._add(item.vertices, item.faces)
        s = 0.6
        self._add(np.array([[-s, -s, 0], [s, -s, 0], [s, s, 0], [-s, s, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
        for other in others or []:
            self._add(other.vertices, other.faces)

    def _add(self, vertices: Array, faces: npt.NDArray[np.int64]) -> None:
        tensor = self._o3d.core.Tensor
        self._scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))

    def cast(
        self, camera: ViewCamera
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8], npt.NDArray[np.bool_], Array]:
        """Return depth [m], RGB, the object's mask and the cosine of incidence."""
        rays = camera.rays() @ camera.R_WC.T
        start = np.broadcast_to(camera.p_WC, rays.shape)
        hit = self._scene.cast_rays(self._o3d.core.Tensor(np.concatenate([start, rays], axis=-1).astype(np.float32)))
        depth, which = hit["t_hit"].numpy(), hit["geometry_ids"].numpy()
        there = np.isfinite(depth)
        mask = which == 0
        points = start + rays * np.where(there, depth, 0)[..., None]
        rgb = np.full((*depth.shape, 3), 40, np.uint8)
        checks = ((np.floor(points[..., 0] / 0.05) + np.floor(points[..., 1] / 0.05)) % 2)[..., None]
        rgb[which == 1] = (150 + 40 * checks[which == 1]).astype(np.uint8)
        rgb[which > 1] = OTHERS
        face = self._item.faces[hit["primitive_ids"].numpy()[mask].astype(int)]
        a, b = hit["primitive_uvs"].numpy()[mask].T.astype(float)
        share = np.stack([1 - a - b, a, b], axis=1)[:, :, None]
        rgb[mask] = np.round(255 * bilinear(self._item.texture, (self._item.uv[face] * share).sum(axis=1))).astype(
            np.uint8
        )
        normal = hit["primitive_normals"].numpy()
        cosine = np.abs((normal * rays).sum(axis=-1)) / np.linalg.norm(rays, axis=-1)
        return np.where(there, depth, 0).astype(np.float32), rgb, mask & there, np.where(there, cosine, 0)


def waves(shape: tuple[int, int], seed: int) -> Array:
    """Return unit noise, Gaussian of σ 15 pixels, that stays for a run."""
    return _correlated(shape, 15.0, np.random.default_rng([seed, 2]))


def _correlated(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> Array:
    rough = ndimage.gaussian_filter(rng.standard_normal(shape), sigma, mode="wrap")
    return np.asarray(rough * (2 * np.sqrt(np.pi) * sigma))


def worsened(
    depth: npt.NDArray[np.float32], cosine: Array, coefficient: float, fixed: Array, rng: np.random.Generator
) -> npt.NDArray[np.float32]:
    """Return depth with noise of RMS coefficient·z² [m], the issue's profile.

    A tenth of its variance is white, 60 % correlated (σ 2.5 pixels), 30 % fixed waves; edges jitter by 0.8 pixel, a
    fifth of their pixels fly between both sides; nothing beyond 75° of incidence.
    """
    if coefficient <= 0:
        return depth
    shape = (depth.shape[0], depth.shape[1])
    v, u = np.indices(shape).astype(float)
    jitter = 0.8 * np.stack([_correlated(shape, 2.5, rng) for _ in range(2)])
    at = np.rint([v + jitter[0], u + jitter[1]]).astype(int)
    at[0], at[1] = np.clip(at[0], 0, shape[0] - 1), np.clip(at[1], 0, shape[1] - 1)
    z = depth[at[0], at[1]].astype(float)
    high, low = ndimage.maximum_filter(z, 3), ndimage.minimum_filter(np.where(z > 0, z, np.inf), 3)
    edge = (high - np.minimum(low, high) > 0.015) & (z > 0)
    flying = edge & (rng.random(shape) < 0.2)
    z = np.where(flying, low + (high - np.where(flying, low, 0)) * rng.random(shape), z)
    noise = (
        np.sqrt(0.1) * rng.standard_normal(shape) + np.sqrt(0.6) * _correlated(shape, 2.5, rng) + np.sqrt(0.3) * fixed
    )
    seen = (z > 0) & (cosine > np.cos(np.radians(75)))
    return np.where(seen, z + coefficient * z**2 * noise, 0).astype(np.float32)


def pictures(
    item: TrueObject,
    count: int,
    coefficient: float = 0.0015,
    off: tuple[float, float] = (0.002, np.radians(0.2)),
    seed: int = 0,
    distance: float = 0.6,
    others: list[TrueObject] | None = None,
    elevations: Sequence[float] = (),
) -> list[Picture]:
    """Return pictures whose told poses are off by `off` (RMS length [m], RMS angle [rad]); `others` stand beside.

    They are taken on a spiral, or on rings at `elevations` [deg].
    """
    studio = Studio(item, others)
    rng = np.random.default_rng([seed, 3])
    fixed = waves((480, 640), seed)
    made = []
    look_at = np.array([0.0, 0.0, item.vertices[:, 2].max() / 2])
    cameras = rings(count, look_at, elevations, distance) if elevations else orbit(count, look_at, distance, seed)
    for camera in cameras:
        depth, rgb, mask, cosine = studio.cast(camera)
        turn = rotations.matrix(rotations.exp(rng.standard_normal(3) * off[1] / np.sqrt(3)))
        told = camera.moved(camera.R_WC @ turn, camera.p_WC + rng.standard_normal(3) * off[0] / np.sqrt(3))
        made.append(Picture(told, camera, worsened(depth, cosine, coefficient, fixed, rng), rgb, mask))
    return made


def cube(edge: float, at: tuple[float, float]) -> TrueObject:
    """Return a green cube that stands at a place on the table."""
    mesh = trimesh.creation.box([edge, edge, edge])
    vertices = np.asarray(mesh.vertices) + [*at, edge / 2]
    return TrueObject(
        "cube", vertices, np.asarray(mesh.faces), np.zeros((len(vertices), 2)), np.zeros((1, 1, 3), np.uint8)
    )


def write_predictions(file: Path, shots: list[Picture], unit: float, seed: int = 0, step: int = 2) -> Path:
    """Write pictures as a network's `predictions.npz` would be: every `step`-th pixel, in a unit of its own [m].

    Told poses stand for predicted ones, and each view's depth is off by a share that differs from view to view (0.3 %)
    and by waves over the picture (0.2 %), as networks are. Where there is no depth, nothing is sure.
    """
    rng = np.random.default_rng([seed, 9])
    points, sure, extrinsic, intrinsic, images = [], [], [], [], []
    for shot in shots:
        depth = shot.depth.astype(float)
        depth *= 1 + 0.003 * rng.standard_normal() + 0.002 * _correlated((depth.shape[0], depth.shape[1]), 40.0, rng)
        c = shot.told
        points.append(((c.rays() * depth[..., None] @ c.R_WC.T + c.p_WC) / unit)[::step, ::step].astype(np.float32))
        sure.append(np.where(shot.depth > 0, 5.0, 1.0)[::step, ::step].astype(np.float32))
        extrinsic.append(np.hstack([c.R_WC.T, -c.R_WC.T @ c.p_WC[:, None] / unit]))
        intrinsic.append([[c.fx / step, 0, c.cx / step], [0, c.fy / step, c.cy / step], [0, 0, 1]])
        images.append(np.moveaxis(shot.rgb[::step, ::step], -1, 0))
    np.savez(
        file,
        world_points=np.stack(points),
        world_points_conf=np.stack(sure),
        extrinsic=np.array(extrinsic),
        intrinsic=np.array(intrinsic),
        images=np.stack(images),
    )
    return file


def write_scene(folder: Path, shots: list[Picture], with_masks: bool = True, depth_scale: float = 0.1) -> Path:
    """Write pictures as a BOP scene folder, with the poses that are told. Returns the folder."""
    cameras = {}
    for what in ("rgb", "depth", *(["mask_visib"] if with_masks else [])):
        (folder / what).mkdir(parents=True, exist_ok=True)
    for k, shot in enumerate(shots):
        cv2.imwrite(str(folder / "rgb" / f"{k:06d}.png"), shot.rgb[..., ::-1])
        cv2.imwrite(str(folder / "depth" / f"{k:06d}.png"), np.round(shot.depth * 1000 / depth_scale).astype(np.uint16))
        if with_masks:
            cv2.imwrite(str(folder / "mask_visib" / f"{k:06d}_000000.png"), shot.mask.astype(np.uint8) * 255)
        c = shot.told
        cameras[str(k)] = {
            "cam_K": [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
            "depth_scale": depth_scale,
            "cam_R_w2c": c.R_WC.T.ravel().tolist(),
            "cam_t_w2c": (-1000 * c.R_WC.T @ c.p_WC).tolist(),
        }
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    return folder
