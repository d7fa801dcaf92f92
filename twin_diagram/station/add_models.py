"""Adds models that stand still or lie about to a plant, welded or free as a scenario says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, ModelInstanceIndex, RigidBody, WeldJoint

from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description import foreign
from twin_diagram.scenario import Pose, Scenario, poses
from twin_diagram.scenario.resources import resolve


def transform(pose: Pose, field: str) -> RigidTransform:
    """Return a scenario's pose as Drake's.

    Raises:
        ScenarioError: it has not three finite numbers each; `field` names it.
    """
    for name, values in (("translation", pose.translation), ("rpy", pose.rpy)):
        if len(values) != 3 or not np.all(np.isfinite(values)):
            raise ScenarioError(f"{field}.{name}", f"{values} is not three finite numbers")
    return poses.pose(pose)


def twin_arm(scenario: Scenario, plant: MultibodyPlant | None = None) -> description.Arm:
    """Return the arm that the twin was told of: its joints' names and, in `plant`, its places.

    Raises:
        ScenarioError: it cannot be loaded.
    """
    try:
        return description.add_arm(plant or MultibodyPlant(0.0), scenario.twin.arm, scenario.packages)
    except ModelError as error:
        raise description.scenario_error("twin.arm", error) from error


def add_model(plant: MultibodyPlant, name: str, packages: Mapping[str, str], model: str) -> list[ModelInstanceIndex]:
    """Parse one description into `plant`.

    Args:
        plant: not yet finalized.
        name: prefix of the new model instances' names.
        packages: local folders for ``package://`` names.
        model: a path, see `twin_diagram.scenario.resources.resolve`.

    Raises:
        ModelError: the file is missing or the parser refuses it; the message says where.
    """
    path = resolve(model, packages)
    if path.is_dir():
        raise ModelError(f"{model}: {path} is a folder, not a model's description")
    try:
        instances = list(foreign.add_models(_parser(plant, packages, name), path))
    except RuntimeError as error:
        raise ModelError(f"{path}: {' '.join(str(error).split())}") from error
    if not instances:
        raise ModelError(f"{path}: no model in it")
    return instances


def _parser(plant: MultibodyPlant, packages: Mapping[str, str], prefix: str) -> Parser:
    """Return the package's own parser, with a prefix to the names of what it adds."""
    parser = Parser(plant, prefix)
    parser.SetAutoRenaming(True)
    known = description.parser(plant, packages).package_map()
    package_map = parser.package_map()
    for name in package_map.GetPackageNames():
        package_map.Remove(name)
    package_map.AddMap(known)
    return parser


def weld_roots(plant: MultibodyPlant, instances: Sequence[ModelInstanceIndex], X_WB: RigidTransform) -> list[RigidBody]:
    """Weld the root bodies of parsed models to the world, those that their description welds there included.

    Args:
        plant: not yet finalized.
        instances: what a parser added.
        X_WB: the model's frame in the world.

    Returns:
        The bodies that are now welded to the world.
    """
    world = plant.world_body()
    children = {int(plant.get_joint(i).child_body().index()) for i in plant.GetJointIndices()}
    indices = [index for instance in instances for index in plant.GetJointIndices(instance)]
    roots: list[tuple[RigidBody, RigidTransform]] = []
    for index in indices:
        joint = plant.get_joint(JointIndex(int(index)))
        if isinstance(joint, WeldJoint) and joint.parent_body().index() == world.index():
            X_WF, X_RM = (f.GetFixedPoseInBodyFrame() for f in (joint.frame_on_parent(), joint.frame_on_child()))
            roots.append((joint.child_body(), X_WF @ joint.X_FM() @ X_RM.inverse()))
            plant.RemoveJoint(joint)
    for instance in instances:
        for body_index in plant.GetBodyIndices(instance):
            if int(body_index) not in children:
                roots.append((plant.get_body(body_index), RigidTransform()))
    for body, X_BR in roots:
        plant.WeldFrames(plant.world_frame(), body.body_frame(), X_WB @ X_BR)
    return [body for body, _ in roots]
