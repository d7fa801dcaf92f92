"""An effect's parameters as they are moved by identification: other values, one vector of them, its derivative."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import TypeVar

import numpy as np

from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.inertia import Payload, point_mass_jacobian
from twin_diagram.model.effects.parameter import Parameter
from twin_diagram.model.rigid_body import rigid_tree
from twin_diagram.model.rigid_body.arm_bodies import ArmBodies
from twin_diagram.signals.arrays import Array

Kind = TypeVar("Kind", bound=Effect)
"""An effect's class, which stays what it is."""


def with_values(effect: Kind, values: Mapping[str, Sequence[float] | Array], *, check: bool = True) -> Kind:
    """Return the same effect with other values of some parameters; bounds are checked unless told otherwise."""
    parameters = dict(effect.parameters)
    for key, value in values.items():
        where = f"effects.{effect.name}.{key}"
        value = Parameter.of(effect.kinds[key], value, where).value if check else np.array(value, dtype=float)
        parameters[key] = replace(parameters[key], value=value)
    result = copy.copy(effect)
    result.parameters = parameters
    if check:
        result.check()
    return result


def vector(effect: Effect) -> Array:
    """Return all parameters that are not frozen, one after the other."""
    free = [parameter.value for parameter in effect.parameters.values() if not parameter.frozen]
    return np.concatenate(free) if free else np.zeros(0)


def with_vector(effect: Kind, theta: Array, *, check: bool = True) -> Kind:
    """Return the same effect whose `vector` is `theta`."""
    values, start = {}, 0
    for key, parameter in effect.parameters.items():
        if not parameter.frozen:
            values[key] = theta[start : start + len(parameter.value)]
            start += len(parameter.value)
    return with_values(effect, values, check=check)


def numeric_sensitivity(effect: Effect, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
    """Return the derivative (N, n, p) of the logged torque with respect to `vector`, by central differences.

    Args:
        effect: of any class.
        bodies: of the arm that it sits on.
        q: (N, n) positions [rad].
        v: (N, n) velocities [rad/s].
        a: (N, n) accelerations [rad/s²].
        tau: (N, n) torque that the joints transmit [N·m].
    """
    theta = vector(effect)
    result = np.empty((*q.shape, len(theta)))
    for k, value in enumerate(theta):
        step = 1e-6 * max(1.0, abs(value))
        sides = []
        for sign in (1.0, -1.0):
            shifted = theta.copy()
            shifted[k] += sign * step
            changed = with_vector(effect, shifted, check=False)
            sides.append(changed.logged(bodies.joints, tau + changed.torque(bodies, q, v, a, tau)))
        result[..., k] = (sides[0] - sides[1]) / (2.0 * step)
    return result


sensitivity = singledispatch(numeric_sensitivity)
"""As `numeric_sensitivity`, in closed form for the classes that have one; a class of one's own may be registered."""


@sensitivity.register
def _(effect: Payload, bodies: ArmBodies, q: Array, v: Array, a: Array, tau: Array) -> Array:
    """Mass first, then the centre's x, y, z."""
    del tau
    body, X_ML = bodies.body_of(effect.link(bodies.last_link))
    jacobian = point_mass_jacobian(float(effect.value("mass")[0]), effect.value("com"))
    return bodies.tree.regressor(q, v, a, body) @ (rigid_tree.transform_inertia(X_ML) @ jacobian)
