"""A thing that is moved before a camera as in SyncTwin's Table I: 15 cm along each axis, 90° about each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from zlib import crc32

import numpy as np
import numpy.typing as npt
from pose_truth import raycast, spoil
from pose_truth.things import Thing
from pose_truth.trials import screen
from rendered_views import Picture, write_scene

from synctwin_truth.told_camera import CameraError
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]

FAR = 0.15
"""Each translation [m]."""
TURN = np.pi / 2
"""Each rotation [rad]."""
STEPS = 6
"""Pictures of a motion, the last one at rest: 3 cm or 18° from each to the next."""
DISTANCE = 0.9
"""Of the camera [m]."""
PERIOD = 1 / 15
"""Between pictures [s]."""
MOTIONS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class Rest:
    """Where the thing is at rest: the picture's number, and its true pose."""

    picture: int
    R: Array
    p: Array


def rests(start: Array, p: Array) -> list[Rest]:
    """Return the poses between motions, seven of them: x, y, z, and in the air roll, pitch and yaw about W's axes."""
    R, found = start, [Rest(0, start, p)]
    for k in range(6):
        if k < 3:
            p = p + FAR * np.eye(3)[k]
        else:
            R = rotations.matrix(rotations.exp(TURN * np.eye(3)[k - 3])) @ R
        found.append(Rest((k + 1) * STEPS, R, p))
    return found


def way(stops: list[Rest]) -> Iterator[tuple[Array, Array]]:
    """Yield the true pose in each picture; moving ones evenly spaced, each rest shown twice."""
    yield stops[0].R, stops[0].p
    for before, after in pairwise(stops):
        turn = rotations.log(rotations.from_matrix(after.R @ before.R.T))
        for k in range(1, STEPS + 1):
            share = min(1.0, k / (STEPS - 1))
            yield rotations.matrix(rotations.exp(share * turn)) @ before.R, before.p + share * (after.p - before.p)


def film(
    folder: Path, thing: Thing, profile: str, hidden: bool, wrong: bool, seed: int, shrink: int = 1
) -> tuple[list[Rest], list[float]]:
    """Write the pictures of one sequence as a BOP scene.

    Args:
        folder: that gets it.
        thing: what is moved.
        profile: of the camera's noise.
        hidden: whether 40 to 60 % of it are hidden by something that moves along, as a hand does.
        wrong: whether the camera has calibration errors.
        seed: of all that is drawn.
        shrink: of pictures, in whole numbers.

    Returns:
        The true poses at rest, and the share that is hidden in each picture.
    """
    rng = np.random.default_rng([crc32(thing.asset.name.encode()), crc32(profile.encode()), int(hidden), seed])
    R0 = rotations.matrix(rotations.exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])))
    bottom = float((thing.mesh.vertices @ R0.T)[:, 2].min())
    stops = rests(R0, np.array([*(rng.uniform(-0.03, 0.03, 2) - FAR / 2), -bottom]))
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(25.0, 60.0))
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    focus = np.array([0.0, 0.0, 0.12])
    camera = raycast.look_at(focus + DISTANCE * away, focus, 640 // shrink, 480 // shrink, 600.0 / shrink)
    true = ViewCamera(camera.width, camera.height, camera.focal, camera.focal, *camera.centre, camera.R_WC, camera.p_WC)
    error = CameraError.drawn(rng) if wrong else CameraError.none()
    share, angle = rng.uniform(0.4, 0.6), rng.uniform(0, 2 * np.pi)
    fixed = None if profile == "ideal" else spoil.field((camera.height, camera.width), 15.0, rng)
    shots, shares = [], []
    for R, p in way(stops):
        picture = raycast.take(camera, [(thing, R, p)])
        whole = np.count_nonzero(picture.label == 0)
        if hidden:
            picture = raycast.take(camera, [(thing, R, p)], screen(camera, picture, share, angle))
        shares.append(1.0 - np.count_nonzero(picture.label == 0) / whole)
        depth, rgb = spoil.spoiled(picture, profile, rng, fixed)
        depth *= np.float32(1.0 + error.depth_scale)
        shots.append(Picture(error.told(true), true, depth, rgb, picture.label == 0))
    write_scene(folder, shots, with_masks=False)
    (folder / "times.json").write_text(str([round(PERIOD * k, 6) for k in range(len(shots))]))
    return stops, shares
