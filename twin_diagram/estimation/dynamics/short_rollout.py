"""Short rollouts of the model under measured torques, and what their errors mean as torque."""

from __future__ import annotations

import numpy as np

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.process_model import step
from twin_diagram.signals.arrays import Array


def short_rollout(
    terms: ArmTerms, parameters: ParameterSet, state: Array, theta: Array, times: Array, torques: Array
) -> tuple[Array, Array]:
    """Move the model on from a state, sensors left out: step 1 of section 3.4 of Hybrid Reality Twins.

    Args:
        terms: the arm.
        parameters: what θ means.
        state: (2n,) at times[0].
        theta: (p,).
        times: (K,) increasing [s].
        torques: (K, n) measured motor torques at these times [N·m]; a step takes the mean of its ends.

    Returns:
        q (n,), v (n,) at times[-1], or where a joint left a hundred times its speed limit.
    """
    q, v = state[: terms.n], state[terms.n :]
    calm = np.zeros(terms.n)
    for k in range(len(times) - 1):
        tau = 0.5 * (torques[k] + torques[k + 1])
        moved = step(terms, parameters, q, v, theta, tau, calm, float(times[k + 1] - times[k]))
        q, v = moved.q, moved.v
        if not np.all(np.abs(v) < 100.0 * terms.velocity_limit):
            break
    return q, v


def torque_error(terms: ArmTerms, parameters: ParameterSet, q: Array, theta: Array, error: Array, span: float) -> Array:
    """Return the constant joint torques (n,) that would have made a position error (n,) over a span [N·m].

    Error in the angles depends on each joint's inertia and on the span; as torque it compares between joints, poses and
    arms. Friction damps an error, so this is a lower bound.
    """
    terms.set_payload(parameters.payload_of(theta))
    return terms.mass_matrix(terms.true_position(q)) @ error * (2.0 / span**2)
