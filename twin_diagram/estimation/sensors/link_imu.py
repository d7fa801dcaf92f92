"""An inertial measurement unit on a link: gyroscope and accelerometer with biases that are states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, skew
from twin_diagram.estimation.dynamics.link_frame import turned_acceleration, turned_rate
from twin_diagram.estimation.sensors.accelerated_sensor import AcceleratedSensor
from twin_diagram.estimation.sensors.sensor import Instant, Linear


@dataclass(frozen=True)
class ImuBias:
    """The biases of an inertial measurement unit, per axis, each a random walk.

    Attributes:
        gyro_std: prior of the gyroscope's [rad/s].
        accel_std: prior of the accelerometer's [m/s²].
        gyro_walk: random walk of the gyroscope's [rad/s/√s].
        accel_walk: random walk of the accelerometer's [m/s²/√s].
    """

    gyro_std: float = 0.02
    accel_std: float = 0.1
    gyro_walk: float = 1e-4
    accel_walk: float = 1e-3


class LinkImu(AcceleratedSensor):
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
        bias: ImuBias = ImuBias(),
        name: str = "imu",
    ) -> None:
        """Make the sensor.

        Args:
            terms: the arm.
            body: the link or frame B that it is fixed to; by name, or the frame itself.
            X_BI: its pose there; B's own frame where None.
            gyro_std: white noise of a reading [rad/s].
            accel_std: white noise of a reading [m/s²].
            bias: of both: what they may be at first, and how they drift.
            name: for messages and counters.

        Raises:
            ModelError: the plant has no such link or frame.
        """
        figures = [[gyro_std, accel_std], [bias.gyro_std, bias.accel_std], [bias.gyro_walk, bias.accel_walk]]
        labels = ("gyro_bias_{a} [rad/s]", "accel_bias_{a} [m/s²]")
        super().__init__(terms, body, X_BI, name, labels, np.array(figures))

    def linear(self, now: Instant) -> Linear:  # noqa: D102
        n = now.n
        motion = self.frame.motion(now.q, now.v)
        R_IW = motion.R_WF.T
        force = motion.J_v @ now.acceleration + motion.bias_a - self._gravity
        H = np.zeros((6, len(now.x)))
        reading = np.concatenate([R_IW @ motion.omega, R_IW @ force]) + self._bias(now, H)
        # R_IW w changes by R_IW (w × J_w dq) where the link turns by J_w dq.
        H[:3, :n] = R_IW @ (skew(motion.omega) @ motion.J_w + turned_rate(motion, now.v))
        H[:3, n : 2 * n] = R_IW @ motion.J_w
        by_q, by_v = turned_acceleration(motion, now.v, now.acceleration)
        H[3:, :n] = R_IW @ (skew(force) @ motion.J_w + by_q)
        H[3:, n : 2 * n] = R_IW @ by_v
        J = R_IW @ motion.J_v
        if now.by_state is not None:
            H[3:] += J @ now.by_state
        R = self._noise
        if now.acceleration_noise is not None:
            R = R.copy()
            R[3:, 3:] += J @ now.acceleration_noise @ J.T
        return Linear(reading, H, R)
