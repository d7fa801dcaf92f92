"""Links of an arm by name, where a plant holds others of that name: a hand's, or a fixture's."""

from __future__ import annotations

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm


def link_of(plant: MultibodyPlant, arm: Arm, name: str) -> RigidBody:
    """Return the link of an arm that is called so: of several that one which a joint of the arm moves.

    Args:
        plant: holds the arm, finalized or not.
        arm: as `add_arm.add_arm` gave it.
        name: of the link.

    Raises:
        ModelError: there is none, or the name does not tell which.
    """
    bodies = (plant.get_body(index) for instance in arm.instances for index in plant.GetBodyIndices(instance))
    called = [body for body in bodies if body.name() == name]
    moved = {int(plant.get_joint(index).child_body().index()) for index in arm.joint_indices}
    found = called if len(called) == 1 else [body for body in called if int(body.index()) in moved] or called
    if not found:
        raise ModelError(f"the model has no link {name!r}")
    if len(found) > 1:
        raise ModelError(f"{len(found)} links of the model are called {name!r}: give all but one another name")
    return found[0]
