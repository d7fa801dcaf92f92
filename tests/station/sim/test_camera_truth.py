"""How far the true camera is from the told one."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.scenario import Camera, CameraDefects, DepthCamera, Pose, Scenario
from twin_diagram.scenario.lenses import colour_lens, depth_lens
from twin_diagram.scenario.poses import pose
from twin_diagram.station.sim.camera_truth import true_camera, with_camera

TOLD = Camera(X_WC=Pose([1.4, 0.1, 0.9], [-2.2, 0.1, 1.5]), width=320, height=240, fx=300.0, fy=298.0, cx=158.0)


def plan(seed: int, defects: CameraDefects | None = None, camera: Camera = TOLD) -> Scenario:
    scenario = Scenario(seed=seed)
    scenario.world.camera_defects, scenario.twin.camera = defects or CameraDefects("d435"), camera
    return scenario


def test_an_ideal_camera_is_what_is_told() -> None:
    found = true_camera(plan(3, CameraDefects()))
    assert found.colour == found.depth == colour_lens(TOLD) and found.depth_scale == 1.0
    assert found.X_WC.IsExactlyEqualTo(pose(TOLD.X_WC)) and found.X_WD.IsExactlyEqualTo(found.X_WC)


def test_a_real_one_is_off_by_as_much_as_is_said_in_a_direction_of_its_own() -> None:
    shifts, scales, asides = [], set(), []
    for seed in range(40):
        found = true_camera(plan(seed))
        told, lens = pose(TOLD.X_WC), colour_lens(TOLD)
        shift = found.X_WC.translation() - told.translation()
        turn = found.X_WC.rotation() @ told.rotation().inverse()
        assert np.linalg.norm(shift) == pytest.approx(0.005)
        assert turn.ToAngleAxis().angle() == pytest.approx(np.radians(0.5))
        assert abs(found.depth.fx / 300.0 - 1.0) == pytest.approx(0.003)
        assert found.depth.fy / 298.0 == pytest.approx(found.depth.fx / 300.0)
        assert found.colour.fx == found.depth.fx
        assert np.hypot(found.depth.cx - 158.0, found.depth.cy - lens.cy) == pytest.approx(0.5)  # 1 px at 640
        asides.append(np.hypot(found.colour.cx - found.depth.cx, found.colour.cy - found.depth.cy))
        shifts.append(shift)
        scales.add(round(found.depth_scale, 6))
    assert scales == {0.99, 1.01}
    assert 0.0 < min(asides) and max(asides) < 2.0 and np.mean(asides) == pytest.approx(1.0, abs=0.3)
    assert np.abs(np.mean(shifts, axis=0)).max() < 0.0015
    again = true_camera(plan(7))
    assert again.X_WC.IsExactlyEqualTo(true_camera(plan(7)).X_WC) and again.colour == true_camera(plan(7)).colour


def test_a_pose_that_the_world_tells_is_the_true_one() -> None:
    scenario = plan(5)
    scenario.world.X_WC = Pose([1.0, 0.0, 0.9], [-2.2, 0.0, 1.5])
    assert true_camera(scenario).X_WC.IsExactlyEqualTo(pose(scenario.world.X_WC))


def test_depth_of_its_own_stands_beside_the_true_colours() -> None:
    depth = DepthCamera(X_DC=Pose([-0.02, 0.0, 0.0], [0.0, 0.01, 0.0]), width=424, height=240, fx=210.0, scale=0.5)
    camera = Camera(X_WC=TOLD.X_WC, depth=depth)
    found = true_camera(plan(5, camera=camera))
    X_DC = found.X_WD.inverse() @ found.X_WC
    assert X_DC.IsNearlyEqualTo(pose(depth.X_DC), 1e-12)
    assert abs(found.depth.fx / 210.0 - 1.0) == pytest.approx(0.003) and found.depth.width == 424
    assert np.hypot(found.depth.cx - 211.5, found.depth.cy - 119.5) == pytest.approx(424 / 640)  # 1 px at 640
    assert round(found.depth_scale, 6) in (1.98, 2.02)  # delivered in units of half a metre
    assert depth_lens(camera).cx == 211.5


def test_each_camera_is_off_by_itself() -> None:
    scenario = plan(5)
    scenario.twin.cameras = {"left": TOLD, "right": TOLD}
    places = [true_camera(with_camera(scenario, name)).X_WC.translation() for name in (TOLD.name, "left", "right")]
    told = pose(TOLD.X_WC).translation()
    apart = np.array([p - told for p in places]) / 0.005
    assert np.abs(apart @ apart.T - np.eye(3)).max() < 0.99, "no two in one direction, or in opposite ones"
