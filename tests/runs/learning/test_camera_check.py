"""A camera that stands otherwise than it is told finds out by table, bin and platform."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram.planning.collision.convex_solids import Box, Solid
from twin_diagram.runs.learning.camera_check import KnownFaces, check_camera
from twin_diagram.runs.learning.cell import Picture, told_camera
from twin_diagram.scenario import Camera, Pose
from twin_diagram.signals.arrays import Array

NONE = np.zeros(0)


def box(middle: tuple[float, float, float], size: tuple[float, float, float]) -> Box:
    return Box(0.5 * np.array(size), np.eye(3), np.array(middle))


SOLIDS: list[Solid] = [
    box((0.4, 0.0, -0.02), (1.4, 1.8, 0.04)),
    box((0.52, 0.0, 0.03), (0.2, 0.2, 0.06)),
    *(box((0.42 + dx, -0.36, 0.06), (0.006, 0.4, 0.12)) for dx in (-0.147, 0.147)),
    *(box((0.42, -0.36 + dy, 0.06), (0.288, 0.006, 0.12)) for dy in (-0.197, 0.197)),
    box((0.42, -0.36, 0.004), (0.288, 0.388, 0.006)),
]
TOLD = {
    "from above": Pose([0.42, -0.36, 0.95], [np.pi, 0.0, np.pi / 2]),
    "slanted": Pose([1.15, 0.0, 0.62], [-2.0595, 0.0, np.pi / 2]),
}


def camera(place: Pose, std: list[float]) -> Camera:
    return Camera(X_WC=place, width=320, height=240, focal=300.0, X_WC_std=std)


def taken(told: Camera, turn: Array, shift: Array, things: list[Solid]) -> Picture:
    """What a camera shows that is off by a turn [rad] and a shift [m]; in it the camera stands as told."""
    view = told_camera(told)
    true = view.moved(Rotation.from_rotvec(turn).as_matrix() @ view.R_WC, view.p_WC + shift)
    far = KnownFaces.of([*SOLIDS, *things]).hit(true.p_WC, (true.rays() @ true.R_WC.T).reshape(-1, 3))[1]
    depth = np.where(np.isfinite(far), far, 0.0).reshape(told.height, told.width)
    noise = 8e-4 * np.random.default_rng(3).normal(size=depth.shape)
    seen = np.where(depth > 0, depth + noise * depth**2, 0.0).astype(np.float32)
    return Picture(np.zeros((*seen.shape, 3), np.uint8), seen, view, 0.0, NONE, NONE)


@pytest.mark.parametrize("place", TOLD)
def test_a_camera_is_found_that_is_off(place: str) -> None:
    told, view = camera(TOLD[place], [0.005, 0.01]), told_camera(camera(TOLD[place], [0.0, 0.0]))
    turn, shift = np.array([0.003, -0.002, 0.004]), np.array([0.0015, -0.001, 0.001])
    # Something that nobody knows lies in the bin, its top near a height that counts.
    found = check_camera(
        told, taken(told, turn, shift, [box((0.4, -0.4, 0.04), (0.1, 0.08, 0.08))]), KnownFaces.of(SOLIDS)
    )
    assert found is not None
    left = found.camera.R_WC @ view.R_WC.T @ Rotation.from_rotvec(-turn).as_matrix()
    assert np.rad2deg(Rotation.from_matrix(left).magnitude()) < 0.02
    np.testing.assert_allclose(found.camera.p_WC, view.p_WC + shift, atol=4e-4)
    assert found.shift == pytest.approx(float(np.linalg.norm(shift)), abs=5e-4)


@pytest.mark.parametrize("place", TOLD)
def test_the_scale_of_its_depth_is_found_where_that_is_told_to_be_unsure(place: str) -> None:
    """Depth 1 % too long: where only its pose may be wrong it seems to stand a centimetre elsewhere."""
    told, view = camera(TOLD[place], [0.005, 0.01]), told_camera(camera(TOLD[place], [0.0, 0.0]))
    turn, shift = np.array([0.003, -0.002, 0.004]), np.array([0.0015, -0.001, 0.001])
    picture = taken(told, turn, shift, [])
    long = replace(picture, depth=(1.01 * picture.depth).astype(np.float32))
    found = check_camera(replace(told, depth_scale_std=0.01, focal_std=0.003), long, KnownFaces.of(SOLIDS))
    assert found is not None and found.depth == pytest.approx(1.0 / 1.01, abs=1e-3)
    np.testing.assert_allclose(found.camera.p_WC, view.p_WC + shift, atol=1.5e-3)
    wrong = check_camera(told, long, KnownFaces.of(SOLIDS))
    assert wrong is not None and np.linalg.norm(wrong.camera.p_WC - view.p_WC - shift) > 4e-3


def test_nothing_is_told_of_a_camera_that_is_trusted_or_sees_nothing_known() -> None:
    told = camera(TOLD["slanted"], [0.005, 0.01])
    picture = taken(told, np.zeros(3), np.zeros(3), [])
    assert check_camera(replace(told, X_WC_std=[0.0, 0.0]), picture, KnownFaces.of(SOLIDS)) is None
    assert check_camera(told, picture, KnownFaces.of([])) is None
    blind = replace(picture, depth=np.zeros_like(picture.depth))
    assert check_camera(told, blind, KnownFaces.of(SOLIDS)) is None
