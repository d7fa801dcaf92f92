"""Springs in and about the joints."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np
import scipy

from twin_diagram.errors import ModelError
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.serialisation import register
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies
from twin_diagram.signals.arrays import Array


@register
class JointSpring(Effect):
    """A torque that is a function of the joint's angle.

    Either linear, the motor giving stiffness × (q − rest_angle) more, or a `curve`: as many angles [rad, rising] and
    then the torques [N·m] that the motor gives more at them, on one joint. Between its points the curve is a monotone
    cubic (Fritsch and Carlson 1980), beyond them it takes its mean slope. On a prismatic joint: positions and forces.
    """

    name: ClassVar[str] = "joint_spring"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "stiffness": ParameterKind("N·m/rad", lower=0.0, optional=True),
        "rest_angle": ParameterKind("rad", optional=True),
        "curve": ParameterKind("rad, N·m", size=None, optional=True),
    }

    def check(self) -> None:
        """See `Effect.check`."""
        if set(self.parameters) not in ({"stiffness", "rest_angle"}, {"curve"}):
            raise ModelError("effects.joint_spring: give `stiffness` and `rest_angle`, or `curve`")
        if "curve" in self.parameters:
            values = self.value("curve")
            if len(self.joints) != 1:
                raise ModelError(f"effects.joint_spring.joints: a curve is one joint's, not {', '.join(self.joints)}")
            if len(values) % 2 or len(values) < 4 or np.any(np.diff(values[: len(values) // 2]) <= 0.0):
                raise ModelError(
                    "effects.joint_spring.curve: needs two or more rising angles, then as many torques, "
                    f"got {values.tolist()}"
                )

    def curve(self) -> Callable[[Array], Array]:
        """Return the curve as a function of angles of any shape.

        Beyond its ends, the slope there gives way to the curve's mean slope within half a piece: an end's slope is the
        least sure of all, and what it says of angles far away is nothing.
        """
        return _curve(tuple(self.value("curve").tolist()))

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del v, a, tau
        if "curve" in self.parameters:
            result = np.zeros_like(q)
            column = self.columns(bodies.joints)
            result[:, column] = self.curve()(q[:, column])
            return result
        stiffness, rest = (self.spread(bodies.joints, self.value(key)) for key in ("stiffness", "rest_angle"))
        return stiffness * (q - rest)


@functools.lru_cache(maxsize=64)
def _curve(values: tuple[float, ...]) -> Callable[[Array], Array]:
    """Return `JointSpring.curve` of angles and then torques.

    Kept by the numbers: a rollout asks for the law of one spring at each of its steps, and to make it takes a hundred
    times as long as to use it.
    """
    angles, torques = np.split(np.array(values), 2)
    inside = scipy.interpolate.PchipInterpolator(angles, torques)
    ends = np.array([angles[0], angles[-1]])
    mean = float(np.polyfit(angles, torques, 1)[0])
    bends = inside.derivative()(ends) - mean
    reach = 0.5 * float(np.mean(np.diff(angles)))

    def beyond(distance: Array, bend: float) -> Array:
        return np.asarray(mean * distance + bend * reach * -np.expm1(-np.abs(distance) / reach) * np.sign(distance))

    def law(q: Array) -> Array:
        below, above = np.minimum(q - ends[0], 0.0), np.maximum(q - ends[1], 0.0)
        result = inside(np.clip(q, *ends)) + beyond(below, bends[0]) + beyond(above, bends[1])
        return np.asarray(result)

    return law
