"""Sums over blocks of time, so that what acts during any span of them costs one small solution."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.search.normal_equations import increments
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    blocks: int = 64
    """Moments at which an effect is tried to start; refined to single samples afterwards."""

    longest: int = blocks // 2
    """Blocks that a push may last that ends: what goes on for most of a log and ends is no event."""

    margin: int = 3
    """An effect must last, and be preceded by, this many blocks to count as one that starts or ends."""


TUNING = Tuning()


def block_edges(rows: int) -> npt.NDArray[np.int64]:
    """Return (BLOCKS + 1,) bounds of equal blocks of rows."""
    return np.round(np.linspace(0, rows, TUNING.blocks + 1)).astype(np.int64)


def spans() -> npt.NDArray[np.int64]:
    """Return (P, 2) blocks at which a push may begin and end; one that goes on beyond the log may last longer."""
    brief = [(i, k) for i in range(1, TUNING.blocks) for k in range(i + 2, min(i + TUNING.longest, TUNING.blocks) + 1)]
    return np.array(brief + [(i, TUNING.blocks) for i in range(TUNING.margin, TUNING.blocks - TUNING.longest)])


def block_sums(
    X: Array, Q: Array, y: Array, edges: Sequence[int] | npt.NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Return per block the information (B, k, k) of columns X (rows, R, k), and their products with Q and y."""
    G, C, b = [], [], []
    for first, last in itertools.pairwise(edges):
        part = X[:, first:last].reshape(-1, X.shape[2])
        G.append(part.T @ part)
        C.append(Q[:, first:last].reshape(-1, Q.shape[2]).T @ part)
        b.append(part.T @ y[:, first:last].ravel())
    return np.array(G), np.array(C), np.array(b)


def sums_of(
    columns: Sequence[Array], Q: Array, y: Array, edges: Sequence[int] | npt.NDArray[np.int64]
) -> list[tuple[Array, Array, Array]]:
    """Return what `block_sums` does of several candidates of the same joints, worked out side by side."""
    if not columns:
        return []
    G, C, b = block_sums(np.concatenate(columns, axis=2), Q, y, edges)
    ends = np.cumsum([0, *(X.shape[2] for X in columns)])
    some = (slice(first, last) for first, last in itertools.pairwise(ends))
    return [(G[:, own, own], C[:, :, own], b[:, own]) for own in some]


def scores(G: Array, C: Array, b: Array, spread: Array, projected: Array) -> Array:
    """Return rises of the evidence (B,), for sums over spans of time."""
    rest = C.transpose(0, 2, 1) @ C
    return increments(G - rest, b - np.einsum("bki,k->bi", C, projected), np.broadcast_to(spread, b.shape))


def span_scores(G: Array, C: Array, b: Array, pairs: npt.NDArray[np.int64], spread: Array, projected: Array) -> Array:
    """Return rises of the evidence (P,) by what acts from one block to another.

    Args:
        G: (B, k, k) of each block, see `block_sums`.
        C: (B, K, k) likewise.
        b: (B, k) likewise.
        pairs: (P, 2) blocks, see `spans`.
        spread: (k,) of the prior.
        projected: (K,) Qᵀy of the hypothesis that it would join.
    """
    G, C, b = (np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)]) for x in (G, C, b))
    first, last = pairs[:, 0], pairs[:, 1]
    flat = C.transpose(1, 0, 2).reshape(C.shape[1], -1)
    # What the hypothesis takes of each pair of sums, once: pair by pair, it would take as many products as pairs.
    shared = (flat.T @ flat).reshape(len(C), C.shape[2], len(C), C.shape[2])
    rest = shared[last, :, last] + shared[first, :, first] - shared[last, :, first] - shared[first, :, last]
    told = b - np.einsum("bki,k->bi", C, projected)
    return increments(
        G[last] - G[first] - rest, told[last] - told[first], np.broadcast_to(spread, (len(pairs), len(spread)))
    )
