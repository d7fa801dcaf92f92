"""What effects may ask of an arm: its joints, its links and their inertia, and its rigid tree.

No more than that, so that an effect stands below the model that holds it.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.links import link_of
from twin_diagram.model.rigid_body import from_plant
from twin_diagram.model.rigid_body.rigid_tree import RigidTree, inertia_vector
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class DescribedLinks:
    """An arm's links as its description states them, before any effect.

    Attributes:
        plant: finalized, holds the arm.
        arm: whose they are.
    """

    plant: MultibodyPlant
    arm: Arm

    @property
    def last_link(self) -> str:
        """Name of the child link of the last arm joint that is no finger; payloads hang on it."""
        return str(self.plant.get_body(self.arm.last_link).name())

    def inertia(self, link: str) -> Array:
        """Return the ten inertial parameters (10,) of a link about its own origin, in its own frame."""
        return inertia_vector(link_of(self.plant, self.arm, link).default_spatial_inertia(), RigidTransform())


class ArmBodies:
    """An arm's rigid bodies with all that effects change in them.

    Attributes:
        joints: names of the arm's joints, in order; n is their number.
        links: as described.
        last_link: see `DescribedLinks`.
        tree: the rigid dynamics, of the links as effects changed them.
    """

    def __init__(self, arm: Arm, links: DescribedLinks, context: Context) -> None:
        """Read the tree off a context of the plant whose parameters hold what effects change."""
        self.joints = arm.joints
        self.links = links
        self.last_link = links.last_link
        self.tree: RigidTree = from_plant.from_plant(links.plant, context, arm)
        self._arm, self._context = arm, context

    def body_of(self, link: str) -> tuple[int, RigidTransform]:
        """Return which body of `tree` carries a link (-1: it stands still), and X_ML of the link in its frame M."""
        plant = self.links.plant
        return from_plant.carrier(plant, self._context, self._arm, link_of(plant, self._arm, link))
