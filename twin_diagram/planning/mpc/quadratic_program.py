"""Quadratic programs, behind one small interface so that the solver can be exchanged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class QuadraticProgram:
    """Minimise xᵀ H x / 2 + gᵀ x where A x = b, low <= C x <= high and lower <= x <= upper.

    Attributes:
        H: (n, n) symmetric.
        g: (n,).
        A: (e, n); e is 0 where there are no equations.
        b: (e,).
        C: (m, n).
        low: (m,) may hold -inf.
        high: (m,) may hold inf.
        lower: (n,) may hold -inf.
        upper: (n,) may hold inf.
    """

    H: Array
    g: Array
    A: Array
    b: Array
    C: Array
    low: Array
    high: Array
    lower: Array
    upper: Array


@dataclass(frozen=True)
class QpSolution:
    """A solver's answer.

    Attributes:
        x: the minimiser, or the best that was found.
        solved: whether `x` keeps the constraints and is optimal to the solver's tolerance.
        iterations: of the solver.
    """

    x: Array
    solved: bool
    iterations: int


class QpSolver(ABC):
    """Something that solves quadratic programs; answers depend on the program alone, not on earlier ones."""

    @abstractmethod
    def solve(self, program: QuadraticProgram) -> QpSolution:
        """Solve one program."""
