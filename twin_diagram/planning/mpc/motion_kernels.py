"""Compiled parts of what is asked of a plan at every step of a driver: where it is now, and what a payload weighs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.arm_kernels import place
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def position(passed: float, step: float, q0: Array, v0: Array, accelerations: Array) -> Array:
    """Return (n,) where a `Trajectory` is, so many steps from its first knot on, 0 to N − 1.

    The double integral of the accelerations (N, n): each knot weighs with the area of its hat that lies before now.
    """
    knots, n = accelerations.shape
    result = np.empty(n)
    for j in range(n):
        result[j] = q0[j] + v0[j] * (passed * step)
    for k in range(min(int(passed) + 2, knots)):
        middle, ahead = max(passed - k, 0.0), max(passed - k - 1.0, 0.0)
        if k == 0:  # only the right half of its hat is in the motion
            weight = middle**2 / 2 - middle**3 / 6 + ahead**3 / 6
        else:
            weight = ((passed - k + 1.0) ** 3 - 2.0 * middle**3 + ahead**3) / 6
        for j in range(n):
            result[j] += step * step * weight * accelerations[k, j]
    return result


@compiled
def weight(
    q: Array,
    constant: Array,
    sine: Array,
    cosine: Array,
    linear: Array,
    axes_P: Array,
    origins_P: Array,
    prismatic: npt.NDArray[np.bool_],
    gravity: Array,
) -> Array:
    """Return (n, 4) what motors give per unit of payload: see `payload_gravity.gravity_regressor`."""
    X, axes, origins = place(q.reshape(1, -1), constant, sine, cosine, linear, axes_P, origins_P)
    n = len(q)
    result = np.zeros((n, 4))
    x, y, z = gravity[0], gravity[1], gravity[2]
    for k in range(n):
        ax, ay, az = axes[0, k, 0], axes[0, k, 1], axes[0, k, 2]
        if prismatic[k]:
            result[k, 0] = -(ax * x + ay * y + az * z)
            continue
        # g · (a × r) = (g × a) · r
        lx, ly, lz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
        for i in range(3):
            result[k, 1 + i] = -(lx * X[0, n, 0, i] + ly * X[0, n, 1, i] + lz * X[0, n, 2, i])
        rx, ry = X[0, n, 0, 3] - origins[0, k, 0], X[0, n, 1, 3] - origins[0, k, 1]
        result[k, 0] = -(lx * rx + ly * ry + lz * (X[0, n, 2, 3] - origins[0, k, 2]))
    return result
