"""A force and moment sensor between the last link and what the arm carries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, skew
from twin_diagram.estimation.dynamics.link_frame import LinkFrame, LinkMotion
from twin_diagram.estimation.sensors.accelerated_sensor import AcceleratedSensor
from twin_diagram.estimation.sensors.sensor import Instant, Linear
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a load has a centre: chosen by hand."""

    lightest: float = 0.05
    """What weighs less has no centre to speak of [kg]."""


TUNING = Tuning()


@dataclass(frozen=True)
class WrenchBias:
    """The biases of a force and moment sensor, per axis, each a random walk.

    Attributes:
        force_std: prior of the forces' [N].
        moment_std: prior of the moments' [N·m].
        force_walk: random walk of the forces' [N/√s].
        moment_walk: random walk of the moments' [N·m/√s].
    """

    force_std: float = 1.0
    moment_std: float = 0.1
    force_walk: float = 0.003
    moment_walk: float = 0.0003


@dataclass(frozen=True)
class KnownTool:
    """What lies beyond a force and moment sensor and is part of the model.

    Attributes:
        mass: [kg].
        com: (3,) its centre in the sensor's frame [m].
    """

    mass: float
    com: Array


class WristWrench(AcceleratedSensor):
    """z = [moment N·m, force N] in sensor frame S at So: what the arm exerts on all that lies beyond the sensor.

    At rest that is the weight held up: force −m g. What lies beyond is a known tool and the payload that the filter
    learns, so that the sensor tells mass and centre directly, motors' friction left out. Its own states are the biases
    of all six, which drift. A contact leaves its gate: the reading is refused; its innovation is the contact's wrench.
    """

    def __init__(
        self,
        terms: ArmTerms,
        body: str | Frame,
        X_BS: RigidTransform | None = None,
        *,
        tool: KnownTool | None = None,
        force_std: float = 0.1,
        moment_std: float = 0.01,
        bias: WrenchBias = WrenchBias(),
        name: str = "wrench",
    ) -> None:
        """Make the sensor.

        Args:
            terms: the arm.
            body: the arm's last link, which the payload hangs on, or a frame fixed to it; by name, or the frame itself.
            X_BS: pose of S there; B's own frame where None.
            tool: what lies beyond the sensor and is part of the model; None: nothing.
            force_std: white noise of a reading [N].
            moment_std: white noise of a reading [N·m].
            bias: of both: what they may be at first, and how they drift.
            name: for messages and counters.

        Raises:
            ModelError: the plant has no such link or frame.
        """
        figures = [[moment_std, force_std], [bias.moment_std, bias.force_std], [bias.moment_walk, bias.force_walk]]
        labels = ("moment_bias_{a} [N·m]", "force_bias_{a} [N]")
        super().__init__(terms, body, X_BS, name, labels, np.array(figures))
        link = LinkFrame(terms, terms.link_frame)
        R_WL, p_WL = link.pose(np.zeros(terms.n))
        R_WS, p_WS = self.frame.pose(np.zeros(terms.n))
        self._R_SL: Array = R_WS.T @ R_WL
        self._p_SL: Array = R_WS.T @ (p_WL - p_WS)
        self.payload: slice | None = None
        self._tool: Array = np.zeros(4) if tool is None else np.concatenate([[tool.mass], tool.mass * tool.com])
        # From mass and first moment about Lo in L to those about So in S.
        self._to_S = np.zeros((4, 4))
        self._to_S[0, 0] = 1.0
        self._to_S[1:, 0] = self._p_SL
        self._to_S[1:, 1:] = self._R_SL

    def declare(self, own: slice, payload: slice | None) -> None:  # noqa: D102
        super().declare(own, payload)
        self.payload = payload

    def linear(self, now: Instant) -> Linear:  # noqa: D102
        n = now.n
        motion = self.frame.motion(now.q, now.v)
        R_SW = motion.R_WF.T
        lift, alpha = self._accelerations(motion, now.acceleration)
        omega = R_SW @ motion.omega
        Y = wrench_regressor(lift, alpha, omega)
        at = self.payload
        turning = skew(alpha) + skew(omega) @ skew(omega)
        whole, by_load = point_moment(self._tool, turning)
        swing = _swing(self._tool)
        carried = self._tool
        if at is not None:
            load = self._to_S @ now.x[at]
            moment, by_load = point_moment(load, turning)
            whole, swing, carried = whole + moment, swing + _swing(load), carried + load
        H = np.zeros((6, len(now.x)))
        reading = Y @ carried + self._bias(now, H)
        reading[:3] += whole
        D = np.empty((6, 3))  # of the wrench by lift
        D[3:] = carried[0] * np.eye(3)
        D[:3] = skew(carried[1:])
        H[:, :n] = D @ _turn(motion, R_SW, lift)
        by_a = D @ (R_SW @ motion.J_v)
        by_a[3:] -= skew(carried[1:]) @ (R_SW @ motion.J_w)
        by_a[:3] += swing @ (R_SW @ motion.J_w)
        if now.by_state is not None:
            H += by_a @ now.by_state
        if at is not None:
            if now.steady is not None:
                lift, alpha = self._accelerations(motion, now.steady)
                turning = skew(alpha) + skew(omega) @ skew(omega)
                Y, by_load = wrench_regressor(lift, alpha, omega), point_moment(load, turning)[1]
            Y[:3] += by_load
            H[:, at] += Y @ self._to_S
        R = self._noise
        if now.acceleration_noise is not None:
            R = R + by_a @ now.acceleration_noise @ by_a.T
        if at is not None and now.covariance is not None and now.by_state is not None:
            by_a = np.concatenate([R_SW @ motion.J_v, R_SW @ motion.J_w])
            shift, wide = self._second_order(by_a, now, at)
            reading, R = reading + shift, R + wide
        return Linear(reading, H, R)

    def _accelerations(self, motion: LinkMotion, a: Array) -> tuple[Array, Array]:
        """Return (3,) acceleration less gravity of S's origin and (3,) angular acceleration, in S."""
        R_SW = motion.R_WF.T
        lift = R_SW @ (motion.J_v @ a + motion.bias_a - self._gravity)
        return lift, R_SW @ (motion.J_w @ a + motion.bias_alpha)

    def _second_order(self, J: Array, now: Instant, at: slice) -> tuple[Array, Array]:
        """Return what the first order leaves out.

        The wrench is a load times an acceleration, and either may be unknown.

        Mean and covariance of a product of two Gaussians about their means; without them the first readings of an
        unknown load would be believed to the digit, whatever the acceleration then was.

        Args:
            J: (6, n) of lift and angular acceleration by the joints' accelerations, in S.
            now: with its covariance.
            at: the payload in x.

        Returns:
            (6,) mean and (6, 6) covariance.
        """
        P, by = now.covariance, now.by_state
        assert P is not None and by is not None
        load = self._to_S @ P[at, at] @ self._to_S.T
        by = J @ by
        moved = by @ P
        motion = moved @ by.T
        if now.acceleration_noise is not None:
            motion = motion + J @ now.acceleration_noise @ J.T
        both = self._to_S @ moved[:, at].T
        # E[δu_j δw_k δu_l δw_m] of two Gaussians, less the product of their means.
        fourth = load[:, None, :, None] * motion[None, :, None, :] + both[:, None, None, :] * both.T[None, :, :, None]
        return PRODUCT @ both.ravel(), PRODUCT @ fourth.reshape(24, 24) @ PRODUCT.T


def wrench_regressor(lift: Array, alpha: Array, omega: Array) -> Array:
    """Return (6, 4): moment and force about S's origin per mass and first moment of a point-like load, all in S.

    force = m (a − g) + α × mc + ω × (ω × mc), moment = mc × (a − g); `point_moment` has the rest of it.
    """
    Y = np.zeros((6, 4))
    spin = skew(omega)
    Y[3:, 0] = lift
    Y[3:, 1:] = skew(alpha) + spin @ spin
    Y[:3, 1:] = -skew(lift)
    return Y


def _product() -> Array:
    """Return (6, 24): how load and acceleration make a wrench; `wrench_regressor` without spin, taken apart."""
    parts = np.zeros((6, 4, 6))
    for k in range(6):
        motion = np.eye(6)[k]
        parts[:, :, k] = wrench_regressor(motion[:3], motion[3:], np.zeros(3))
    return parts.reshape(6, 24)


PRODUCT: Final = _product()
"""(6, 24), of a load's four numbers by the motion's six."""


def point_moment(load: Array, turning: Array) -> tuple[Array, Array]:
    """Return the moment (3,) about S's origin that turns a point-like load, and its derivative.

    The moment is m c × (α × c + ω × (ω × c)).

    Args:
        load: (4,) mass and first moment about S's origin.
        turning: (3, 3) matrix of α × and ω × (ω ×).

    Returns:
        (3,) [N·m] and (3, 4) by mass and first moment.
    """
    mass, centre = _point(load)
    lever = turning @ centre
    per_mass = skew(centre) @ lever
    by = np.empty((3, 4))
    by[:, 0] = -per_mass if mass > TUNING.lightest else 0.0
    by[:, 1:] = skew(centre) @ turning - skew(lever)
    return mass * per_mass, by


def _swing(load: Array) -> Array:
    """Return (3, 3) inertia of a point-like load about S's origin [kg·m²]."""
    mass, centre = _point(load)
    return np.asarray(-mass * skew(centre) @ skew(centre))


def _point(load: Array) -> tuple[float, Array]:
    mass = max(float(load[0]), TUNING.lightest)
    return mass, load[1:] / mass


def _turn(motion: LinkMotion, R_SW: Array, lift: Array) -> Array:
    """Return (3, n) of lift in S by q where the link turns: R_SW (w × J_w dq), with w = lift in W."""
    return np.asarray(R_SW @ (skew(R_SW.T @ lift) @ motion.J_w))
