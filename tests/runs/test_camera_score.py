"""The true errors of a simulated camera's calibration, with the signs of `signals.calibration_error`."""

from __future__ import annotations

import numpy as np

from twin_diagram.perception.calibration import corrected
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.runs.camera_score import true_errors
from twin_diagram.scenario import CameraDefects
from twin_diagram.scenario.file import load_scenario
from twin_diagram.station.sim.camera_truth import true_camera


def test_with_its_true_errors_taken_out_a_camera_is_the_true_one() -> None:
    plan = load_scenario("tabletop", ["seed=3"])
    plan.world.camera_defects = CameraDefects(
        X_WC_error=[0.02, 0.01], focal_error=0.004, centre_error=2.0, depth_scale_error=0.03
    )
    assert plan.twin.camera is not None
    told, true = Pinhole.from_scenario(plan.twin.camera), true_camera(plan)
    errors = true_errors(plan, told)
    mended, factor = corrected(told, errors)
    np.testing.assert_allclose(mended.R_WC, true.X_WC.rotation().matrix(), atol=1e-6)
    np.testing.assert_allclose(mended.p_WC, true.X_WC.translation(), atol=1e-12)
    np.testing.assert_allclose(
        [mended.fx, mended.fy, *mended.centre], [true.depth.fx, true.depth.fy, *true.depth.centre]
    )
    assert np.isclose(factor * true.depth_scale, 1.0) and abs(errors[6]) > 0.01
    np.testing.assert_allclose(np.linalg.norm(errors[3:6]), 0.02)
    np.testing.assert_allclose(np.linalg.norm(errors[:3]), 0.01, rtol=1e-4)
