"""Steps of least squares that keep to lower bounds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from twin_diagram.signals.arrays import Array

Chosen = npt.NDArray[np.bool_]


def bounded(H: Array, gradient: Array, lower: Array, free: Chosen) -> Array:
    """Return the step of least squares that keeps to lower bounds."""
    moving = free.copy()
    step = np.zeros(len(gradient))
    for _ in range(8):
        some, fixed = np.flatnonzero(moving), np.flatnonzero(step)
        fixed = fixed[~moving[fixed]]
        rest = gradient[some] + H[np.ix_(some, fixed)] @ step[fixed] if len(fixed) else gradient[some]
        step[some] = -solved(H if len(some) == len(H) else H[np.ix_(some, some)], rest)
        below = moving & (step < lower)
        if not np.any(below):
            break
        step[below] = lower[below]
        moving &= ~below
    return np.maximum(step, lower)


def solved(H: Array, right: Array) -> Array:
    """Return H⁻¹ right (M,) of a normal matrix (M, M) whose rows may differ in size by many orders."""
    scale = 1.0 / np.sqrt(np.diag(H))
    inner = H * np.outer(scale, scale)
    if len(H):
        _, found, failed = lapack.dposv(inner, right * scale)
        if not failed:
            return np.asarray(found * scale)
    return np.asarray(np.linalg.solve(inner, right * scale) * scale)  # where rounding has the last word
