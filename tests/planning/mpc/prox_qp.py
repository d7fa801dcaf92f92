"""ProxQP behind the planner's interface: an independent solver, which the planner's own is compared with."""

from __future__ import annotations

import sys
import types
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin_diagram.planning.mpc.quadratic_program import QpSolution, QpSolver, QuadraticProgram
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ProxTuning:
    """Scaling of the objective, chosen by hand: with less, ProxQP stopped far from the optimum.

    `tests/planning` compares its answers with an independent solver's.
    """

    curvature: float = 0.1
    """The objective is scaled so that its weakest curvature is this [1]."""


TUNING = ProxTuning()


class ProxQp(QpSolver):
    """ProxQP's dense solver (Bambade et al., ProxQP: yet another quadratic programming solver, RSS 2022).

    It stops by absolute residuals, and by itself does not look at complementarity: with a weakly curved objective it
    calls answers solved that are far off. So the objective is scaled to a curvature of at least `ProxTuning.curvature`,
    the duality gap has to close, and each bound that pulls has to be met: in the gap, pulls of either sign by bounds
    that are not met cancel (with residuals of 1e-8 in 4 of 1000 drawn programs).

    Args:
        tolerance: of the residuals, in the units of the constraints and of the scaled gradient.
        gap: of the scaled objective, and of each bound's pull or distance, whichever is less.
        iterations: at most.
    """

    def __init__(self, tolerance: float = 1e-10, gap: float = 1e-7, iterations: int = 400) -> None:
        self._proxqp = _repeatable_proxqp()
        self._tolerance, self._gap = tolerance, gap
        self._iterations = iterations

    def solve(self, program: QuadraticProgram) -> QpSolution:
        """Solve one program, see `QpSolver`."""
        size = len(program.g)
        solver = self._proxqp.dense.QP(size, len(program.b), len(program.low), True)
        settings = solver.settings
        settings.eps_abs = self._tolerance
        settings.eps_rel = 0.0
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs = self._gap
        settings.eps_duality_gap_rel = 0.0
        settings.max_iter = self._iterations
        settings.initial_guess = self._proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        weakest = float(np.diag(program.H).min())
        scale = TUNING.curvature / weakest if weakest > 0.0 else 1.0
        solver.init(
            scale * program.H,
            scale * program.g,
            program.A,
            program.b,
            program.C,
            program.low,
            program.high,
            program.lower,
            program.upper,
        )
        solver.solve()
        info = solver.results.info
        x = np.array(solver.results.x, dtype=float)
        solved = info.status == self._proxqp.QPSolverOutput.PROXQP_SOLVED and bool(np.isfinite(x).all())
        met = solved and _pulled_apart(program, x, np.array(solver.results.z)) <= self._gap
        return QpSolution(x, met, int(info.iter))


def _pulled_apart(program: QuadraticProgram, x: Array, z: Array) -> float:
    """Return the lesser of a bound's pull and of how far from it the answer is, of the bound where that is most.

    Args:
        program: with m rows, beside the bounds on x.
        x: (n,) the answer.
        z: (m + n,) pull of each bound, positive towards lower values.
    """
    at = np.concatenate([program.C @ x, x])
    low, high = np.concatenate([program.low, program.lower]), np.concatenate([program.high, program.upper])
    room = np.where(z > 0.0, high - at, at - low)
    return float(np.minimum(np.abs(z), np.abs(room)).max(initial=0.0))


def _repeatable_proxqp() -> Any:
    """ProxQP's module, in the build without wide vectors.

    The builds for AVX2 and AVX-512 sum in an order that depends on where in memory a matrix happens to lie, so that
    equal programs get answers that differ in the last bits, and two equal runs drift apart. The plain build does not,
    at 1.5 times the time. The package picks its build by asking its module `instructionset`; this answers in its
    place. Where somebody has imported proxsuite before, that build is used, for two of them do not fit into one
    process.
    """
    if "proxsuite" not in sys.modules:
        name = "proxsuite.instructionset"
        none: Any = types.ModuleType(name)
        none.has_AVX512F = none.has_AVX2 = lambda: False
        sys.modules[name] = none
        try:
            import proxsuite
        finally:
            del sys.modules[name]
    import proxsuite

    return proxsuite.proxqp
