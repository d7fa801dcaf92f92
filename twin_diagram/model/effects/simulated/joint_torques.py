"""Torques beside the motors' own: springs, ripple and bias, each an actuator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin_diagram.model.effects.actuation import TorqueBias
from twin_diagram.model.effects.ripple import TorqueRipple
from twin_diagram.model.effects.simulated.realisation import Fitting, Realisation, realises
from twin_diagram.model.effects.transmission import JointSpring


@realises(JointSpring)
class Springs(Realisation[JointSpring]):
    """Position-controlled actuators, springs that the plant integrates implicitly; curves are explicit."""

    def fittings(self) -> list[Fitting]:
        """Return one per joint."""
        effect = self.effect
        if "curve" in effect.parameters:
            law, joint = effect.curve(), effect.joints[0]
            return [Fitting(f"{joint}_{effect.name}", joint, curve=lambda q: -float(law(np.array(q))))]

        def linear(k: float, rest: float) -> Callable[[float], float]:
            return lambda q: -k * (q - rest)

        each = [
            (f"{joint}_{effect.name}", joint, float(k), float(rest))
            for joint, k, rest in zip(effect.joints, effect.value("stiffness"), effect.value("rest_angle"), strict=True)
        ]
        if effect.when.timed:
            return [Fitting(name, joint, curve=linear(k, rest)) for name, joint, k, rest in each]
        return [Fitting(name, joint, stiffness=k, rest=rest) for name, joint, k, rest in each if k > 0.0]


@realises(TorqueRipple)
class Ripples(Realisation[TorqueRipple]):
    """Explicit actuators: keep amplitude × cycles × step² below the joint's inertia."""

    def fittings(self) -> list[Fitting]:
        """Return one per joint."""
        result = []
        values = map(self.effect.value, self.effect.kinds)
        for joint, amplitude, cycles, phase in zip(self.effect.joints, *values, strict=True):

            def curve(q: float, a: float = amplitude, c: float = cycles, p: float = phase) -> float:
                return float(-a * np.sin(c * q + p))

            result.append(Fitting(f"{joint}_{self.effect.name}_{cycles:g}", joint, curve=curve))
        return result


@realises(TorqueBias)
class Biases(Realisation[TorqueBias]):
    """Actuators that always give the same."""

    def fittings(self) -> list[Fitting]:
        """Return one per joint."""
        return [
            Fitting(f"{joint}_{self.effect.name}", joint, torque=float(torque))
            for joint, torque in zip(self.effect.joints, self.effect.value("torque"), strict=True)
        ]
