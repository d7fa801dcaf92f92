"""The true arm inside the world's plant: description, hidden effects and the motors of its driver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Joint,
    JointActuator,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
)

from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.scenario import ArmModel, Driver, Scenario
from twin_diagram.signals import Array
from twin_diagram.station.parsing import actuator_of, add_model, joints_of, transform, weld_roots

FINGER_STIFFNESS = 2000.0
"""Of a finger's own controller [N/m]."""
FINGER_DAMPING = 80.0
"""[N·s/m]"""


@dataclass(frozen=True)
class ArmPlant:
    """The arm's part of the world's plant.

    Attributes:
        instance: its model instance.
        joints: the n arm joints.
        fingers: the g finger joints.
        motors: actuators of the arm's, then the fingers' joints, (n + g).
        stiffness, damping: of those actuators' controllers (n + g).
        root_bodies: bodies welded to the world.
        q0: (n,) joint angles at the start [rad].
    """

    instance: ModelInstanceIndex
    joints: list[Joint]
    fingers: list[Joint]
    motors: list[JointActuator]
    stiffness: Array
    damping: Array
    root_bodies: list[RigidBody]
    q0: Array


def select_joints(plant: MultibodyPlant, instance: ModelInstanceIndex, spec: ArmModel, field: str) -> tuple[list[Joint], list[Joint]]:
    """Arm joints and finger joints as the scenario names them; where it names none, what is actuated.

    Raises:
        ScenarioError: a name that is not in the model.
    """
    every = {joint.name(): joint for joint in joints_of(plant, [instance])}
    actuated = [joint for joint in every.values() if actuator_of(plant, joint) is not None]

    def named(names: list[str], key: str, kind: type[Joint]) -> list[Joint]:
        if not names:
            return [joint for joint in actuated if isinstance(joint, kind)]
        for name in names:
            if name not in every:
                raise ScenarioError(f"{field}.{key}", f"no joint {name!r} in the model; it has {', '.join(every)}")
        return [every[name] for name in names]

    joints = named(spec.joints, "joints", RevoluteJoint)
    fingers = named(spec.gripper_joints, "gripper_joints", PrismaticJoint)
    fingers = [finger for finger in fingers if finger.name() not in {joint.name() for joint in joints}]
    if not joints:
        raise ScenarioError(f"{field}.joints", "no actuated revolute joint in the model; name the arm's joints")
    return joints, fingers


def driver_gains(driver: Driver, effort_limits: Array) -> tuple[Array, Array]:
    """Stiffness [N·m/rad] and damping [N·m·s/rad] of the arm's own controller.

    Where the scenario gives none: 600 for the first four joints and 250 for the rest, which suit joints of 87 and 12 N·m,
    scaled to this arm's limits; damping twice the square root of stiffness.

    Args:
        driver: of the scenario.
        effort_limits: (n,) [N·m]; infinite where the model gives none.

    Raises:
        ScenarioError: not one number per joint, or not positive.
    """
    n = len(effort_limits)
    first = np.arange(n) < 4
    scale = np.where(np.isfinite(effort_limits) & (effort_limits > 0), effort_limits / np.where(first, 87.0, 12.0), 1.0)
    stiffness = np.where(first, 600.0, 250.0) * scale
    for name, values in (("stiffness", driver.stiffness), ("damping", driver.damping)):
        if values and (len(values) != n or not np.all(np.array(values) >= 0)):
            raise ScenarioError(f"twin.driver.{name}", f"{values} is not one number >= 0 for each of {n} joints")
    if driver.stiffness:
        stiffness = np.array(driver.stiffness, dtype=float)
    damping = np.array(driver.damping, dtype=float) if driver.damping else 2.0 * np.sqrt(stiffness)
    return stiffness, damping


def initial_angles(scenario: Scenario, n: int) -> Array:
    """Where the arm stands at the start: ``world.q0``, else ``twin.home``, else zeros (n,) [rad].

    Raises:
        ScenarioError: not as many numbers as joints.
    """
    for name, values in (("world.q0", scenario.world.q0), ("twin.home", scenario.twin.home)):
        if values:
            if len(values) != n:
                raise ScenarioError(name, f"{len(values)} numbers for {n} joints")
            return np.array(values, dtype=float)
    return np.zeros(n)


def add_arm(plant: MultibodyPlant, scenario: Scenario) -> ArmPlant:
    """Adds the true arm, its hidden effects and its driver's motors.

    Raises:
        ScenarioError: the model or a joint is missing; it names the field.
    """
    spec = scenario.world.arm
    try:
        instances = add_model(plant, spec.model, scenario.packages)
    except ModelError as error:
        raise ScenarioError("world.arm.model", str(error)) from error
    if len(instances) != 1:
        raise ScenarioError("world.arm.model", f"{spec.model} holds {len(instances)} models; an arm and its gripper are one")
    roots = weld_roots(plant, instances, transform(spec.X_WB, "world.arm.X_WB"))
    joints, fingers = select_joints(plant, instances[0], spec, "world.arm")
    motors: list[JointActuator] = []
    for joint in [*joints, *fingers]:
        motors.append(actuator_of(plant, joint) or plant.AddJointActuator(f"{joint.name()}_motor", joint))
    limits = np.array([motor.effort_limit() for motor in motors[: len(joints)]])
    stiffness, damping = driver_gains(scenario.twin.driver, limits)
    stiffness = np.concatenate([stiffness, np.full(len(fingers), FINGER_STIFFNESS)])
    damping = np.concatenate([damping, np.full(len(fingers), FINGER_DAMPING)])
    for motor, p, d in zip(motors, stiffness, damping, strict=True):
        motor.set_controller_gains(PdControllerGains(p=p, d=d))
    q0 = initial_angles(scenario, len(joints))
    for joint, angle in zip(joints, q0, strict=True):
        joint.set_default_positions([angle])
    return ArmPlant(instances[0], joints, fingers, motors, stiffness, damping, roots, q0)
