"""Open-loop rollouts of a model from many starts at once.

One step from (q, v) under torque τ, all starts together:

    (M + h/2 D) (v₊ − v) + λ = h (τ − loads(q + h/2 v, v + h/2 a) − D v),    q₊ = q + h/2 (v + v₊)

with M and the loads at the middle of the step (second order), dampers D by the trapezoidal rule (stable for any light
joint), and λ the impulses of dry friction, within ± h × its level and such that they oppose v₊: they can hold a joint
at rest exactly (`friction_impulses`).

Where gears yield, q is the motors' and the state holds the twist e of each gear too: links are at q + e, springs are
part of the left side like dampers, and play ends by impulses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin_diagram.model.dynamics.friction_impulses import DryFriction, Stop, solve
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    longest_step: float = 0.004
    """Samples farther apart than this are integrated in several steps [s]."""

    lightest_rotor: float = 1e-4
    """Least share of a link's inertia that a rotor before a yielding gear has."""


TUNING = Tuning()


@dataclass
class State:
    """Of S rollouts: true positions and speeds of the motors (S, n), and twists of the gears that yield (S, s).

    `a` (S, n + s) are the accelerations of the step before, to foresee the middle of the next.
    """

    q: Array
    v: Array
    e: Array
    rate: Array
    a: Array

    def rows(self, index: Any) -> State:
        """Return some of them."""
        return State(self.q[index], self.v[index], self.e[index], self.rate[index], self.a[index])


def rollout(
    model: Model,
    q: Array,
    v: Array,
    tau: Array,
    period: float,
    time: Array | None = None,
    twist: tuple[Array, Array] | None = None,
    *,
    arrived: bool = False,
) -> Array:
    """Return the measured positions (S, n) at the end of open-loop rollouts; arguments as of `trajectory` [rad]."""
    for position in trajectory(model, q, v, tau, period, time, twist, arrived=arrived):
        end = position
    return end


def trajectory(
    model: Model,
    q: Array,
    v: Array,
    tau: Array,
    period: float,
    time: Array | None = None,
    twist: tuple[Array, Array] | None = None,
    *,
    arrived: bool = False,
) -> Iterator[Array]:
    """Yield open-loop rollouts, period by period.

    Args:
        model: whose measured positions q are.
        q: (S, n) measured positions at the starts [rad].
        v: (S, n) velocities [rad/s].
        tau: (K + 1, S, n) logged torques at the start and after each of K periods; linear between [N·m]. Without
            `arrived` nothing waits: what was logged before the start is not known.
        period: [s].
        time: (S,) of the starts, for effects that start or end [s]; None: what is there to stay counts.
        twist: angles [rad] and rates [rad/s] of the gears that yield at the starts, each (S, s); None: at rest.
        arrived: whether `tau` is what reaches the joints already (`Model.applied`).

    Yields:
        (S, n) measured positions after 1, 2, … K periods [rad].
    """
    if not model.timed:
        time = None
    parts = max(1, int(np.ceil(period / TUNING.longest_step - 1e-9)))
    h = period / parts
    state = _begun(model, q, v, tau[0], time, twist, arrived)
    for k in range(len(tau) - 1):
        positions = np.empty_like(q)
        for part in range(parts):
            share = (part + 0.5) / parts
            middle = (1.0 - share) * tau[k] + share * tau[k + 1]
            last = part == parts - 1
            for rows, static in _groups(model, time, (k * parts + part + 0.5) * h):
                torque = middle[rows] if arrived else static.applied(middle[rows])
                after = step(static, state.rows(rows), torque, h)
                if isinstance(rows, slice):
                    state = after
                else:
                    _put(state, rows, after)
                if last:
                    positions[rows] = static.measured_position(after.q)
        yield positions


def _begun(
    model: Model,
    q: Array,
    v: Array,
    tau: Array,
    time: Array | None,
    twist: tuple[Array, Array] | None,
    arrived: bool,
) -> State:
    """Return the state at the starts; arguments as of `trajectory`, `tau` (S, n) at the starts."""
    s = len(model.law.yielding)
    state = State(q, v.copy(), np.zeros((len(q), s)), np.zeros((len(q), s)), np.zeros((len(q), model.tree.n + s)))
    if twist is not None:
        state.e[:], state.rate[:] = twist
    for rows, static in _groups(model, time, 0.0):
        first = tau[rows] if arrived else static.applied(tau[rows])
        group = state.rows(rows)
        group.q = static.true_position(group.q)
        begun = start(static, group, first, at_rest=twist is None)
        if isinstance(rows, slice):
            return begun
        state.q = state.q.copy()
        _put(state, rows, begun)
    return state


def _groups(model: Model, time: Array | None, later: float) -> list[tuple[Any, Model]]:
    """Return which rollouts each model without onsets holds for, `later` seconds after their starts."""
    if time is None:
        return [(slice(None), model)]
    return [(np.flatnonzero(mask), static) for mask, static in model.epochs(time + later)]


def _put(state: State, rows: Any, part: State) -> None:
    for name in ("q", "v", "e", "rate", "a"):
        getattr(state, name)[rows] = getattr(part, name)


def start(model: Model, state: State, tau: Array, *, at_rest: bool) -> State:
    """Return accelerations at the start, and twists where they are not known: those that carry the load.

    Where a joint rests, dry friction that would hold it is left out: it is only used to foresee half a step.
    """
    gears = model.law.yielding
    joints, stiffness, half = gears.joints, gears.stiffness, gears.half
    mass, load = model.law.mass_and_load(state.q, state.v, tau)
    inverse: Any = np.linalg.inv(mass)
    a = _times(inverse, tau - load)
    if len(joints) and at_rest:
        carried = model.law.link_load(state.q, state.v, a)[:, joints]
        state.e = -np.sign(carried) * half - carried / stiffness
        state.rate = np.zeros_like(state.e)
    state.a = np.hstack([a, np.zeros_like(state.e)])
    return state


def step(model: Model, state: State, tau: Array, h: float) -> State:
    """Return one step under torques `tau` (S, n) that reach the joints in its middle [N·m], of `h` seconds."""
    if len(model.law.yielding):
        return _yielding_step(model, state, tau, h)
    damping = model.tree.damping
    q, v = state.q, state.v
    q_middle, v_middle = q + 0.5 * h * v, v + 0.5 * h * state.a
    mass, load = model.law.mass_and_load(q_middle, v_middle, tau, dry=False)
    mass[:, range(len(damping)), range(len(damping))] += 0.5 * h * damping
    load, brakes = _brakes(model, q_middle, v_middle, tau, load, h, len(damping))
    inverse: Any = np.linalg.inv(mass)
    impulse = h * (tau - (load - damping * v_middle) - damping * v)
    v_next = v + _times(inverse, impulse)
    if brakes:
        v_next = solve(inverse, v_next, brakes, [])
    return State(q + 0.5 * h * (v + v_next), v_next, state.e, state.rate, (v_next - v) / h)


def _yielding_step(model: Model, state: State, tau: Array, h: float) -> State:
    """As `step`, with twists; M₊ is the mass matrix of motors and twists together."""
    gears = model.law.yielding
    joints, stiffness, half = gears.joints, gears.stiffness, gears.half
    n, s = model.tree.n, len(joints)
    hard = ~np.isfinite(stiffness)
    velocity = np.hstack([state.v, state.rate])
    middle = np.hstack([state.q, state.e]) + 0.5 * h * velocity
    speed = velocity + 0.5 * h * state.a
    q, v = middle[:, :n].copy(), speed[:, :n].copy()
    q[:, joints] += middle[:, n:]
    v[:, joints] += speed[:, n:]
    mass, load = model.law.mass_and_load(q, v, tau, dry=False)
    links = mass.copy()
    links[:, range(n), range(n)] -= model.tree.rotor
    before_gear = model.law.motor_load(q, v, tau)
    load, brakes = _brakes(model, middle[:, :n], speed[:, :n], tau, load, h, n + s)
    behind_gear = (load - before_gear)[:, joints]

    spring = np.where(hard | (np.abs(middle[:, n:]) <= half), 0.0, stiffness)
    rest = np.sign(middle[:, n:]) * half
    loss = gears.loss * spring
    damping = np.concatenate([model.tree.damping, np.zeros(s)])
    whole = np.empty((len(q), n + s, n + s))
    whole[:, :n, :n] = mass
    whole[:, joints, joints] += TUNING.lightest_rotor * links[:, joints, joints]
    whole[:, :n, n:] = links[:, :, joints]
    whole[:, n:, :n] = links[:, joints, :]
    whole[:, n:, n:] = links[:, joints[:, None], joints]
    diagonal = np.arange(n + s)
    whole[:, diagonal, diagonal] += 0.5 * h * damping
    whole[:, diagonal[n:], diagonal[n:]] += 0.5 * h * loss + 0.25 * h * h * spring
    force = np.empty_like(velocity)
    force[:, :n] = tau - (load - model.tree.damping * v) - model.tree.damping * state.v
    force[:, n:] = -behind_gear - spring * (middle[:, n:] - rest) - loss * state.rate
    inverse: Any = np.linalg.inv(whole)
    after = velocity + h * _times(inverse, force)
    stops = [
        Stop(n + k, (-half[k] - state.e[:, k]) / h, (half[k] - state.e[:, k]) / h)
        for k in np.flatnonzero(hard).tolist()
    ]
    if brakes or stops:
        after = solve(inverse, after, brakes, stops)
    mean = 0.5 * (velocity + after)
    mean[:, n:][:, hard] = after[:, n:][:, hard]  # the end of play is met without rebound
    moved = np.hstack([state.q, state.e]) + h * mean
    return State(moved[:, :n], after[:, :n], moved[:, n:], after[:, n:], (after - velocity) / h)


def _brakes(
    model: Model, q: Array, v: Array, tau: Array, load: Array, h: float, size: int
) -> tuple[Array, list[DryFriction]]:
    """Return dry friction of a step, and the loads without what of it they hold."""
    n = model.tree.n
    result = []
    if model.law.dry:
        forward, backward = model.law.friction_level(q, v, tau)
        result = [DryFriction(np.eye(size)[j], h * forward[:, j], h * backward[:, j]) for j in range(n)]
    for effect in model.law.coupled:
        level = np.full(len(q), h * float(effect.value("torque")[0]))
        direction = np.concatenate([effect.direction(model.bodies), np.zeros(size - n)])
        result.append(DryFriction(direction, level, level))
        load = load - effect.dry_torque(model.bodies, v)
    return load, result


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("sij,sj->si", matrix, vector))
