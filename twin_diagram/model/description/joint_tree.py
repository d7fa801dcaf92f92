"""Which joints of a description carry which; what is no tree is refused before anybody walks along it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, JointIndex, ModelInstanceIndex, RevoluteJoint

from twin_diagram.errors import ModelError
from twin_diagram.model.description.unparsed import Following


def carriers(every: Sequence[Joint]) -> Callable[[Joint], list[Joint]]:
    """Return what answers the joints between one and the base, the nearest first.

    Args:
        every: joints of the robot, also those that are fixed; they form no loop.
    """
    to_child = {int(joint.child_body().index()): joint for joint in every}

    def above(joint: Joint) -> list[Joint]:
        found: list[Joint] = []
        while int(joint.parent_body().index()) in to_child:
            joint = to_child[int(joint.parent_body().index())]
            found.append(joint)
        return found

    return above


def from_the_base(joints: list[Joint], every: Sequence[Joint]) -> list[Joint]:
    """Return joints from the base on where they are one chain, however the file lists them, else as they are."""
    above = carriers(every)
    wanted = {int(joint.index()) for joint in joints}
    depths = [sum(int(each.index()) in wanted for each in above(joint)) for joint in joints]
    if sorted(depths) != list(range(len(joints))):
        return joints
    return [joints[k] for k in np.argsort(depths)]


def unbranched(plant: MultibodyPlant, joints: Sequence[JointIndex]) -> list[list[str]]:
    """Return the names of joints in runs in which each carries the next one and no other, the longest first.

    Args:
        plant: that holds them.
        joints: of a robot; what is fixed, or not among them, parts no run.
    """
    above = carriers([plant.get_joint(index) for index in plant.GetJointIndices()])
    own = {int(index): plant.get_joint(index) for index in joints}
    carrier = {k: next((c for j in above(joint) if (c := int(j.index())) in own), -1) for k, joint in own.items()}
    carried = {k: [other for other, by in carrier.items() if by == k] for k in own}
    runs = []
    for k, by in carrier.items():
        if by >= 0 and len(carried[by]) == 1:
            continue
        run = [k]
        while len(carried[run[-1]]) == 1:
            run += carried[run[-1]]
        runs.append([own[each].name() for each in run])
    return sorted(runs, key=len, reverse=True)


def refuse_loops(path: str, every: Sequence[Joint]) -> None:
    """Raise ModelError where joints form a closed loop, as those of parallel linkages do.

    Args:
        path: of the description.
        every: its joints, also those that are fixed.
    """
    to_child: dict[int, Joint] = {}
    for joint in every:
        other = to_child.setdefault(int(joint.child_body().index()), joint)
        if other is not joint:
            _refuse(path, f"{other.name()!r} and {joint.name()!r} both move link {joint.child_body().name()!r}")
    rooted: set[int] = set()
    for joint in every:
        passed: list[int] = []
        body = joint.child_body()
        while int(body.index()) in to_child and int(body.index()) not in rooted:
            if int(body.index()) in passed:
                _refuse(path, f"link {body.name()!r} carries itself")
            passed.append(int(body.index()))
            body = to_child[int(body.index())].parent_body()
        rooted.update(passed)


def _refuse(path: str, what: str) -> None:
    raise ModelError(
        f"{path}: the joints form a closed loop: {what}; such a robot is not modelled: leave one joint out"
    )


def refuse_alike(
    path: str, plant: MultibodyPlant, instances: Iterable[ModelInstanceIndex], arm: Sequence[Joint]
) -> None:
    """Raise ModelError where a joint of an arm has a namesake in another model: names tell them apart.

    Args:
        path: of the description.
        plant: that holds it.
        instances: the models that it adds.
        arm: joints of the arm.
    """
    for name in (joint.name() for joint in arm):
        models = [plant.GetModelInstanceName(instance) for instance in instances if plant.HasJointNamed(name, instance)]
        if len(models) > 1:
            raise ModelError(
                f"{path}: joint {name!r} is in {' and in '.join(models)}: names must tell a robot's arms apart; "
                "give one arm's own description (X_WB: where its base stands)"
            )


def refuse_carried(
    place: str, arm: Sequence[Joint], every: Sequence[Joint], following: Mapping[str, Following]
) -> None:
    """Raise ModelError where a joint that follows one of an arm's carries another: it would be held where it is.

    Args:
        place: the description.
        arm: its joints.
        every: joints of the robot, also those that are fixed.
        following: of each joint that follows another one, how.
    """
    above = carriers(every)
    own = {joint.name() for joint in arm}
    for joint in arm:
        for name in (each.name() for each in above(joint)):
            if name not in own and name in following and following[name].leader in own:
                raise ModelError(
                    f"{place}: joint {name!r} follows {following[name].leader!r} and carries {joint.name()!r}; "
                    "such an arm is not modelled. If these are a gripper's, name the arm's own joints (--joints, "
                    "twin.arm.joints), else name it, too, as one that is driven"
                )


def is_finger(joint: Joint, movable: Sequence[Joint]) -> bool:
    """Return whether a prismatic joint is a finger's: they come in pairs and carry nothing.

    An arm's come one by one.
    """
    beside = [other for other in movable if other.parent_body().index() == joint.parent_body().index()]
    beyond = [other for other in movable if other.parent_body().index() == joint.child_body().index()]
    return len(beside) > 1 and not beyond


def turning_fingers(
    driven: Sequence[Joint], every: Sequence[Joint], following: Mapping[str, Following]
) -> dict[str, list[str]]:
    """Return a hand's revolute joints by name: each carries none but followers, and others on the same palm follow it.

    Args:
        driven: joints with a motor.
        every: joints of the robot, also those that are fixed.
        following: of each joint that follows another one, how.

    Returns:
        By the name of each its followers' names, also of those with a motor of their own.
    """
    above = carriers(every)
    carrying = {int(each.index()) for joint in driven if joint.name() not in following for each in above(joint)}
    found: dict[str, list[str]] = {}
    for joint in driven:
        own, palm = int(joint.index()), int(joint.parent_body().index())
        if not isinstance(joint, RevoluteJoint) or own in carrying:
            continue
        led = [each for each in every if each.name() in following and following[each.name()].leader == joint.name()]
        chains = [[each, *above(each)] for each in led]
        beside = [chain for chain in chains if own not in {int(each.index()) for each in chain}]
        if any(int(each.parent_body().index()) == palm for chain in beside for each in chain):
            found[joint.name()] = [each.name() for each in led]
    return found
