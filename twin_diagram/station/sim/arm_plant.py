"""The true arm inside the world's plant: description, hidden effects and the motors of its driver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PdControllerGains

from twin_diagram.errors import ModelError, ScenarioError
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description.finger_travel import turns
from twin_diagram.model.description.followers import couple
from twin_diagram.model.effects import Effect, add_to_plant, renewed
from twin_diagram.scenario import Driver, Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.linkage import Linkage, levers, linkage_of


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    finger_stiffness: float = 2000.0
    """Of a finger's own controller [N/m]; of a joint that turns by the square of its lever more, as if it slid."""

    finger_damping: float = 110.0
    """[N·s/m]: critical with `finger_mass`."""

    finger_mass: float = 1.5
    """What a finger's motor and gear add to its mass, where the description says nothing of it [kg]: a spindle of 3 mm
    lead on a rotor of 3.4e-7 kg·m². Drake's solver smooths friction the more, the lighter what is pressed: between
    bare fingers of 30 g a box that is held 2 cm off its centre turns by 0.4° a second, with this by 0.06°."""


TUNING = Tuning()


@dataclass(frozen=True)
class ArmPlant:
    """The arm's part of the world's plant.

    Attributes:
        arm: indices in the plant.
        effects: that are realised in the plant, those among them that the twin was not told of included.
        joints: the n arm joints.
        fingers: the g finger joints.
        stiffness, damping: of the motors' controllers: n arm joints, then the fingers that have a motor.
        driven: places of the fingers with a motor among all g.
        q0: (n + g,) positions at the start [rad, m].
        linkage: of a gripper whose joints turn; None: they slide.
    """

    arm: description.Arm
    effects: tuple[Effect, ...]
    joints: list[Joint]
    fingers: list[Joint]
    stiffness: Array
    damping: Array
    driven: list[int]
    q0: Array
    linkage: Linkage | None = None


def driver_gains(driver: Driver, effort_limits: Array) -> tuple[Array, Array]:
    """Return stiffness [N·m/rad] and damping [N·m·s/rad] of the arm's own controller.

    Where the scenario gives none: 600 for the first four joints and 250 for the rest, which suit joints of 87 and
    12 N·m, scaled to this arm's limits; damping twice the square root of stiffness.

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
    """Return where the arm stands at the start: ``world.q0``, else ``twin.home``, else zeros (n,) [rad].

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
    """Add the true arm, its hidden effects and its driver's motors.

    Raises:
        ScenarioError: the model, a joint or an effect cannot be; it names the field.
    """
    try:
        arm = description.add_arm(plant, scenario.world.arm, scenario.packages)
        effects = add_to_plant(plant, arm)
        arm = renewed(plant, arm)
        if plant.num_constraints() == 0:  # of a URDF Drake has read what follows what
            couple(plant, arm)
        linkage = linkage_of(scenario.world.arm, scenario.packages) if turns(plant, arm) else None
    except ModelError as error:
        raise description.scenario_error("world.arm", error) from error
    joints = [plant.get_joint(index) for index in arm.joint_indices]
    fingers = [plant.get_joint(index) for index in arm.gripper_joint_indices]
    motors = [plant.get_joint_actuator(index) for index in (*arm.actuator_indices, *arm.gripper_actuator_indices)]
    limits = np.array([motor.effort_limit() for motor in motors[: len(joints)]])
    stiffness, damping = driver_gains(scenario.twin.driver, limits)
    more = len(motors) - len(joints)
    with_motor = {int(motor.joint().index()) for motor in motors}
    driven = [k for k, finger in enumerate(fingers) if int(finger.index()) in with_motor]
    described = np.array([finger.default_positions()[0] for finger in fingers])
    slopes = np.ones(more) * levers(linkage, described, driven)
    stiffness = np.concatenate([stiffness, slopes**2 * TUNING.finger_stiffness])
    damping = np.concatenate([damping, slopes**2 * TUNING.finger_damping])
    for motor, p, d in zip(motors, stiffness, damping, strict=True):
        motor.set_controller_gains(PdControllerGains(p=p, d=d))
    for motor, lever in zip(motors[len(joints) :], slopes, strict=True):
        if motor.default_rotor_inertia() * motor.default_gear_ratio() ** 2 == 0.0:
            motor.set_default_rotor_inertia(float(lever**2 * TUNING.finger_mass))
            motor.set_default_gear_ratio(1.0)
    angles = initial_angles(scenario, len(joints))
    for joint, angle in zip(joints, angles, strict=True):
        joint.set_default_positions([angle])
    q0 = np.concatenate([angles, described])
    return ArmPlant(arm, effects, joints, fingers, stiffness, damping, driven, q0, linkage)
