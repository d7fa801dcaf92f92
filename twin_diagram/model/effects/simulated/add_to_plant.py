"""Effects in a simulator: how a station puts them into its plant, and how it then drives the arm's motors.

    arm = add_arm(plant, spec, packages)
    fitted = add_to_plant(plant, arm)            # before Finalize: bodies, dampers, brakes, springs
    plant.Finalize()
    motors = connect(builder, plant, arm, fitted)
    builder.Connect(controller, motors.torque)   # (n) in the arm's order, whatever actuators the effects added

Brakes and springs are further actuators of the arm's model instances, so a station never connects an actuation or
desired-state port of those instances itself: `connect` does, and offers the motors alone. Controller gains of the
motors are set before `connect`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex
from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.named_places import check_places
from twin_diagram.model.effects.serialisation import effect_of, make
from twin_diagram.model.effects.simulated.external_force import Push, pushing
from twin_diagram.model.effects.simulated.motor_drive import Drive
from twin_diagram.model.effects.simulated.realisation import Realisation, realisations
from twin_diagram.model.effects.stated import stated_effects
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    least: float = 1e-9
    """Friction below zero by less than this is rounding [N·m]."""


TUNING = Tuning()


def add_to_plant(
    plant: MultibodyPlant, arm: Arm, effects: Iterable[Effect | EffectSpec] | None = None
) -> tuple[Effect, ...]:
    """Realise effects in a discrete plant that is not finalized.

    Args:
        plant: holds the arm.
        arm: as `add_arm.add_arm` gave it.
        effects: which; None: those that the description states and those of the arm's spec.

    Returns:
        The effects, for `connect`. Where one replaces joints (elastic gears), those of `arm` are gone: go on with
        `renewed(plant, arm)`.

    Raises:
        ModelError: an effect names a joint or link that is not there; it starts or ends, and a plant cannot change it
            during a run; or it does so before the run.
    """
    own: list[Effect | EffectSpec] = [*stated_effects(arm), *arm.spec.effects]
    chosen = own if effects is None else effects
    each = [make(effect) if isinstance(effect, EffectSpec) else effect for effect in chosen]
    check_places(plant, arm, each)
    made = tuple(lessened(each, arm.prismatic(plant)))
    realised = realisations(made)
    for effect in realised:
        _check_times(effect)
    for effect in sorted(realised, key=lambda each: not each.replaces_joints):
        effect.before_finalize(plant, renewed(plant, arm))
    _keep_rotors(plant, renewed(plant, arm))
    return made


def _check_times(realised: Realisation[Effect]) -> None:
    """Raise ModelError where an effect's onset or end cannot be those of a run, which begins at 0 s."""
    when, name = realised.effect.when, realised.effect.name
    key = "onset" if when.onset is not None else "end"
    if when.timed and realised.changes_plant:
        raise ModelError(
            f"effects.{name}.{key}: a simulator cannot start or end it during a run; leave `onset` and `end` out"
        )
    if when.onset is not None and when.onset < 0.0:
        raise ModelError(
            f"effects.{name}.onset: {when.onset:g} s is before the run, which begins at 0 s; leave `onset` out for "
            "what was there before"
        )
    if when.end is not None and when.end <= 0.0:
        raise ModelError(f"effects.{name}.end: at {when.end:g} s the run has not begun; leave the effect out")


def lessened(effects: Sequence[Effect], prismatic: Collection[str] = ()) -> list[Effect]:
    """Return the effects of which one takes away from another made one: a brake cannot push.

    Args:
        effects: of one arm.
        prismatic: which of its joints are.

    Raises:
        ModelError: it starts or ends, or takes away more than there is.
    """
    dry = [effect for effect in effects if isinstance(effect, CoulombFriction)]
    if not any(np.min(effect.levels()) < 0.0 for effect in dry):
        return list(effects)
    if any(effect.when.timed for effect in dry):
        raise ModelError(
            f"effects.{CoulombFriction.name}.onset: a simulator cannot let friction become less during a run"
        )
    joints = sorted({joint for effect in dry for joint in effect.joints})
    levels = np.sum([[effect.spread(joints, level) for level in effect.levels()] for effect in dry], axis=0)
    parameters = {"torque_positive": levels[0].tolist(), "torque_negative": levels[1].tolist()}
    if np.min(levels) < -TUNING.least:
        joint = joints[int(np.argmin(np.min(levels, axis=0)))]
        unit = dry[0].kinds["torque"].unit_on(joint in prismatic)
        said = f"{np.min(levels):g} {unit} in all is not within [0, inf]"
        raise ModelError(f"effects.{CoulombFriction.name}.torque: {said}")
    left = {key: np.maximum(level, 0.0).tolist() for key, level in parameters.items()}
    whole = effect_of(CoulombFriction, EffectSpec(CoulombFriction.name, joints, [], left))
    return [*(effect for effect in effects if effect not in dry), whole]


def _keep_rotors(plant: MultibodyPlant, arm: Arm) -> None:
    """Hand each motor's rotor inertia on to the joint's last actuator: a plant takes that one's for the joint's."""
    last = {}
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        last[int(actuator.joint().index())] = actuator
    for index in arm.actuator_indices:
        motor = plant.get_joint_actuator(index)
        other = last[int(motor.joint().index())]
        if other.index() != index:
            other.set_default_rotor_inertia(motor.default_reflected_inertia() / other.default_gear_ratio() ** 2)
            motor.set_default_rotor_inertia(0.0)


def renewed(plant: MultibodyPlant, arm: Arm) -> Arm:
    """Return the same arm where joints were replaced by others of the same names, and motors likewise."""
    present = {int(index) for index in plant.GetJointIndices()}
    if all(int(index) in present for index in arm.joint_indices):
        return arm
    instance = plant.get_body(arm.base).model_instance()
    joints = [plant.GetJointByName(name, instance) for name in arm.joints]
    motors: dict[int, JointActuatorIndex] = {}
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        motors.setdefault(int(actuator.joint().index()), actuator.index())  # fittings come later
    fingers = [motors[int(index)] for index in arm.gripper_joint_indices if int(index) in motors]
    return replace(
        arm,
        joint_indices=tuple(joint.index() for joint in joints),
        actuator_indices=tuple(motors[int(joint.index())] for joint in joints),
        gripper_actuator_indices=tuple(fingers),
    )


def measured_position(effects: Sequence[Effect], joints: Sequence[str], q: Array) -> Array:
    """Return what the encoders read (…, n) at true positions `q`; stations pass their positions through it."""
    for effect in reversed(effects):
        q = effect.measured_position(joints, q)
    return q


@dataclass(frozen=True)
class Motors:
    """The ports by which a station drives its arm; all in the orders of `Arm.joints` and `Arm.gripper_joints`.

    Attributes:
        torque: (n) feed-forward torque, as it is logged [N·m]. May stay unconnected: zero.
        desired_state: (2n) positions as measured and velocities, for motors with controller gains. May stay unconnected
            where none has: zero.
        gripper_torque: (g), likewise [N].
        gripper_desired_state: (2g), likewise.
        torque_logged: (n) what the motors' log shows of the plant's last step: feed-forward and controller, without the
            effects' own actuators [N·m].
        gripper_torque_logged: (g).
    """

    torque: InputPort
    desired_state: InputPort
    gripper_torque: InputPort
    gripper_desired_state: InputPort
    torque_logged: OutputPort
    gripper_torque_logged: OutputPort


def connect(builder: DiagramBuilder, plant: MultibodyPlant, arm: Arm, effects: Sequence[Effect]) -> Motors:
    """Wire the actuators of the arm's model instances; call it once, after Finalize, with the plant in the builder.

    Gains and limits of the motors may be changed by it: a motor that gives another torque than is logged.
    """
    arm = renewed(plant, arm)
    realised = realisations(effects)
    _keep_from_touching(builder, plant, [each.effect for each in realised if each.replaces_joints])
    for each in realised:
        each.after_finalize(plant, arm)
    model = plant.GetModelInstanceName(plant.get_joint(arm.joint_indices[0]).model_instance())
    drive = builder.AddNamedSystem(f"{model}_drive", Drive(plant, arm, effects))
    builder.Connect(plant.get_state_output_port(), drive.GetInputPort("state"))
    if pushing(effects):
        push = builder.AddNamedSystem(f"{model}_push", Push(plant, arm, effects))
        builder.Connect(plant.get_state_output_port(), push.get_input_port())
        builder.Connect(push.get_output_port(), plant.get_applied_spatial_force_input_port())
    for instance in arm.instances:
        if plant.num_actuators(instance) > 0:
            name = plant.GetModelInstanceName(instance)
            builder.Connect(drive.GetOutputPort(f"actuation.{name}"), plant.get_actuation_input_port(instance))
            builder.Connect(drive.GetOutputPort(f"desired_state.{name}"), plant.get_desired_state_input_port(instance))
    return Motors(
        drive.GetInputPort("torque"),
        drive.GetInputPort("desired_state"),
        drive.GetInputPort("gripper_torque"),
        drive.GetInputPort("gripper_desired_state"),
        drive.GetOutputPort("torque_logged"),
        drive.GetOutputPort("gripper_torque_logged"),
    )


def _keep_from_touching(builder: DiagramBuilder, plant: MultibodyPlant, splitting: Sequence[Effect]) -> None:
    """Let links on both sides of a split joint overlap there, as those of a whole joint may."""
    source = plant.get_source_id()
    names = [name for effect in splitting for name in effect.joints]
    for system in builder.GetSystems() if names and source is not None else []:
        if isinstance(system, SceneGraph) and system.model_inspector().SourceIsRegistered(source):
            for name in names:
                sides = (plant.GetJointByName(name).parent_body(), plant.GetJointByName(f"{name}_twist").child_body())
                both = [GeometrySet(plant.GetCollisionGeometriesForBody(body)) for body in sides]
                system.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeBetween(*both))
