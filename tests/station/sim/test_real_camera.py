"""The real camera, rendered: where its pixels look, when, and what it delivers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from pydrake.systems.analysis import Simulator

from twin_diagram.perception.alignment import Alignment
from twin_diagram.perception.pinhole import Pinhole, back_project
from twin_diagram.scenario import Camera, CameraDefects, DepthCamera, Fixture, Pose, Scenario, WorldObject
from twin_diagram.station import make_station
from twin_diagram.station.sim.camera_truth import true_camera
from twin_diagram.station.sim.real_camera import RealCamera
from twin_diagram.station.sim.station import SimStation

CLEAN: dict[str, Any] = {
    "depth_noise": 0.0, "colour_noise": 0.0, "edge_dropout": 0.0, "depth_unit": 1e-4,
}  # fmt: skip
X_WC = Pose([0.9, 0.0, 0.7], [-2.356194, 0.0, 1.570796])
"""Looks down on the table at 45°, with the world's x towards it."""


def plan(defects: CameraDefects, camera: Camera, seed: int = 2) -> Scenario:
    scenario = Scenario(seed=seed)
    scenario.world.fixtures = [Fixture("scenes/table.sdf")]
    scenario.world.objects = {"box": WorldObject("objects/sugar_box", Pose([0.45, 0.1, 0.0875]))}
    scenario.world.camera_defects, scenario.twin.camera = defects, camera
    return scenario


def pictures(scenario: Scenario, time: float = 0.05) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    station = make_station(scenario)
    simulator = Simulator(station)
    simulator.AdvanceTo(time)
    context = simulator.get_context()
    rgb, depth = (station.GetOutputPort(f"camera.{kind}_image").Eval(context).data.copy() for kind in ("rgb", "depth"))
    return rgb, depth[..., 0]


def on_table(view: Pinhole, depth: npt.NDArray[np.float32], scale: float = 1.0) -> npt.NDArray[np.float64]:
    """Heights of the points that should be the table's: all but few."""
    points = back_project((depth * scale).astype(np.float32), view.rays(), view.p_WC)
    return np.asarray(points[..., 2][(depth > 0) & (points[..., 0] > 0.35) & (np.abs(points[..., 1]) < 0.5)])


TWO = Camera(
    X_WC=X_WC, width=120, height=90, fx=100.0, fy=97.0, cx=57.0, cy=46.0, distortion=[0.1, -0.06, 0.002, -0.002, 0.0],
    depth=DepthCamera(
        Pose([-0.03, 0.002, 0.0], [0.0, 0.02, 0.01]), width=140, height=80, fx=90.0, fy=92.0, cx=68.0,
        distortion=[-0.06, 0.02, 0.001, 0.0, 0.0], scale=0.5,
    ),
)  # fmt: skip


def test_two_bent_eyes_see_the_table_where_it_is(egl: None) -> None:
    rgb, depth = pictures(plan(CameraDefects(**CLEAN), TWO))
    assert rgb.shape == (90, 120, 4) and depth.shape == (80, 140)
    heights = on_table(Pinhole.of_depth(TWO), depth, 0.5)
    assert np.quantile(np.abs(heights), 0.8) < 6e-4 and len(heights) > 2000
    # On the colours' grid, the box's depth is where its colours are.
    alignment = Alignment.of(TWO)
    warped, straight = alignment.depth(depth), alignment.colours(rgb[..., :3]).astype(float)
    height = back_project(warped, alignment.camera.rays(), alignment.camera.p_WC)[..., 2]
    box = (height > 0.01) & (warped > 0)
    table = straight[(np.abs(height) < 0.004) & (warped > 0)]
    other = np.abs(straight - np.median(table, axis=0)).max(axis=-1) > 40
    inside = np.zeros_like(other)
    inside[5:-5, 5:-5] = True
    u = np.arange(120)[None, :] * np.ones((90, 1))
    assert box.sum() > 60 and (other & inside & box).sum() > 0.85 * (box & inside).sum()
    assert u[box].mean() == pytest.approx(
        u[other & (np.abs(u - u[box].mean()) < 20) & (height > -0.02)].mean(), abs=1.5
    )


def test_square_and_oblong_pixels_are_rendered_as_told(egl: None) -> None:
    camera = Camera(X_WC=X_WC, width=120, height=90, fx=100.0, fy=110.0, cx=50.0, cy=52.0)
    _, depth = pictures(plan(CameraDefects(**CLEAN), camera))
    heights = np.abs(on_table(Pinhole.from_scenario(camera), depth))
    assert np.quantile(heights, 0.8) < 2e-4 and len(heights) > 2000


def test_what_is_delivered_is_off_by_its_calibration_and_its_noise(egl: None) -> None:
    camera = Camera(X_WC=X_WC, width=160, height=120, focal=150.0)
    scenario = plan(CameraDefects("d435"), camera)
    rgb, depth = pictures(scenario)
    truth = true_camera(scenario)
    eye = Pinhole.behind(truth.depth, truth.X_WD)
    heights = on_table(eye, depth, 1.0 / truth.depth_scale)
    # σ = 3.8 z² mm along the ray, of which the table shows a good two thirds; z about 0.9 m.
    assert np.median(heights) == pytest.approx(0.0, abs=1e-3)
    assert 1.4826 * np.median(np.abs(heights)) == pytest.approx(2.2e-3, rel=0.35)
    told = on_table(Pinhole.from_scenario(camera), depth)
    assert abs(np.median(told)) > 2.0 * abs(np.median(heights)) and abs(np.median(told)) > 1e-3
    again = pictures(scenario)
    np.testing.assert_array_equal(again[0], rgb)
    np.testing.assert_array_equal(again[1], depth)
    assert (pictures(plan(CameraDefects("d435"), camera, seed=3))[1] != depth).mean() > 0.5


def test_an_objects_reflections_are_its_own(egl: None) -> None:
    camera = Camera(X_WC=X_WC, width=160, height=120, focal=150.0)
    defects = CameraDefects(**CLEAN, reflective_lost=1.0)
    plain, shining = plan(defects, camera), plan(defects, camera)
    shining.world.objects["box"].reflective = True
    (_, dull), (_, bright) = pictures(plain), pictures(shining)
    lost = (dull > 0) & (bright == 0)
    np.testing.assert_array_equal(dull[~lost], bright[~lost])
    points = back_project(dull, Pinhole.from_scenario(camera).rays(), Pinhole.from_scenario(camera).p_WC)
    near = np.abs(points - [0.45, 0.1, 0.0875]).max(axis=-1) < 0.1
    assert lost.sum() > 100 and near[lost].all() and lost[near & (points[..., 2] > 0.005)].mean() > 0.97


def test_a_covered_lens_and_the_time_before_the_first_image_are_dark(egl: None) -> None:
    camera = Camera(X_WC=X_WC, width=32, height=24, focal=30.0)
    for defects, time in ((CameraDefects("d415", covered=[[0.0, 1.0]]), 0.05), (CameraDefects("d415"), 0.02)):
        rgb, depth = pictures(plan(defects, camera), time)
        assert rgb[..., :3].max() == 0 and (rgb[..., 3] == 255).all() and depth.max() == 0.0


@pytest.mark.long
def test_depth_is_older_than_its_colours_and_moving_things_are_blurred(egl: None) -> None:
    camera = Camera(X_WC=Pose([0.5, 0.0, 0.6], [np.pi, 0.0, 0.0]), width=160, height=120, focal=150.0)

    def seen(moving: bool, delay: float, exposure: float) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        scenario = plan(CameraDefects(**CLEAN, depth_delay=delay, exposure=exposure), camera)
        # Above the table, it falls: by g t²/2 = 22 mm in 1/15 s.
        scenario.world.objects["box"].X_WO = Pose([0.5, 0.0, 0.15 if moving else 0.0875])
        return pictures(scenario, 1 / 15 + 0.04)

    tops = [float(np.median(seen(True, delay, 0.001)[1][55:65, 75:85])) for delay in (0.0, 0.5)]
    fallen = [0.5 * 9.81 * t**2 for t in (1 / 15, 0.5 / 15)]
    assert tops[0] - tops[1] == pytest.approx(fallen[0] - fallen[1], abs=1.5e-3)
    sharp, blurred = seen(True, 0.0, 1e-6)[0], seen(True, 0.0, 0.06)[0]
    assert (np.abs(sharp.astype(int) - blurred) > 8).mean() > 0.004
    still = [seen(False, 0.0, exposure)[0] for exposure in (1e-6, 0.001)]
    assert (np.abs(still[0].astype(int) - still[1]) > 8).mean() < 0.002


@pytest.mark.long
def test_pictures_that_a_process_takes_are_those_that_are_taken_here(egl: None) -> None:
    scenario = plan(CameraDefects(profile="d435"), Camera(X_WC=X_WC, width=160, height=120, focal=140.0))
    here = pictures(scenario, 0.25)
    station = SimStation(scenario)
    with station.pictures_beside():
        simulator = Simulator(station)
        simulator.AdvanceTo(0.25)
        context = simulator.get_context()
        camera = next(iter(station._cameras.values()))
        assert isinstance(camera, RealCamera) and camera._beside is not None
        for kind, expected in zip(("rgb", "depth"), here, strict=True):
            image = station.GetOutputPort(f"camera.{kind}_image").Eval(context).data
            np.testing.assert_array_equal(image if kind == "rgb" else image[..., 0], expected)
        assert any(asked.answer is not None for asked in camera._beside._known), "the process took it"
        assert not camera._beside.why
    assert camera._beside is None
