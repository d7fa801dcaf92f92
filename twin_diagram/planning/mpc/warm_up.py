"""Plans for nothing, so that no tick that counts loads compiled loops."""

from __future__ import annotations

import numpy as np

from twin_diagram.planning.mpc.payload_gravity import gravity_regressor
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.signals.layouts import ObjectStatus, Track
from twin_diagram.signals.pose_vectors import from_matrix


def warm_up(planner: MotionPlanner) -> None:
    """Plan two ticks towards things that move and lie in the way; nothing is left of them but what they loaded."""
    scene = planner.scene
    low, high = np.maximum(scene.lower, -1.0), np.minimum(scene.upper, 1.0)
    q = (low + high) / 2
    poses = scene.chain.tool(scene.chain.place(np.stack([q, 0.7 * q + 0.3 * high])))
    tool, elsewhere = map(from_matrix, poses)
    moving = np.array([0.0, 0.0, 0.5, 0.1, 0.0, 0.0])
    track = Track(ObjectStatus.MOVING, 0.0, tool, moving, 1e-6 * np.eye(6)).pack()
    tracks = np.tile(track, scene.object_count)
    memory = planner.initial(q)
    gravity_regressor(scene.chain, q)
    for now in (0.0, 0.1):
        memory, _ = planner.tick(memory, now, np.concatenate([q, np.zeros(len(q))]), tracks, elsewhere)
    memory.trajectory.position(0.1)
