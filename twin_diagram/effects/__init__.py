"""The catalogue of effects: friction, inertia, transmission, actuation, environment.

Importing this package registers every effect that comes along; a user's own needs one class and `@register`.
"""

from __future__ import annotations

from twin_diagram.effects import actuation, environment, friction, inertia, transmission
from twin_diagram.effects.effect import REGISTRY, Effect, make, register
from twin_diagram.effects.fitting import Brake, Fitting, RigidChange
from twin_diagram.effects.parameter import Parameter, ParameterKind
from twin_diagram.effects.realisation import Motors, add_to_plant, connect, measured_position

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
    "environment",
    "friction",
    "inertia",
    "make",
    "measured_position",
    "register",
    "transmission",
]
