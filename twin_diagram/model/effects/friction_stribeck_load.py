"""Dry friction whose level changes: with speed (Stribeck), with load, or on a sum of joint speeds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.friction import smooth_sign
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.serialisation import register
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
