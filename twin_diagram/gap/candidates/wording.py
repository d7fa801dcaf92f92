"""What the sentences about effects are made of: values in their joints' own units."""

from __future__ import annotations

from twin_diagram.model.effects import Effect


def effort(effect: Effect) -> str:
    """Return what the motors of an effect's joints give: a torque, or a force where all of them are prismatic."""
    turning = set(effect.joints) - effect.prismatic
    return "torque or force" if effect.prismatic and turning else "force" if effect.prismatic else "torque"


def values_on_joints(effect: Effect, key: str) -> str:
    """Return a parameter's value on each joint of an effect, each in the joint's own unit."""
    values = zip(effect.joints, effect.value(key), strict=True)
    return ", ".join(f"{x:.4g} {effect.unit(key, joint)} on {joint}" for joint, x in values)


def name_and_place(effect: Effect) -> str:
    """Return what can be said of any effect: its name, its joints or links."""
    return f"{effect.name.replace('_', ' ')} on {', '.join(effect.joints or effect.links)}"
