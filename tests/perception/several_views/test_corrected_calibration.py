"""A camera whose calibration is corrected while others look on: what it showed moves with it, by its share."""

from __future__ import annotations

import numpy as np

from twin_diagram import load_scenario
from twin_diagram.perception.several_views.fusion import FusedPose
from twin_diagram.perception.several_views.pose_system import SeveralCamerasEstimator
from twin_diagram.signals.calibration_error import RESTS_SIZE
from twin_diagram.signals.layouts import PoseMeasurement

SHARE = np.diag([0.3, 0.3, 0.3, 0.25, 0.25, 0.25])
"""Of the corrected camera in the pose."""


def moved(change: list[float], place: list[float]) -> np.ndarray:
    """Return by how much (6) an object at a place moves as the first of two cameras is corrected by a change (10)."""
    twin = load_scenario("tabletop").twin
    assert twin.camera is not None
    estimator = SeveralCamerasEstimator({}, {"one": twin.camera, "other": twin.camera}, twin)
    rows = estimator.GetOutputPort("rests").size() // RESTS_SIZE
    shown = PoseMeasurement(1.0, 0.0, np.array([1.0, 0.0, 0.0, 0.0, *place]), np.eye(6))
    fused = [FusedPose(shown, None, np.stack([SHARE, np.eye(6) - SHARE]))] * rows
    after = estimator._rested(np.zeros(rows * RESTS_SIZE), fused, 0, np.array(change))
    return np.asarray(after.reshape(rows, RESTS_SIZE)[0, 36:])


def test_what_a_camera_shows_goes_with_the_camera() -> None:
    """It stands 8 mm farther along y than it was told: so does what it shows, and a quarter of that is believed."""
    found = moved([0.0, 0.0, 0.0, 0.0, 0.008, 0.0, *[0.0] * 4], [0.5, 0.1, 0.05])
    np.testing.assert_allclose(found, [0.0, 0.0, 0.0, 0.0, 0.002, 0.0], atol=1e-12)


def test_what_a_camera_shows_turns_about_the_camera() -> None:
    twin = load_scenario("tabletop").twin
    assert twin.camera is not None
    turn, place = np.array([0.0, 0.0, 0.01]), np.array([0.5, 0.1, 0.05])
    found = moved([*turn, *[0.0] * 7], place.tolist())
    about = np.cross(turn, place - np.array(twin.camera.X_WC.translation))
    np.testing.assert_allclose(found, [*(0.3 * turn), *(0.25 * about)], atol=1e-12)
