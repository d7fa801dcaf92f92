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

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
)

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.effect import Effect, register
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.realisation import RigidChange
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies, DescribedLinks
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

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
    replaces_joints: ClassVar[bool] = True
    changes_plant: ClassVar[bool] = True

    def gears(self) -> dict[str, Gear]:
        """By joint."""
        raise NotImplementedError

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`: with the gear taken as rigid."""
        del q, v, tau
        return self.spread(bodies.joints, self.value("rotor_inertia")) * a

    def change(self, links: DescribedLinks) -> RigidChange:
        """As the motors' rotors."""
        del links
        return RigidChange(rotor=dict(zip(self.joints, self.value("rotor_inertia").tolist(), strict=True)))

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Put a rotor without mass between the joint's two links; its inertia is the motor's reflected one."""
        gears = self.gears()
        for name, inertia in zip(self.joints, self.value("rotor_inertia"), strict=True):
            _split(plant, arm, name, gears[name], float(inertia))


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


def _split(plant: MultibodyPlant, arm: Arm, name: str, gear: Gear, inertia: float) -> None:
    """Replace a joint by one of the same name for the motor and a second one, `<name>_twist`, for the gear."""
    joint = plant.GetJointByName(name, arm.instances[0]) if len(arm.instances) == 1 else plant.GetJointByName(name)
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    own = [actuator for actuator in actuators if actuator.joint().index() == joint.index()]
    if len(own) != 1 or not isinstance(joint, (RevoluteJoint, PrismaticJoint)):
        raise ModelError(f"effects: {name} has {len(own)} actuators; one joint yields in one place only")
    motor = own[0]
    kept = (motor.name(), motor.effort_limit(), motor.default_rotor_inertia(), motor.default_gear_ratio())
    gains = motor.get_controller_gains() if motor.has_controller() else None
    on_parent, on_child, child = joint.frame_on_parent(), joint.frame_on_child(), joint.child_body()
    kind = type(joint)
    # Copies: what these answer is a part of the joint, which goes.
    axis = (joint.revolute_axis() if isinstance(joint, RevoluteJoint) else joint.translation_axis()).copy()
    lower, upper = joint.position_lower_limits().copy(), joint.position_upper_limits().copy()
    speeds = joint.velocity_lower_limits().copy(), joint.velocity_upper_limits().copy()
    damping, start = joint.default_damping_vector().copy(), joint.default_positions().copy()
    plant.RemoveJointActuator(motor)
    plant.RemoveJoint(joint)
    rotor = plant.AddRigidBody(f"{name}_rotor", child.model_instance(), SpatialInertia.Zero())
    first = plant.AddJoint(kind(name, on_parent, rotor.body_frame(), axis, float(damping[0])))
    first.set_position_limits(lower, upper)
    first.set_velocity_limits(*speeds)
    first.set_default_positions(start)
    second = plant.AddJoint(kind(f"{name}_twist", rotor.body_frame(), on_child, axis))
    again = plant.AddJointActuator(kept[0], first, kept[1])
    again.set_default_rotor_inertia(kept[2] + inertia / kept[3] ** 2)
    again.set_default_gear_ratio(kept[3])
    if gains is not None:
        again.set_controller_gains(gains)
    if math.isfinite(gear.stiffness):
        spring = plant.AddJointActuator(f"{name}_gear", second)
        spring.set_controller_gains(PdControllerGains(p=gear.stiffness, d=gear.loss * gear.stiffness))
    else:
        half: list[float] = [0.5 * gear.gap]
        second.set_position_limits([-half[0]], half)
