"""The compiled parts of `process_model` and of the filter's prediction: small systems and products.

A dozen numbers at a time cost microseconds for each array operation; as one loop they cost little more than one.
"""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place


@compiled_in_place
def _factor(A: Array) -> bool:
    """Put Cholesky's lower factor of A (n, n) in its place; False where A is not positive definite."""
    n = len(A)
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i > j:
                A[i, j] = total / A[j, j]
            elif total > 0.0:
                A[i, i] = np.sqrt(total)
            else:
                return False
    return True


@compiled_in_place
def _substitute(L: Array, x: Array) -> None:
    """Put the solution of L Lᵀ y = x in the place of x (n, m)."""
    n, m = x.shape
    for i in range(n):
        for k in range(i):
            for j in range(m):
                x[i, j] -= L[i, k] * x[k, j]
        for j in range(m):
            x[i, j] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            for j in range(m):
                x[i, j] -= L[k, i] * x[k, j]
        for j in range(m):
            x[i, j] /= L[i, i]


@compiled
def slide(
    mass: Array,
    push: Array,
    v: Array,
    damping: Array,
    viscous: Array,
    bounds: Array,
    dt: float,
    stuck: float,
    times: int,
) -> tuple[bool, Array, Array]:
    """Return whether it could be solved, v⁺ (n,) and the slope of all friction there (n,): see `process_model`.

    Args:
        mass: (n, n)
        push: (n,) torque on the joints but for friction [N·m].
        v: (n,) [rad/s].
        damping: (n,) viscous coefficients that are part of `push`.
        viscous: (n,) of all viscous friction.
        bounds: (2, n) of dry friction against positive and against negative motion.
        dt: [s].
        stuck: speed below which a joint counts as stuck.
        times: how many secants are taken.
    """
    n = len(v)
    at, drag, start = v.copy(), np.empty(n), np.empty((n, 1))
    system, right = np.empty((n, n)), np.empty((n, 1))
    for i in range(n):
        total = dt * (push[i] + damping[i] * v[i])
        for j in range(n):
            total += mass[i, j] * v[j]
        start[i, 0] = total
    for _ in range(times):
        system[:], right[:] = mass, start
        for i in range(n):
            level = bounds[0, i] if at[i] > 0.0 else bounds[1, i]
            width = at[i] * at[i] + stuck * stuck
            secant = level / np.sqrt(width)
            system[i, i] += dt * (viscous[i] + secant)
            drag[i] = viscous[i] + secant * (stuck * stuck / width)
        if not _factor(system):
            return False, at, drag
        _substitute(system, right)
        at[:] = right[:, 0]
    return True, at, drag


@compiled
def differentiate(
    mass: Array, drag: Array, by_q: Array, by_v: Array, Y: Array, damping: Array, dt: float
) -> tuple[bool, Array]:
    """Return whether it could be solved, and (2n, 3n + p) derivatives of (q⁺, v⁺) by q, v, a torque and θ.

    Args:
        mass: (n, n)
        drag: (n,) slope of all friction at v⁺.
        by_q: (n, n) derivative of inverse dynamics.
        by_v: (n, n)
        Y: (n, p) regressor of θ.
        damping: (n,) viscous coefficients in inverse dynamics.
        dt: [s].
    """
    n, p = len(drag), Y.shape[1]
    system, whole = mass.copy(), np.zeros((2 * n, 3 * n + p))
    velocity = whole[n:]
    for i in range(n):
        system[i, i] += dt * drag[i]
        for j in range(n):
            velocity[i, j] = -dt * by_q[i, j]
            velocity[i, n + j] = mass[i, j] - dt * by_v[i, j] - 0.5 * dt * dt * by_q[i, j]
        velocity[i, n + i] += dt * damping[i]
        velocity[i, 2 * n + i] = dt
        for j in range(p):
            velocity[i, 3 * n + j] = -dt * Y[i, j]
    if not _factor(system):
        return False, whole
    _substitute(system, velocity)
    for i in range(n):
        for j in range(3 * n + p):
            whole[i, j] = 0.5 * dt * velocity[i, j]
        whole[i, i] += 1.0
        whole[i, n + i] += 0.5 * dt
    return True, whole


@compiled
def spread(F: Array, P: Array, Q: Array, white: Array, walk: Array, dt: float) -> None:
    """Enter the noise of a step in Q (N, N), and put F P Fᵀ + Q in the place of P (N, N).

    Args:
        F: (N, N); beyond the first 2n rows it is diagonal.
        P: covariance before.
        Q: zeros.
        white: (2n, n) what a standard deviation of each joint's white torque adds to (q, v).
        walk: (N − 2n,) variances that the other states gain.
        dt: [s].
    """
    N, m = len(F), len(white)
    n = m // 2
    for i in range(m):
        for j in range(m):
            total = 0.0
            for k in range(n):
                total += white[i, k] * white[j, k]
            Q[i, j] = total
    # When within the step it acts is not known: it moves a joint by more or less than the speeds at both ends say.
    for i in range(n):
        for j in range(n):
            Q[i, j] += dt * dt / 12.0 * Q[n + i, n + j]
    for i in range(m, N):
        Q[i, i] = walk[i - m]
    half = _through(F, P, m)
    whole = _through(F, half.T.copy(), m)
    for i in range(N):
        for j in range(i + 1):
            P[i, j] = P[j, i] = 0.5 * ((whole[i, j] + Q[i, j]) + (whole[j, i] + Q[j, i]))


@compiled
def _through(F: Array, P: Array, m: int) -> Array:
    """Return F P (N, N), of F (N, N) whose rows beyond the first m are diagonal."""
    N = len(F)
    found = np.zeros((N, N))
    for i in range(m):
        for k in range(N):
            f = F[i, k]
            for j in range(N):
                found[i, j] += f * P[k, j]
    for i in range(m, N):
        for j in range(N):
            found[i, j] = F[i, i] * P[i, j]
    return found
