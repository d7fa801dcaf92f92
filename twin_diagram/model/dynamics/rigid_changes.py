"""What effects change in the rigid model, put into the parameters of a plant's context."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.links import link_of
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.friction import CoulombFriction, ViscousFriction
from twin_diagram.model.effects.inertia import ReflectedInertia
from twin_diagram.model.effects.link_inertia import spatial_inertia
from twin_diagram.model.effects.rigid_change import RigidChange
from twin_diagram.model.rigid_body.rigid_tree import inertia_vector


def fold(plant: MultibodyPlant, context: Context, arm: Arm, changes: Iterable[RigidChange]) -> None:
    """Add links' inertias, rotors and dampers.

    Args:
        plant: holds the arm.
        context: whose parameters are changed.
        arm: its joints.
        changes: each is asked for once those before it are in.

    Raises:
        ModelError: more is taken away than there is.
    """
    rotors: dict[str, float] = {}
    dampers: dict[str, float] = {}
    prismatic = arm.prismatic(plant)
    for change in changes:
        for link, added in change.inertia.items():
            body = link_of(plant, arm, link)
            present = body.CalcSpatialInertiaInBodyFrame(context)
            whole = inertia_vector(present, RigidTransform()) + added
            body.SetSpatialInertiaInBodyFrame(context, spatial_inertia(whole))
        for name, reflected in change.rotor.items():
            rotors[name] = rotors.get(name, 0.0) + reflected
        for name, damping in change.damping.items():
            dampers[name] = dampers.get(name, 0.0) + damping
    for name, reflected in rotors.items():
        actuator = arm.actuator(plant, name)
        rotor = actuator.rotor_inertia(context) + reflected / actuator.gear_ratio(context) ** 2
        _check_whole(ReflectedInertia, "inertia", name, rotor, name in prismatic)
        actuator.SetRotorInertia(context, max(rotor, 0.0))
    for name, damping in dampers.items():
        joint = plant.get_joint(arm.joint_indices[arm.joints.index(name)])
        total: Any = joint.GetDampingVector(context) + damping
        _check_whole(ViscousFriction, "damping", name, float(total[0]), name in prismatic)
        joint.SetDampingVector(context, np.maximum(total, 0.0))


def check_friction(joints: Sequence[str], effects: Iterable[Effect], prismatic: Collection[str] = ()) -> None:
    """Check that dry friction is no less than none on every joint; `prismatic`: which joints are.

    Raises:
        ModelError: it is.
    """
    levels = np.zeros((2, len(joints)))
    for effect in effects:
        if isinstance(effect, CoulombFriction):
            levels += [effect.spread(joints, level) for level in effect.levels()]
    for name, level in zip(joints, np.min(levels, axis=0), strict=True):
        _check_whole(CoulombFriction, "torque", name, float(level), name in prismatic)


def _check_whole(effect: type[Effect], key: str, joint: str, value: float, prismatic: bool) -> None:
    """Refuse effects that take away more than the description and other effects state."""
    if value < -1e-9:
        said = f"{value:g} {effect.kinds[key].unit_on(prismatic)} in all on {joint}"
        raise ModelError(f"effects.{effect.name}.{key}: {said} is not within [0, inf]; take away no more than there is")
