"""Films a script as an outsider's folder of frames, and keeps what is true of each frame apart from it."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pose_truth import raycast, spoil
from rendered_views import Picture, write_scene
from synctwin_truth.told_camera import CameraError

from scene_truth.script import PERIOD, Script
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.signals.calibration_error import SIZE

Array = npt.NDArray[np.float64]
NEAR = 0.004
"""A point of a surface is seen where depth meets it this closely [m]."""


@dataclass(frozen=True)
class Truth:
    """What is true of each of F frames and K things.

    Attributes:
        R, p: (F, K, 3, 3), (F, K, 3) X_CO in the true camera's frame [m].
        seen: (F, K) share of the camera-facing surface that is in the picture.
        carried: (F, K) whether it is being carried.
        R_WC, p_WC: the true camera's pose: what is reported in W is scored there, calibration errors and all.
        told: camera that the folder tells of; None: the true one.
        calibration: (10,) its errors, in the order of `signals.calibration_error`.
    """

    R: Array
    p: Array
    seen: Array
    carried: npt.NDArray[np.bool_]
    R_WC: Array
    p_WC: Array
    told: ViewCamera | None = None
    calibration: Array = field(default_factory=lambda: np.zeros(SIZE))


def film(
    folder: Path, script: Script, profile: str, wrong: bool, seconds: float, rng: np.random.Generator, shrink: int = 1
) -> Truth:
    """Write the frames of a script, seen from a place that is drawn.

    Args:
        folder: that gets the BOP scene.
        script: who is where and when.
        profile: of the camera's noise.
        wrong: whether the camera has calibration errors.
        seconds: how long.
        rng: of all that is drawn.
        shrink: of pictures, in whole numbers.
    """
    camera = _camera(rng, shrink)
    view = ViewCamera(camera.width, camera.height, camera.focal, camera.focal, *camera.centre, camera.R_WC, camera.p_WC)
    error = CameraError.drawn(rng) if wrong else CameraError.none()
    told = error.told(view)
    shape = (camera.height, camera.width)
    waves = None if profile == "ideal" else spoil.field(shape, 15.0, rng)
    shots, rows = [], []
    for k in range(round(seconds / PERIOD)):
        time = k * PERIOD
        poses = [one.pose(time) for one in script.actors]
        things = [(a.kind, R, p) for a, (R, p, _) in zip(script.actors, poses, strict=True)]
        picture = raycast.take(camera, things, _before(camera, script, poses, time))
        rows.append((poses, [_seen(camera, picture, j, *one) for j, one in enumerate(things)]))
        depth, rgb = spoil.spoiled(picture, profile, rng, waves)
        depth *= np.float32(1.0 + error.depth_scale)
        shots.append(Picture(told, view, depth, rgb, picture.label == 0))
    write_scene(folder, shots, with_masks=False)
    (folder / "times.json").write_text(json.dumps([round(PERIOD * k, 6) for k in range(len(shots))]))
    R = np.array([[camera.R_WC.T @ one[0] for one in poses] for poses, _ in rows])
    p = np.array([[camera.R_WC.T @ (one[1] - camera.p_WC) for one in poses] for poses, _ in rows])
    carried = np.array([[one[2] for one in poses] for poses, _ in rows])
    seen = np.array([one for _, one in rows])
    return Truth(R, p, seen, carried, camera.R_WC, camera.p_WC, told if wrong else None, error.calibration)


def _camera(rng: np.random.Generator, shrink: int) -> Pinhole:
    """Return a camera a metre away that sees all cells, in pictures of 640 × 480 pixels, `shrink` times smaller."""
    azimuth, elevation = rng.uniform(-2.2, -0.9), np.radians(rng.uniform(35.0, 60.0))
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    eye, focus = float(rng.uniform(1.0, 1.15)) * away, np.array([0.0, 0.0, 0.03])
    return raycast.look_at(eye, focus, 640 // shrink, 480 // shrink, 560.0 / shrink)


def _before(
    camera: Pinhole, script: Script, poses: list[tuple[Array, Array, bool]], time: float
) -> tuple[Array, npt.NDArray[np.int64]] | None:
    """Return what else is in view: forearms that hold what is carried, and the plate."""
    vertices: list[Array] = []
    faces: list[npt.NDArray[np.int64]] = []
    for actor, (R, p, carried) in zip(script.actors, poses, strict=True):
        if not carried:
            continue
        top = float((actor.kind.mesh.vertices @ R.T + p)[:, 2].max())
        tip, root = np.array([p[0], p[1], top - 0.01]), np.array([p[0] + 0.1, p[1] + 0.6, top + 0.25])
        _append(vertices, faces, *_beam(tip, root, 0.035))
    start, end, begin, until = script.plate
    if begin < time < until:
        x, y = start + (time - begin) / (until - begin) * (end - start)
        flat = np.array(
            [[x - 0.06, y - 0.4, 0.6], [x + 0.06, y - 0.4, 0.6], [x + 0.06, y + 0.4, 0.6], [x - 0.06, y + 0.4, 0.6]]
        )
        _append(vertices, faces, flat @ camera.R_WC.T + camera.p_WC, np.array([[0, 1, 2], [0, 2, 3]]))
    if not vertices:
        return None
    return np.concatenate(vertices), np.concatenate(faces)


def _append(
    vertices: list[Array], faces: list[npt.NDArray[np.int64]], more: Array, corners: npt.NDArray[np.int64]
) -> None:
    faces.append(corners + sum(len(one) for one in vertices))
    vertices.append(more)


def _beam(tip: Array, root: Array, half: float) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return a square beam between two points: a forearm."""
    way = (root - tip) / np.linalg.norm(root - tip)
    side = np.cross(way, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, way)
    ring = half * np.array([side + up, -side + up, -side - up, side - up])
    vertices = np.concatenate([tip + ring, root + ring])
    walls = [[k, (k + 1) % 4, 4 + (k + 1) % 4] for k in range(4)] + [[k, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
    return vertices, np.array([*walls, [0, 1, 2], [0, 2, 3]])


def _seen(camera: Pinhole, picture: raycast.Picture, number: int, kind: object, R: Array, p: Array) -> float:
    """Return the share of a thing's camera-facing surface that the picture shows."""
    asset = kind.asset  # type: ignore[attr-defined]
    points, normals = asset.points_O @ R.T + p, asset.normals_O @ R.T
    facing = np.einsum("ni,ni->n", normals, camera.p_WC - points) > 0.2 * np.linalg.norm(camera.p_WC - points, axis=1)
    p_C = (points[facing] - camera.p_WC) @ camera.R_WC
    cu, cv = camera.centre
    u = np.round(camera.focal * p_C[:, 0] / p_C[:, 2] + cu).astype(int)
    v = np.round(camera.focal * p_C[:, 1] / p_C[:, 2] + cv).astype(int)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    u, v, z = u[inside], v[inside], p_C[inside, 2]
    shown = (picture.label[v, u] == number) & (np.abs(picture.depth[v, u] - z) < NEAR + 0.01 * z)
    alone = max(1, np.count_nonzero(facing))
    return float(shown.sum() / alone)
