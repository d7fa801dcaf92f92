"""Inner products of whitened columns and of the residual with them, each worked out once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.signals.arrays import Array

REMEMBERED = 500
"""Joints' inner products that are kept, of some tens of kilobytes each: those of a step's hypotheses."""


class InnerProducts:
    """Remembers the inner products that hypotheses share."""

    def __init__(self, y: Array, candidates: list[Candidate], columns: list[Array]) -> None:
        """Take what the products are of.

        Args:
            y: (n, R) whitened residual.
            candidates: may grow.
            columns: (rows, R, k) of each, whitened; grows with them.
        """
        self._y = y
        self._candidates = candidates
        self._columns = columns
        self._grams: dict[tuple[int, int], Array] = {}
        self._blocks: dict[tuple[int, int, int], Array] = {}
        self._rows: list[npt.NDArray[np.int64]] = []
        self._joints: dict[tuple[int, tuple[int, ...]], Array] = {}

    def gram(self, i: int, k: int) -> Array:
        """Return the inner products of two candidates' columns over all joints."""
        if (i, k) not in self._grams:
            a, b = self._candidates[i], self._candidates[k]
            shared = [(a.rows.index(j), b.rows.index(j)) for j in a.rows if j in b.rows]
            result = np.zeros((a.size, b.size))
            for x, y in shared:
                result += self._columns[i][x].T @ self._columns[k][y]
            self._grams[i, k] = result
            self._grams[k, i] = result.T
        return self._grams[i, k]

    def stacked(self, order: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """Return per joint the residual's square (n,), its products with all columns (n, K), and theirs (n, K, K).

        Args:
            order: candidates as they are stacked; 0 stands where one does nothing to a joint.
        """
        n, sizes = len(self._y), [self._candidates[k].size for k in order]
        total = sum(sizes)
        square, right, between = np.empty(n), np.zeros((n, total)), np.zeros((n, total, total))
        acts = np.zeros((len(order), n), dtype=bool)
        for at, k in enumerate(order):
            acts[at, self._rows_of(k)] = True
        of_columns = np.repeat(acts, sizes, axis=0)
        for j in range(n):
            G = self._on_joint(j, tuple(k for k, there in zip(order, acts[:, j].tolist(), strict=True) if there))
            square[j] = G[0, 0]
            if len(G) == total + 1:
                right[j], between[j] = G[0, 1:], G[1:, 1:]
                continue
            index = np.flatnonzero(of_columns[:, j])
            right[j, index] = G[0, 1:]
            between[j, index[:, None], index] = G[1:, 1:]
        return square, right, between

    def _rows_of(self, k: int) -> npt.NDArray[np.int64]:
        """Return the joints whose torque a candidate changes, as an index."""
        while len(self._rows) <= k:
            self._rows.append(np.array(self._candidates[len(self._rows)].rows, dtype=np.int64))
        return self._rows[k]

    def _on_joint(self, j: int, there: tuple[int, ...]) -> Array:
        """Return the inner products (1 + m, 1 + m) of the residual and of candidates' columns on a joint.

        Hypotheses that are solved one after the other differ on few joints.
        """
        known = self._joints.get((j, there))
        if known is not None:
            return known
        signals = (-1, *there)
        starts = np.cumsum([0, 1, *(self._candidates[k].size for k in there)])
        G = np.empty((starts[-1], starts[-1]))
        for x, a in enumerate(signals):
            for y in range(x, len(signals)):
                block = self._block(j, a, signals[y])
                G[starts[x] : starts[x + 1], starts[y] : starts[y + 1]] = block
                if x != y:
                    G[starts[y] : starts[y + 1], starts[x] : starts[x + 1]] = block.T
        if len(self._joints) >= REMEMBERED:
            self._joints.clear()
        self._joints[j, there] = G
        return G

    def _block(self, j: int, a: int, b: int) -> Array:
        key = (j, a, b)
        if key not in self._blocks:
            self._blocks[key] = self._signal(j, a).T @ self._signal(j, b)
        return self._blocks[key]

    def _signal(self, j: int, k: int) -> Array:
        """Return (R, m) of a candidate's columns on a joint, or the residual (k = −1)."""
        return self._y[j][:, None] if k < 0 else self._columns[k][self._candidates[k].rows.index(j)]
