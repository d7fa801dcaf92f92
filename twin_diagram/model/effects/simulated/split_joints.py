"""Yielding gears in a plant: a rotor body with a joint of its own between motor and link."""

from __future__ import annotations

import math

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, RevoluteJoint, SpatialInertia

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.elasticity import Gear, YieldingGear
from twin_diagram.model.effects.simulated.realisation import Realisation, realises


@realises(YieldingGear)
class SplitJoints(Realisation[YieldingGear]):
    """Each joint replaced by the motor's and the gear's."""

    replaces_joints = True
    changes_plant = True

    def before_finalize(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Put a rotor without mass between the joint's two links; its inertia is the motor's reflected one."""
        gears = self.effect.gears()
        for name, inertia in zip(self.effect.joints, self.effect.value("rotor_inertia"), strict=True):
            _split(plant, arm, name, gears[name], float(inertia))


def _split(plant: MultibodyPlant, arm: Arm, name: str, gear: Gear, inertia: float) -> None:
    """Replace a joint by one of the same name for the motor and a second one, `<name>_twist`, for the gear."""
    joint = plant.GetJointByName(name, arm.instances[0]) if len(arm.instances) == 1 else plant.GetJointByName(name)
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    own = [actuator for actuator in actuators if actuator.joint().index() == joint.index()]
    if len(own) != 1 or not isinstance(joint, (RevoluteJoint, PrismaticJoint)):
        raise ModelError(f"effects: {name} has {len(own)} actuators; one joint yields in one place only")
    motor = own[0]
    kept = (motor.name(), motor.effort_limit(), motor.default_rotor_inertia(), motor.default_gear_ratio())
    gains = motor.get_controller_gains() if motor.has_controller() else None
    on_parent, on_child, child = joint.frame_on_parent(), joint.frame_on_child(), joint.child_body()
    kind = type(joint)
    # Copies: what these answer is a part of the joint, which goes.
    axis = (joint.revolute_axis() if isinstance(joint, RevoluteJoint) else joint.translation_axis()).copy()
    lower, upper = joint.position_lower_limits().copy(), joint.position_upper_limits().copy()
    speeds = joint.velocity_lower_limits().copy(), joint.velocity_upper_limits().copy()
    damping, start = joint.default_damping_vector().copy(), joint.default_positions().copy()
    plant.RemoveJointActuator(motor)
    plant.RemoveJoint(joint)
    rotor = plant.AddRigidBody(f"{name}_rotor", child.model_instance(), SpatialInertia.Zero())
    first = plant.AddJoint(kind(name, on_parent, rotor.body_frame(), axis, float(damping[0])))
    first.set_position_limits(lower, upper)
    first.set_velocity_limits(*speeds)
    first.set_default_positions(start)
    second = plant.AddJoint(kind(f"{name}_twist", rotor.body_frame(), on_child, axis))
    again = plant.AddJointActuator(kept[0], first, kept[1])
    again.set_default_rotor_inertia(kept[2] + inertia / kept[3] ** 2)
    again.set_default_gear_ratio(kept[3])
    if gains is not None:
        again.set_controller_gains(gains)
    if math.isfinite(gear.stiffness):
        spring = plant.AddJointActuator(f"{name}_gear", second)
        spring.set_controller_gains(PdControllerGains(p=gear.stiffness, d=gear.loss * gear.stiffness))
    else:
        half: list[float] = [0.5 * gear.gap]
        second.set_position_limits([-half[0]], half)
