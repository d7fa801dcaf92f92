"""Where a scene is looked at from, by the arm's size, place and side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.scene import TwinScene
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Chosen by eye, on the Panda at its table, which fills the page."""

    before: float = 0.45
    """Where an arm works: so far before its base, of its length [1]."""

    aside: float = 0.3
    """… and so far to either side of that [1]."""

    from_where: tuple[float, float, float] = (0.75, -0.51, 0.42)
    """To the eye: ahead, to the right, above [1]."""

    half_angle: float = 0.56
    """Of the cone that holds all of it [rad]: Meshcat's picture goes 0.65 up from its middle."""


TUNING = Tuning()


def view_of_arm(p_WPoints: Array) -> tuple[Array, Array]:
    """Return where to look from, p_WV, and where to, p_WT [m], so that an arm and where it works are in the picture.

    The eye stands on the side that the arm works to, of the four along x and y of W.

    Args:
        p_WPoints: (n, 3) from the base along its joints to its tool [m]; both ends of what slides.
    """
    length = float(np.linalg.norm(np.diff(p_WPoints, axis=0), axis=1).sum())
    x, y, _ = p_WPoints[-1] - p_WPoints[0]
    turn = 0.5 * np.pi * np.round(np.arctan2(y, x) / (0.5 * np.pi)) if np.hypot(x, y) > 1e-6 * length else 0.0
    c, s = np.cos(turn), np.sin(turn)
    R_WA = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    corners_A = length * np.array([[TUNING.before, side * TUNING.aside, 0.0] for side in (-1.0, 1.0)])
    shown = np.vstack([p_WPoints, p_WPoints[0] + corners_A @ R_WA.T])
    p_WT = 0.5 * (shown.min(axis=0) + shown.max(axis=0))
    far = float(np.linalg.norm(shown - p_WT, axis=1).max()) / np.sin(TUNING.half_angle)
    out_A = np.array(TUNING.from_where)
    return p_WT + far * R_WA @ (out_A / np.linalg.norm(out_A)), p_WT


def points_along(scene: TwinScene) -> Array:
    """Return (n, 3) from the arm's base along its joints to its tool, at home, both ends of what slides [m]."""
    plant = scene.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, scene.default_positions)
    points = [plant.get_body(scene.arm.base).EvalPoseInWorld(context).translation()]
    for index in scene.arm.joint_indices:
        joint, q = plant.get_joint(index), scene.default_positions.copy()
        ends = np.array([joint.position_lower_limits()[0], joint.position_upper_limits()[0]])
        slides = joint.type_name() == "prismatic" and bool(np.isfinite(ends).all())
        for position in ends if slides else q[[joint.position_start()]]:
            q[joint.position_start()] = position
            plant.SetPositions(context, q)
            points.append(joint.frame_on_child().CalcPoseInWorld(context).translation())
    plant.SetPositions(context, scene.default_positions)
    points.append(plant.get_frame(scene.arm.tool_frame).CalcPoseInWorld(context).translation())
    return np.array(points)
