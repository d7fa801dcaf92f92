"""What a step knows of the world: objects, tool and fingers at a tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twin_diagram.planning.tasks.grasp_choice import ShapeGrasps
from twin_diagram.planning.tasks.in_hand import Eye
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import PoseMeasurement, Track


@dataclass(frozen=True)
class Takeable:
    """An object of the library, as far as taking it goes.

    Attributes:
        pieces: corners (m, 3) of the convex pieces that hold it, in O [m].
        symmetric: whether it looks the same however it is turned about its z axis.
        shape: grasps of its shape; none where nobody asked for them.
    """

    pieces: tuple[Array, ...]
    symmetric: bool
    shape: ShapeGrasps = field(default_factory=ShapeGrasps)

    @property
    def radius(self) -> float:
        """Of the upright cylinder about the object's z axis that holds it [m]."""
        return float(np.linalg.norm(np.concatenate(self.pieces)[:, :2], axis=1).max())


@dataclass(frozen=True)
class StepView:
    """What is known now.

    Attributes:
        now: [s].
        X_WT: (7) the tool.
        speed: of its origin [m/s].
        tracks: of the library's objects.
        measured: of the newest image, one for each of the library's objects.
        opening: between the fingers [m].
        finger_speed: of the fastest finger [m/s].
        widest: the fingers' greatest opening [m].
        reach: number of joint positions that reach the goal; `NEVER` where the planner has none.
        free: how far the finger tips reach beyond the palm [m].
        eye: the camera, as far as calibration goes; None where nothing is told of its errors.
    """

    now: float
    X_WT: Array
    speed: float
    tracks: Sequence[Track]
    measured: Sequence[PoseMeasurement]
    opening: float
    finger_speed: float
    widest: float
    reach: float
    eye: Eye | None = None
    free: float = np.inf
