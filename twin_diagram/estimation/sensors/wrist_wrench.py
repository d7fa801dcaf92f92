"""A force and moment sensor between the last link and what the arm carries."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.link_frame import LinkFrame, Motion, skew
from twin_diagram.estimation.sensors.sensor import Instant, Linear, Sensor
from twin_diagram.signals import Array


class WristWrench(Sensor):
    """z = [moment N·m, force N] in sensor frame S at So: what the arm exerts on all that lies beyond the sensor.

    At rest that is the weight held up: force −m g. What lies beyond is a known tool and the payload that the filter
    learns, so that the sensor tells mass and centre directly, motors' friction left out. Its own states are the biases
    of all six, which drift. A contact leaves its gate: the reading is refused; its innovation is the contact's wrench.
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str,
        X_BS: RigidTransform | None = None,
        *,
        tool_mass: float = 0.0,
        tool_com: Array | None = None,
        force_std: float = 0.1,
        moment_std: float = 0.01,
        force_bias_std: float = 1.0,
        moment_bias_std: float = 0.1,
        force_bias_walk: float = 0.003,
        moment_bias_walk: float = 0.0003,
        name: str = "wrench",
    ) -> None:
        """Makes the sensor.

        Args:
            terms: the arm.
            body: the arm's last link, which the payload hangs on, or a frame fixed to it.
            X_BS: pose of S there; B's own frame where None.
            tool_mass: beyond the sensor and part of the model [kg].
            tool_com: (3,) its centre in S [m].
            force_std: white noise of a reading [N].
            moment_std: white noise of a reading [N·m].
            force_bias_std: prior of its bias [N].
            moment_bias_std: prior of its bias [N·m].
            force_bias_walk: random walk of its bias [N/√s].
            moment_bias_walk: random walk of its bias [N·m/√s].
            name: for messages and counters.

        Raises:
            ModelError: the plant has no such link or frame.
        """
        super().__init__(name, 6)
        self.frame = LinkFrame(terms, body, X_BS)
        link = LinkFrame(terms, terms.link_name)
        R_WL, p_WL = link.pose(np.zeros(terms.n))
        R_WS, p_WS = self.frame.pose(np.zeros(terms.n))
        self._R_SL: Array = R_WS.T @ R_WL
        self._p_SL: Array = R_WS.T @ (p_WL - p_WS)
        self.payload: slice | None = None
        self._tool = np.concatenate([[tool_mass], tool_mass * (np.zeros(3) if tool_com is None else tool_com)])
        self._noise: Array = np.diag(np.repeat([moment_std**2, force_std**2], 3))
        self._bias_std = np.repeat([moment_bias_std, force_bias_std], 3)
        self._bias_walk = np.repeat([moment_bias_walk, force_bias_walk], 3)
        self._gravity = terms.plant.gravity_field().gravity_vector()
        # From mass and first moment about Lo in L to those about So in S.
        self._to_S = np.zeros((4, 4))
        self._to_S[0, 0] = 1.0
        self._to_S[1:, 0] = self._p_SL
        self._to_S[1:, 1:] = self._R_SL

    def declare(self, own: slice, payload: slice | None) -> None:  # noqa: D102
        super().declare(own, payload)
        self.payload = payload

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
        R_SW = motion.R_WF.T
        lift = R_SW @ (motion.J_v @ now.acceleration + motion.bias_a - self._gravity)
        alpha = R_SW @ (motion.J_w @ now.acceleration + motion.bias_alpha)
        omega = R_SW @ motion.omega
        Y = wrench_regressor(lift, alpha, omega)
        at = self.payload
        carried = self._tool if at is None else self._tool + self._to_S @ now.x[at]
        bias = now.x[self.own] if self.own.stop > self.own.start else np.zeros(6)
        H = np.zeros((6, len(now.x)))
        D = np.empty((6, 3))  # of the wrench by lift
        D[3:] = carried[0] * np.eye(3)
        D[:3] = skew(carried[1:])
        H[:, :n] = D @ _turn(motion, R_SW, lift)
        by_a = D @ (R_SW @ motion.J_v)
        by_a[3:] -= skew(carried[1:]) @ (R_SW @ motion.J_w)
        if now.by_state is not None:
            H += by_a @ now.by_state
        if at is not None:
            H[:, at] += Y @ self._to_S
        if self.own.stop > self.own.start:
            H[:, self.own] = np.eye(6)
        R = self._noise
        if now.acceleration_noise is not None:
            R = R + by_a @ now.acceleration_noise @ by_a.T
        return Linear(Y @ carried + bias, H, R)

    def _still(self, x: Array) -> Instant:
        n = self.frame.terms.n
        return Instant(x, n, 0, np.zeros(n))

    def own_labels(self) -> list[str]:  # noqa: D102
        return [f"{self.name}.moment_bias_{a} [N·m]" for a in "xyz"] + [
            f"{self.name}.force_bias_{a} [N]" for a in "xyz"
        ]

    def own_std(self) -> Array:  # noqa: D102
        return self._bias_std

    def own_walk(self) -> Array:  # noqa: D102
        return self._bias_walk


def wrench_regressor(lift: Array, alpha: Array, omega: Array) -> Array:
    """(6, 4): moment and force about S's origin per mass and first moment of a point-like load, all in S.

    force = m (a − g) + α × mc + ω × (ω × mc), moment = mc × (a − g); the load's own inertia, quadratic in c, is left
    out as in `ArmTerms.payload_regressor`.
    """
    Y = np.zeros((6, 4))
    spin = skew(omega)
    Y[3:, 0] = lift
    Y[3:, 1:] = skew(alpha) + spin @ spin
    Y[:3, 1:] = -skew(lift)
    return Y


def _turn(motion: Motion, R_SW: Array, lift: Array) -> Array:
    """(3, n) of lift in S by q where the link turns: R_SW (w × J_w dq), with w = lift in W."""
    return np.asarray(R_SW @ (skew(R_SW.T @ lift) @ motion.J_w))
