"""What an arm's joints may do while it moves by plans."""

from __future__ import annotations

import logging

import numpy as np

from twin_diagram import scenario
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.collision_scene import Scene
from twin_diagram.planning.mpc.arm_torque import TUNING as ARM_TORQUE
from twin_diagram.planning.mpc.arm_torque import acceleration_limit
from twin_diagram.planning.mpc.trajectory_optimisation import Limits
from twin_diagram.signals.arrays import Array


def limits_of(model: Model | None, scene: Scene, velocity_limit: Array, params: scenario.Planner) -> Limits:
    """Return what the joints may do.

    Args:
        model: of the arm, whose description and torques limit accelerations; None: `params` and speeds do alone.
        scene: has the joints' range.
        velocity_limit: (n,) the joints' [rad/s], may be infinite.
        params: tuning.
    """
    if model is not None and not np.isfinite(velocity_limit).all():
        silent = ", ".join(
            f"{joint} ({'m/s' if joint in model.prismatic else 'rad/s'})"
            for joint, limit in zip(model.joints, velocity_limit, strict=True)
            if not np.isfinite(limit)
        )
        logging.getLogger("twin_diagram").warning(
            "no limit of speed in the description: planned at %.2f at most (π times planner.velocity_share); "
            "give these joints a velocity limit: %s",
            np.pi * params.velocity_share,
            silent,
        )
    velocity = params.velocity_share * np.where(np.isfinite(velocity_limit), velocity_limit, np.pi)
    most = np.inf if params.acceleration is None else params.acceleration
    if model is None:
        return Limits(scene.lower, scene.upper, velocity, np.minimum(most, velocity / ARM_TORQUE.quickest))
    acceleration = np.minimum(most, acceleration_limit(model, velocity, params.torque_share))
    effort = params.torque_share * np.where(model.effort_limit > 0.0, model.effort_limit, np.inf)
    return Limits(scene.lower, scene.upper, velocity, acceleration, effort if np.isfinite(effort).any() else None)
