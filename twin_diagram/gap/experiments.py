"""What to measure next where two names fit the data nearly as well."""

from __future__ import annotations

STATIC = "static poses: hold many poses over the whole range, each reached once from above and once from below"
SLOW = "reverse slowly at 0.02 rad/s, about many angles"
SPEEDS = "sweep each joint at constant speeds from 0.02 rad/s to its limit, both ways"
LOAD = "repeat with a known payload"
FAST = "accelerate hard about one pose: sines of small range at 1 to 4 Hz"
LONG = "repeat the same motion for some minutes"
STILL = "hold still for 10 s at the begin and at the end"

GRAVITY = {"payload", "inertial_parameters", "gravity_tilt", "encoder_offset", "joint_spring", "torque_bias"}
DRY = {"coulomb_friction", "stribeck_friction", "load_dependent_friction", "coupled_friction", "backlash"}
SPEED = {"viscous_friction", "coupled_friction", "stribeck_friction"}
DYNAMIC = {"reflected_inertia", "joint_elasticity", "time_delay", "inertial_parameters", "payload"}
MOTOR = {"torque_constant", "actuator_fault", "torque_saturation", "load_dependent_friction"}
TIMED = {"external_force", "actuator_fault"}


def experiment(a: str, b: str) -> str:
    """The experiment that would tell two names apart."""
    pair = {a, b}
    if a == b:
        return SLOW if a in DRY else FAST if a in DYNAMIC else STATIC
    if pair & TIMED:
        return STILL
    if pair <= DRY | SPEED:
        return LOAD if "load_dependent_friction" in pair else SPEEDS if pair & SPEED else SLOW
    if pair & MOTOR:
        return LOAD
    if pair <= GRAVITY:
        return STATIC
    if pair & DYNAMIC:
        return FAST
    if pair & DRY:
        return SLOW
    return STATIC if pair & GRAVITY else SPEEDS
