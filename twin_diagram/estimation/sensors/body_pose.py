"""The pose of a body on the arm, hand or held object, as a camera or another tracker gives it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import Frame

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.sensors.sensor import Instant, Linear, Sensor
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.rotations import difference, exp, multiply, normalized


@dataclass(frozen=True)
class PoseBias:
    """An error of calibration that stays, and is learnt as six own states.

    Attributes:
        std_p: prior of the position's, per axis [m].
        std_r: prior of the orientation's, per axis [rad].
        walk: random walk of both, as a share of these [1/√s].
    """

    std_p: float
    std_r: float
    walk: float = 0.01


class BodyPose(Sensor):
    """X_WO of a frame O on the arm: z = [quaternion wxyz, position m] in W.

    The innovation is a rotation vector in W [rad] and a translation [m]: a left perturbation about O's origin, as
    `layouts.PoseMeasurement` has it. A reading may bring its own R (`noise=` of `Ekf.update`), which grows with
    occlusion and bad light (section 3.3, vision).
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str | Frame,
        *,
        X_BO: RigidTransform | None = None,
        std_p: float = 0.003,
        std_r: float = 0.02,
        bias: PoseBias | None = None,
        name: str = "camera",
    ) -> None:
        """Make the sensor.

        Args:
            terms: the arm.
            body: the link or frame B that O is fixed to; by name, or the frame itself.
            X_BO: pose of O on it; B's own frame where None.
            std_p: of the position, per axis [m].
            std_r: of the orientation, per axis [rad].
            bias: an error of calibration that stays; None: there is none to learn.
            name: for messages and counters.

        Raises:
            ModelError: the plant has no such link or frame.
        """
        super().__init__(name, 6, length=7)
        self.frame = LinkFrame(terms, body, X_BO)
        self._noise: Array = np.diag(np.repeat([std_r**2, std_p**2], 3))
        self._bias_std = np.zeros(0) if bias is None else np.repeat([bias.std_r, bias.std_p], 3)
        self._bias_walk = self._bias_std if bias is None else bias.walk * self._bias_std

    def reading(self, x: Array) -> Array:  # noqa: D102
        R_WO, p_WO = self.frame.pose(x[: self.frame.terms.n])
        return np.concatenate([RotationMatrix(R_WO).ToQuaternion().wxyz(), p_WO])

    def jacobian(self, x: Array) -> Array:  # noqa: D102
        H = np.zeros((6, len(x)))
        H[:, : self.frame.terms.n] = self.frame.jacobian(x[: self.frame.terms.n])[2]
        return H

    def noise(self, x: Array) -> Array:  # noqa: D102
        return self._noise

    def linear(self, now: Instant) -> Linear:  # noqa: D102
        R_WO, p_WO, J = self.frame.jacobian(now.q)
        H = np.zeros((6, len(now.x)))
        H[:, : now.n] = J
        wxyz = RotationMatrix(R_WO).ToQuaternion().wxyz()
        if self.own.stop > self.own.start:
            H[:, self.own] = np.eye(6)
            bias = now.x[self.own]
            wxyz, p_WO = multiply(exp(bias[:3]), wxyz), p_WO + bias[3:]
        return Linear(np.concatenate([wxyz, p_WO]), H, self._noise)

    def innovation(self, z: Array, reading: Array) -> Array:  # noqa: D102
        return np.concatenate([difference(normalized(z[:4]), reading[:4]), z[4:] - reading[4:]])

    def own_labels(self) -> list[str]:  # noqa: D102
        if not len(self._bias_std):
            return []
        turns = [f"{self.name}.bias_r{a} [rad]" for a in "xyz"]
        return turns + [f"{self.name}.bias_{a} [m]" for a in "xyz"]

    def own_std(self) -> Array:  # noqa: D102
        return self._bias_std

    def own_walk(self) -> Array:  # noqa: D102
        return self._bias_walk

    def sound(self, z: Array) -> bool:
        """Return whether all is finite, and the quaternion of length 1 to within a tenth."""
        return super().sound(z) and abs(float(np.linalg.norm(z[:4])) - 1.0) < 0.1
