"""Effects on the plant's bodies: masses welded to links, rotors, and a base that stands tilted."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody, SpatialInertia, UnitInertia, WeldJoint

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.links import link_of
from twin_diagram.model.effects.environment import GravityTilt
from twin_diagram.model.effects.inertia import Payload, ReflectedInertia
from twin_diagram.model.effects.link_inertia import InertialParameters, spatial_inertia
from twin_diagram.model.effects.simulated.realisation import Realisation, realises
from twin_diagram.model.rigid_body import rigid_tree


@realises(Payload)
class WeldedMass(Realisation[Payload]):
    """A body welded to the link that carries the payload; until it comes and once it is gone, `Push` bears it."""

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Weld a body to the link."""
        mass = float(self.effect.value("mass")[0])
        if mass == 0.0:
            return
        carrier = carrying_body(plant, arm, self.effect)
        name = f"{self.effect.name}_{carrier.name()}"
        while plant.HasBodyNamed(name):
            name += "_"
        here: Any = np.zeros(3)
        there: Any = self.effect.value("com").copy()
        point = SpatialInertia(mass, here, UnitInertia(0.0, 0.0, 0.0))
        body = plant.AddRigidBody(name, carrier.model_instance(), point)
        plant.AddJoint(WeldJoint(f"{name}_weld", carrier.body_frame(), body.body_frame(), RigidTransform(there)))


def carrying_body(plant: MultibodyPlant, arm: Arm, effect: Payload) -> RigidBody:
    """Return the body of the link that carries a payload."""
    return link_of(plant, arm, effect.links[0]) if effect.links else plant.get_body(arm.last_link)


@realises(ReflectedInertia)
class Rotors(Realisation[ReflectedInertia]):
    """More inertia of the motors' rotors."""

    changes_plant = True

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Add to the rotor inertia of the motors."""
        for joint, inertia in zip(self.effect.joints, self.effect.value("inertia"), strict=True):
            actuator = arm.actuator(plant, joint)
            rotor = actuator.default_rotor_inertia() + float(inertia) / actuator.default_gear_ratio() ** 2
            actuator.set_default_rotor_inertia(rotor)


@realises(InertialParameters)
class ExchangedLink(Realisation[InertialParameters]):
    """The link as it is, welded to the described one, and the described one's negative."""

    changes_plant = True

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Weld to the link itself as it is, and itself as described with a negative mass."""
        link = link_of(plant, arm, self.effect.links[0])
        present = rigid_tree.inertia_vector(link.default_spatial_inertia(), RigidTransform())
        for sign, vector in ((1.0, self.effect.whole(present)), (-1.0, present)):
            if vector[0] == 0.0:
                continue
            name = f"{link.name()}_{'actual' if sign > 0 else 'described'}"
            body = plant.AddRigidBody(name, link.model_instance(), spatial_inertia(vector, sign))
            plant.AddJoint(WeldJoint(f"{name}_weld", link.body_frame(), body.body_frame(), RigidTransform()))


@realises(GravityTilt)
class TiltedBase(Realisation[GravityTilt]):
    """The base, welded to the world anew."""

    changes_plant = True

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Weld the base anew, tilted about its own origin.

        Raises:
            ModelError: it is not welded to the world.
        """
        base = plant.get_body(arm.base)
        weld = next(
            joint
            for joint in map(plant.get_joint, plant.GetJointIndices())
            if joint.child_body().index() == base.index()
        )
        if not isinstance(weld, WeldJoint) or weld.parent_body().index() != plant.world_body().index():
            raise ModelError(f"effects.{self.effect.name}: {base.name()} is not welded to the world")
        X_WJp = weld.frame_on_parent().GetFixedPoseInBodyFrame()
        X_BJc = weld.frame_on_child().GetFixedPoseInBodyFrame()
        X_WB = X_WJp @ weld.X_FM() @ X_BJc.inverse()
        name = weld.name()
        plant.RemoveJoint(weld)
        R = self.effect.rotation().ToRotationMatrix()
        tilted = RigidTransform(R @ X_WB.rotation(), X_WB.translation())
        plant.AddJoint(WeldJoint(f"{name}_tilted", plant.world_frame(), base.body_frame(), tilted))
