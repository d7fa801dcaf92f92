"""Films things before a wall, in a crate or small, with a ray caster and a camera unlike the twin's."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import trimesh
from pose_truth.raycast import look_at
from rendered_views import Picture, write_scene
from scipy.spatial.transform import Rotation

from foreign_truth.shapes import Array, Foreign
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.native import import_open3d

o3d = import_open3d()
SCENES = ("wall", "small", "crate", "strangers")
FRAMES = 15
COARSE = 4
"""Every so many-th ray tells what share of a thing is seen."""


@dataclass(frozen=True)
class Placed:
    """A thing at R_WM, p_WM [m] of its mesh."""

    one: Foreign
    R: Array
    p: Array


def laid_out(scene: str, known: Sequence[Foreign], others: Sequence[Foreign], rng: np.random.Generator) -> list[Placed]:
    """Place things: on a table in cells, or close by one another in a crate, the last ones on the first."""
    if scene == "strangers":
        return [_stood(one, at, rng) for one, at in zip(others, _cells(0.17, rng), strict=False)]
    some = [known[k] for k in rng.permutation(len(known))[:6]]
    if not any(one.name == "mug" for one in some):
        some[0] = known[0]
    strange = [others[k] for k in rng.permutation(len(others))[:2]]
    if scene != "crate":
        return [_stood(one, at, rng) for one, at in zip([*some, *strange], _cells(0.17, rng), strict=False)]
    flat = [one for one in known if one.name == "box"]
    rest = [one for one in some if one.name != "box"]
    placed = [
        _stood(one, at, rng) for one, at in zip([*flat, *rest[1:], *strange[:1]], _cells(0.125, rng), strict=False)
    ]
    top = _stood(rest[0], placed[0].p[:2], rng)
    return [*placed, Placed(top.one, top.R, top.p + [0.0, 0.0, _height(placed[0])])]


def _height(one: Placed) -> float:
    return float((one.one.vertices @ one.R.T + one.p)[:, 2].max())


def _cells(step: float, rng: np.random.Generator) -> list[Array]:
    """Return nine places on the table in any order [m]."""
    grid = [np.array([x, y]) for x in (-step, 0.0, step) for y in (-step, 0.0, step)]
    return [grid[k] + rng.uniform(-0.1, 0.1, 2) * step for k in rng.permutation(9)]


def _stood(one: Foreign, at: Array, rng: np.random.Generator) -> Placed:
    turn = Rotation.from_rotvec([0, 0, rng.uniform(-np.pi, np.pi)])
    if one.lying:
        turn = turn * Rotation.from_rotvec([np.pi / 2, 0, 0])
    R = turn.as_matrix()
    corners = one.vertices @ R.T
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return Placed(one, R, np.array([at[0] - middle[0], at[1] - middle[1], -corners[:, 2].min()]))


class Stage:
    """Casts rays at things and what stands about them; which part of which thing each ray meets is told."""

    def __init__(self, scene: str, placed: Sequence[Placed]) -> None:
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self.owner, self._colour = list[tuple[int, int]](), list[Array]()
        for k, one in enumerate(placed):
            for j, part in enumerate(one.one.parts):
                self._add(part.mesh, one.R, one.p, part.colour, (k, j))
        for mesh, colour in _about(scene) if scene else []:
            self._add(mesh, np.eye(3), np.zeros(3), np.array(colour), (-1, 0))

    def _add(self, mesh: trimesh.Trimesh, R: Array, p: Array, colour: Array, owner: tuple[int, int]) -> None:
        vertices = o3d.core.Tensor((np.asarray(mesh.vertices) @ R.T + p).astype(np.float32))
        self._scene.add_triangles(vertices, o3d.core.Tensor(np.asarray(mesh.faces).astype(np.uint32)))
        self.owner.append(owner)
        self._colour.append(colour)

    def cast(self, view: ViewCamera, step: int = 1) -> tuple[Array, npt.NDArray[np.int64], Array, Array]:
        """Return depth [m] (0: nothing), which mesh each ray meets (-1: none), its colour of 255, and the incidence."""
        rays = view.rays()[::step, ::step] @ view.R_WC.T
        both = np.concatenate([np.broadcast_to(view.p_WC, rays.shape), rays], axis=-1).astype(np.float32)
        hit = self._scene.cast_rays(o3d.core.Tensor(both))
        depth, normal = hit["t_hit"].numpy().astype(float), hit["primitive_normals"].numpy().astype(float)
        there = np.isfinite(depth)
        which = np.where(there, hit["geometry_ids"].numpy().astype(np.int64), -1)
        sight = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        facing = np.abs((normal * sight).sum(axis=-1)) * there
        lamp = np.array([0.5, -0.35, 0.8]) / np.linalg.norm([0.5, -0.35, 0.8])
        lit = 0.55 + 0.35 * np.maximum(normal @ lamp, 0.0) + 0.1 * facing
        colour = np.array([*self._colour, np.zeros(3)])[which] * lit[..., None]
        return np.where(there, depth, 0.0), which, colour, facing


def _about(scene: str) -> list[tuple[trimesh.Trimesh, tuple[float, float, float]]]:
    """Return the table, and a wall behind or a crate around."""

    def box(x: float, y: float, z: float, at: tuple[float, float, float]) -> trimesh.Trimesh:
        return trimesh.creation.box((x, y, z), trimesh.transformations.translation_matrix(at))

    found = [(box(1.6, 1.6, 0.02, (0, 0, -0.01)), (120.0, 95.0, 70.0))]
    if scene in ("wall", "strangers"):
        found.append((box(3.0, 0.02, 1.6, (0, 0.42, 0.6)), (190.0, 185.0, 170.0)))
    if scene == "crate":
        for x, y, at in (
            (0.46, 0.01, (0, 0.23)),
            (0.46, 0.01, (0, -0.23)),
            (0.01, 0.46, (0.23, 0)),
            (0.01, 0.46, (-0.23, 0)),
        ):
            found.append((box(x, y, 0.07, (*at, 0.035)), (60.0, 90.0, 130.0)))
    return found


def film(folder: Path, scene: str, placed: Sequence[Placed], rng: np.random.Generator) -> dict[str, Any]:
    """Write a folder of frames; return the true cameras' poses and the share of each thing and telling part seen.

    Args:
        folder: that gets the BOP scene.
        scene: of `SCENES`.
        placed: what stands there.
        rng: of all that is drawn.
    """
    stage, alone = Stage(scene, placed), [Stage("", [one]) for one in placed]
    small = scene == "small"
    width, height, focal = (320, 240, 290.0) if small else (640, 480, 570.0)
    sway, bow = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.35, 0.8, 6)
    azimuth, elevation = rng.uniform(-2.1, -1.0), np.radians(rng.uniform(32, 55))
    far = rng.uniform(0.75, 0.9)
    away = far * np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    patches = _field((height, width), 12.0, rng)
    shots, cameras, shown, parts = [], [], [], []
    for k in range(FRAMES):
        hand = np.zeros(6) if small else np.sin(sway + bow * k)
        pinhole = look_at(away + 0.012 * hand[:3], 0.012 * hand[3:] + [0, 0, 0.03], width, height, focal)
        view = ViewCamera(width, height, focal, focal, *pinhole.centre, pinhole.R_WC, pinhole.p_WC)
        depth, which, colour, facing = stage.cast(view)
        shots.append(Picture(view, view, _depth(depth, facing, patches, rng), _rgb(colour, k, rng), which == 0))
        cameras.append([view.R_WC.tolist(), view.p_WC.tolist()])
        seen = [_seen(stage, which, j, lone.cast(view, COARSE)[1]) for j, lone in enumerate(alone)]
        shown.append([one[0] for one in seen])
        parts.append([one[1] for one in seen])
    write_scene(folder, shots, with_masks=False, depth_scale=1.0)
    (folder / "times.json").write_text(json.dumps([round(k / 15, 6) for k in range(FRAMES)]))
    if small:
        told = json.loads((folder / "scene_camera.json").read_text())
        kept = {k: {key: v for key, v in one.items() if "w2c" not in key} for k, one in told.items()}
        (folder / "scene_camera.json").write_text(json.dumps(kept))
    return {"cameras": cameras, "shown": shown, "telling": parts}


def _seen(stage: Stage, which: npt.NDArray[np.int64], k: int, alone: npt.NDArray[np.int64]) -> tuple[float, float]:
    """Return what share of a thing, and of its last part (of the thing's own pixels), the picture shows."""
    mine = [number for number, (owner, _) in enumerate(stage.owner) if owner == k]
    coarse = which[::COARSE, ::COARSE]
    whole = max(int((alone >= 0).sum()), 1)
    return float(np.isin(coarse, mine).sum()) / whole, float((coarse == mine[-1]).sum()) / whole


def _field(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> Array:
    rough = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), sigma)
    return np.asarray(rough / rough.std())


def _depth(depth: Array, facing: Array, patches: Array, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Return depth as a cheap camera gives it: errors in patches, holes at edges and on slopes, whole millimetres."""
    shape = (depth.shape[0], depth.shape[1])
    rms = 0.0006 + 0.0016 * depth**2
    errors = 0.7 * _field(shape, 1.8, rng) + 0.5 * patches + 0.5 * rng.standard_normal(shape)
    kernel = np.ones((3, 3))
    edge = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > 0.02
    lost = (edge & (rng.random(shape) < 0.6)) | (facing < 0.2) | (_field(shape, 3.0, rng) > 3.2)
    return np.where((depth > 0) & ~lost, np.round(depth + rms * errors, 3), 0.0).astype(np.float32)


def _rgb(colour: Array, frame: int, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return colours under an exposure that changes, darker at the corners, a little soft."""
    h, w = colour.shape[:2]
    v, u = np.mgrid[:h, :w]
    corner = 1 - 0.15 * ((u / w - 0.5) ** 2 + (v / h - 0.5) ** 2) * 2
    exposed = colour * (1 + 0.12 * np.sin(0.5 * frame)) * corner[..., None]
    soft = cv2.GaussianBlur(exposed, (0, 0), 0.8) + rng.normal(0, 3.0, colour.shape)
    return np.clip(soft, 0, 255).astype(np.uint8)
