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
    ripple,
    sensing,
    transmission,
)
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.parameter import Parameter, ParameterKind
from twin_diagram.model.effects.rigid_change import RigidChange
from twin_diagram.model.effects.serialisation import REGISTRY, make, register, spec_of
from twin_diagram.model.effects.simulated.add_to_plant import Motors, add_to_plant, connect, measured_position, renewed
from twin_diagram.model.effects.simulated.realisation import Brake, Fitting, Realisation, realisation, realises
from twin_diagram.model.effects.timing import Interval

__all__ = [
    "REGISTRY",
    "Brake",
    "Effect",
    "Fitting",
    "Interval",
    "Motors",
    "Parameter",
    "ParameterKind",
    "Realisation",
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
    "realisation",
    "realises",
    "register",
    "renewed",
    "ripple",
    "sensing",
    "spec_of",
    "transmission",
]
