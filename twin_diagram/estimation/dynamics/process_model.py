"""One step of the arm's motion under measured torque, and its derivatives.

They are f(x, u, θ) and F of section 3.2 of Hybrid Reality Twins.

Friction is taken implicitly. With the mid-point position q̄ = q + v dt/2 and viscous coefficients D,

    (M + dt (D + K)) v⁺ = M v + dt (τ + d − b(q̄, v) + D v),      q⁺ = q + dt (v + v⁺)/2,

where K = diag(F_i / √(v*_i² + s²)) is the secant of dry friction of level F_i at v*, first v and then the v⁺ so
found, with s the speed below which a joint counts as stuck. A secant is never negative, not even where Stribeck
friction falls with speed, so the step cannot blow up however large F dt is against the joint's inertia: it stops a
joint instead of throwing it to the other side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """The implicit step's treatment of dry friction: chosen by hand.

    `sims/benchmarks/filter_timing.py` shows what a step costs.
    """

    stuck_speed: float = 1e-3
    """s above: a joint creeps this fast, times load over level, while dry friction holds it [rad/s]."""

    iterations: int = 3
    """Secants that are taken one after the other: at v, then at the v⁺ of the one before."""


TUNING = Tuning()

_NOT_POSITIVE: Final = "the mass matrix with the friction of a step is not positive definite"
"""Of an arm that cannot be; nor can it be factored where something is no number."""


@dataclass(frozen=True)
class ArmStep:
    """A step and what its derivatives need.

    Attributes:
        q, v: (n,) after the step [rad], [rad/s].
        middle: (n,) q̄, as true positions [rad].
        a: (n,) mean acceleration over the step [rad/s²].
        mass: M(q̄) (n, n) [kg·m²].
        drag: (n,) slope of all friction at v⁺, never negative [N·m·s/rad].
    """

    q: Array
    v: Array
    middle: Array
    a: Array
    mass: Array
    drag: Array


@dataclass(frozen=True)
class Jacobians:
    """Derivatives of (q⁺, v⁺).

    Attributes:
        state: (2n, 2n) with respect to (q, v).
        torque: (2n, n) with respect to a torque on the joints.
        parameters: (2n, p) with respect to θ.
    """

    state: Array
    torque: Array
    parameters: Array


def step(
    terms: ArmTerms,
    parameters: ParameterSet,
    q: Array,
    v: Array,
    theta: Array,
    tau: Array,
    disturbance: Array,
    dt: float,
    dry: tuple[Array, Array] | None = None,
) -> ArmStep:
    """Move the arm on by dt.

    Args:
        terms: the arm.
        parameters: what θ means.
        q: (n,) [rad].
        v: (n,) [rad/s].
        theta: (p,).
        tau: (n,) motor torque, the mean over the step [N·m].
        disturbance: (n,) further torque on the joints [N·m].
        dt: [s].
        dry: bounds of dry friction, where they are known already.
    """
    terms.set_payload(parameters.payload_of(theta))
    middle = q + (0.5 * dt) * v
    there = terms.true_position(middle)
    viscous = parameters.viscous(theta, terms.damping)
    push = terms.applied(tau) + parameters.push(theta, tau) + disturbance - terms.load(there, v, tau)
    mass = np.ascontiguousarray(terms.mass_matrix(there))
    forward, backward = dry or terms.dry(there, v, tau)
    change = parameters.dry(theta)
    bounds = np.maximum(np.stack([forward, backward]) + change, 0.0)
    from twin_diagram.estimation.dynamics import step_kernels  # compiled; not with every import

    slow = TUNING.stuck_speed, TUNING.iterations
    solved, at, drag = step_kernels.slide(mass, push, v, terms.damping, viscous, bounds, dt, *slow)
    if not solved:
        raise np.linalg.LinAlgError(_NOT_POSITIVE)
    return ArmStep(q=q + (0.5 * dt) * (v + at), v=at, middle=there, a=(at - v) / dt, mass=mass, drag=drag)


def jacobians(
    terms: ArmTerms,
    parameters: ParameterSet,
    moved: ArmStep,
    v: Array,
    theta: Array,
    dt: float,
    acceleration: Array,
    tau: Array | None = None,
    sliding: Array | None = None,
) -> Jacobians:
    """Differentiate a step by the implicit function theorem, inverse dynamics by forward differences.

    Args:
        terms: the arm.
        parameters: what θ means.
        moved: the step.
        v: (n,) before it [rad/s].
        theta: (p,).
        dt: [s].
        acceleration: (n,) as observed. A load that θ does not know of yet makes the predicted acceleration wrong, and a
            regressor that held it would teach wrong parameters for good [rad/s²].
        tau: (n,) motor torque, for parameters that depend on it; zeros where None [N·m].
        sliding: (n,) how sure it is that a joint slides, from 0 to 1; None: that they all do.
    """
    n = terms.n
    terms.set_payload(parameters.payload_of(theta))
    # The regressor first: the plant is where the step left it.
    Y = parameters.regressor(terms, moved.middle, v, acceleration, np.zeros(n) if tau is None else tau, sliding)
    by_q, by_v = terms.derivatives(moved.middle, v, moved.a)
    from twin_diagram.estimation.dynamics import step_kernels  # compiled; not with every import

    Y, mass = np.ascontiguousarray(Y), np.ascontiguousarray(moved.mass)
    solved, whole = step_kernels.differentiate(mass, moved.drag, by_q, by_v, Y, terms.damping, dt)
    if not solved:
        raise np.linalg.LinAlgError(_NOT_POSITIVE)
    return Jacobians(whole[:, : 2 * n], whole[:, 2 * n : 3 * n], whole[:, 3 * n :])
