"""Torques behind the gears, as an arm with joint torque sensors measures them: no rotor, no friction of the drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram.errors import ScenarioError
from twin_diagram.signals.arrays import Array


class LinkTorque(LeafSystem):
    """Picks what each gear passes on to its link out of the plant's reaction forces.

    .. pydrake_system::

        name: LinkTorque
        input_ports:
        - reaction_forces
        output_ports:
        - torque

    `torque` (n) [N·m], [N] where the joint slides: that of the plant's step which begins now, along the joint's axis
    upon its child. Where a gear yields it is that of the gear. No latency.
    """

    def __init__(self, plant: MultibodyPlant, joints: Sequence[Joint]) -> None:
        """Build it for the arm's joints of a finalized plant.

        Raises:
            ScenarioError: a joint that neither turns nor slides.
        """
        super().__init__()
        # Forces stand in the order of the joints that are there: of a gear that yields the first one was replaced.
        order = [int(index) for index in plant.GetJointIndices()]
        behind = [_behind(plant, joint) for joint in joints]
        self._rows = [(order.index(int(joint.index())), _axis(joint)) for joint in behind]
        self._forces = self.DeclareAbstractInputPort("reaction_forces", Value([SpatialForce()]))
        self.DeclareVectorOutputPort("torque", len(joints), self._calc, {self._forces.ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        forces: Any = self._forces.Eval(context)
        output.SetFromVector(cast(Any, [float(axis @ forces[at].get_coeffs()) for at, axis in self._rows]))


def _behind(plant: MultibodyPlant, joint: Joint) -> Joint:
    """Return the joint behind a yielding gear's rotor, where there is one; else the joint itself."""
    twist = f"{joint.name()}_twist"
    instance = joint.model_instance()
    return plant.GetJointByName(twist, instance) if plant.HasJointNamed(twist, instance) else joint


def _axis(joint: Joint) -> Array:
    """Return what of a joint's force (6), torque before force, lies along its axis."""
    none = np.zeros(3)
    if isinstance(joint, RevoluteJoint):
        return np.concatenate([joint.revolute_axis(), none])
    if isinstance(joint, PrismaticJoint):
        return np.concatenate([none, joint.translation_axis()])
    raise ScenarioError(
        "twin.driver.torque_side", f"link: the joint {joint.name()} neither turns nor slides; its torque is not one"
    )
