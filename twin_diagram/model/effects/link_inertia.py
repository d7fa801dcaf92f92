"""A link whose mass, centre and inertia are others than its description says."""

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


def about_origin(mass: float, centre: Array, about_centre: Array) -> Array:
    """Return (10,) inertial parameters about a frame's origin, of a body given as descriptions do.

    Args:
        mass: [kg].
        centre: (3,) centre of mass [m].
        about_centre: (6,) inertia about it, in the frame's axes: xx, yy, zz, xy, xz, yz [kg·m²].
    """
    shift = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    added = np.array([*np.diag(shift), shift[0, 1], shift[0, 2], shift[1, 2]])
    return np.concatenate([[mass], mass * centre, about_centre + added])


def about_centre(vector: Array) -> tuple[float, Array, Array]:
    """Return the inverse of `about_origin`; without mass the centre is the origin."""
    mass = float(vector[0])
    centre = vector[1:4] / mass if mass > 0.0 else np.zeros(3)
    shift = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return mass, centre, vector[4:] - [*np.diag(shift), shift[0, 1], shift[0, 2], shift[1, 2]]


@register
class InertialParameters(Effect):
    """Differences of a link's mass, centre of mass and inertia about it (xx, yy, zz, xy, xz, yz) from the description.

    All in the link's own frame, as the description's `<inertial>` states them for this link alone.
    """

    name: ClassVar[str] = "inertial_parameters"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "mass": ParameterKind("kg"),
        "com": ParameterKind("m", size=3, default=0.0),
        "inertia": ParameterKind("kg·m²", size=6, default=0.0, help="about the centre of mass", prismatic_unit="kg·m²"),
    }
    per_joint: ClassVar[bool] = False
    folds: ClassVar[bool] = True
    changes_plant: ClassVar[bool] = True

    def check(self) -> None:
        """See `Effect.check`."""
        if len(self.links) != 1:
            raise ModelError(f"effects.inertial_parameters.links: name one link, not {', '.join(self.links) or 'none'}")

    def whole(self, present: Array) -> Array:
        """Return (10,) about the link's origin, of the link with the differences.

        Args:
            present: (10,) of the link as described.

        Raises:
            ModelError: it would have no mass, or less.
        """
        mass, centre, inertia = about_centre(present)
        total = mass + float(self.value("mass")[0])
        if total <= 0.0:
            raise ModelError(
                f"effects.inertial_parameters.mass: {self.value('mass')[0]:g} kg of {mass:g} kg leave {self.links[0]} "
                f"with {total:g} kg"
            )
        return about_origin(total, centre + self.value("com"), inertia + self.value("inertia"))

    def difference(self, links: DescribedLinks) -> Array:
        """Return (10,) what is added to the link's inertial parameters, about its origin in its frame."""
        present = links.inertia(self.links[0])
        return self.whole(present) - present

    def torque(self, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """See `Effect.torque`."""
        del tau
        body, X_ML = bodies.body_of(self.links[0])
        if body < 0:
            return np.zeros_like(q)
        inertia = np.zeros((len(bodies.joints), 10))
        inertia[body] = rigid_tree.transform_inertia(X_ML) @ self.difference(bodies.links)
        return bodies.tree.bare(inertia).inverse_dynamics(q, v, a)

    def change(self, links: DescribedLinks) -> RigidChange:
        """Add to the link's inertia."""
        return RigidChange(inertia={self.links[0]: self.difference(links)})

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Weld to the link itself as it is, and itself as described with a negative mass."""
        link = plant.GetBodyByName(self.links[0])
        present = rigid_tree.inertia_vector(link.default_spatial_inertia(), RigidTransform())
        for sign, vector in ((1.0, self.whole(present)), (-1.0, present)):
            if vector[0] == 0.0:
                continue
            name = f"{link.name()}_{'actual' if sign > 0 else 'described'}"
            body = plant.AddRigidBody(name, link.model_instance(), spatial_inertia(vector, sign))
            plant.AddJoint(WeldJoint(f"{name}_weld", link.body_frame(), body.body_frame(), RigidTransform()))


def spatial_inertia(vector: Array, sign: float = 1.0) -> SpatialInertia:
    """From ten inertial parameters about the body's origin; `sign` −1 takes the body away."""
    mass = float(vector[0])
    xx, yy, zz, xy, xz, yz = vector[4:] / mass if mass > 0.0 else np.zeros(6)
    centre: Any = vector[1:4] / mass if mass > 0.0 else np.zeros(3)
    unit = UnitInertia(xx, yy, zz, xy, xz, yz)
    return SpatialInertia(sign * mass, centre, unit, skip_validity_check=True)
