"""Open-loop rollouts of a model from many starts at once.

One step from (q, v) under torque τ, all starts together:

    (M + h/2 D) (v₊ − v) + λ = h (τ − loads(q + h/2 v, v + h/2 a) − D v),    q₊ = q + h/2 (v + v₊)

with M and the loads at the middle of the step (second order), dampers D by the trapezoidal rule (stable for any light
joint), and λ the impulse of dry friction, within ± h × its level and such that it opposes v₊: it can hold a joint at
rest exactly. λ is found by projected Gauss-Seidel on (M + h/2 D)⁻¹ (Moreau's time stepping; Jean and Moreau 1992).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.model import Model

Array = npt.NDArray[np.float64]

LONGEST_STEP = 0.004
"""Samples farther apart than this are integrated in several steps [s]."""

SWEEPS = 60
TOLERANCE = 1e-10


def rollout(model: Model, q: Array, v: Array, tau: Array, period: float) -> Array:
    """Measured positions (S, n) at the end of open-loop rollouts; arguments as of `trajectory` [rad]."""
    for position in trajectory(model, q, v, tau, period):
        end = position
    return end


def trajectory(model: Model, q: Array, v: Array, tau: Array, period: float) -> Iterator[Array]:
    """Open-loop rollouts, period by period.

    Args:
        model: whose measured positions q are.
        q: (S, n) measured positions at the starts [rad].
        v: (S, n) velocities [rad/s].
        tau: (K + 1, S, n) logged torques at the start and after each of K periods; linear between [N·m].
        period: [s].

    Yields:
        (S, n) measured positions after 1, 2, … K periods [rad].
    """
    parts = max(1, int(np.ceil(period / LONGEST_STEP - 1e-9)))
    h = period / parts
    q, v = model.true_position(q).copy(), v.copy()
    applied = model.applied(tau)
    a: Array | None = None
    for k in range(len(tau) - 1):
        for part in range(parts):
            share = (part + 0.5) / parts
            middle = (1.0 - share) * applied[k] + share * applied[k + 1]
            if a is None:
                a = _accelerations(model, q, v, applied[0])
            q, v, a = step(model, q, v, a, middle, h)
        yield measured(model, q)


def measured(model: Model, q: Array) -> Array:
    """What encoders read at true positions (…, n)."""
    for effect in reversed(model.effects):
        q = effect.measured_position(model.joints, q)
    return q


def step(model: Model, q: Array, v: Array, a: Array, tau: Array, h: float) -> tuple[Array, Array, Array]:
    """One step.

    Args:
        model: any.
        q: (S, n) true positions [rad].
        v: (S, n) velocities [rad/s].
        a: (S, n) accelerations of the step before, to foresee the middle of this one [rad/s²].
        tau: (S, n) applied torques in the middle of the step [N·m].
        h: step [s].

    Returns:
        Positions, velocities and mean accelerations at its end.
    """
    damping = model.tree.damping
    q_middle, v_middle = q + 0.5 * h * v, v + 0.5 * h * a
    mass, load = model.mass_and_load(q_middle, v_middle, tau, dry=False)
    mass[:, range(len(damping)), range(len(damping))] += 0.5 * h * damping
    inverse: Any = np.linalg.inv(mass)
    impulse = h * (tau - (load - damping * v_middle) - damping * v)
    v_next = v + _times(inverse, impulse)
    if any(effect.dry for effect in model.effects):
        forward, backward = model.friction_level(q_middle, v_middle, tau)
        v_next = _with_dry_friction(inverse, v_next, h * forward, h * backward)
    return q + 0.5 * h * (v + v_next), v_next, (v_next - v) / h


def _with_dry_friction(inverse: Array, v: Array, forward: Array, backward: Array) -> Array:
    """Velocities (S, n) after friction impulses bounded by `forward` against v > 0 and `backward` against v < 0."""
    n = v.shape[1]
    v = v.copy()
    friction = np.zeros_like(v)
    scale = np.maximum(np.max(forward + backward, axis=0), 1e-300)
    braked = [j for j in range(n) if scale[j] > 1e-200]
    for _ in range(SWEEPS):
        change = 0.0
        for j in braked:
            wanted = np.clip(friction[:, j] + v[:, j] / inverse[:, j, j], -backward[:, j], forward[:, j])
            difference = wanted - friction[:, j]
            friction[:, j] = wanted
            v -= inverse[:, :, j] * difference[:, None]
            change = max(change, float(np.max(np.abs(difference)) / scale[j]))
        if change < TOLERANCE:
            break
    return v


def _accelerations(model: Model, q: Array, v: Array, tau: Array) -> Array:
    """Where a joint rests, dry friction that would hold it is left out: it is only used to foresee half a step."""
    mass, load = model.mass_and_load(q, v, tau)
    inverse: Any = np.linalg.inv(mass)
    return _times(inverse, tau - load)


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("sij,sj->si", matrix, vector))
