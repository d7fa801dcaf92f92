"""What a scenario tells of its camera: defaults that are those of before, and what is refused."""

from __future__ import annotations

import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Camera, DepthCamera, Scenario, Twin, load_scenario
from twin_diagram.scenario.field_table import rows_at
from twin_diagram.scenario.lenses import calibration_error, colour_lens, depth_lens
from twin_diagram.scenario.validation import check_twin
from twin_diagram.signals.lens import Lens


def test_a_camera_of_before_has_square_pixels_about_its_middle_and_no_doubt() -> None:
    camera = load_scenario("tabletop").twin.camera
    assert camera is not None
    assert colour_lens(camera) == depth_lens(camera) == Lens(640, 480, 600.0, 600.0, 319.5, 239.5)
    assert camera.depth_size == (640, 480) and not calibration_error(camera).variances.any()


def test_all_that_a_calibration_tells_is_read() -> None:
    camera = load_scenario(
        "tabletop",
        [
            "twin.camera.fx=601", "twin.camera.fy=599", "twin.camera.cx=318", "twin.camera.cy=241",
            "twin.camera.distortion=[0.01, -0.02, 0.001, 0.002]", "twin.camera.X_WC_std=[0.005, 0.009]",
            "twin.camera.focal_std=0.003", "twin.camera.centre_std=1", "twin.camera.depth_scale_std=0.01",
            "twin.camera.depth_noise.sheet=d435",
            "twin.camera.depth={width: 848, height: 480, fx: 430, fy: 431, cy: 239, scale: 0.001, distortion: []}",
        ],
    ).twin.camera  # fmt: skip
    assert camera is not None
    assert colour_lens(camera) == Lens(640, 480, 601.0, 599.0, 318.0, 241.0, (0.01, -0.02, 0.001, 0.002, 0.0))
    assert depth_lens(camera) == Lens(848, 480, 430.0, 431.0, 423.5, 239.0)
    assert camera.depth_size == (848, 480) and camera.depth is not None and camera.depth.scale == 0.001
    error = calibration_error(camera)
    assert (error.shift, error.turn, error.focal, error.centre, error.depth_scale) == (0.005, 0.009, 0.003, 1.0, 0.01)


@pytest.mark.parametrize(
    ("override", "field"),
    [
        ("fx=0", "fx"),
        ("fy=-1", "fy"),
        ("distortion=[0.1]", "distortion"),
        ("depth={fx: 0}", r"depth\.fx"),
        ("depth={scale: 0}", r"depth\.scale"),
        ("depth={distortion: [1, 2, 3]}", r"depth\.distortion"),
        ("depth_noise={growth: -0.001}", r"depth_noise\.growth"),
        ("depth_noise={sheet: d999}", r"depth_noise\.sheet"),
        ("X_WC_std=[0.005]", "X_WC_std"),
        ("X_WC_std=[0.005, -1]", "X_WC_std"),
        ("focal_std=-0.1", "focal_std"),
        ("centre_std=-0.1", "centre_std"),
        ("depth_scale_std=-0.1", "depth_scale_std"),
    ],
)
def test_what_cannot_be_is_refused(override: str, field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"twin\.camera\.{field}"):
        check_twin(load_scenario("tabletop", [f"twin.camera.{override}"]).twin)


def test_the_reference_tells_of_each_field() -> None:
    for path in ("twin.camera", "twin.camera.depth", "twin.camera.depth_noise", "world.camera_defects"):
        assert all(row.meaning for row in rows_at(Scenario, path)), path
    assert {"fx", "distortion", "X_WC_std"} <= {row.name for row in rows_at(Scenario, "twin.camera")}
    assert Camera().depth is None


def test_a_lens_that_folds_the_image_is_refused_by_its_own_name() -> None:
    folding = Camera(name="side", role="perception", distortion=[-5.0, 0.0, 0.0, 0.0])
    with pytest.raises(ScenarioError, match=r"twin\.cameras\.side\.distortion: .* folds the image over itself"):
        check_twin(Twin(cameras={"side": folding}))
    with pytest.raises(ScenarioError, match=r"twin\.camera\.depth\.distortion: .* folds the image over itself"):
        check_twin(Twin(camera=Camera(depth=DepthCamera(distortion=[-5.0, 0.0, 0.0, 0.0]))))
