"""The effects that an arm's own description states, which Drake's parsers leave unread."""

from __future__ import annotations

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.serialisation import effect_of
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.scenario import EffectSpec


def stated_effects(arm: Arm) -> list[Effect]:
    """Return dry friction and springs of an arm's description, marked as given.

    Raises:
        ModelError: a value that is not physical.
    """
    result = []
    if arm.stated.friction:
        levels = {"torque": [*arm.stated.friction.values()]}
        result.append(effect_of(CoulombFriction, EffectSpec(CoulombFriction.name, [*arm.stated.friction], [], levels)))
    if arm.stated.springs:
        stiffness, rest = zip(*arm.stated.springs.values(), strict=True)
        values = {"stiffness": [*stiffness], "rest_angle": [*rest]}
        result.append(effect_of(JointSpring, EffectSpec(JointSpring.name, [*arm.stated.springs], [], values)))
    for effect in result:
        effect.given = True
    return result
