"""A scenario's intrinsics as lenses, and what it says of their errors."""

from __future__ import annotations

import numpy as np

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario.camera import Camera, DepthCamera
from twin_diagram.signals.calibration_error import CalibrationError
from twin_diagram.signals.lens import Lens, unit_rays


def colour_lens(camera: Camera, field: str = "twin.camera") -> Lens:
    """Return the lens of the colour camera as the twin is told of it.

    Args:
        camera: the twin's.
        field: where it stands in the scenario, for messages.

    Raises:
        ScenarioError: a distortion of another length, or one that shows places twice.
    """
    fx, fy = (camera.focal if f is None else f for f in (camera.fx, camera.fy))
    return _lens(camera, fx, fy, field)


def depth_lens(camera: Camera, field: str = "twin.camera") -> Lens:
    """Return the lens that depth comes through: its own, or that of the colours; see `colour_lens`."""
    depth = camera.depth
    if depth is None:
        return colour_lens(camera, field)
    return _lens(depth, depth.fx, depth.fx if depth.fy is None else depth.fy, f"{field}.depth")


def _lens(camera: Camera | DepthCamera, fx: float, fy: float, field: str) -> Lens:
    if len(camera.distortion) not in (0, 4, 5):
        raise ScenarioError(f"{field}.distortion", f"{camera.distortion} is not k1, k2, p1, p2 and perhaps k3")
    cx = (camera.width - 1) / 2 if camera.cx is None else camera.cx
    cy = (camera.height - 1) / 2 if camera.cy is None else camera.cy
    distortion = (*camera.distortion, 0.0)[:5] if any(camera.distortion) else ()
    lens = Lens(camera.width, camera.height, fx, fy, cx, cy, distortion)
    if distortion and not np.isfinite(unit_rays(lens)).all():
        raise ScenarioError(f"{field}.distortion", f"{camera.distortion} folds the image over itself")
    return lens


def calibration_error(camera: Camera) -> CalibrationError:
    """Return what the twin is told of its camera's calibration being off."""
    shift, turn = camera.X_WC_std
    return CalibrationError(shift, turn, camera.focal_std, camera.centre_std, camera.depth_scale_std)
