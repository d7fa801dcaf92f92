"""How far a camera is from its calibration: as told, and as the twin corrected it while it ran."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.scenario import Camera, Perception, Scenario
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import SIZE, point_shifts
from twin_diagram.station.sim.camera_truth import true_camera, with_camera
from twin_diagram.twin.closed_loop import ClosedLoop


def camera_told(loop: ClosedLoop, context: Context) -> dict[str, Any]:
    """Return what ``summary.json`` tells: `calibration` of one camera, `calibrations` by name of several.

    Of the camera's place [mm], its turn [°], the scale of its depth [%], and how far points in the middle of the
    workspace are shown aside [mm]: what was found (`corrected`), the deviation that the twin claims is left before
    and after (`claimed`), and for a simulated camera the true error before and after (`error`).

    Args:
        loop: that ran.
        context: of its Diagram.
    """
    twin, cameras = loop.twin.diagram, loop.scenario.twin.perceiving
    ports = {name: "calibration" if len(cameras) == 1 else f"{name}.calibration" for name in cameras}
    own = twin.GetMyContextFromRoot(context)
    each = {
        name: _told(loop.scenario, camera, np.array(twin.GetOutputPort(ports[name]).Eval(own)))
        for name, camera in cameras.items()
        if twin.HasOutputPort(ports[name])
    }
    if not each:
        return {}
    return {"calibration": next(iter(each.values()))} if len(cameras) == 1 else {"calibrations": each}


def _told(scenario: Scenario, camera: Camera, found: Array) -> dict[str, Any]:
    """Return what is told of one camera, whose port `calibration` has `found`."""
    errors, covariance = found[:SIZE], found[SIZE:].reshape(SIZE, SIZE)
    told = Pinhole.from_scenario(camera)
    J = _aside(told, scenario.twin.perception)
    result: dict[str, Any] = {"corrected": _lengths(errors, J)}
    first = np.diag(calibration_error(camera).variances)
    result["claimed"] = {"before": _deviations(first, J), "after": _deviations(covariance, J)}
    if scenario.station == "sim":
        true = true_errors(with_camera(scenario, camera.name), told)
        result["error"] = {"before": _lengths(true, J), "after": _lengths(true - errors, J)}
    return result


def true_errors(scenario: Scenario, told: Pinhole) -> Array:
    """Return the errors (10,) of a simulated camera's calibration; see `signals.calibration_error`."""
    true = true_camera(scenario)
    camera = scenario.twin.camera
    scale = true.depth_scale * (camera.depth.scale if camera is not None and camera.depth is not None else 1.0)
    R = true.X_WC.rotation().matrix() @ told.R_WC.T
    # The vector of a small turn; exact enough: a degree errs by a part in ten thousand.
    turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    lens = true.colour
    of_lens = [0.0, 0.0, 0.0]
    if camera is not None and camera.depth is None:
        lens = true.depth
        of_lens = [lens.fx / told.fx - 1.0, lens.cx - told.centre[0], lens.cy - told.centre[1]]
    return np.array([*turn, *(true.X_WC.translation() - told.p_WC), scale - 1.0, *of_lens])


def _aside(told: Pinhole, perception: Perception) -> Array:
    """Return (3, 10) how the middle of the workspace, on the table, is shown aside by errors."""
    middle = np.mean(np.asarray(perception.workspace, dtype=float), axis=0)
    middle[2] = perception.table_height
    p_C = (middle - told.p_WC) @ told.R_WC
    return np.asarray(point_shifts(p_C[None], told.R_WC, told.fx, told.fy)[0])


def _lengths(errors: Array, J: Array) -> dict[str, float]:
    return {
        "X_WC_mm": round(1e3 * float(np.linalg.norm(errors[3:6])), 3),
        "X_WC_deg": round(float(np.degrees(np.linalg.norm(errors[:3]))), 4),
        "depth_scale_percent": round(100.0 * float(abs(errors[6])), 3),
        "shown_aside_mm": round(1e3 * float(np.linalg.norm(J @ errors)), 3),
    }


def _deviations(covariance: Array, J: Array) -> dict[str, float]:
    return {
        "X_WC_mm": round(1e3 * float(np.sqrt(np.trace(covariance[3:6, 3:6]))), 3),
        "X_WC_deg": round(float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))), 4),
        "depth_scale_percent": round(100.0 * float(np.sqrt(covariance[6, 6])), 3),
        "shown_aside_mm": round(1e3 * float(np.sqrt(np.trace(J @ covariance @ J.T))), 3),
    }
