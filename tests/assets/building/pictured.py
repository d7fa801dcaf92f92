"""Simple bodies on a table as a small depth camera sees them, exact by ray casting; and folders of such pictures."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import trimesh

from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.native import import_open3d
from twin_diagram.signals import rotations


def box(size: tuple[float, float, float], at: tuple[float, float] = (0.0, 0.0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([*at, size[2] / 2])
    return mesh


def cup(radius: float = 0.03, wall: float = 0.004, height: float = 0.05) -> trimesh.Trimesh:
    r = radius - wall
    profile = [[0, 0], [radius, 0], [radius, height], [r, height], [r, wall], [0, wall]]
    return trimesh.creation.revolve(np.array(profile), sections=64)


def table(half: float = 0.5) -> trimesh.Trimesh:
    corners = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def looking(azimuth: float, elevation: float, middle: float, distance: float) -> ViewCamera:
    """A camera [rad, m] that looks at the z axis at a height, its picture upright."""
    c, s = np.cos(elevation), np.sin(elevation)
    away = np.array([c * np.cos(azimuth), c * np.sin(azimuth), s])
    x = np.cross(-away, [0.0, 0, 1])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(-away, x), -away], axis=1)
    return ViewCamera(200, 160, 300.0, 300.0, 99.5, 79.5, R, away * distance + [0, 0, middle])


def cameras(
    count: int, middle: float, low: float = 15.0, high: float = 78.0, distance: float = 0.35
) -> list[ViewCamera]:
    """Cameras on a spiral from a low to a high elevation [deg]."""
    heights = np.radians(low + (high - low) * (np.arange(count) + 0.5) / count)
    return [looking(2 * np.pi * 0.381966 * k, height, middle, distance) for k, height in enumerate(heights)]


@dataclass(frozen=True)
class Shots:
    """Frames in memory, as `reconstruct` reads them."""

    frames: list[RgbdFrame]

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, index: int) -> RgbdFrame:
        return self.frames[index]

    def told(self, off: list[np.ndarray], about: np.ndarray) -> Shots:
        """The same pictures, their poses told wrong by twists about a point."""
        made = []
        for frame, twist in zip(self.frames, off, strict=True):
            R = rotations.matrix(rotations.exp(twist[:3]))
            c = frame.camera
            camera = c.moved(R @ c.R_WC, R @ (c.p_WC - about) + about + twist[3:])
            made.append(replace(frame, camera=camera, colour=camera))
        return Shots(made)


def shots(
    bodies: list[trimesh.Trimesh], views: list[ViewCamera], masked: bool = False, green: int | None = None
) -> Shots:
    """Pictures of bodies on a table, each of another colour; `green` is the number of a green one."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for mesh in [table(), *bodies]:
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
        scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
    palette = np.array([[200, 200, 200], [200, 40, 40], [40, 40, 200]], np.uint8)
    if green is not None:
        palette[1 + green] = (30, 170, 50)
    frames = []
    for k, camera in enumerate(views):
        rays = camera.rays() @ camera.R_WC.T
        start = np.broadcast_to(camera.p_WC, rays.shape)
        hit = scene.cast_rays(o3d.core.Tensor(np.concatenate([start, rays], axis=-1).astype(np.float32)))
        depth, which = hit["t_hit"].numpy(), hit["geometry_ids"].numpy()
        there = np.isfinite(depth)
        rgb = np.where(there[..., None], palette[np.minimum(which, 2)], 0).astype(np.uint8)
        depth = np.where(there, depth, 0).astype(np.float32)
        frames.append(RgbdFrame(k, float(k), rgb, depth, which == 1 if masked else None, camera, camera))
    return Shots(frames)


def write(taken: Shots, folder: Path, depth_scale: float = 0.1) -> Path:
    """Write a BOP scene folder."""
    entries = {}
    for frame in taken.frames:
        for what, image in (
            ("rgb", frame.rgb[..., ::-1] if frame.rgb is not None else None),
            ("depth", np.round(frame.depth * 1000 / depth_scale).astype(np.uint16)),
            ("mask_visib", None if frame.mask is None else frame.mask.astype(np.uint8) * 255),
        ):
            if image is not None:
                (folder / what).mkdir(parents=True, exist_ok=True)
                suffix = "_000000" if what == "mask_visib" else ""
                assert cv2.imwrite(str(folder / what / f"{frame.number:06d}{suffix}.png"), image)
        c = frame.camera
        entries[str(frame.number)] = {
            "cam_K": [c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1],
            "depth_scale": depth_scale,
            "cam_R_w2c": c.R_WC.T.ravel().tolist(),
            "cam_t_w2c": (-1000 * c.R_WC.T @ c.p_WC).tolist(),
        }
    (folder / "scene_camera.json").write_text(json.dumps(entries))
    return folder


def rings(count: int, elevations: tuple[float, ...], middle: float, distance: float = 0.35) -> list[ViewCamera]:
    """Cameras all around, so many at each elevation [deg]."""
    return [looking(2 * np.pi * k / count, np.radians(e), middle, distance) for e in elevations for k in range(count)]
