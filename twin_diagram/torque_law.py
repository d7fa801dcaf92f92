"""What reaches an arm's joints: the rigid bodies' torque and every effect's law, for many samples at once.

Functions of a `Model`, which offers them as its methods; positions are true ones here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from twin_diagram.effects.friction import smooth_sign
from twin_diagram.timeline import shifted

if TYPE_CHECKING:
    from twin_diagram.model import Model

Array = npt.NDArray[np.float64]

FEW = 24
"""Up to this many samples a call per sample into the plant is quicker than the vectorised tree."""


def rigid(model: Model, q: Array, v: Array, a: Array) -> Array:
    """(…, n) without the effects that are laws of their own."""
    if q.ndim == 1:
        return model.calls.inverse_dynamics(q, v, a)
    flat = (-1, q.shape[-1])
    q, v, a, shape = q.reshape(flat), v.reshape(flat), a.reshape(flat), q.shape
    if model.vectorises and len(q) > FEW:
        return model.tree.inverse_dynamics(q, v, a).reshape(shape)
    return np.array([model.calls.inverse_dynamics(*sample) for sample in zip(q, v, a, strict=True)]).reshape(shape)


def joint_load(model: Model, q: Array, v: Array, a: Array, tau: Array | None = None) -> Array:
    """See `Model.joint_load`."""
    bodies = rigid(model, q, v, a)
    if not model.laws:
        return bodies
    flat = (-1, q.shape[-1])
    total: Array = bodies.reshape(flat)
    motion = (q.reshape(flat), v.reshape(flat), a.reshape(flat))
    for effect in model.laws:
        if not effect.dry:
            total = total + effect.torque(model, *motion, total)
    transmitted = total if tau is None else np.reshape(tau, flat)
    for effect in model.dry:
        total = total + effect.torque(model, *motion, transmitted)
    return total.reshape(q.shape)


def link_load(model: Model, q: Array, v: Array, a: Array) -> Array:
    """See `Model.link_load`."""
    tree = replace(model.tree, rotor=np.zeros_like(model.tree.rotor), damping=np.zeros_like(model.tree.damping))
    total = tree.inverse_dynamics(q, v, a)
    for effect in model.laws:
        if not effect.motor_side:
            total = total + effect.torque(model, q, v, a, total)
    return total


def mass_and_load(model: Model, q: Array, v: Array, tau: Array, *, dry: bool = True) -> tuple[Array, Array]:
    """See `Model.mass_and_load`."""
    if model.vectorises:
        mass, load = model.tree.mass_and_bias(q, v)
    else:
        mass = np.array([model.calls.mass(x) for x in q])
        load = rigid(model, q, v, np.zeros_like(q))
    a = np.zeros_like(q)
    for effect in model.laws:
        if not effect.dry:
            load = load + effect.torque(model, q, v, a, tau)
    if dry and model.dry:
        forward, backward = friction_level(model, q, v, tau)
        load = load + np.where(v >= 0.0, forward, backward) * smooth_sign(v)
    return mass, load


def motor_load(model: Model, q: Array, v: Array, tau: Array) -> Array:
    """See `Model.motor_load`."""
    load = model.tree.damping * v
    a = np.zeros_like(q)
    for effect in model.laws:
        if effect.motor_side and not effect.dry:
            load = load + effect.torque(model, q, v, a, tau)
    return load


def friction_level(model: Model, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
    """See `Model.friction_level`."""
    forward, backward = np.zeros_like(q), np.zeros_like(q)
    for effect in model.dry:
        up, down = effect.friction_level(model, q, v, tau)
        forward, backward = forward + up, backward + down
    return forward, backward


def held(model: Model, total: Array, q: Array, v: Array, arrived: Array) -> Array:
    """Joint loads (N, n) in which dry friction at rest holds what it can of the torque that arrived."""
    for effect in model.coupled:
        along, level = effect.direction(model), float(effect.value("torque")[0])
        sliding = smooth_sign(v @ along)
        friction = level * sliding
        held = np.clip((arrived - total) @ along / np.sum(along) + friction, -level, level)
        total = total + np.outer((1.0 - sliding**2) * (held - friction), along)
    if not model.dry:
        return total
    forward, backward = friction_level(model, q, v, arrived)
    sliding = smooth_sign(v)
    friction = np.where(v >= 0.0, forward, backward) * sliding
    held = np.clip(arrived - (total - friction), -backward, forward)
    return np.asarray(total + (1.0 - sliding**2) * (held - friction))


def logged(model: Model, total: Array, seen: Array | None, time: Array | None) -> Array:
    """What motors log (N, n), when it acts, where `total` reaches the joints; see `Model.inverse_dynamics`."""
    shown: list[Array] = []
    if seen is not None and any(effect.loses for effect in model.laws):
        arrived = seen if time is None else shifted(seen, time, -model.delay)
        for effect in model.laws:
            shown.append(arrived)
            arrived = effect.applied(model.joints, arrived)
    for k, effect in reversed(list(enumerate(model.laws))):
        if shown and effect.loses:
            total = total + shown[k] - effect.applied(model.joints, shown[k])
        else:
            total = effect.logged(model.joints, total)
    return total
