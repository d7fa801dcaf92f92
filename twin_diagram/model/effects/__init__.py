"""The catalogue of effects: friction, inertia, transmission, actuation, environment.

Importing this package registers every effect that comes along; a user's own needs one class and `@register`.
"""

from __future__ import annotations

from twin_diagram.model.effects import (
    actuation,
    elasticity,
    environment,
    friction,
    friction_stribeck_load,
    inertia,
    link_inertia,
    sensing,
    torque_ripple,
    transmission,
)
from twin_diagram.model.effects.effect import REGISTRY, Effect, make, register
from twin_diagram.model.effects.parameter import Parameter, ParameterKind
from twin_diagram.model.effects.realisation import Brake, Fitting, RigidChange
from twin_diagram.model.effects.simulated.add_to_plant import Motors, add_to_plant, connect, measured_position, renewed

__all__ = [
    "REGISTRY",
    "Brake",
    "Effect",
    "Fitting",
    "Motors",
    "Parameter",
    "ParameterKind",
    "RigidChange",
    "actuation",
    "add_to_plant",
    "connect",
    "elasticity",
    "environment",
    "friction",
    "friction_stribeck_load",
    "inertia",
    "link_inertia",
    "make",
    "measured_position",
    "register",
    "renewed",
    "sensing",
    "torque_ripple",
    "transmission",
]
