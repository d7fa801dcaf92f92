"""An active-set solver for programs whose cost is the square of a distance; compiled.

The dual method of Goldfarb and Idnani (A numerically stable dual method for solving strictly convex quadratic
programs, Mathematical Programming 27, 1983): it begins at the optimum without rows, which is known, and takes one
broken row after the other in. Motions break few rows, so few steps are made, each of the order of variables times
active rows. Sums are made in one order, whatever the machine: equal programs have equal answers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.mpc.quadratic_program import QpSolution, QpSolver, QuadraticProgram
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a row counts as broken and when a program as without answer; chosen by hand."""

    broken: float = 1e-8
    """A row that is broken by more than this is taken in, in its own units: a tenth of what `motion_program` heeds."""

    endless: float = 1e19
    """Bounds beyond this are none."""


TUNING = Tuning()


class ActiveSet(QpSolver):
    """Solves programs with a positive definite H and without equations.

    Args:
        steps: at most.
    """

    def __init__(self, steps: int = 1000) -> None:
        self._steps = steps

    def solve(self, program: QuadraticProgram) -> QpSolution:
        """Solve one program, see `QpSolver`; it is not solved where H is not definite or rows contradict each other.

        Raises:
            ValueError: the program has equations.
        """
        from twin_diagram.planning.mpc.active_set_kernels import solve  # compiled; not with every import

        if len(program.b):
            raise ValueError(f"{len(program.b)} equations: ActiveSet takes bounds alone")
        size, H = len(program.g), program.H
        root = None if np.array_equal(H, np.eye(size)) else _root(H)
        if root is not None and not np.isfinite(root).all():
            return QpSolution(np.zeros(size), False, 0)
        bounds = np.isfinite(program.lower) & (program.lower > -TUNING.endless)
        bounds |= np.isfinite(program.upper) & (program.upper < TUNING.endless)
        rows = np.concatenate([np.eye(size)[bounds], program.C])
        low = np.concatenate([program.lower[bounds], program.low])
        high = np.concatenate([program.upper[bounds], program.high])
        g = program.g
        if root is not None:
            g, rows = root @ g, rows @ root.T
        first = int(bounds.sum()) if root is None else 0
        wish, rows, low, high = (np.ascontiguousarray(part, dtype=float) for part in (-g, rows, low, high))
        y, solved, steps = solve(wish, rows, low, high, first, TUNING.broken, TUNING.endless, self._steps)
        x = np.asarray(y if root is None else root.T @ y)
        return QpSolution(x, bool(solved and np.isfinite(x).all()), int(steps))


def _root(H: Array) -> Array:
    """Return the inverse of H's lower Cholesky factor; not finite where there is none."""
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(H)))
    except np.linalg.LinAlgError:
        return np.full_like(H, np.nan)
