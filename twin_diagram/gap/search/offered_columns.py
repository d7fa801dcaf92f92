"""Whitened columns of the candidates that are offered to a search, side by side, so that all are scored at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.signals.arrays import Array

Group = tuple[int, int, npt.NDArray[np.int64], Array, Array]
"""Joint, number k of coefficients, indices (m,) of candidates, their columns (R, m k) side by side, and each one's
inner products (m, k, k)."""


class OfferedColumns:
    """Knows which candidates are offered, and keeps their columns stacked until another one is."""

    def __init__(self, shape: tuple[int, int], candidates: list[Candidate], columns: list[Array]) -> None:
        """Start without an offer.

        Args:
            shape: (n, R) of the whitened residual.
            candidates: may grow; `add` follows.
            columns: (rows, R, k) of each, whitened; grows with them.
        """
        self._shape = shape
        self._candidates = candidates
        self._columns = columns
        self._offered: list[bool] = []
        self._several: tuple[list[int], Array] | None = None
        self._groups: list[Group] | None = None

    def add(self, offered: bool) -> None:
        """Note whether the next candidate is offered."""
        self._offered.append(offered)
        if offered:
            self._groups = self._several = None

    def offer(self, k: int) -> None:
        """Offer a candidate that was taken in without being offered."""
        self._offered[k] = True
        self._groups = self._several = None

    def __contains__(self, k: int) -> bool:
        """Return whether a candidate is offered."""
        return self._offered[k]

    def wide(self) -> tuple[list[int], Array]:
        """Return candidates of several rows, and their columns (n R, M) side by side."""
        if self._several is None:
            n, rows = self._shape
            indices = [k for k, c in enumerate(self._candidates) if len(c.rows) > 1 and self._offered[k]]
            stacked = np.zeros((n, rows, sum(self._candidates[k].size for k in indices)))
            start = 0
            for k in indices:
                size = self._candidates[k].size
                stacked[list(self._candidates[k].rows), :, start : start + size] = self._columns[k]
                start += size
            self._several = indices, stacked.reshape(n * rows, stacked.shape[2])
        return self._several

    def by_joint(self) -> list[Group]:
        """Return candidates of one row, by joint and number of coefficients, side by side."""
        if self._groups is None:
            keys: dict[tuple[int, int], list[int]] = {}
            for k, candidate in enumerate(self._candidates):
                if len(candidate.rows) == 1 and self._offered[k]:
                    keys.setdefault((candidate.rows[0], candidate.size), []).append(k)
            self._groups = []
            for (j, size), indices in keys.items():
                X = np.concatenate([self._columns[k][0] for k in indices], axis=1)
                parts = X.reshape(len(X), len(indices), size).transpose(1, 2, 0)
                self._groups.append((j, size, np.array(indices), X, parts @ parts.transpose(0, 2, 1)))
        return self._groups
