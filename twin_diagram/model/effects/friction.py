"""Friction at single joints.

Dry friction has two faces: a smooth law for identification and filters, and a bound on a torque that opposes motion for
integrators, which solve for it (a smooth law stiff enough to be right would need steps of microseconds).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.rigid_change import RigidChange
from twin_diagram.model.effects.serialisation import register
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies, DescribedLinks
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module; the speed was chosen by hand, of the damping nothing depends on how large it is."""

    smooth_velocity: float = 0.005
    """Speed at which the smooth law of dry friction has reached three quarters of its level [rad/s]."""

    hold: float = 1e6
    """Damping with which a dry joint is held below its level [N·m·s/rad].

    Drake's solver softens it to some 2.5e-4 of the speed that one free step would give the joint, whatever the damping.
    """


TUNING = Tuning()


def smooth_sign(v: Array) -> Array:
    """Return a sign that is smooth about zero speed."""
    return np.tanh(v / TUNING.smooth_velocity)


@register
class ViscousFriction(Effect):
    """Friction in proportion to speed: the motor gives damping × v more."""

    name: ClassVar[str] = "viscous_friction"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"damping": ParameterKind("N·m·s/rad", lower=0.0, lessens=True)}
    folds: ClassVar[bool] = True
    motor_side: ClassVar[bool] = True

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del q, a, tau
        return self.spread(bodies.joints, self.value("damping")) * v

    def change(self, links: DescribedLinks) -> RigidChange:
        """Return it as dampers of the joints."""
        del links
        return RigidChange(damping=dict(zip(self.joints, self.value("damping").tolist(), strict=True)))


@register
class CoulombFriction(Effect):
    """Dry friction of one level, or of one level per direction.

    The motor gives `torque` more where v > 0 and less where v < 0; at rest the friction is whatever it must be to hold
    the joint, up to the level.
    """

    name: ClassVar[str] = "coulomb_friction"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "torque": ParameterKind("N·m", lower=0.0, lessens=True, optional=True),
        "torque_positive": ParameterKind(
            "N·m", lower=0.0, help="level against positive motion", lessens=True, optional=True
        ),
        "torque_negative": ParameterKind(
            "N·m", lower=0.0, help="level against negative motion", lessens=True, optional=True
        ),
    }
    dry: ClassVar[bool] = True
    even: ClassVar[bool] = True
    motor_side: ClassVar[bool] = True

    def check(self) -> None:
        """See `Effect.check`."""
        if set(self.parameters) not in ({"torque"}, {"torque_positive", "torque_negative"}):
            raise ModelError("effects.coulomb_friction: give `torque`, or `torque_positive` and `torque_negative`")

    def levels(self) -> tuple[Array, Array]:
        """Return levels against positive and against negative motion, one number per joint of the effect."""
        if "torque" in self.parameters:
            return self.value("torque"), self.value("torque")
        return self.value("torque_positive"), self.value("torque_negative")

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del q, a, tau
        forward, backward = (self.spread(bodies.joints, level) for level in self.levels())
        return np.where(v >= 0.0, forward, backward) * smooth_sign(v)

    def friction_level(self, bodies: ArmBodies, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """See `Effect.friction_level`."""
        del v, tau
        forward, backward = (self.spread(bodies.joints, level) for level in self.levels())
        return np.broadcast_to(forward, q.shape), np.broadcast_to(backward, q.shape)
