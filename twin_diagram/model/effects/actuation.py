"""What becomes of the logged torque before it reaches the joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.model.effects.effect import Effect, register
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.realisation import Fitting
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    weak: float = 0.2
    """Below this gain, what the motor gives says too little of what is logged."""


TUNING = Tuning()


@register
class TorqueBias(Effect):
    """A constant torque applied beyond what is logged."""

    name: ClassVar[str] = "torque_bias"
    last: ClassVar[bool] = True
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"torque": ParameterKind("N·m")}

    def applied(self, joints: Sequence[str], tau: Array) -> Array:
        """See `Effect.applied`."""
        return tau + self.spread(joints, self.value("torque"))

    def logged(self, joints: Sequence[str], tau: Array) -> Array:
        """See `Effect.logged`."""
        return tau - self.spread(joints, self.value("torque"))

    def fittings(self) -> list[Fitting]:
        """Return an actuator that always gives the same."""
        return [
            Fitting(f"{joint}_torque_bias", joint, torque=float(torque))
            for joint, torque in zip(self.joints, self.value("torque"), strict=True)
        ]


class Gain(Effect):
    """The joint gets the logged torque times a gain."""

    def gains(self, joints: Sequence[str]) -> Array:
        """Return (n,) one where it does not act."""
        result = np.ones(len(joints))
        result[self.columns(joints)] = self.value("gain")
        return result

    @property
    def loses(self) -> bool:
        """See `Effect.loses`: a motor that hardly gives anything may have been asked for much."""
        return bool(np.any(self.value("gain") < TUNING.weak))

    def applied(self, joints: Sequence[str], tau: Array) -> Array:
        """See `Effect.applied`."""
        return tau * self.gains(joints)

    def logged(self, joints: Sequence[str], tau: Array) -> Array:
        """See `Effect.logged`; below a hundredth of the torque, a hundredth is assumed."""
        return tau / np.maximum(self.gains(joints), 0.01)


@register
class TorqueConstant(Gain):
    """The motors' torque is another than what is logged: gain = torque applied / torque logged."""

    name: ClassVar[str] = "torque_constant"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"gain": ParameterKind("1", lower=0.01, upper=10.0)}

    @property
    def loses(self) -> bool:
        """A constant is never so small; were it taken for a dead motor, any torque would be explained by it."""
        return False


@register
class ActuatorFault(Gain):
    """A motor loses torque, from some moment on: what is left of it is `gain`."""

    name: ClassVar[str] = "actuator_fault"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"gain": ParameterKind("1", lower=0.0, upper=1.0)}


@register
class TorqueSaturation(Effect):
    """The torque that reaches a joint is bounded, whatever is logged."""

    name: ClassVar[str] = "torque_saturation"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"limit": ParameterKind("N·m", lower=0.0)}

    @property
    def loses(self) -> bool:
        """See `Effect.loses`."""
        return True

    def limits(self, joints: Sequence[str]) -> Array:
        """Return (n,) infinite where it does not act [N·m]."""
        result = np.full(len(joints), np.inf)
        result[self.columns(joints)] = self.value("limit")
        return result

    def applied(self, joints: Sequence[str], tau: Array) -> Array:
        """See `Effect.applied`."""
        limit = self.limits(joints)
        return np.clip(tau, -limit, limit)


@register
class TimeDelay(Effect):
    """The logged torque acts later, on all joints alike."""

    name: ClassVar[str] = "time_delay"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"delay": ParameterKind("s", lower=0.0, upper=1.0)}
    per_joint: ClassVar[bool] = False
    changes_plant: ClassVar[bool] = True

    def check(self) -> None:
        """See `Effect.check`."""
        if self.joints:
            raise ModelError("effects.time_delay.joints: all joints wait alike; name none")

    @property
    def delay(self) -> float:
        """See `Effect.delay`."""
        return float(self.value("delay")[0])
