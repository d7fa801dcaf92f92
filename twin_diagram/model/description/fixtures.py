"""Puts what stands still into a plant: one way for scene, planner, stop monitor and station, so that all agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, ModelInstanceIndex, RigidBody, WeldJoint

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.model.description import foreign, parser_warnings
from twin_diagram.model.description.add_arm import parser
from twin_diagram.scenario import poses, resources


def add_fixture(
    plant: MultibodyPlant, fixture: scenario.Fixture, packages: Mapping[str, str | Path] | None = None
) -> list[RigidBody]:
    """Parse a fixture and weld it at X_WB; return its bodies.

    Args:
        plant: not yet finalized.
        fixture: what stands still, and where.
        packages: local folders for `package://` names.

    Raises:
        ModelError: it cannot be read.
    """
    path = resources.resolve(fixture.model, packages)
    try:
        with parser_warnings.in_one_line(path):
            instances = foreign.add_models(parser(plant, packages), path, still=True)
    except RuntimeError as error:
        raise ModelError(f"{path}: cannot be read: {str(error).strip().splitlines()[0]}") from error
    weld_roots(plant, instances, poses.pose(fixture.X_WB))
    return [plant.get_body(body) for instance in instances for body in plant.GetBodyIndices(instance)]


def weld_roots(plant: MultibodyPlant, instances: Sequence[ModelInstanceIndex], X_WB: RigidTransform) -> None:
    """Weld the root bodies of parsed models to the world, those that their description welds there included.

    Args:
        plant: not yet finalized.
        instances: what a parser added.
        X_WB: the models' frame in the world.
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
