"""An object that an arm holds: where it is on the last body, and which joints feel it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform, RotationMatrix

from twin_diagram.errors import TwinError
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body.kinematic_tree import Kinematics
from twin_diagram.model.rigid_body.rigid_tree import transform_inertia
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    rounded: float = 1e-3
    """By which rows of a matrix may miss being those of a rotation: they come from files with few digits."""


TUNING = Tuning()


class WeighingError(TwinError):
    """What an object cannot be weighed with: logs, limits or a grasp that do not fit."""


def as_pose(given: Any) -> RigidTransform:
    """Return X_TO as a pose, given as one or as a matrix (4, 4).

    Raises:
        WeighingError: it is neither.
    """
    if isinstance(given, RigidTransform):
        return given
    told = f"X_TO must be a pose: a RigidTransform or a matrix (4, 4), not {given}"
    try:
        X = np.asarray(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise WeighingError(told) from error
    R = X[:3, :3] if X.shape == (4, 4) else np.zeros((3, 3))
    if not (np.abs(R @ R.T - np.eye(3)).max() < TUNING.rounded and np.linalg.det(R) > 0.0 and np.isfinite(X).all()):
        raise WeighingError(told)
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), X[:3, 3])


@dataclass(frozen=True)
class Held:
    """An object's frame O, fixed on a body of an arm's tree.

    Attributes:
        body: index of the tree's body that carries it.
        X_MO: pose of O in that body's frame M.
        rows: (m,) indices of the turning joints that move it, in the model's order.
    """

    body: int
    X_MO: RigidTransform
    rows: npt.NDArray[np.int64]

    @staticmethod
    def in_tool(model: Model, X_TO: RigidTransform) -> Held:
        """Return an object at X_TO in the model's tool frame T.

        Raises:
            WeighingError: the pose is not finite, or no turning joint moves the tool.
        """
        X_TO = as_pose(X_TO)
        if not np.all(np.isfinite(X_TO.GetAsMatrix34())):
            raise WeighingError(f"X_TO is not finite: {np.array2string(X_TO.GetAsMatrix34(), precision=3)}")
        body, _ = model.bodies.body_of(model.last_link)
        rest = np.zeros((1, len(model.joints)))
        motion = Kinematics.of(model.tree, model.true_position(rest).T)
        R_WM, p_WM = motion.R[:, :, body, 0], motion.p[:, body, 0]
        X_WT = model.tool_pose(rest[0])
        R_MT = R_WM.T @ X_WT.rotation().matrix()
        p_MT = R_WM.T @ (X_WT.translation() - p_WM)
        X_MT = np.vstack([np.column_stack([R_MT, p_MT]), [0.0, 0.0, 0.0, 1.0]])
        rows = np.flatnonzero((model.tree.ancestors[body] > 0.0) & model.tree.revolute)
        if not len(rows):
            raise WeighingError(f"{model.last_link}: no turning joint moves it, so nothing held there can be weighed")
        return Held(body, RigidTransform(X_MT) @ X_TO, rows)

    def regressor(self, model: Model, q: Array, v: Array, a: Array) -> Array:
        """Return torques (N, m, 10) of the `rows` per unit of each of the object's parameters in O.

        Args:
            model: the arm.
            q: (N, n) true positions [rad].
            v: (N, n) velocities [rad/s].
            a: (N, n) accelerations [rad/s²].
        """
        return model.tree.regressor(q, v, a, self.body)[:, self.rows] @ transform_inertia(self.X_MO)
