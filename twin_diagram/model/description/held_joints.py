"""Welds joints that nothing moves here: a second arm, a mobile base, a head, fingers, knuckles that tendons pull."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint, WeldJoint

from twin_diagram.model.description import joint_tree
from twin_diagram.model.description.unparsed import Following

HELD = "_held"
"""Ends the names of the welds in the place of joints."""


def beside(arm: Sequence[Joint], every: Sequence[Joint]) -> list[Joint]:
    """Return the joints that move without the arm: what its joints carry, as fingers and wrists, is left out.

    Args:
        arm: its joints.
        every: joints of the robot, also those that are fixed.
    """
    above = joint_tree.carriers(every)
    own = {int(joint.index()) for joint in arm}
    movable = [joint for joint in every if isinstance(joint, (RevoluteJoint, PrismaticJoint))]
    return [one for one in movable if own.isdisjoint(int(each.index()) for each in (one, *above(one)))]


def elsewhere(arm: Sequence[Joint], every: Sequence[Joint]) -> list[Joint]:
    """Return those of `beside` that do not carry the arm either: on a fixed base the arm does not feel them."""
    above = joint_tree.carriers(every)
    carrying = {int(each.index()) for joint in arm for each in above(joint)}
    return [joint for joint in beside(arm, every) if int(joint.index()) not in carrying]


def not_driven(driven: Sequence[Joint], every: Sequence[Joint], following: Mapping[str, Following]) -> list[Joint]:
    """Return the joints that neither are driven nor follow one that is: they would hang loose.

    Of a hand that tendons pull, which Drake does not read, and where an arm's joints are named, all others.

    Args:
        driven: joints of arm and gripper.
        every: joints of the robot, also those that are fixed.
        following: of each joint that follows another one, how; what follows a driven one, also through others, is left
            out.
    """
    moved = {joint.name() for joint in driven}
    for _ in following:  # also through others
        moved |= {name for name, how in following.items() if how.leader in moved}
    movable = [joint for joint in every if isinstance(joint, (RevoluteJoint, PrismaticJoint))]
    return [joint for joint in movable if joint.name() not in moved]


def hold(
    plant: MultibodyPlant, held: Sequence[Joint], following: Mapping[str, Following], closed: bool = False
) -> list[str]:
    """Replace joints by welds at the positions that the description starts them at, within their limits.

    A plant with constraints or springs gives no joint up. The constraints of joints that follow others are taken out
    and put back; where there is more, all joints stay as they are.

    Args:
        plant: not yet finalized.
        held: revolute and prismatic joints.
        following: of each joint that follows another one, how.
        closed: whether the plant's constraints are those that close a linkage all of which is held.

    Returns:
        The names of those that were welded.
    """
    springs = plant.num_force_elements() > 1  # beside gravity; with them a plant gives no joint up
    if not held or springs or not (closed or plant.num_constraints() in (0, len(following))):
        return []
    coupled = plant.num_constraints() > 0 and not closed
    for constraint in plant.GetConstraintIds():
        plant.RemoveConstraint(constraint)
    gone = {int(joint.index()) for joint in held}
    for actuator in map(plant.get_joint_actuator, list(plant.GetJointActuatorIndices())):
        if int(actuator.joint().index()) in gone:
            plant.RemoveJointActuator(actuator)
    names = [joint.name() for joint in held]
    for joint in held:
        _weld(plant, joint)
    if coupled:
        left = {plant.get_joint(index).name(): plant.get_joint(index) for index in plant.GetJointIndices()}
        for name, how in following.items():
            if name in left and how.leader in left:
                plant.AddCouplerConstraint(left[name], left[how.leader], how.multiplier, how.offset)
    return names


def _weld(plant: MultibodyPlant, joint: Joint) -> None:
    at = float(np.clip(joint.default_positions(), joint.position_lower_limits(), joint.position_upper_limits())[0])
    if isinstance(joint, RevoluteJoint):
        X_FM = RigidTransform(RotationMatrix(AngleAxis(at, joint.revolute_axis())), np.zeros(3))
    else:
        X_FM = RigidTransform(at * joint.translation_axis())
    name, frames = joint.name(), (joint.frame_on_parent(), joint.frame_on_child())
    plant.RemoveJoint(joint)
    plant.AddJoint(WeldJoint(name + HELD, *frames, X_FM))
