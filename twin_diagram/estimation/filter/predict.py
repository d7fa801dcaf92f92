"""The prediction: moves the belief on through the arm's equation of motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twin_diagram.estimation.dynamics.process_model import Jacobians, jacobians, step
from twin_diagram.estimation.filter.base import TUNING as BASE
from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import Belief, Entry
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
    """How far a prediction may go: chosen by hand."""

    longest_prediction: float = 2.5
    """What is further ahead is not predicted to [s]."""


TUNING = Tuning()


def propagate(core: Core, u: Array, dt: float, torque_std: Array | float) -> None:
    """Move the belief on by dt, in steps of `longest_step` at most.

    Args:
        core: its belief and history are changed.
        u: (n,) motor torque, mean over the time [N·m].
        dt: [s].
        torque_std: unmodelled torque, as white noise over one filter period [N·m].
    """
    parts = int(np.ceil(dt / BASE.longest_step - 1e-9))
    for _ in range(parts):
        _once(core, u, dt / parts, torque_std)


def _once(core: Core, u: Array, dt: float, torque_std: Array | float) -> None:
    belief, terms, parameters, n = core.belief, core.terms, core.parameters, core.terms.n
    dry = terms.dry(terms.true_position(belief.q), belief.v, u)
    level = np.maximum(0.5 * (dry[0] + dry[1]) + parameters.dry(belief.model), 0.0)
    keep, fresh, changed = follow_regimes(belief, core.params, dt, level)
    core.wander = disturbance_std(core.params, EVERY, level) ** 2
    v = belief.v.copy()
    _follow_acceleration(belief, dt)
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
    by = jacobians(terms, parameters, moved, v, theta, dt, steady, u, sure_to_slide(belief))
    by_state = _enter_transition(core.F, by, keep, changed, dt)
    Q, core.creep = _widen(core, by, level, fresh, dt, torque_std, blind)
    core.bound()
    learnt = by.parameters @ (belief.theta - theta)
    # Where the model asks for the impossible (a torque in error on a light joint), it is not followed there. A joint
    # that was measured to be as fast as that may still gain speed: held at its own, the model would lack its torque.
    limit = BASE.impossible * np.maximum(terms.velocity_limit, np.abs(v))
    speed = moved.v + learnt[n:]
    belief.v[:] = np.clip(speed, -limit, limit)
    belief.q[:] = moved.q + learnt[:n] + (0.5 * dt) * (belief.v - speed)
    belief.disturbance *= keep
    belief.header[Entry.TIME] += dt
    still = moved.a - by_state @ start
    core.history.push(float(belief.header[Entry.TIME]), dt, belief.x, still, steady, by_state, core.F, Q)
    core.history.settle(belief.x, belief.P)
    core.by_torque = by.torque
    core.step_mass = moved.mass


def _follow_acceleration(belief: Belief, dt: float) -> None:
    """Low-pass the acceleration over the step before, as observed."""
    span = float(belief.header[Entry.SPAN])
    if span > 0.0:
        observed = (belief.v - belief.before) / span
        belief.acceleration += min(span / DISTURBANCE.speed_time, 1.0) * (observed - belief.acceleration)
    belief.before[:], belief.header[Entry.SPAN] = belief.v, dt


def _enter_transition(F: Array, by: Jacobians, keep: Array, changed: np.ndarray, dt: float) -> Array:
    """Enter the derivative of a step in F.

    Args:
        F: (N, N), changed; its rows of θ and of the sensors' own states are those of 1.
        by: of the arm's step.
        keep: (n,) how much of the disturbance is kept.
        changed: (n,) where it is drawn afresh.
        dt: [s].

    Returns:
        (n, N) derivative of the mean acceleration over the step, as the readings at its end see it: by a disturbance
        that is drawn afresh, too.
    """
    n, N = len(keep), len(F)
    F[: 2 * n, : 2 * n] = by.state
    F[: 2 * n, 2 * n : 3 * n] = by.torque
    F[: 2 * n, 3 * n : 3 * n + by.parameters.shape[1]] = by.parameters
    F.flat[2 * n * (N + 1) : 3 * n * (N + 1) : N + 1] = keep
    by_state = F[n : 2 * n].copy()
    by_state[:, n : 2 * n].flat[:: n + 1] -= 1.0
    by_state /= dt
    if changed.any():  # what is drawn afresh has nothing to do with what was
        F[: 2 * n, 2 * n + np.flatnonzero(changed)] = 0.0
    return by_state


def _widen(
    core: Core, by: Jacobians, level: Array, fresh: Array, dt: float, torque_std: Array | float, blind: bool
) -> tuple[Array, Array]:
    """Carry the covariance over a step, by F as it was entered.

    Return its Q (N, N), and the variance (n,) that friction brings to joints that creep [N²·m²].

    Args:
        core: the covariance of its belief is changed; the rest of it is that before the step.
        by: of the arm's step.
        level: (n,) of dry friction [N·m].
        fresh: (n,) variance that the disturbance gains [N²·m²].
        dt: [s].
        torque_std: unmodelled torque, as white noise over one filter period [N·m].
        blind: whether nobody has told of the state lately.
    """
    belief, params, n = core.belief, core.params, core.terms.n
    own = 3 * n + belief.p
    # White torque was found small with the joints in view, who hold the model in check. Blind it is as given.
    adapted = np.maximum(belief.noise[2], 0.0) if blind else belief.noise[2]
    creep = creep_std(belief.v, level, belief.P.diagonal()[n : 2 * n])
    torque_std = np.hypot(torque_std * np.exp(0.5 * adapted), creep)
    white = by.torque * (torque_std * np.sqrt(core.period / dt))
    walk = np.zeros(belief.size - 2 * n)
    walk[:n] = fresh
    if params.rule == "covariance" and np.any(belief.regime != 0.0):
        walk[n : own - 2 * n] = (params.parameter_walk * core.parameters.scale) ** 2 * dt
    if belief.size > own:
        walk[own - 2 * n :] = core.walk * dt
    from twin_diagram.estimation.dynamics import step_kernels  # compiled; not with every import

    Q = np.zeros_like(core.F)
    step_kernels.spread(core.F, belief.P, Q, white, walk, dt)
    return Q, creep**2 * (core.period / dt)


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
