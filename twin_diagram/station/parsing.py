"""Adds a model's description to a plant, with its root welded where a scenario says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, JointActuator, ModelInstanceIndex, RigidBody, WeldJoint

from twin_diagram.errors import ModelError
from twin_diagram.resources import models_dir, resolve
from twin_diagram.scenario import Pose


def transform(pose: Pose, field: str = "pose") -> RigidTransform:
    """A scenario's pose as Drake's.

    Raises:
        ModelError: it has not three numbers each.
    """
    if len(pose.translation) != 3 or len(pose.rpy) != 3:
        raise ModelError(f"{field}: translation {pose.translation} and rpy {pose.rpy} have three numbers each")
    return RigidTransform(RollPitchYaw(pose.rpy), pose.translation)


def parser_for(plant: MultibodyPlant, packages: Mapping[str, str], prefix: str = "") -> Parser:
    """A parser that finds ``package://`` names in local folders alone: nothing is ever downloaded."""
    parser = Parser(plant, prefix) if prefix else Parser(plant)
    parser.SetAutoRenaming(True)
    package_map = parser.package_map()
    for name in ("drake_models", "twin_diagram", *packages):
        if package_map.Contains(name):
            package_map.Remove(name)
    for name, folder in {"twin_diagram": str(models_dir()), **packages}.items():
        try:
            package_map.Add(name, str(folder))
        except RuntimeError as error:
            raise ModelError(f"packages.{name}: {folder}: {error}") from error
    return parser


def add_model(plant: MultibodyPlant, name: str, packages: Mapping[str, str], prefix: str = "") -> list[ModelInstanceIndex]:
    """Parses one description into `plant`.

    Raises:
        ModelError: the file is missing or the parser refuses it; the message says where.
    """
    path = resolve(name, packages)
    if path.is_dir():
        raise ModelError(f"{name}: {path} is a folder, not a model's description")
    try:
        instances = list(parser_for(plant, packages, prefix).AddModels(str(path)))
    except RuntimeError as error:
        raise ModelError(f"{path}: {' '.join(str(error).split())}") from error
    if not instances:
        raise ModelError(f"{path}: no model in it")
    return instances


def joints_of(plant: MultibodyPlant, instances: Sequence[ModelInstanceIndex]) -> list[Joint]:
    """The joints of some model instances, in the order of the descriptions (also before Finalize)."""
    wanted = {int(i) for i in instances}
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if int(joint.model_instance()) in wanted]


def actuator_of(plant: MultibodyPlant, joint: Joint) -> JointActuator | None:
    """The first actuator on a joint (also before Finalize), or None."""
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.joint().index() == joint.index():
            return actuator
    return None


def weld_roots(plant: MultibodyPlant, instances: Sequence[ModelInstanceIndex], X_WB: RigidTransform) -> list[RigidBody]:
    """Welds the root bodies of parsed models to the world, those that their description welds there included.

    Args:
        plant: not yet finalized.
        instances: what a parser added.
        X_WB: the model's frame in the world.

    Returns:
        The bodies that are now welded to the world.
    """
    world = plant.world_body()
    children = {int(plant.get_joint(i).child_body().index()) for i in plant.GetJointIndices()}
    roots: list[tuple[RigidBody, RigidTransform]] = []
    for instance in instances:
        for joint in joints_of(plant, [instance]):
            if isinstance(joint, WeldJoint) and joint.parent_body().index() == world.index():
                X_WC = (
                    joint.frame_on_parent().GetFixedPoseInBodyFrame()
                    @ joint.X_FM()
                    @ joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
                )
                roots.append((joint.child_body(), X_WC))
                plant.RemoveJoint(joint)
        for index in plant.GetBodyIndices(instance):
            body = plant.get_body(index)
            if int(index) not in children:
                roots.append((body, RigidTransform()))
    for body, X_BR in roots:
        plant.WeldFrames(plant.world_frame(), body.body_frame(), X_WB @ X_BR)
    return [body for body, _ in roots]
