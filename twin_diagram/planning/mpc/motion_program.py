"""The quadratic program of a motion, in few variables and with only those rows that bind.

Minimise, over the free accelerations A (k, n),

    Σ_ij P_ij A_i · A_j / 2 + G · A + Σ_s (linear_s σ_s + square_s σ_s² / 2)    where  rest · A = end,  σ >= 0

and each row r keeps low_r <= left_r · A right_r + σ_slack(r) <= high_r: it takes one combination of times and one of
joints. P, `rest` and the prices of slack σ are constants of a horizon, so what they need is done once: variables are
changed so that the motions that end as asked cost the square of their distance to the best, and rows enter only once
they are broken. The answer is that of the whole program: what breaks no row that was left out is its optimum, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.mpc.quadratic_program import QpSolver, QuadraticProgram
from twin_diagram.signals.arrays import Array, Ints


@dataclass(frozen=True)
class Tuning:
    """When rows enter, chosen by hand."""

    broken: float = 1e-7
    """A row that is broken by more than this enters, in its own units: far below what an arm keeps."""

    rounds: int = 12
    """Times that rows may enter: after some three none is broken any more."""

    endless: float = 1e20
    """Stands for no bound."""


TUNING = Tuning()


@dataclass(frozen=True)
class Rows:
    """Bounds on a motion; R rows.

    Attributes:
        left: (R, k) of times.
        right: (R, n) of joints.
        low, high: (R,) bounds.
        slack: (R,) which slack loosens a row, or −1.
    """

    left: Array
    right: Array
    low: Array
    high: Array
    slack: Ints

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        """Return several as one."""
        fields = [(rows.left, rows.right, rows.low, rows.high, rows.slack) for rows in parts]
        left, right, low, high, slack = (np.concatenate(list(column)) for column in zip(*fields, strict=True))
        return Rows(left, right, low, high, slack)

    @staticmethod
    def of_joints(times: Array, low: Array, high: Array) -> Rows:
        """Return a row for each combination of times (T, k) and each joint, between bounds (T, n)."""
        n = low.shape[1]
        unit = np.tile(np.eye(n), (len(times), 1))
        return Rows(np.repeat(times, n, axis=0), unit, low.ravel(), high.ravel(), np.full(low.size, -1))

    def values(self, A: Array) -> Array:
        """Return (R,) what each row gives for accelerations (k, n), without slack."""
        result: Array = np.einsum("rn,rn->r", self.left @ A, self.right)
        return result


class MotionProgram:
    """What is constant of a horizon's programs.

    Attributes:
        slack_scale, slack_price: (m,) units in which the square of slack costs a half, and its price in these.

    Args:
        P: (k, k) prices of accelerations, the same for each joint.
        rest: (k,) that combination of accelerations which is told.
        slack_linear, slack_square: (m,) prices of slack.
    """

    def __init__(self, P: Array, rest: Array, slack_linear: Array, slack_square: Array) -> None:
        toward = np.linalg.solve(P, rest)
        self._particular = toward / (rest @ toward)
        # Directions that leave `rest` as it is, orthogonal in P.
        free = np.linalg.svd(rest[None])[2][1:].T
        self._W = free @ np.linalg.inv(np.linalg.cholesky(free.T @ P @ free)).T
        self.slack_scale = 1.0 / np.sqrt(slack_square)
        self.slack_price = slack_linear * self.slack_scale

    def solve(self, gradient: Array, end: Array, rows: Rows, solver: QpSolver) -> Array | None:
        """Solve one.

        Args:
            gradient: G, (k, n).
            end: (n,) what `rest · A` must be.
            rows: bounds.
            solver: of dense programs.

        Returns:
            (k, n) accelerations; None where the solver found none.
        """
        base = np.outer(self._particular, end)
        pull = self._W.T @ gradient
        shift = rows.values(base)
        low, high, left = rows.low - shift, rows.high - shift, rows.left @ self._W
        loose = rows.slack >= 0
        scale = np.where(loose, self.slack_scale[rows.slack], 0.0)
        Y, slack = -pull, np.zeros(len(self.slack_scale))
        working = np.zeros(len(low), dtype=bool)
        for _ in range(TUNING.rounds):
            value = np.einsum("rn,rn->r", left @ Y, rows.right) + scale * np.where(loose, slack[rows.slack], 0.0)
            broken = ((value < low - TUNING.broken) | (value > high + TUNING.broken)) & ~working
            if not broken.any():
                return np.asarray(base + self._W @ Y)
            working |= broken
            found = self._solve(pull, left, rows, low, high, scale, np.flatnonzero(working), solver)
            if found is None:
                return None
            Y, slack = found
        return None

    def _solve(
        self,
        pull: Array,
        left: Array,
        rows: Rows,
        low: Array,
        high: Array,
        scale: Array,
        working: npt.NDArray[np.int64],
        solver: QpSolver,
    ) -> tuple[Array, Array] | None:
        """Return the optimum Y and the scaled slacks where the working rows alone count."""
        size, own = pull.size, rows.slack[working]
        names = np.unique(own[own >= 0])
        C = np.zeros((len(working), size + len(names)))
        C[:, :size] = (left[working][:, :, None] * rows.right[working][:, None, :]).reshape(len(working), size)
        with_slack = np.flatnonzero(own >= 0)
        C[with_slack, size + np.searchsorted(names, own[with_slack])] = scale[working[with_slack]]
        solution = solver.solve(
            QuadraticProgram(
                H=np.eye(size + len(names)),
                g=np.concatenate([pull.ravel(), self.slack_price[names]]),
                A=np.zeros((0, size + len(names))),
                b=np.zeros(0),
                C=C,
                low=low[working],
                high=high[working],
                lower=np.concatenate([np.full(size, -TUNING.endless), np.zeros(len(names))]),
                upper=np.full(size + len(names), TUNING.endless),
            )
        )
        if not solution.solved:
            return None
        slack = np.zeros(len(self.slack_scale))
        slack[names] = solution.x[size:]
        return solution.x[:size].reshape(pull.shape), slack
