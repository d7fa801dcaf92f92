"""Dry friction whose level changes: with speed (Stribeck), with load, or on a sum of joint speeds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.model.effects.effect import Effect, register
from twin_diagram.model.effects.friction import TUNING as FRICTION
from twin_diagram.model.effects.friction import smooth_sign
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.realisation import Brake, Fitting
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies
from twin_diagram.signals.arrays import Array


@register
class StribeckFriction(Effect):
    """Dry friction that falls from its static to its Coulomb level as the joint gets under way.

    Level: coulomb + (static − coulomb) exp(−(v / stribeck_velocity)²) (Armstrong-Hélouvry, Dupont and Canudas de Wit
    1994, eq. 4 with an exponent of 2).
    """

    name: ClassVar[str] = "stribeck_friction"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "coulomb": ParameterKind("N·m", lower=0.0),
        "static": ParameterKind("N·m", lower=0.0),
        "stribeck_velocity": ParameterKind("rad/s", lower=1e-4, upper=100.0),
    }
    dry: ClassVar[bool] = True
    motor_side: ClassVar[bool] = True

    def levels(self, bodies: ArmBodies, v: Array) -> Array:
        """Return the level (N, n) at speeds (N, n) [N·m]."""
        coulomb, static = (self.spread(bodies.joints, self.value(key)) for key in ("coulomb", "static"))
        speed = self.spread(bodies.joints, self.value("stribeck_velocity"))
        speed[speed == 0.0] = 1.0
        return np.asarray(coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2)))

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del q, a, tau
        return self.levels(bodies, v) * smooth_sign(v)

    def friction_level(self, bodies: ArmBodies, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """See `Effect.friction_level`."""
        del q, tau
        level = self.levels(bodies, v)
        return level, level

    def brakes(self) -> list[Brake]:
        """See `Effect.brakes`; only where it starts or ends during a run."""
        if not self.timed:
            return []
        raise ModelError("effects.stribeck_friction.onset: a simulator cannot start it during a run")

    def fittings(self) -> list[Fitting]:
        """Return a brake of the higher level, and a push that takes off what is too much at speed.

        The push vanishes at rest, so that the joint sticks as it should, and is never more than the brake.
        """
        result = []
        values = (self.value(key) for key in ("coulomb", "static", "stribeck_velocity"))
        for joint, coulomb, static, speed in zip(self.joints, *values, strict=True):
            highest = float(max(coulomb, static))
            if highest == 0.0:
                continue
            result.append(Fitting(f"{joint}_stribeck_friction", joint, limit=highest, damping=FRICTION.hold))

            def push(v: float, c: float = coulomb, s: float = static, w: float = speed, top: float = highest) -> float:
                return float((top - c - (s - c) * np.exp(-((v / w) ** 2))) * np.tanh(v / 0.005))

            result.append(Fitting(f"{joint}_stribeck_friction_push", joint, speed_curve=push))
        return result


@register
class LoadDependentFriction(Effect):
    """Dry friction in proportion to the absolute torque that the joint transmits, as geared joints have it.

    The transmitted torque is that on the load's side: the motor gives T + coefficient |T| sign(v).
    """

    name: ClassVar[str] = "load_dependent_friction"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"coefficient": ParameterKind("1", lower=0.0, upper=0.95)}
    dry: ClassVar[bool] = True
    motor_side: ClassVar[bool] = True

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del q, a
        return self.spread(bodies.joints, self.value("coefficient")) * np.abs(tau) * smooth_sign(v)

    def friction_level(self, bodies: ArmBodies, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """See `Effect.friction_level`: a motor's torque of T (1 ± c) transmits T."""
        del q, v
        c = self.spread(bodies.joints, self.value("coefficient"))
        with_motor, against_motor = c * np.abs(tau) / (1.0 + c), c * np.abs(tau) / (1.0 - c)
        return np.where(tau >= 0.0, with_motor, against_motor), np.where(tau >= 0.0, against_motor, with_motor)

    def brakes(self) -> list[Brake]:
        """Return one per joint, its level after the motor's torque."""
        return [_load_brake(joint, float(c)) for joint, c in zip(self.joints, self.value("coefficient"), strict=True)]


@register
class CoupledFriction(Effect):
    """Friction on the sum of the speeds of the joints named, as in geared wrists: each gets the same torque.

    One effect sits on one group of joints, so its parameters hold one number.
    """

    name: ClassVar[str] = "coupled_friction"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "damping": ParameterKind("N·m·s/rad", lower=0.0, default=0.0),
        "torque": ParameterKind("N·m", lower=0.0, default=0.0),
    }
    per_joint: ClassVar[bool] = False
    motor_side: ClassVar[bool] = True

    def check(self) -> None:
        """See `Effect.check`."""
        if len(self.joints) < 2 or len(set(self.joints)) != len(self.joints):
            raise ModelError("effects.coupled_friction.joints: name the two or more joints that are coupled")

    def direction(self, bodies: ArmBodies) -> Array:
        """Return (n,) 1 on the coupled joints."""
        return self.spread(bodies.joints, np.ones(len(self.joints)))

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del q, a, tau
        along = self.direction(bodies)
        return self.value("damping")[0] * np.outer(v @ along, along) + self.dry_torque(bodies, v)

    def dry_torque(self, bodies: ArmBodies, v: Array) -> Array:
        """Return the part of `torque` that integrators solve for."""
        along = self.direction(bodies)
        return self.value("torque")[0] * np.outer(smooth_sign(v @ along), along)

    def brakes(self) -> list[Brake]:
        """Return one, on the sum."""
        level = float(self.value("torque")[0])
        return [Brake("coupled_friction", self.joints, lambda _: (level, level), float(self.value("damping")[0]))]


def _load_brake(joint: str, c: float) -> Brake:
    def level(tau: Array) -> tuple[float, float]:
        with_motor, against_motor = c * abs(tau[0]) / (1.0 + c), c * abs(tau[0]) / (1.0 - c)
        return (with_motor, against_motor) if tau[0] >= 0.0 else (against_motor, with_motor)

    return Brake("load_dependent_friction", (joint,), level)
