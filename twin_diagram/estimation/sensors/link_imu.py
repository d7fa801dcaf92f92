"""An inertial measurement unit on a link: gyroscope and accelerometer with biases that are states."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame

from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.link_frame import LinkFrame, skew, turned_rate
from twin_diagram.estimation.sensors.sensor import Instant, Linear, Sensor
from twin_diagram.signals import Array


class LinkImu(Sensor):
    """z = [angular velocity rad/s, specific force a − g m/s²] of frame I on a link, both in I.

    Its own states are the biases of both, each a random walk. While the arm is still the specific force is gravity
    alone, so the accelerometer aligns the link with it (section 3.3, IMU); the gyroscope's bias is seen against the
    encoders all the time. The link's acceleration is the model's, through v̇ of the step that led to the reading: an
    unmodelled torque is therefore seen by the accelerometer too.
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str | Frame,
        X_BI: RigidTransform | None = None,
        *,
        gyro_std: float = 1e-3,
        accel_std: float = 1e-2,
        gyro_bias_std: float = 0.02,
        accel_bias_std: float = 0.1,
        gyro_bias_walk: float = 1e-4,
        accel_bias_walk: float = 1e-3,
        name: str = "imu",
    ) -> None:
        """Makes the sensor.

        Args:
            terms: the arm.
            body: the link or frame B that it is fixed to; by name, or the frame itself.
            X_BI: its pose there; B's own frame where None.
            gyro_std: white noise of a reading [rad/s].
            accel_std: white noise of a reading [m/s²].
            gyro_bias_std: prior of its bias [rad/s].
            accel_bias_std: prior of its bias [m/s²].
            gyro_bias_walk: random walk of its bias [rad/s/√s].
            accel_bias_walk: random walk of its bias [m/s²/√s].
            name: for messages and counters.

        Raises:
            ModelError: the plant has no such link or frame.
        """
        super().__init__(name, 6)
        self.frame = LinkFrame(terms, body, X_BI)
        self._noise: Array = np.diag(np.repeat([gyro_std**2, accel_std**2], 3))
        self._bias_std = np.repeat([gyro_bias_std, accel_bias_std], 3)
        self._bias_walk = np.repeat([gyro_bias_walk, accel_bias_walk], 3)
        self._gravity = terms.plant.gravity_field().gravity_vector()

    def reading(self, x: Array) -> Array:
        """As if no joint accelerated: `linear` knows how they do."""
        return self.linear(self._still(x)).reading

    def jacobian(self, x: Array) -> Array:  # noqa: D102
        return self.linear(self._still(x)).jacobian

    def noise(self, x: Array) -> Array:  # noqa: D102
        return self._noise

    def linear(self, now: Instant) -> Linear:  # noqa: D102
        n = now.n
        motion = self.frame.motion(now.q, now.v)
        R_IW = motion.R_WF.T
        force = motion.J_v @ now.acceleration + motion.bias_a - self._gravity
        bias = now.x[self.own] if self.own.stop > self.own.start else np.zeros(6)
        reading = np.concatenate([R_IW @ motion.omega, R_IW @ force]) + bias
        H = np.zeros((6, len(now.x)))
        # R_IW w changes by R_IW (w × J_w dq) where the link turns by J_w dq.
        H[:3, :n] = R_IW @ (skew(motion.omega) @ motion.J_w + turned_rate(motion, now.v))
        H[:3, n : 2 * n] = R_IW @ motion.J_w
        H[3:, :n] = R_IW @ (skew(force) @ motion.J_w)
        J = R_IW @ motion.J_v
        if now.by_state is not None:
            H[3:] += J @ now.by_state
        if self.own.stop > self.own.start:
            H[:, self.own] = np.eye(6)
        R = self._noise
        if now.acceleration_noise is not None:
            R = R.copy()
            R[3:, 3:] += J @ now.acceleration_noise @ J.T
        return Linear(reading, H, R)

    def _still(self, x: Array) -> Instant:
        n = self.frame.terms.n
        return Instant(x, n, 0, np.zeros(n))

    def own_labels(self) -> list[str]:  # noqa: D102
        return [f"{self.name}.gyro_bias_{a} [rad/s]" for a in "xyz"] + [
            f"{self.name}.accel_bias_{a} [m/s²]" for a in "xyz"
        ]

    def own_std(self) -> Array:  # noqa: D102
        return self._bias_std

    def own_walk(self) -> Array:  # noqa: D102
        return self._bias_walk
