"""The prediction: moves the belief on through the arm's equation of motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twin_diagram.estimation.dynamics.process_model import jacobians, step
from twin_diagram.estimation.filter.base import TUNING as BASE
from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.disturbance import (
    TUNING as DISTURBANCE,
)
from twin_diagram.estimation.filter.disturbance import (
    creep_std,
    disturbance_std,
    follow_regimes,
    sure_to_slide,
)
from twin_diagram.estimation.filter.parameter_adaptation import release
from twin_diagram.estimation.filter.sensor_registry import TUNING as SENSOR_REGISTRY
from twin_diagram.signals.arrays import Array

EVERY: Final = np.array(True)
"""Of joints: they slide."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    longest_step: float = 0.01
    """A longer prediction is cut into steps no longer than this [s]."""

    longest_prediction: float = 2.5
    """What is further ahead is not predicted to [s]."""


TUNING = Tuning()


def propagate(core: Core, u: Array, dt: float, torque_std: Array | float) -> None:
    """Move the belief on by dt, in steps of `LONGEST_STEP` at most.

    Args:
        core: its belief and history are changed.
        u: (n,) motor torque, mean over the time [N·m].
        dt: [s].
        torque_std: unmodelled torque, as white noise over one filter period [N·m].
    """
    parts = int(np.ceil(dt / TUNING.longest_step - 1e-9))
    for _ in range(parts):
        _once(core, u, dt / parts, torque_std)


def _once(core: Core, u: Array, dt: float, torque_std: Array | float) -> None:
    belief, terms, parameters, params, n = core.belief, core.terms, core.parameters, core.params, core.terms.n
    dry = terms.dry(terms.true_position(belief.q), belief.v, u)
    level = np.maximum(0.5 * (dry[0] + dry[1]) + parameters.dry(belief.model), 0.0)
    keep, fresh, changed = follow_regimes(belief, params, dt, level)
    core.wander = disturbance_std(params, EVERY, level) ** 2
    v = belief.v.copy()
    span = float(belief.header[Entry.SPAN])
    if span > 0.0:
        observed = (v - belief.before) / span
        belief.acceleration += min(span / DISTURBANCE.speed_time, 1.0) * (observed - belief.acceleration)
    belief.before[:], belief.header[Entry.SPAN] = v, dt
    release(core, float(belief.header[Entry.TIME]))
    theta = belief.model
    # A resting joint's acceleration is noise alone. In a regressor it would seem to excite what it does not.
    steady = np.where(belief.regime != 0.0, belief.acceleration, 0.0)
    start = belief.x.copy()
    start[3 * n : 3 * n + belief.p] = theta
    moved = step(terms, parameters, belief.q, v, theta, u, belief.disturbance, dt, dry)
    blind = bool(belief.header[Entry.HEARD] < belief.header[Entry.TIME] - SENSOR_REGISTRY.vouched)
    if blind:
        # Stiction that nobody watches may have let go: as if it held a joint no stiffer than one that creeps.
        moved = replace(
            moved, drag=np.minimum(moved.drag, parameters.viscous(theta, terms.damping) + level / DISTURBANCE.creep)
        )
    sliding = sure_to_slide(belief)
    by = jacobians(terms, parameters, moved, v, theta, dt, steady, u, sliding)
    F, own = core.F, 3 * n + belief.p
    F[: 2 * n, : 2 * n] = by.state
    F[: 2 * n, 2 * n : 3 * n] = by.torque
    F[: 2 * n, 3 * n : own] = by.parameters
    F.flat[2 * n * (belief.size + 1) : 3 * n * (belief.size + 1) : belief.size + 1] = keep
    # What the readings at the step's end see of it: a disturbance drawn afresh, too.
    by_state = F[n : 2 * n].copy()
    by_state[:, n : 2 * n].flat[:: n + 1] -= 1.0
    by_state /= dt
    if changed.any():  # what is drawn afresh has nothing to do with what was
        F[: 2 * n, 2 * n + np.flatnonzero(changed)] = 0.0
    Q = np.zeros_like(F)
    # White torque was found small with the joints in view, who hold the model in check. Blind it is as given.
    adapted = np.maximum(belief.noise[2], 0.0) if blind else belief.noise[2]
    creep = creep_std(v, level, belief.P.diagonal()[n : 2 * n])
    core.creep = creep**2 * (core.period / dt)
    torque_std = np.hypot(torque_std * np.exp(0.5 * adapted), creep)
    white = by.torque * (torque_std * np.sqrt(core.period / dt))
    Q[: 2 * n, : 2 * n] = white @ white.T
    # When within the step it acts is not known: it moves a joint by more or less than the speeds at both ends say.
    Q[:n, :n] += (dt * dt / 12.0) * Q[n : 2 * n, n : 2 * n]
    at = np.arange(2 * n, 3 * n)
    Q[at, at] = fresh
    if params.rule == "covariance" and np.any(belief.regime != 0.0):
        at = np.arange(3 * n, own)
        Q[at, at] = (params.parameter_walk * parameters.scale) ** 2 * dt
    if belief.size > own:
        at = np.arange(own, belief.size)
        Q[at, at] = core.walk * dt
    P = F @ belief.P @ F.T + Q
    belief.P[:] = 0.5 * (P + P.T)
    core.bound()
    learnt = by.parameters @ (belief.theta - theta)
    # Where the model asks for the impossible (a torque in error on a light joint), it is not followed there.
    limit = np.maximum(BASE.impossible * terms.velocity_limit, np.abs(v))
    speed = moved.v + learnt[n:]
    belief.v[:] = np.clip(speed, -limit, limit)
    belief.q[:] = moved.q + learnt[:n] + (0.5 * dt) * (belief.v - speed)
    belief.disturbance *= keep
    belief.header[Entry.TIME] += dt
    still = moved.a - by_state @ start
    core.history.push(float(belief.header[Entry.TIME]), dt, belief.x, still, steady, by_state, F, Q)
    core.history.settle(belief.x, belief.P)
    core.by_torque = by.torque
    core.step_mass = moved.mass


def unmodelled(core: Core, jump: Array | float) -> Array:
    """Return the covariance (N, N) that an unmodelled torque of the effort limits' size adds in the newest step.

    When within the step it began is not known: a jump of speed moves a joint by 0 to dt times that.

    Args:
        core: with a step made.
        jump: (n,) of the speeds, as measured [rad/s].
    """
    assert core.by_torque is not None
    n = core.terms.n
    spread = core.by_torque * core.terms.effort_limit
    added = np.zeros((core.belief.size, core.belief.size))
    added[: 2 * n, : 2 * n] = spread @ spread.T
    late = jump * (float(core.belief.header[Entry.SPAN]) / np.sqrt(12.0))
    added[np.arange(n), np.arange(n)] += late**2
    return added
