"""The compiled part of `inverse_kinematics`: damped Gauss–Newton from one start after the other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.arm_kernels import place
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def search(
    q: Array, constant: Array, sine: Array, cosine: Array, linear: Array, axes_P: Array, origins_P: Array,
    prismatic: npt.NDArray[np.bool_], X_LT: Array, X_WG: Array, low: Array, high: Array,
    iterations: int, damping: float, longest: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Return where searches from configurations (N, n) end, and their errors there (N, 6), see `pose_error`.

    The chain's constants are those of `Chain`; X_WG (4, 4) is the tool's goal, low and high (n,) the limits, `damping`
    is added to J Jᵀ, and no joint takes a longer step than `longest` [rad].
    """
    count, n = q.shape
    q, errors = q.copy(), np.empty((count, 6))
    error, J, step, one = np.empty(6), np.empty((6, n)), np.empty(n), np.empty((1, n))
    for row in range(count):
        for at in range(iterations + 1):
            one[0] = q[row]
            X_WL, axes, origins = place(one, constant, sine, cosine, linear, axes_P, origins_P)
            p = _error(X_WL[0, n], X_LT, X_WG, error)
            if at == iterations:
                break
            _jacobian(axes[0], origins[0], prismatic, p, J)
            _damped(J, error, damping, step)
            stuck = False
            for k in range(n):
                if (q[row, k] <= low[k] and step[k] < 0.0) or (q[row, k] >= high[k] and step[k] > 0.0):
                    stuck = True
                    J[:, k] = 0.0
            if stuck:  # joints at a limit that would have to pass it take no part in this step
                _damped(J, error, damping, step)
            most = 1e-12
            for k in range(n):
                most = max(most, abs(step[k]))
            share = min(1.0, longest / most)
            for k in range(n):
                q[row, k] = min(max(q[row, k] + share * step[k], low[k]), high[k])
        errors[row] = error
    return q, errors


@compiled
def _error(X_WL: Array, X_LT: Array, X_WG: Array, error: Array) -> Array:
    """Fill in what turns and moves the tool into its goal, (6,); return where the tool is, (3,)."""
    X_WT, turn = np.zeros((3, 4)), np.zeros((3, 3))
    for i in range(3):
        for j in range(4):
            for k in range(4):
                X_WT[i, j] += X_WL[i, k] * X_LT[k, j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turn[i, j] += X_WG[i, k] * X_WT[j, k]
    x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    sine, cosine = 0.5 * np.sqrt(x * x + y * y + z * z), 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)
    if sine > 1e-7:
        share = 0.5 * np.arctan2(sine, cosine) / sine
        error[0], error[1], error[2] = share * x, share * y, share * z
    elif cosine > 0.0:
        error[0], error[1], error[2] = 0.5 * x, 0.5 * y, 0.5 * z
    else:  # half a turn: the axis is that of the largest entry of (R + 1) / 2
        k = 0
        for i in range(3):
            if turn[i, i] > turn[k, k]:
                k = i
        long = np.sqrt(max(0.5 * (turn[k, k] + 1.0), 1e-12))
        for i in range(3):
            error[i] = np.pi * (long if i == k else 0.25 * (turn[i, k] + turn[k, i]) / long)
    for i in range(3):
        error[3 + i] = X_WG[i, 3] - X_WT[i, 3]
    return X_WT[:, 3].copy()


@compiled
def _jacobian(axes: Array, origins: Array, prismatic: npt.NDArray[np.bool_], p: Array, J: Array) -> None:
    """Fill in the jacobian (6, n) of a point of the last link: angular above linear."""
    for k in range(len(axes)):
        a, o = axes[k], origins[k]
        if prismatic[k]:
            for i in range(3):
                J[i, k], J[3 + i, k] = 0.0, a[i]
            continue
        x, y, z = p[0] - o[0], p[1] - o[1], p[2] - o[2]
        for i in range(3):
            J[i, k] = a[i]
        J[3, k], J[4, k], J[5, k] = a[1] * z - a[2] * y, a[2] * x - a[0] * z, a[0] * y - a[1] * x


@compiled
def _damped(J: Array, error: Array, damping: float, step: Array) -> None:
    """Fill in the step (n,) of damped least squares: Jᵀ (J Jᵀ + damping)⁻¹ error, by Cholesky's factor."""
    L, y = np.zeros((6, 6)), np.empty(6)
    for i in range(6):
        for j in range(i + 1):
            total = damping if i == j else 0.0
            for k in range(J.shape[1]):
                total += J[i, k] * J[j, k]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
    for i in range(6):
        total = error[i]
        for k in range(i):
            total -= L[i, k] * y[k]
        y[i] = total / L[i, i]
    for i in range(5, -1, -1):
        total = y[i]
        for k in range(i + 1, 6):
            total -= L[k, i] * y[k]
        y[i] = total / L[i, i]
    for k in range(len(step)):
        step[k] = 0.0
        for i in range(6):
            step[k] += J[i, k] * y[i]
