"""How much room the hand has where it is to go: drawn objects must leave it what the planner always keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_diagram import scenario
from twin_diagram.planning.collision.ball_cover import arm_balls, arm_plant
from twin_diagram.planning.collision.chain import Chain, depths
from twin_diagram.planning.paths.guide import TUNING as GUIDE
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    unsure: float = 0.008
    """By so much what poses are unsure of brings things nearer [m]: before the D435 of `real_camera` a cracker box that
    stood 15.7 mm from the covered hand came to 9.0 mm (seed 11)."""


TUNING = Tuning()


@dataclass(frozen=True)
class HandShape:
    """The shape that the planner takes a hand for: balls that cover it.

    Attributes:
        centres_T: (S, 3) in the tool's frame [m].
        radii: (S,) [m].
    """

    centres_T: Array
    radii: Array

    @staticmethod
    def of(spec: scenario.ArmModel, packages: Mapping[str, str | Path] | None = None) -> HandShape:
        """Return what is rigidly joined to an arm's last link: the Panda's hand, 0.102 m to each side, 0.112 m covered.

        Raises:
            ModelError: as `load_scene`.
        """
        plant, scene_graph, arm, keep_alive = arm_plant(spec, packages)
        balls = arm_balls(plant, scene_graph, arm, depths(plant, arm.joint_indices))
        chain = Chain.from_plant(plant, arm.joint_indices, arm.tool_frame)
        del keep_alive
        last, X_TL = balls.links == chain.size, np.linalg.inv(chain.X_LT)
        return HandShape(balls.centres_L[last] @ X_TL[:3, :3].T + X_TL[:3, 3], balls.radii[last])

    def distance(self, X_WT: Array, X_WO: Array, size: Array) -> float:
        """Return how near the hand at (4, 4) is to a box (4, 4) about its middle, with edges (3,) [m]."""
        X_OT = np.linalg.inv(X_WO) @ X_WT
        beyond = np.abs(self.centres_T @ X_OT[:3, :3].T + X_OT[:3, 3]) - 0.5 * np.asarray(size)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return float((outside + np.minimum(beyond.max(axis=1), 0.0) - self.radii).min())


def kept_at_goal(planner: scenario.Planner) -> float:
    """Return how far the hand at its goal must be from objects [m]: what is always kept, and what is unsure."""
    return GUIDE.least * planner.clearance + TUNING.unsure
