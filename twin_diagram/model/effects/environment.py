"""What the arm's surroundings do to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydrake.math import RollPitchYaw

from twin_diagram.errors import ModelError
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.serialisation import register
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies
from twin_diagram.signals.arrays import Array


@register
class GravityTilt(Effect):
    """The base stands tilted: rolled about world x, then pitched about world y.

    The model keeps the base at X_WB and turns gravity the other way, so that its W is the tilted base's; the simulator
    tilts the base.
    """

    name: ClassVar[str] = "gravity_tilt"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "roll": ParameterKind("rad", lower=-np.pi, upper=np.pi, prismatic_unit="rad"),
        "pitch": ParameterKind("rad", lower=-np.pi, upper=np.pi, prismatic_unit="rad"),
    }
    per_joint: ClassVar[bool] = False

    def rotation(self) -> RollPitchYaw:
        """Return the tilt, as a rotation of the base in W."""
        return RollPitchYaw(float(self.value("roll")[0]), float(self.value("pitch")[0]), 0.0)

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del a, tau
        tilted = self.rotation().ToRotationMatrix().matrix().T @ bodies.tree.gravity
        change = replace(bodies.tree.bare(bodies.tree.inertia), gravity=tilted - bodies.tree.gravity)
        zero = np.zeros_like(q)
        del v
        return change.inverse_dynamics(q, zero, zero)


@register
class ExternalForce(Effect):
    """Something pushes at a link: a wrench in world axes at a point of the link, its origin unless another is told."""

    name: ClassVar[str] = "external_force"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "wrench": ParameterKind("N, N·m", size=6, help="force (3), then moment (3)", prismatic_unit="N, N·m"),
        "point": ParameterKind("m", size=3, default=0.0, help="where it acts, in the link's frame", prismatic_unit="m"),
    }
    per_joint: ClassVar[bool] = False

    def check(self) -> None:
        """See `Effect.check`."""
        if len(self.links) != 1:
            raise ModelError(f"effects.external_force.links: name one link, not {', '.join(self.links) or 'none'}")

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`: what the push gives, the motors need not."""
        del v, a, tau
        body, X_ML = bodies.body_of(self.links[0])
        force, moment = np.split(self.value("wrench"), 2)
        place = np.asarray(X_ML.multiply(self.value("point"))).ravel()
        return -bodies.tree.pushed(q, body, place, force, moment)
