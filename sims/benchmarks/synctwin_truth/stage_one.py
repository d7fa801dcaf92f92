"""Assets that Stage I builds of pictures, by the path that `twin-diagram assets build` takes."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from pose_truth import raycast, spoil
from rendered_views import Picture, Studio, TrueObject, load, orbit, write_scene

from synctwin_truth.told_camera import CameraError
from twin_diagram.assets.building import build_from_frames
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals import rotations

THINGS = {"box": "003_cracker_box", "cup": "mug", "bottle": "bottle", "ketchup": "006_mustard_bottle"}
"""What stands for the paper's four."""
POSES_OFF = (0.002, float(np.radians(0.2)))
"""RMS length [m] and angle [rad] by which told poses are off."""


def true_object(name: str, data: Path) -> TrueObject:
    """Return one of the shipped objects, or else of the YCB meshes in `data`."""
    own = models_dir() / "objects" / name
    return load(own if own.is_dir() else data / "ycb" / f"{name}_textured.gltf")


def shoot(item: TrueObject, profile: str, views: int, seed: int, wrong: bool, distance: float = 0.6) -> list[Picture]:
    """Return pictures around an object by a camera of a profile; with `wrong`, its K and depth scale are off, too."""
    rng = np.random.default_rng([seed, 7])
    error = CameraError.drawn(rng) if wrong else CameraError.none()
    fixed = None if profile == "ideal" else spoil.field((480, 640), 15.0, rng)
    studio = Studio(item)
    made = []
    for camera in orbit(views, np.array([0.0, 0.0, item.vertices[:, 2].max() / 2]), distance, seed):
        depth, rgb, mask, cosine = studio.cast(camera)
        label = np.where(mask, 0, np.where(depth > 0, -1, -3)).astype(np.int16)
        taken = raycast.Picture(depth, rgb, label, cosine.astype(np.float32))
        depth, rgb = spoil.spoiled(taken, profile, rng, fixed)
        turn = rotations.matrix(rotations.exp(rng.standard_normal(3) * POSES_OFF[1] / np.sqrt(3)))
        told = camera.moved(camera.R_WC @ turn, camera.p_WC + rng.standard_normal(3) * POSES_OFF[0] / np.sqrt(3))
        made.append(
            Picture(error.told(told, posed=False), camera, depth * np.float32(1 + error.depth_scale), rgb, mask)
        )
    return made


def built(library: Path, thing: str, profile: str, views: int, seed: int, wrong: bool, data: Path) -> Path:
    """Return the folder of the asset of one thing, built of pictures where it is not there yet."""
    folder = library / thing
    if not (folder / "asset.yaml").is_file():
        shots = shoot(true_object(THINGS[thing], data), profile, views, seed, wrong)
        with tempfile.TemporaryDirectory() as aside:
            scene = write_scene(Path(aside) / "scene", shots)
            build_from_frames(scene, thing, library, density=500.0)
    return folder
