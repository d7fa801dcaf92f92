"""What a candidate brings beside fits that leave kinds of motion out, to first order: which are worth a fit in full."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.whole_robot.left_out import LeftOut, likelihood
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, coupling
from twin_diagram.gap.whole_robot.physical_links import slopes
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class ReadyFits:
    """Left-out fits to first order, ready for one candidate after the other.

    Attributes:
        left_out: the fits.
        inverses: (F, Z, Z) per kind of motion left out, of the normal matrix; 0 where a coordinate does not move.
        slopes: (F, n, 10, 10) of links' parameters by their coordinates.
        full: (F, n, K + 1) what each fit makes of the columns: less its parameters, and 1 for the residual.
        order: (N,) samples, sorted by kinds of motion.
        begins: (F + 1,) where in that order each kind begins, and the last one ends.
    """

    left_out: LeftOut
    inverses: Array
    slopes: Array
    full: Array
    order: npt.NDArray[np.int64]
    begins: npt.NDArray[np.int64]

    @staticmethod
    def of(left_out: LeftOut) -> ReadyFits:
        """Make fits ready."""
        problem, n = left_out.problem, left_out.problem.n
        inverses = np.zeros((len(left_out.fits), len(problem.mean), len(problem.mean)))
        for inverse, z, (H, _) in zip(inverses, left_out.fits, left_out.systems, strict=True):
            some = np.flatnonzero(problem.free & (z > problem.lower))
            inner = H[np.ix_(some, some)]
            scale = np.sqrt(np.diag(inner))
            size = np.outer(scale, scale)
            inverse[np.ix_(some, some)] = np.linalg.inv(inner / size) / size
        full = [np.concatenate([-problem.difference(z), np.ones((n, 1))], axis=1) for z in left_out.fits]
        blocks = [slopes(z[: 10 * n].reshape(n, 10)) for z in left_out.fits]
        kind = problem.sums.kind
        begins = np.concatenate([[0], np.cumsum(np.bincount(kind, minlength=len(full)))])
        order = np.argsort(kind, kind="stable")
        return ReadyFits(left_out, inverses, np.stack(blocks), np.stack(full), order, begins)

    def gain(self, candidate: Candidate) -> float:
        """Return the rise of the left-out log likelihood that a candidate brings beside all that is free.

        Its columns are summed up once per kind of motion; what is fitted sees the sums alone.
        """
        problem, sums = self.left_out.problem, self.left_out.problem.sums
        crosses, owns = self.sums_of(candidate)
        rows = list(candidate.rows)
        weight = (problem.share / problem.variance)[rows][:, None, None]
        cross, own = ((np.sum(x, axis=0) - x) * weight for x in (crosses, owns))
        B = couplings(problem, rows, self.slopes, cross)
        solved = self.inverses @ B
        S = np.sum(own, axis=1) + np.diag(candidate.spread**-2.0) - B.transpose(0, 2, 1) @ solved
        right = np.einsum("fjk,fjkm->fm", self.full[:, rows], cross)
        c = np.linalg.pinv(S, rcond=1e-9, hermitian=True) @ right[:, :, None]
        c = np.clip(c, candidate.lower[:, None], candidate.upper[:, None])
        moved = self.full + settled(problem, self.slopes, (solved @ c)[:, :, 0])
        squares = np.sum((moved[:, :, None] @ sums.of_kinds)[:, :, 0] * moved, axis=(0, 2))
        columns = (crosses @ c[:, None])[..., 0]
        squares[rows] -= 2.0 * np.einsum("fjk,fjk->j", moved[:, rows], columns)
        squares[rows] += np.einsum("fm,fjml,fl->j", c[..., 0], owns, c[..., 0])
        rms = np.sqrt(np.maximum(squares, 1e-30) / sums.counted)
        return float(np.sum(likelihood(problem, rms)) - self.left_out.score())

    def sums_of(self, candidate: Candidate) -> tuple[Array, Array]:
        """Return per kind of motion products with all columns (F, r, K + 1, k), and its own (F, r, k, k)."""
        sums, rows = self.left_out.problem.sums, list(candidate.rows)
        cross, own = [], []
        for begin, end in itertools.pairwise(map(int, self.begins)):
            some = self.order[begin:end]
            mine = candidate.columns[some]
            weighted = (mine * sums.weights[some][:, rows, None]).transpose(1, 0, 2)
            cross.append(sums.columns[some][:, rows].transpose(1, 2, 0) @ weighted)
            own.append(mine.transpose(1, 2, 0) @ weighted)
        return np.stack(cross), np.stack(own)


def couplings(problem: RobotProblem, rows: list[int], slopes: Array, cross: Array) -> Array:
    """Return (F, Z, k) `coupling` of each of some fits (F, …)."""
    return np.stack([coupling(problem, rows, *one) for one in zip(slopes, cross, strict=True)])


def settled(problem: RobotProblem, slopes: Array, step: Array) -> Array:
    """Return (F, n, K + 1) by which what fits make of the columns changes where coordinates go back by (F, Z)."""
    n, count = problem.n, len(step)
    links = (slopes @ step[:, : 10 * n].reshape(count, n, 10, 1)).reshape(count, 1, 10 * n)
    own = step[:, 10 * n : 14 * n].reshape(count, n, len(OWN))
    further = step[:, None, 14 * n :]
    return np.concatenate(
        [
            np.broadcast_to(links, (count, n, 10 * n)),
            own,
            np.broadcast_to(further, (count, n, further.shape[2])),
            np.zeros((count, n, 1)),
        ],
        axis=2,
    )
