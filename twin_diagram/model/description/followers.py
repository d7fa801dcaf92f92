"""Joints that follow the gripper's: a finger that one motor moves with another, a linkage.

URDF's and SDF's ``<mimic>``, Drake's ``<drake:mimic>``, MJCF's ``<equality><joint/></equality>``.

They have no motor and no place in what a station tells of the gripper; a plant without contact does not move them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.unparsed import following, of_all
from twin_diagram.signals.arrays import Array, Ints


def couple(plant: MultibodyPlant, arm: Arm) -> None:
    """Hold an arm's joints to those that they follow; in a discrete plant that is not finalized."""
    every = [plant.get_joint(index) for instance in arm.instances for index in plant.GetJointIndices(instance)]
    known = {joint.name(): joint for joint in every if isinstance(joint, (RevoluteJoint, PrismaticJoint))}
    for name, how in of_all(following, arm.parts).items():
        if name in known and how.leader in known:
            plant.AddCouplerConstraint(known[name], known[how.leader], how.multiplier, how.offset)


@dataclass(frozen=True)
class Followers:
    """How F joints follow g of the gripper.

    Attributes:
        joints: that follow.
        index: (F,) of their positions in the plant.
        leader: (F,) of the positions of the gripper's joint that each follows, be it through others.
        multiplier: (F,) of the leader's position.
        offset: (F,) added to it [m or rad].
        widening: (g,) by how much an opening grows per unit of each of the gripper's joints: the joint, and what slides
            with it.
    """

    joints: tuple[Joint, ...]
    index: Ints
    leader: Ints
    multiplier: Array
    offset: Array
    widening: Array

    @staticmethod
    def of(plant: MultibodyPlant, arm: Arm) -> Followers:
        """Return those of an arm in a finalized plant.

        Raises:
            ModelError: a number in the description that cannot be read.
        """
        told = of_all(following, arm.parts)
        leaders = [plant.get_joint(index) for index in arm.gripper_joint_indices]
        place = {joint.name(): k for k, joint in enumerate(leaders)}
        taken = {int(index) for index in (*arm.joint_indices, *arm.gripper_joint_indices)}
        found: list[tuple[Joint, int, float, float]] = []
        for index in (index for instance in arm.instances for index in plant.GetJointIndices(instance)):
            joint = plant.get_joint(index)
            if int(index) in taken or not isinstance(joint, (RevoluteJoint, PrismaticJoint)):
                continue
            name, multiplier, offset = joint.name(), 1.0, 0.0
            for _ in told:  # no longer than all of them: who follows itself follows nobody
                if name not in told or name in place:
                    break
                how = told[name]
                name, multiplier, offset = how.leader, multiplier * how.multiplier, offset + multiplier * how.offset
            if name in place and name != joint.name():
                found.append((joint, place[name], multiplier, offset))
        widening = np.ones(len(leaders))
        for joint, k, multiplier, _ in found:
            if isinstance(joint, PrismaticJoint) and isinstance(leaders[k], PrismaticJoint):
                widening[k] += abs(multiplier)
        return Followers(
            tuple(joint for joint, *_ in found),
            np.array([joint.position_start() for joint, *_ in found], dtype=int),
            np.array([leaders[k].position_start() for _, k, *_ in found], dtype=int),
            np.array([multiplier for *_, multiplier, _ in found], dtype=float),
            np.array([offset for *_, offset in found], dtype=float),
            widening,
        )

    @staticmethod
    def gripping(plant: MultibodyPlant, arm: Arm) -> list[Joint]:
        """Return the gripper's joints and those that follow them: what an arm in a finalized plant grips with."""
        own = [plant.get_joint(index) for index in arm.gripper_joint_indices]
        return [*own, *Followers.of(plant, arm).joints]

    def follow(self, positions: Array) -> None:
        """Put the joints where they are with the gripper's, in a plant's positions (nq,), in place."""
        positions[self.index] = self.multiplier * positions[self.leader] + self.offset
