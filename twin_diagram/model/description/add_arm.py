"""Puts an arm's description (URDF, SDF, MJCF, .dmd.yaml or the folder of a corrected model) into a plant.

The model and every station add their arm with `add_arm`, so that both mean the same joints, base and tool.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from pathlib import Path

import numpy as np
from pydrake.common.yaml import yaml_load_typed
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    FrameIndex,
    Joint,
    JointActuator,
    JointActuatorIndex,
    JointIndex,
    ModelInstanceIndex,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)

from twin_diagram import scenario
from twin_diagram.errors import ModelError, ScenarioError, expect
from twin_diagram.model.description import (
    foreign,
    held_joints,
    impossible,
    joint_tree,
    named_files,
    parser_warnings,
    unparsed,
)
from twin_diagram.model.description.tool_frame import tool_frame
from twin_diagram.scenario import resources
from twin_diagram.scenario.poses import pose

EFFECTS_FILE = "effects.yaml"
"""Written beside the description in the folder of a corrected model."""


@dataclass(frozen=True)
class Arm:
    """Where an arm sits in a plant; valid before and after Finalize.

    Attributes:
        spec: the arm as described, its folder of corrections resolved.
        instances: the description's model instances.
        joints: names of the arm's joints, in order.
        joint_indices: theirs in the plant.
        actuator_indices: their motors' in the plant.
        gripper_joints: names of the finger joints, in order.
        gripper_joint_indices: theirs in the plant.
        gripper_actuator_indices: their motors' in the plant; those that have none (mimicking fingers) are left out.
        base: the root link.
        last_link: the child link of the last arm joint that is no finger; payloads hang on it.
        tool_frame: the frame that the planner moves.
        parts: the files that describe it: of a .dmd.yaml those that it names.
        stated: friction and springs that the description states and Drake does not read.
        link_side: whether its torques are those behind the gears, where no rotor of its own shows.
    """

    spec: scenario.ArmModel
    instances: tuple[ModelInstanceIndex, ...]
    joints: tuple[str, ...]
    joint_indices: tuple[JointIndex, ...]
    actuator_indices: tuple[JointActuatorIndex, ...]
    gripper_joints: tuple[str, ...]
    gripper_joint_indices: tuple[JointIndex, ...]
    gripper_actuator_indices: tuple[JointActuatorIndex, ...]
    base: BodyIndex
    last_link: BodyIndex
    tool_frame: FrameIndex
    parts: tuple[Path, ...]
    stated: unparsed.StatedDynamics = field(default_factory=unparsed.StatedDynamics)
    link_side: bool = False

    def actuator(self, plant: MultibodyPlant, joint: str) -> JointActuator:
        """Return the motor of an arm joint."""
        return plant.get_joint_actuator(self.actuator_indices[self.joints.index(joint)])

    def behind_gears(self, plant: MultibodyPlant) -> Arm:
        """Return the arm with torques measured behind its gears; takes its rotors out of a plant not yet finalized."""
        for index in self.actuator_indices:
            plant.get_mutable_joint_actuator(index).set_default_rotor_inertia(0.0)
        return replace(self, link_side=True)

    def prismatic(self, plant: MultibodyPlant) -> frozenset[str]:
        """Return the names of the arm's prismatic joints: their positions are lengths, their torques forces."""
        both = zip(self.joints, map(plant.get_joint, self.joint_indices), strict=True)
        return frozenset(name for name, joint in both if isinstance(joint, PrismaticJoint))


def scenario_error(field: str, error: ModelError) -> ScenarioError:
    """Return what is wrong with an arm, said with the scenario's field.

    Args:
        field: of the arm, e.g. ``twin.arm``.
        error: of this module or of the effects; where it names none of the arm's fields it is about the description.
    """
    part, _, rest = str(error).partition(": ")
    if rest and part.split(".")[0] in {each.name for each in fields(scenario.ArmModel)}:
        return ScenarioError(f"{field}.{part}", rest)
    return ScenarioError(f"{field}.model", str(error))


def resolve(
    spec: scenario.ArmModel | str | Path,
    packages: Mapping[str, str | Path] | None = None,
    base_dir: str | Path | None = None,
) -> scenario.ArmModel:
    """Find the description, and merge what the folder of a corrected model says.

    Args:
        spec: an arm of a scenario, or just the path of a description or folder.
        packages: local folders for `package://` names.
        base_dir: folder that relative paths are looked up in first.

    Returns:
        An arm whose `model` is the absolute path of a description. A folder's effects come before those of `spec`; its
        joints, tool frame and base pose hold where `spec` leaves them at their defaults.

    Raises:
        ModelError: no such file, or a folder without a readable `effects.yaml`.
    """
    expect(spec, (str, os.PathLike, scenario.ArmModel), "model", "the path of a URDF, SDF or MJCF file, or an ArmModel")
    if not isinstance(spec, scenario.ArmModel):
        spec = scenario.ArmModel(model=str(spec), tool_frame="")
    name = spec.model
    if base_dir is not None and "://" not in name and (Path(base_dir) / name).exists():
        path = (Path(base_dir) / name).resolve()
    else:
        path = resources.resolve(name, packages)
    if not path.is_dir():
        return replace(spec, model=str(path))
    corrections = path / EFFECTS_FILE
    if not corrections.is_file():
        raise ModelError(f"{path}: a folder of a corrected model holds {EFFECTS_FILE}; this one does not")
    try:
        corrected = yaml_load_typed(schema=scenario.ArmModel, filename=str(corrections), defaults=scenario.ArmModel())
    except (RuntimeError, ValueError, TypeError, KeyError) as error:
        raise ModelError(f"{corrections}: {_first_line(error)}") from error
    description = path / corrected.model
    if not description.is_file():
        raise ModelError(f"{corrections}: model: {corrected.model}: no such file beside it")
    plain = scenario.ArmModel()
    chosen = {
        field.name: getattr(corrected, field.name)
        for field in fields(scenario.ArmModel)
        if getattr(spec, field.name) in (getattr(plain, field.name), "", [])
    }
    chosen["model"] = str(description)
    chosen["effects"] = [*corrected.effects, *spec.effects]
    return replace(spec, **chosen)


def parser(plant: MultibodyPlant, packages: Mapping[str, str | Path] | None = None) -> Parser:
    """Return a parser that knows the local packages and never downloads.

    Args:
        plant: where models go; when it is registered with a SceneGraph, geometry is read too.
        packages: local folders by package name; `twin_diagram` is the folder of the models that come along.
    """
    result = Parser(plant)
    result.SetAutoRenaming(True)
    package_map = result.package_map()
    folders = {"twin_diagram": resources.models_dir(), **(packages or {})}
    for name, folder in folders.items():
        if package_map.Contains(name):
            package_map.Remove(name)
        if not Path(folder).is_dir():
            raise ModelError(f"packages.{name}: {folder}: no such folder")
        package_map.Add(name, Path(folder).resolve())
    if "drake_models" not in folders and package_map.Contains("drake_models"):
        package_map.Remove("drake_models")
    return result


def add_arm(
    plant: MultibodyPlant,
    spec: scenario.ArmModel | str | Path,
    packages: Mapping[str, str | Path] | None = None,
    base_dir: str | Path | None = None,
    *,
    looked_at: bool = True,
) -> Arm:
    """Parse an arm into a plant that is not finalized, and weld its base at X_WB where it is free.

    A description without any motor (most URDFs carry no transmissions) gets one on each joint that is named, or, where
    none is named, on each revolute joint; joints that are named get the motor they lack. A revolute joint at the end
    which others beside it follow is a hand's, not the arm's. Where joints are named, all others but the gripper's and
    what follows are held where the description starts them (a second arm, wheels, a head, fingers of which none
    follows another), and so are the knuckles of a hand that tendons pull. What is not `looked_at` may lack the shapes
    that nothing touches, and is read in a third of the time.

    Raises:
        ModelError: unreadable description, no joint to drive, a name that is not in the model (the message lists those
            that are), or a base that is fixed by the description although X_WB is given.
    """
    spec = resolve(spec, packages, base_dir)
    instances, parts = _parsed(plant, spec, packages, looked_at)
    every = _joints(plant, instances)
    joint_tree.refuse_loops(spec.model, every)
    # Before Finalize the plant does not list actuators by model instance.
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    motors = {int(motor.joint().index()): motor for motor in actuators if motor.model_instance() in instances}
    following = unparsed.of_all(unparsed.following, parts)
    arm_joints, gripper_joints = _choose(spec, every, motors, following, unparsed.of_all(unparsed.driven, parts))
    joint_tree.refuse_alike(spec.model, plant, instances, arm_joints)
    pulled, still = any(map(unparsed.pulls_tendons, parts)), list[Joint]()
    if pulled or spec.joints:
        still = held_joints.not_driven([*arm_joints, *gripper_joints], every, following)
    if held_joints.hold(plant, still, following, closed=pulled):
        every = _joints(plant, instances)
    _add_motors(plant, [*arm_joints, *(gripper_joints if spec.gripper_joints or not motors else [])], motors, parts)
    base = _weld_base(plant, instances, arm_joints[0], spec)
    carrying = [j for j in arm_joints if not (isinstance(j, PrismaticJoint) and joint_tree.is_finger(j, every))]
    last_link = (carrying or arm_joints)[-1].child_body()
    return Arm(
        spec=spec,
        instances=instances,
        joints=tuple(joint.name() for joint in arm_joints),
        joint_indices=tuple(joint.index() for joint in arm_joints),
        actuator_indices=tuple(motors[int(joint.index())].index() for joint in arm_joints),
        gripper_joints=tuple(joint.name() for joint in gripper_joints),
        gripper_joint_indices=tuple(joint.index() for joint in gripper_joints),
        gripper_actuator_indices=tuple(
            motors[int(joint.index())].index() for joint in gripper_joints if int(joint.index()) in motors
        ),
        base=base.index(),
        last_link=last_link.index(),
        tool_frame=tool_frame(plant, instances, spec, last_link),
        parts=parts,
        stated=unparsed.stated_dynamics(parts, [joint.name() for joint in arm_joints]),
    )


def _parts(spec: scenario.ArmModel, packages: Mapping[str, str | Path] | None) -> tuple[Path, ...]:
    """Return the files that describe an arm."""
    folders = foreign.folders_of(parser(MultibodyPlant(0.0), packages).package_map())
    return named_files.parts_of(Path(spec.model), folders)


def _parsed(
    plant: MultibodyPlant, spec: scenario.ArmModel, packages: Mapping[str, str | Path] | None, looked_at: bool
) -> tuple[tuple[ModelInstanceIndex, ...], tuple[Path, ...]]:
    """Put a description into a plant and return its files, too; what is wrong with it is said in one line."""
    if Path(spec.model).suffix.lower() == ".xacro":
        raise ModelError(f"{spec.model}: a xacro is read once it is expanded: xacro {Path(spec.model).name} > arm.urdf")
    try:
        parts = _parts(spec, packages)
        for part in parts:
            impossible.refuse_impossible(part)
        with parser_warnings.in_one_line(Path(spec.model)):
            instances = foreign.add_models(parser(plant, packages), Path(spec.model), looked_at=looked_at)
    except SystemExit as error:  # of a condition within Drake, from which pydrake would end the program
        raise ModelError(f"{spec.model}: Drake's parser does not hold it: {_first_line(error)}") from error
    except (RuntimeError, ValueError) as error:
        if isinstance(error, ModelError):
            raise
        said = impossible.with_owner(Path(spec.model), _first_line(error))
        unknown = re.search(r"unknown package '([^']+)'", said)
        advice = f"; {resources.name_package(unknown[1])}" if unknown else ""
        raise ModelError(f"{spec.model}: cannot be read: {said}{advice}") from error
    if not instances:
        raise ModelError(f"{spec.model}: holds no model")
    return instances, parts


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def _joints(plant: MultibodyPlant, instances: Iterable[ModelInstanceIndex]) -> list[Joint]:
    indices = sorted(int(index) for instance in instances for index in plant.GetJointIndices(instance))
    return [plant.get_joint(JointIndex(index)) for index in indices]


def _add_motors(
    plant: MultibodyPlant, joints: Sequence[Joint], motors: dict[int, JointActuator], parts: Sequence[Path]
) -> None:
    """Give each joint a motor, with the limit and the rotor that the description states."""
    efforts, rotors = unparsed.of_all(unparsed.effort_limits, parts), unparsed.of_all(unparsed.armatures, parts)
    for joint in joints:
        if int(joint.index()) not in motors:
            limit = efforts.get(joint.name(), np.inf)
            motor = motors[int(joint.index())] = plant.AddJointActuator(f"{joint.name()}_motor", joint, limit)
            motor.set_default_rotor_inertia(rotors.get(joint.name(), 0.0))
        elif joint.name() in efforts:
            motors[int(joint.index())].set_effort_limit(efforts[joint.name()])


def _choose(
    spec: scenario.ArmModel,
    every: Sequence[Joint],
    motors: Mapping[int, JointActuator],
    following: Mapping[str, unparsed.Following],
    told: Mapping[str, bool],
) -> tuple[list[Joint], list[Joint]]:
    """Return the arm's joints and the gripper's, named or by rule, of `every` joint, also those that are fixed."""
    movable = [joint for joint in every if isinstance(joint, (RevoluteJoint, PrismaticJoint))]
    driven = [joint for joint in movable if joint.name() not in following]
    if motors:
        geared = {j.name() for j in driven if isinstance(j, RevoluteJoint) and told.get(j.name(), False)}
        driven = [joint for joint in movable if int(joint.index()) in motors or joint.name() in geared]
    else:  # what turns and is told to have none is a hand's: its tendon is moved
        driven = [j for j in driven if told.get(j.name(), True) or isinstance(j, PrismaticJoint)]
    hands = joint_tree.turning_fingers(driven, every, following)
    fingers = [joint for joint in driven if isinstance(joint, PrismaticJoint) and joint_tree.is_finger(joint, movable)]
    fingers += [joint for joint in driven if joint.name() in {*hands, *chain.from_iterable(hands.values())}]
    held = {int(joint.index()) for joint in fingers}
    links = [joint for joint in driven if int(joint.index()) not in held]
    arm = _by_name(spec.joints, movable, "joints") if spec.joints else joint_tree.from_the_base(links or driven, every)
    if not arm:
        raise ModelError(f"{spec.model}: has no revolute or prismatic joint")
    if spec.gripper_joints:
        gripper = _by_name(spec.gripper_joints, movable, "gripper_joints")
    else:
        beside = {int(joint.index()) for joint in held_joints.beside(arm, every)} if spec.joints else set()
        hand = (joint for joint in driven if isinstance(joint, PrismaticJoint) or joint.name() in hands)
        gripper = [joint for joint in hand if int(joint.index()) not in beside]
    in_arm = {int(joint.index()) for joint in arm}
    joint_tree.refuse_carried(spec.model, arm, every, following)
    return arm, [joint for joint in gripper if int(joint.index()) not in in_arm]


def _by_name(names: Sequence[str], movable: Sequence[Joint], field: str) -> list[Joint]:
    by_name: dict[str, Joint] = {}
    for joint in movable:
        by_name.setdefault(joint.name(), joint)
    for name in names:
        if name not in by_name:
            raise ModelError(f"{field}: the model has no joint {name!r}; its joints are {', '.join(by_name)}")
    if len(set(names)) != len(names):
        raise ModelError(f"{field}: a joint is named twice in {', '.join(names)}")
    return [by_name[name] for name in names]


def _weld_base(
    plant: MultibodyPlant, instances: Iterable[ModelInstanceIndex], first: Joint, spec: scenario.ArmModel
) -> RigidBody:
    """Weld the free root link; answer the root link."""
    to_child = {int(joint.child_body().index()): joint for joint in _joints(plant, instances)}
    world = int(plant.world_body().index())
    carriers = {child: int(joint.parent_body().index()) for child, joint in to_child.items()}

    def root_of(body: RigidBody) -> RigidBody:
        index = int(body.index())
        while carriers.get(index, world) != world:
            index = carriers[index]
        return plant.get_body(BodyIndex(index))

    roots = {
        int(root.index()): root
        for instance in instances
        for root in (root_of(plant.get_body(index)) for index in plant.GetBodyIndices(instance))
    }
    root = root_of(first.parent_body()) if int(first.parent_body().index()) != world else first.child_body()
    free = [
        body
        for body in roots.values()
        if int(body.index()) not in to_child or to_child[int(body.index())].num_velocities() == 6
    ]
    others = [body.name() for body in free if body.index() != root.index()]
    if others:
        roots_named = ", ".join([root.name(), *others])
        raise ModelError(f"{spec.model}: more than one root link: {roots_named}; give the arm in a file of its own")
    X_WB = pose(spec.X_WB)
    if not free:
        if not X_WB.IsNearlyIdentity(1e-12):
            raise ModelError(f"X_WB: {spec.model} fixes its base to the world itself; leave X_WB at identity")
        return root
    floating = to_child.get(int(root.index()))
    if floating is not None:
        plant.RemoveJoint(floating)
    plant.AddJoint(WeldJoint(f"{root.name()}_weld", plant.world_frame(), root.body_frame(), X_WB))
    return root
