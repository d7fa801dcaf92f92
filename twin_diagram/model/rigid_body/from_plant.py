"""An arm's rigid tree, read off a plant."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    ForceElementIndex,
    Joint,
    PrismaticJoint,
    PrismaticSpring,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    UniformGravityFieldElement,
)
from pydrake.systems.framework import Context

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.rigid_body.rigid_tree import RigidTree, inertia_vector
from twin_diagram.signals.arrays import Array


def is_whole(plant: MultibodyPlant) -> bool:
    """Return whether gravity, dampers and joint springs are all the forces that a plant holds, as in `RigidTree`."""
    known = (UniformGravityFieldElement, RevoluteSpring, PrismaticSpring)
    elements = (plant.get_force_element(ForceElementIndex(k)) for k in range(plant.num_force_elements()))
    return all(isinstance(element, known) for element in elements)


def carrier(plant: MultibodyPlant, context: Context, arm: Arm, body: RigidBody) -> tuple[int, RigidTransform]:
    """Return the arm joint that moves a body (-1: none), and the body's pose in that joint's moving frame M.

    The positions in `context` of joints outside the arm count; the arm's own do not.
    """
    to_child = {int(joint.child_body().index()): joint for joint in map(plant.get_joint, plant.GetJointIndices())}
    order = {int(index): i for i, index in enumerate(arm.joint_indices)}
    start = body
    while int(body.index()) in to_child:
        joint = to_child[int(body.index())]
        if int(joint.index()) in order:
            X_WM = joint.frame_on_child().CalcPoseInWorld(context)
            return order[int(joint.index())], X_WM.inverse() @ plant.EvalBodyPoseInWorld(context, start)
        body = joint.parent_body()
    return -1, plant.EvalBodyPoseInWorld(context, start)


def from_plant(plant: MultibodyPlant, context: Context, arm: Arm) -> RigidTree:
    """Read the tree of an arm off a finalized plant.

    Args:
        plant: holds the arm.
        context: of the plant; joints outside the arm are taken as they are in it, the arm's own are set to zero.
        arm: which joints are the arm's.
    """
    joints = [plant.get_joint(index) for index in arm.joint_indices]
    for joint in joints:
        _at_zero(joint, context)
    order = {int(joint.index()): i for i, joint in enumerate(joints)}
    X_WM = [joint.frame_on_child().CalcPoseInWorld(context) for joint in joints]
    parent = np.array([carrier(plant, context, arm, joint.parent_body())[0] for joint in joints])
    X_PF = [
        (X_WM[p].inverse() if p >= 0 else RigidTransform()) @ joint.frame_on_parent().CalcPoseInWorld(context)
        for p, joint in zip(parent, joints, strict=True)
    ]
    inertia = np.zeros((len(joints), 10))
    for k in range(plant.num_bodies()):
        body = plant.get_body(BodyIndex(k))
        owner, X_MB = carrier(plant, context, arm, body)
        if owner >= 0:
            inertia[owner] += inertia_vector(body.CalcSpatialInertiaInBodyFrame(context), X_MB)
    stiffness, rest = _springs(plant, order)
    rotor = np.zeros(len(joints))
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        if int(actuator.joint().index()) in order:
            # Of several motors on a joint, a plant takes the last one's rotor for the joint's.
            rotor[order[int(actuator.joint().index())]] = actuator.calc_reflected_inertia(context)
    return RigidTree(
        parent=parent,
        revolute=np.array([isinstance(joint, RevoluteJoint) for joint in joints]),
        axis=np.array([_axis(joint) for joint in joints]),
        R_PF=np.array([X.rotation().matrix() for X in X_PF]),
        p_PF=np.array([X.translation() for X in X_PF]),
        inertia=inertia,
        rotor=rotor,
        damping=np.array([float(joint.GetDampingVector(context)[0]) for joint in joints]),
        stiffness=stiffness,
        rest=rest,
        gravity=np.array(plant.gravity_field().gravity_vector()),
        link=tuple(joint.child_body().name() for joint in joints),
    )


def _at_zero(joint: Joint, context: Context) -> None:
    if isinstance(joint, RevoluteJoint):
        joint.set_angle(context, 0.0)
    elif isinstance(joint, PrismaticJoint):
        joint.set_translation(context, 0.0)


def _axis(joint: Joint) -> Array:
    if isinstance(joint, RevoluteJoint):
        return np.array(joint.revolute_axis())
    assert isinstance(joint, PrismaticJoint)
    return np.array(joint.translation_axis())


def _springs(plant: MultibodyPlant, order: dict[int, int]) -> tuple[Array, Array]:
    """Return stiffness and rest position per joint, of all the springs that the description puts on it."""
    stiffness, moment = np.zeros(len(order)), np.zeros(len(order))
    for k in range(plant.num_force_elements()):
        spring = plant.get_force_element(ForceElementIndex(k))
        if isinstance(spring, RevoluteSpring):
            value, rest = spring.default_stiffness(), spring.default_nominal_angle()
        elif isinstance(spring, PrismaticSpring):
            value, rest = spring.stiffness(), spring.nominal_position()
        else:
            continue
        joint = int(spring.joint().index())
        if joint in order:
            stiffness[order[joint]] += value
            moment[order[joint]] += value * rest
    return stiffness, np.divide(moment, stiffness, out=np.zeros_like(moment), where=stiffness > 0.0)
