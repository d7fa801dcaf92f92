"""What to measure next where two names fit the data nearly as well."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from twin_diagram.gap.findings import Separation
from twin_diagram.signals import units

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
    """Return the experiment that would tell two names apart."""
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


def worded(text: str, joints: Sequence[str], prismatic: Collection[str]) -> str:
    """Return an experiment's sentence as it is said of some joints: speeds and places of prismatic ones are m/s and m.

    Args:
        text: of this module.
        joints: that it is about.
        prismatic: which of the arm's joints are.
    """
    slide = [joint in prismatic for joint in joints]
    if not any(slide):
        return text
    for turning, other in ((units.SPEED, units.on_joint(units.SPEED)), ("angles", "positions")):
        text = text.replace(turning, other if all(slide) else f"{turning} or {other}")
    return text


def asked(pair: Separation, joints: Sequence[str], prismatic: Collection[str]) -> str:
    """Return the experiment of a near pair, worded for the joints that the pair names, or for all of the arm's."""
    places = {place for claim in (pair.a, pair.b) for place in claim.partition(" on ")[2].split(", ")}
    return worded(pair.experiment, [joint for joint in joints if joint in places] or joints, prismatic)
