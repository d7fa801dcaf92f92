"""Whitened columns of the candidates that are offered to a search, side by side, so that all are scored at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Group:
    """Candidates of one joint alone and of one number k of coefficients, side by side.

    Attributes:
        joint: whose torque they change.
        indices: (m,) of the candidates.
        columns: (R, m k).
        own: (m, k, k) inner products of each one's columns.
        right: (m, k) of them and the residual.
        spread: (m, k) of the priors.
        lower, upper: (m, k) what coefficients may be.
        conditional: places of those that there are further conditions on.
    """

    joint: int
    indices: npt.NDArray[np.int64]
    columns: Array
    own: Array
    right: Array
    spread: Array
    lower: Array
    upper: Array
    conditional: tuple[int, ...]


class OfferedColumns:
    """Knows which candidates are offered, and keeps their columns stacked until another one is."""

    def __init__(
        self, shape: tuple[int, int], candidates: list[Candidate], columns: list[Array], right: list[Array]
    ) -> None:
        """Start without an offer.

        Args:
            shape: (n, R) of the whitened residual.
            candidates: may grow; `add` follows.
            columns: (rows, R, k) of each, whitened; grows with them.
            right: (k,) inner products of each one's columns with the residual; grows with them.
        """
        self._shape = shape
        self._candidates = candidates
        self._columns = columns
        self._right = right
        self._offered: list[bool] = []
        self._several: tuple[list[int], Array] | None = None
        self._groups: list[Group] | None = None
        self._beside: dict[int, Array] = {}

    def add(self, offered: bool) -> None:
        """Note whether the next candidate is offered."""
        self._offered.append(offered)
        if offered:
            self._forget()

    def offer(self, k: int) -> None:
        """Offer a candidate that was taken in without being offered."""
        self._offered[k] = True
        self._forget()

    def _forget(self) -> None:
        """Drop what was stacked before another candidate was offered."""
        self._groups = self._several = None
        self._beside = {}

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

    def beside(self, k: int) -> Array:
        """Return inner products (size, M) of a candidate's columns with those of `by_joint`, then of `wide`.

        All hypotheses that it is in share them.
        """
        if k not in self._beside:
            rows, own, of_joint = self._candidates[k].rows, self._columns[k], self.by_joint()
            zeros = np.zeros((own.shape[2], 0))
            parts = [
                own[rows.index(group.joint)].T @ group.columns
                if group.joint in rows
                else np.zeros((own.shape[2], group.columns.shape[1]))
                for group in of_joint
            ]
            wide = self.wide()[1].reshape(*self._shape, -1)[list(rows)]
            last = own.reshape(-1, own.shape[2]).T @ wide.reshape(-1, wide.shape[2]) if wide.shape[2] else zeros
            self._beside[k] = np.concatenate([*parts, last], axis=1)
        return self._beside[k]

    def width(self) -> int:
        """Return the number M of columns that are offered."""
        return sum(group.columns.shape[1] for group in self.by_joint()) + self.wide()[1].shape[1]

    def by_joint(self) -> list[Group]:
        """Return candidates of one row, by joint and number of coefficients, side by side."""
        if self._groups is None:
            keys: dict[tuple[int, int], list[int]] = {}
            for k, candidate in enumerate(self._candidates):
                if len(candidate.rows) == 1 and self._offered[k]:
                    keys.setdefault((candidate.rows[0], candidate.size), []).append(k)
            self._groups = [self._side_by_side(j, size, indices) for (j, size), indices in keys.items()]
        return self._groups

    def _side_by_side(self, joint: int, size: int, indices: list[int]) -> Group:
        X = np.concatenate([self._columns[k][0] for k in indices], axis=1)
        parts = X.reshape(len(X), len(indices), size).transpose(1, 2, 0)
        there = [self._candidates[k] for k in indices]
        return Group(
            joint,
            np.array(indices),
            X,
            own=parts @ parts.transpose(0, 2, 1),
            right=np.stack([self._right[k] for k in indices]),
            spread=np.stack([candidate.spread for candidate in there]),
            lower=np.stack([candidate.lower for candidate in there]),
            upper=np.stack([candidate.upper for candidate in there]),
            conditional=tuple(at for at, candidate in enumerate(there) if candidate.admits is not None),
        )
