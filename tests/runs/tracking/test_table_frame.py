"""What things stand on is found beside larger floors and walls, however the camera is held."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.segmentation.segmentation import Grid
from twin_diagram.runs.tracking.table_frame import table_frame
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner [m]."""
THINGS: tuple[Box, ...] = (
    ((-0.15, -0.05, 0.0), (-0.08, 0.05, 0.12)),
    ((0.05, -0.1, 0.0), (0.15, -0.04, 0.05)),
    ((0.02, 0.08, 0.0), (0.1, 0.14, 0.2)),
)
FLOOR: Box = ((-4.0, -4.0, -0.76), (4.0, 4.0, -0.74))
WALL: Box = ((-4.0, 0.35, -0.1), (4.0, 0.4, 3.0))


def looking(distance: float, down: float, roll: float = 0.0) -> Pinhole:
    """A camera that looks at the origin along y, `down` by an angle [rad]."""
    z = np.array([0.0, np.cos(down), -np.sin(down)])
    x = np.array([1.0, 0.0, 0.0])
    R = np.column_stack([x, np.cross(z, x), z]) @ rotations.matrix(rotations.exp(np.array([0.0, 0.0, roll])))
    return Pinhole(320, 240, 300.0, R, -distance * z + [0.0, 0.0, 0.06])


def depth_of(boxes: tuple[Box, ...], camera: Pinhole) -> npt.NDArray[np.float32]:
    """Return the depth image (h, w) of boxes, 0 where there is none, with noise of a millimetre at a metre."""
    rays = Grid.of(camera, 1).rays
    nearest = np.full(rays.shape[:2], np.inf)
    for low, high in boxes:
        with np.errstate(divide="ignore"):
            a, b = ((np.array(corner) - camera.p_WC) / rays for corner in (low, high))
        enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        nearest = np.where((enter < leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    depth = np.where(np.isfinite(nearest), nearest, 0.0)
    return np.asarray(depth * (1 + 0.001 * depth * np.random.default_rng(0).normal(size=depth.shape)), np.float32)


@pytest.mark.parametrize(
    ("others", "distance", "down", "roll"),
    [
        ((((-1.0, -0.8, -0.02), (1.0, 0.8, 0.0)),), 0.8, 0.8, 0.0),
        ((((-0.35, -0.22, -0.02), (0.35, 0.22, 0.0)), FLOOR), 1.3, 0.7, 0.0),  # a small table
        ((((-0.35, -0.22, -0.02), (0.35, 0.22, 0.0)), FLOOR), 1.3, 1.5, 2.0),  # from above
        ((((-4.0, -4.0, -0.02), (4.0, 4.0, 0.0)), WALL), 0.9, 0.2, 0.0),  # a wall fills most of it
        ((((-4.0, -4.0, -0.02), (4.0, 4.0, 0.0)), WALL), 0.9, 0.3, np.pi),  # held upside down
    ],
)
def test_the_plane_with_things_on_it_is_the_table(
    others: tuple[Box, ...], distance: float, down: float, roll: float
) -> None:
    camera = looking(distance, down, roll)
    found = table_frame(depth_of((*others, *THINGS), camera), camera)
    assert found.found
    assert np.degrees(np.arccos(np.clip(found.R_WT[2, 2], -1, 1))) < 0.5
    assert abs(found.R_WT[:, 2] @ found.p_WT) < 0.002


def test_nothing_on_it_the_largest_level_one_is_the_table() -> None:
    camera = looking(0.9, 0.5)
    found = table_frame(depth_of((((-4.0, -4.0, -0.02), (4.0, 4.0, 0.0)), WALL), camera), camera)
    assert found.found and found.R_WT[2, 2] > 0.999


def test_a_things_side_is_no_table() -> None:
    camera = looking(0.5, 0.5)
    assert not table_frame(depth_of(THINGS, camera), camera).found


def test_a_frame_of_what_is_beyond_tells_nothing_but_only_where_a_support_is_known() -> None:
    camera = looking(0.8, 0.8)
    table = depth_of((*THINGS, ((-1.0, -0.8, -0.02), (1.0, 0.8, 0.0))), camera)
    beyond = np.full_like(table, 4.0)
    known = table_frame(table, camera)
    assert known.found
    assert (known.told(table, camera) == table).all() and not known.told(beyond, camera).any()
    ball = table_frame(depth_of((((-0.05, -0.05, 0.0), (0.05, 0.05, 0.1)),), camera), camera)
    assert not ball.found
    assert (ball.told(beyond, camera) == beyond).all(), "the camera has stepped back"
