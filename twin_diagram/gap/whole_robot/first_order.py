"""What a candidate brings beside fits that leave kinds of motion out, to first order: which are worth a fit in full."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.whole_robot.left_out import LeftOut, likelihood
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, coupling
from twin_diagram.gap.whole_robot.torque_equations import OWN, TorqueEquations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ReadyFits:
    """Left-out fits to first order, ready for one candidate after the other.

    Attributes:
        left_out: the fits.
        moving: per kind of motion left out, which coordinates move.
        inverses: per kind, of the normal matrix of those.
        slopes: per kind (10 n, 10 n), of links' parameters by their coordinates.
        full: (F, n, K + 1) what each fit makes of the columns: less its parameters, and 1 for the residual.
    """

    left_out: LeftOut
    moving: list[npt.NDArray[np.int64]]
    inverses: list[Array]
    slopes: list[Array]
    full: Array

    @staticmethod
    def of(left_out: LeftOut) -> ReadyFits:
        """Make fits ready."""
        problem = left_out.problem
        moving = [np.flatnonzero(problem.free & (z > problem.lower)) for z in left_out.fits]
        inverses = []
        for some, (H, _) in zip(moving, left_out.systems, strict=True):
            inner = H[np.ix_(some, some)]
            scale = np.sqrt(np.diag(inner))
            inverses.append(np.linalg.inv(inner / np.outer(scale, scale)) / np.outer(scale, scale))
        full = [np.concatenate([-problem.difference(z), np.ones((problem.n, 1))], axis=1) for z in left_out.fits]
        return ReadyFits(left_out, moving, inverses, [problem.slope(z) for z in left_out.fits], np.stack(full))

    def gain(self, candidate: Candidate) -> float:
        """Return the rise of the left-out log likelihood that a candidate brings beside all that is free.

        Its columns are summed up once per kind of motion; what is fitted sees the sums alone.
        """
        problem, sums = self.left_out.problem, self.left_out.problem.sums
        crosses, owns = candidate_sums(sums, candidate)
        rows = list(candidate.rows)
        weight = (problem.share / problem.variance)[rows][:, None, None]
        squares = np.zeros(problem.n)
        prior = np.diag(candidate.spread**-2.0)
        for k, (some, inverse, slope, full) in enumerate(
            zip(self.moving, self.inverses, self.slopes, self.full, strict=True)
        ):
            cross, own = (np.sum(x, axis=0) - x[k] for x in (crosses, owns))
            cross = cross * weight
            B = coupling(problem, rows, slope, cross)[some]
            solved = inverse @ B
            S = np.sum(own * weight, axis=0) + prior - B.T @ solved
            right = np.einsum("jk,jkm->m", full[rows], cross)
            c = np.clip(np.linalg.lstsq(S, right, rcond=1e-9)[0], candidate.lower, candidate.upper)
            step = np.zeros(len(problem.mean))
            step[some] = solved @ c
            moved = full + settled(problem, slope, step)
            squares += np.sum((moved[:, None] @ sums.of_kinds[k])[:, 0] * moved, axis=1)
            mixed = np.einsum("jk,jkm,m->j", moved[rows], crosses[k], c)
            squares[rows] += np.einsum("m,jml,l->j", c, owns[k], c) - 2.0 * mixed
        rms = np.sqrt(np.maximum(squares, 1e-30) / sums.counted)
        return float(np.sum(likelihood(problem, rms)) - self.left_out.score())


def settled(problem: RobotProblem, slope: Array, step: Array) -> Array:
    """Return (n, K + 1) by which what a fit makes of the columns changes where coordinates go back by a step (Z,)."""
    n = problem.n
    links = np.broadcast_to(slope @ step[: 10 * n], (n, 10 * n))
    further = np.broadcast_to(step[14 * n :], (n, len(step) - 14 * n))
    own = step[10 * n : 14 * n].reshape(n, len(OWN))
    return np.concatenate([links, own, further, np.zeros((n, 1))], axis=1)


def candidate_sums(sums: TorqueEquations, candidate: Candidate) -> tuple[Array, Array]:
    """Return per kind of motion a candidate's products: with all columns (F, r, K + 1, k), and its own (F, r, k, k)."""
    rows = list(candidate.rows)
    kind = sums.fold[sums.stretch]
    weighted = candidate.columns * sums.weights[:, rows, None]
    cross, own = [], []
    for k in sums.kinds:
        some = kind == k
        mine = weighted[some].transpose(1, 0, 2)
        cross.append(sums.columns[some][:, rows].transpose(1, 2, 0) @ mine)
        own.append(candidate.columns[some].transpose(1, 2, 0) @ mine)
    return np.stack(cross), np.stack(own)
