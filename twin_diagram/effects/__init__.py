"""The catalogue of effects: friction, inertia, transmission, actuation, environment.

Importing this package registers every effect that comes along; a user's own needs one class and `@register`.
"""

from __future__ import annotations

from twin_diagram.effects.effect import REGISTRY, Effect, Parameter, ParameterKind, RigidChange, make, register

__all__ = ["REGISTRY", "Effect", "Parameter", "ParameterKind", "RigidChange", "make", "register"]
