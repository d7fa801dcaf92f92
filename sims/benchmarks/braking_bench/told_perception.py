"""A perception that is told where things are, with noise: the monitor is not judged by the camera's luck."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram.scenario import World, WorldObject
from twin_diagram.scenario.poses import pose
from twin_diagram.signals import rotations
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, PoseMeasurement
from twin_diagram.station.sim.movers import Path

NOISE = (0.0015, 0.005)
"""Of each image: position [m] and angle [rad]; white."""


class ToldPerception(LeafSystem):
    """Tells the pose of each of the world's objects at the time of the newest image."""

    def __init__(self, world: World, names: list[str], seed: int) -> None:
        """`names`: of the twin's library, in order."""
        super().__init__()
        self._objects = [world.objects[name] for name in names]
        self._paths = [Path(each.path, "path") if each.path else None for each in self._objects]
        self._seed = seed
        self._time = self.DeclareVectorInputPort("image_time", 1)
        self.DeclareVectorOutputPort("object_poses", MEASUREMENT_SIZE * len(names), self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        value: Any = self._time.Eval(context)
        time = float(value[0])
        rng = np.random.default_rng([self._seed, max(0, round(1000 * time))])
        covariance = np.diag([NOISE[1] ** 2] * 3 + [NOISE[0] ** 2] * 3)
        rows = []
        for each, path in zip(self._objects, self._paths, strict=True):
            X = _pose(each, path, time)
            turn = rotations.exp(NOISE[1] * rng.standard_normal(3))
            X = np.concatenate([rotations.multiply(turn, X[:4]), X[4:] + NOISE[0] * rng.standard_normal(3)])
            rows.append(PoseMeasurement(1.0 if time >= 0 else 0.0, time, X, covariance).pack())
        output.SetFromVector(np.concatenate(rows))


def _pose(each: WorldObject, path: Path | None, time: float) -> np.ndarray:
    """Return X_WO (7) at a time; what lies free is taken to lie still."""
    if path is None:
        X = pose(each.X_WO)
        return np.concatenate([X.rotation().ToQuaternion().wxyz(), X.translation()])
    (x, y, yaw), _ = path.state(time)
    first = pose(each.path[0].X_WO)
    turn = rotations.exp(np.array([0.0, 0.0, yaw - each.path[0].X_WO.rpy[2]]))
    q = rotations.multiply(turn, first.rotation().ToQuaternion().wxyz())
    return np.concatenate([q, [x, y, path.z]])
