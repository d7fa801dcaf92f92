"""What the profiles are, and that each figure can be set otherwise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import CameraDefects, load_scenario
from twin_diagram.station.sim.camera_profiles import PROFILES, faults

REAL = {
    "white_share": 0.1, "wave_share": 0.3, "correlation": 2.5, "waves": 15.0, "edge_jitter": 0.8, "flying_pixels": 0.2,
    "steepest": np.radians(75.0), "too_deep": (0.005, 0.03), "colour_offset": 4.0, "depth_delay": 0.5,
    "X_WC_error": (0.005, np.radians(0.5)), "focal_error": 0.003, "centre_error": 1.0, "depth_scale_error": 0.01,
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "depth"), [("d415", (0.0015, 0.0, 0.0)), ("d435", (0.0038, 0.0, 0.0)), ("kinect1", (0.0019, 0.0012, 0.4))]
)
def test_real_cameras_are_as_bad_as_they_are_said_to_be(name: str, depth: tuple[float, ...]) -> None:
    found = faults(CameraDefects(name))
    assert (found.depth_noise, found.depth_noise_floor, found.depth_noise_start) == depth
    assert {key: getattr(found, key) for key in REAL} == REAL
    assert found.reflective_lost > 0 and found.reflective_deep > 0 and found.exposure > 0 and found.shot_noise > 0
    assert found.light < 1 and not found.plain


def test_the_ideal_camera_has_white_noise_and_lost_edges_alone() -> None:
    found = faults(CameraDefects())
    assert found == PROFILES["ideal"] and found.plain
    assert (found.depth_noise, found.edge_dropout, found.white_share) == (0.0008, 0.5, 1.0)
    assert not any(getattr(found, name) for name in ("edge_jitter", "flying_pixels", "depth_delay", "colour_offset"))
    assert (found.X_WC_error, found.light, found.steepest) == ((0.0, 0.0), 1.0, np.pi / 2)


@pytest.mark.parametrize(
    ("name", "value", "plain"),
    [
        ("depth_noise", 0.002, True),
        ("edge_dropout", 0.1, True),
        ("depth_noise_floor", 0.001, False),
        ("depth_noise_start", 0.1, False),
        ("white_share", 0.5, False),
        ("flying_pixels", 0.1, False),
        ("steepest", 1.0, False),
        ("depth_delay", 0.2, False),
        ("light", 0.5, False),
        ("X_WC_error", [0.001, 0.0], False),
        ("depth_scale_error", 0.001, False),
    ],
)
def test_each_figure_can_be_set_otherwise(name: str, value: Any, plain: bool) -> None:
    found = faults(CameraDefects(**{name: value}))
    assert getattr(found, name) == (tuple(value) if isinstance(value, list) else value)
    assert found.plain is plain
    real = faults(CameraDefects("d435", **{name: value}))
    assert getattr(real, name) == getattr(found, name) and real.wave_share == 0.3


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"profile": "d405"}, "profile"),
        ({"flying_pixels": 1.1}, "flying_pixels"),
        ({"flying_pixels": -0.1}, "flying_pixels"),
        ({"white_share": 0.8, "wave_share": 0.3}, "wave_share"),
        ({"profile": "d435", "reflective_lost": 0.8}, "reflective_deep"),
        ({"too_deep": [0.1]}, "too_deep"),
        ({"X_WC_error": [0.005, -0.1]}, "X_WC_error"),
        ({"correlation": 0.0}, "correlation"),
        ({"light": 0.0}, "light"),
        ({"depth_delay": 1.01}, "depth_delay"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, Any], field: str) -> None:
    with pytest.raises(ScenarioError, match=rf"world\.camera_defects\.{field}"):
        faults(CameraDefects(**change))


def test_a_file_says_it_in_world_alone() -> None:
    plan = load_scenario("tabletop", ["world.camera_defects.profile=kinect1", "world.camera_defects.light=0.9"])
    assert faults(plan.world.camera_defects).light == 0.9
    assert plan.twin == load_scenario("tabletop").twin
