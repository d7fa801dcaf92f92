"""Mass and inertia that the description lacks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, UnitInertia, WeldJoint

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.effect import Effect, register
from twin_diagram.model.effects.parameter import ParameterKind
from twin_diagram.model.effects.realisation import RigidChange
from twin_diagram.model.rigid_body import rigid_tree
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies, DescribedLinks
from twin_diagram.signals.arrays import Array


def point_mass(mass: float, centre: Array) -> Array:
    """Return (10,) inertial parameters, as in `rigid_tree.RigidTree`, of a point mass."""
    tensor = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    off_diagonal = [tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    return np.concatenate([[mass], mass * centre, np.diag(tensor), off_diagonal])


def point_mass_jacobian(mass: float, centre: Array) -> Array:
    """Return (10, 4): derivative of `point_mass` with respect to mass and centre."""
    result = np.zeros((10, 4))
    result[:, 0] = point_mass(1.0, centre)
    result[1:4, 1:4] = mass * np.eye(3)
    for k in range(3):
        unit = np.eye(3)[k]
        tensor = mass * (2.0 * centre[k] * np.eye(3) - np.outer(unit, centre) - np.outer(centre, unit))
        result[4:, 1 + k] = [*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    return result


@register
class Payload(Effect):
    """A mass gained at the last link (or at the one link named), as a point in that link's frame."""

    name: ClassVar[str] = "payload"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "mass": ParameterKind("kg", lower=0.0),
        "com": ParameterKind("m", size=3, default=0.0),
    }
    per_joint: ClassVar[bool] = False
    folds: ClassVar[bool] = True
    changes_plant: ClassVar[bool] = True

    def check(self) -> None:
        """See `Effect.check`."""
        if len(self.links) > 1:
            raise ModelError(f"effects.payload.links: one link carries it, not {', '.join(self.links)}")

    def link(self, last_link: str) -> str:
        """Return the link that carries it."""
        return self.links[0] if self.links else last_link

    def inertia(self) -> Array:
        """Return (10,) in the carrying link's frame."""
        return point_mass(float(self.value("mass")[0]), self.value("com"))

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del tau
        body, X_ML = bodies.body_of(self.link(bodies.last_link))
        inertia = np.zeros((len(bodies.joints), 10))
        inertia[body] = rigid_tree.transform_inertia(X_ML) @ self.inertia()
        return bodies.tree.bare(inertia).inverse_dynamics(q, v, a)

    def sensitivity(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.sensitivity`; mass first, then the centre's x, y, z."""
        del tau
        body, X_ML = bodies.body_of(self.link(bodies.last_link))
        jacobian = point_mass_jacobian(float(self.value("mass")[0]), self.value("com"))
        return bodies.tree.regressor(q, v, a, body) @ (rigid_tree.transform_inertia(X_ML) @ jacobian)

    def change(self, links: DescribedLinks) -> RigidChange:
        """Add to the link's inertia."""
        return RigidChange(inertia={self.link(links.last_link): self.inertia()})

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Weld a body to the link."""
        mass = float(self.value("mass")[0])
        if mass == 0.0:
            return
        carrier = plant.get_body(arm.last_link)
        if self.links:
            carrier = plant.GetBodyByName(self.links[0])
        name = f"payload_{carrier.name()}"
        while plant.HasBodyNamed(name):
            name += "_"
        here: Any = np.zeros(3)
        there: Any = self.value("com").copy()
        point = SpatialInertia(mass, here, UnitInertia(0.0, 0.0, 0.0))
        body = plant.AddRigidBody(name, carrier.model_instance(), point)
        plant.AddJoint(WeldJoint(f"{name}_weld", carrier.body_frame(), body.body_frame(), RigidTransform(there)))


@register
class ReflectedInertia(Effect):
    """Inertia about a joint's own axis alone, such as a rotor's times the gear ratio squared."""

    name: ClassVar[str] = "reflected_inertia"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"inertia": ParameterKind("kg·m²", lower=0.0, lessens=True)}
    folds: ClassVar[bool] = True
    changes_plant: ClassVar[bool] = True

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del q, v, tau
        return self.spread(bodies.joints, self.value("inertia")) * a

    def change(self, links: DescribedLinks) -> RigidChange:
        """As the motors' rotors."""
        del links
        return RigidChange(rotor=dict(zip(self.joints, self.value("inertia").tolist(), strict=True)))

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Add to the rotor inertia of the motors."""
        for joint, inertia in zip(self.joints, self.value("inertia"), strict=True):
            actuator = arm.actuator(plant, joint)
            rotor = actuator.default_rotor_inertia() + float(inertia) / actuator.default_gear_ratio() ** 2
            actuator.set_default_rotor_inertia(rotor)
