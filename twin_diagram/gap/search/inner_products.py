"""Inner products of whitened columns and of the residual with them, each worked out once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.signals.arrays import Array


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

    def on_joint(self, order: tuple[int, ...], j: int) -> tuple[npt.NDArray[np.int64], Array]:
        """Return which coefficients matter on a joint, and the inner products (1 + m, 1 + m) of the residual and them.

        Args:
            order: candidates as they are stacked.
            j: joint.
        """
        index: list[int] = []
        signals = [-1]
        start = 0
        for k in order:
            size = self._candidates[k].size
            if j in self._candidates[k].rows:
                signals.append(k)
                index += range(start, start + size)
            start += size
        starts = np.cumsum([0, 1, *(self._candidates[k].size for k in signals[1:])])
        G = np.empty((1 + len(index), 1 + len(index)))
        for x, a in enumerate(signals):
            for y in range(x, len(signals)):
                block = self._block(j, a, signals[y])
                G[starts[x] : starts[x + 1], starts[y] : starts[y + 1]] = block
                if x != y:
                    G[starts[y] : starts[y + 1], starts[x] : starts[x + 1]] = block.T
        return np.array(index, dtype=np.int64), G

    def _block(self, j: int, a: int, b: int) -> Array:
        key = (j, a, b)
        if key not in self._blocks:
            self._blocks[key] = self._signal(j, a).T @ self._signal(j, b)
        return self._blocks[key]

    def _signal(self, j: int, k: int) -> Array:
        """Return (R, m) of a candidate's columns on a joint, or the residual (k = −1)."""
        return self._y[j][:, None] if k < 0 else self._columns[k][self._candidates[k].rows.index(j)]
