"""Gears that yield: springs and play between a motor and its joint.

Measured positions are the motors'. The link turns by q = θ + e with the twist e of the gear, which transmits

    torque = −stiffness × d(e) − loss × stiffness × ė,        d(e): what of e is beyond ± gap / 2.

`loss` [s] says how soon a gear's swing dies away. The catalogue has no name for it, so that no report tells it.

`twin_diagram.model.dynamics.elastic_gears` works out the twist for a measured motion, `rollout` integrates it, and a
simulator's plant gets a rotor body with a joint of its own between motor and link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.rigid_change import RigidChange
from twin_diagram.model.effects.serialisation import register
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies, DescribedLinks
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, after what harmonic drives are known for; no measurement set them."""

    loss: float = 1e-3
    """Usual damping of an elastic gear over its stiffness [s]: 5 % of critical at 100 rad/s, as harmonic drives
    have."""


TUNING = Tuning()


@dataclass(frozen=True)
class Gear:
    """What lies between a motor and its joint.

    Attributes:
        stiffness: [N·m/rad], infinite for play alone.
        gap: total play [rad].
        loss: damping over stiffness [s].
    """

    stiffness: float = math.inf
    gap: float = 0.0
    loss: float = TUNING.loss


class YieldingGear(Effect):
    """Base of the two; as seen without time, it is its rotor's inertia alone."""

    folds: ClassVar[bool] = True

    def gears(self) -> dict[str, Gear]:
        """Return the gears by joint."""
        raise NotImplementedError

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`: with the gear taken as rigid."""
        del q, v, tau
        return self.spread(bodies.joints, self.value("rotor_inertia")) * a

    def change(self, links: DescribedLinks) -> RigidChange:
        """Return it as the motors' rotors."""
        del links
        return RigidChange(rotor=dict(zip(self.joints, self.value("rotor_inertia").tolist(), strict=True)))


@register
class JointElasticity(YieldingGear):
    """A spring between motor and joint."""

    name: ClassVar[str] = "joint_elasticity"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "stiffness": ParameterKind("N·m/rad", lower=1e-3, upper=1e9),
        "rotor_inertia": ParameterKind("kg·m²", lower=0.0, default=0.0, help="beyond the description's"),
        "loss": ParameterKind("s", lower=0.0, upper=0.1, default=TUNING.loss, help="damping over stiffness"),
    }

    def gears(self) -> dict[str, Gear]:
        """See `YieldingGear.gears`."""
        both = zip(self.joints, self.value("stiffness"), self.value("loss"), strict=True)
        return {joint: Gear(stiffness=float(k), loss=float(loss)) for joint, k, loss in both}


@register
class Backlash(YieldingGear):
    """Play between motor and joint, without any spring but the ends."""

    name: ClassVar[str] = "backlash"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "gap": ParameterKind("rad", lower=0.0, upper=0.5, help="total play"),
        "rotor_inertia": ParameterKind("kg·m²", lower=0.0, default=0.0, help="beyond the description's"),
    }

    def gears(self) -> dict[str, Gear]:
        """See `YieldingGear.gears`."""
        return {j: Gear(gap=float(gap)) for j, gap in zip(self.joints, self.value("gap"), strict=True)}
