"""Torque that comes and goes as a joint turns: cogging of motors, teeth of gears."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from twin_diagram.model.effects.effect import Effect, register
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.realisation import Fitting
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies
from twin_diagram.signals.arrays import Array


@register
class TorqueRipple(Effect):
    """The motor gives amplitude × sin(cycles q + phase) more."""

    name: ClassVar[str] = "torque_ripple"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "amplitude": ParameterKind("N·m", lower=0.0),
        "cycles": ParameterKind("1", lower=0.0, upper=1e5, help="per revolution of the joint", prismatic_unit="rad/m"),
        "phase": ParameterKind("rad", prismatic_unit="rad"),
    }
    motor_side: ClassVar[bool] = True

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del v, a, tau
        amplitude, cycles, phase = (self.spread(bodies.joints, self.value(key)) for key in self.kinds)
        return amplitude * np.sin(cycles * q + phase)

    def fittings(self) -> list[Fitting]:
        """Return an actuator per joint, explicit: keep amplitude × cycles × step² below the joint's inertia."""
        result = []
        for joint, amplitude, cycles, phase in zip(self.joints, *map(self.value, self.kinds), strict=True):

            def curve(q: float, a: float = amplitude, c: float = cycles, p: float = phase) -> float:
                return float(-a * np.sin(c * q + p))

            result.append(Fitting(f"{joint}_torque_ripple_{cycles:g}", joint, curve=curve))
        return result
