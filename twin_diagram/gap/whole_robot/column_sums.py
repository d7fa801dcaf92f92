"""Squares and products of the columns of equations, summed up per group of samples, and again where few change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

Places = npt.NDArray[np.int64]


def summed(columns: Array, weights: Array, group: Places) -> Array:
    """Return (G, n, K, K) weighted squares and products of columns (N, n, K) over each of groups (N,), from 0."""
    count = int(np.max(group)) + 1
    result = np.empty((count, columns.shape[1], columns.shape[2], columns.shape[2]))
    for one in range(count):
        here = group == one
        some = columns[here].transpose(1, 2, 0)
        np.matmul(some * weights[here].T[:, None], some.transpose(0, 2, 1), out=result[one])
    return result


def summed_again(before: Array, was: Sequence[int], columns: Array, weights: Array, group: Places) -> Array:
    """Return the same as `summed`, of columns of which most are in sums already: what is new costs alone.

    Args:
        before: (G, n, L, L) sums.
        was: (K,) where among their L columns each is, −1 where it is new.
        columns: (N, n, K).
        weights: (N, n).
        group: (N,) as of the sums.
    """
    result = np.empty((*before.shape[:2], len(was), len(was)))
    runs, new = _runs(was), np.flatnonzero(np.asarray(was) < 0)
    for to, at in runs:
        for other_to, other_at in runs:
            result[:, :, to, other_to] = before[:, :, at, other_at]
    if not len(new):
        return result
    for one in range(len(before)):
        here = np.flatnonzero(group == one)
        there = columns[here]
        mine = there[:, :, new] * weights[here][:, :, None]
        cross = there.transpose(1, 2, 0) @ mine.transpose(1, 0, 2)
        result[one][:, :, new] = cross
        result[one][:, new] = cross.transpose(0, 2, 1)
    return result


def _runs(was: Sequence[int]) -> list[tuple[slice, slice]]:
    """Return slices of columns that follow each other now and before, each with where they were."""
    result: list[tuple[slice, slice]] = []
    for to, at in enumerate(was):
        if at < 0:
            continue
        if result and (result[-1][0].stop, result[-1][1].stop) == (to, at):
            result[-1] = slice(result[-1][0].start, to + 1), slice(result[-1][1].start, at + 1)
        else:
            result.append((slice(to, to + 1), slice(at, at + 1)))
    return result
