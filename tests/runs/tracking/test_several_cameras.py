"""`track` on frames of several cameras: each goes on from what it saw itself, and what one cannot see another tells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.assets.building.pictured import Shots, cameras, shots
from tests.runs.tracking.test_track_frames import SIZE, STEP, YAW, body, folder_of, larger, library, lines, of, track
from twin_diagram.logs.frames import ViewCamera
from twin_diagram.signals import rotations

__all__ = ["library"]  # the fixture
WALL = ((0.01, 0.26, 0.2), 0.13, 0.0, 0.0)
"""Between the brick and the first camera."""


def around(azimuth: float) -> ViewCamera:
    """A camera 0.7 m away that looks at the table's middle from a side [°]."""
    made = larger(cameras(1, 0.03, 35.0, 35.0, 0.7)[0])
    c, s = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return made.moved(turn @ made.R_WC, turn @ made.p_WC)


def off_by(camera: ViewCamera, twist: list[float]) -> ViewCamera:
    """A camera as it is told of: turned [rad] and moved [m]."""
    R = rotations.matrix(rotations.exp(np.array(twist[:3])))
    return camera.moved(R @ camera.R_WC, camera.p_WC + twist[3:])


def sequence(
    views: list[ViewCamera],
    count: int,
    x: Callable[[int], float],
    wall: bool = False,
    told: list[ViewCamera] | None = None,
) -> Shots:
    """Frames of the views in turn, the brick at x(k) [m]; the cameras are `told` to be elsewhere."""
    frames = []
    for k in range(count):
        bodies = [body(SIZE, x(k), 0.02, YAW), *([body(*WALL)] if wall else [])]
        (one,) = shots(bodies, [views[k % len(views)]]).frames
        if told is not None:
            camera = told[k % len(told)]
            one = replace(one, camera=camera, colour=camera)
        frames.append(replace(one, number=k, time=k / 15.0))
    return Shots(frames)


def error(entry: dict[str, Any], x: float) -> float:
    """How far an object is from where it is, on the table [m]."""
    return float(np.linalg.norm(np.array(entry["p_WO"])[:2] - [x, 0.02]))


def pushed(k: int) -> float:
    return STEP * k - 0.06


@pytest.mark.slow
def test_what_is_hidden_from_one_camera_is_known_by_the_other(library: Path, tmp_path: Path) -> None:
    """The brick is pushed behind a wall, a quarter turn from the camera that sees it."""
    first, second = around(0.0), around(90.0)
    both = sequence([first, second], 12, pushed, wall=True)
    alone = Shots([replace(frame, number=j) for j, frame in enumerate(both.frames[1::2])])
    assert track(library, folder_of(both, tmp_path / "both"), tmp_path / "both_out") == 0
    assert track(library, folder_of(alone, tmp_path / "alone"), tmp_path / "alone_out") == 0
    of_both = [error(of(line, "brick"), pushed(k)) for k, line in enumerate(lines(tmp_path / "both_out")) if k > 1]
    of_one = [error(of(line, "brick"), pushed(2 * k + 1)) for k, line in enumerate(lines(tmp_path / "alone_out"))]
    assert max(of_both[1::2]) <= max(of_one[1:]) + 1e-3
    # How fast it is the other camera's second picture tells.
    assert max(of_both[2:]) < 0.5 * STEP


@pytest.mark.slow
def test_calibrations_that_differ_are_no_motion(library: Path, tmp_path: Path) -> None:
    """Two cameras that are told 6 and 8 mm aside show one brick at rest in two places."""
    views = [around(0.0), around(90.0)]
    told = [off_by(views[0], [0, 0, 0, 0.006, 0, 0]), off_by(views[1], [0, 0, 0, 0, 0.008, 0])]
    seen = sequence(views, 10, lambda _: -0.03, told=told)
    assert track(library, folder_of(seen, tmp_path / "frames"), tmp_path / "out") == 0
    found = [of(line, "brick") for line in lines(tmp_path / "out")]
    assert {one["status"] for one in found[2:]} == {"tracked"}
    assert all(error(one, -0.03) < 0.011 for one in found)
    assert all(len({entry["track"] for entry in line["objects"]}) == 1 for line in lines(tmp_path / "out"))


@pytest.mark.slow
def test_a_camera_that_is_led_along_is_one(library: Path, tmp_path: Path) -> None:
    """Forty degrees about the table, five from frame to frame."""
    frames = [sequence([around(5.0 * k)], 1, lambda _: -0.03).frames[0] for k in range(9)]
    led = Shots([replace(frame, number=k, time=k / 15.0) for k, frame in enumerate(frames)])
    assert track(library, folder_of(led, tmp_path / "frames"), tmp_path / "out") == 0
    found = [of(line, "brick") for line in lines(tmp_path / "out")]
    assert max(error(one, -0.03) for one in found) < 0.003
