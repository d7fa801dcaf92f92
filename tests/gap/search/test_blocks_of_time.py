"""Sums over blocks: several candidates side by side, and all spans at once, say what each alone says."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.search.blocks_of_time import block_edges, block_sums, scores, span_scores, spans, sums_of


def test_candidates_side_by_side_have_the_sums_that_each_alone_has() -> None:
    rng = np.random.default_rng(1)
    Q, y, edges = rng.normal(size=(3, 200, 5)), rng.normal(size=(3, 200)), block_edges(200)
    some = [rng.normal(size=(3, 200, k)) for k in (1, 6, 3)]
    for X, together in zip(some, sums_of(some, Q, y, edges), strict=True):
        for mine, alone in zip(together, block_sums(X, Q, y, edges), strict=True):
            np.testing.assert_allclose(mine, alone, atol=1e-12)
    assert sums_of([], Q, y, edges) == []


def test_all_spans_at_once_score_as_each_of_them_alone_does() -> None:
    rng = np.random.default_rng(2)
    Q = np.linalg.qr(rng.normal(size=(400, 5)))[0].reshape(2, 200, 5)
    X, y, spread = rng.normal(size=(2, 200, 6)), rng.normal(size=(2, 200)), rng.uniform(0.5, 3.0, 6)
    projected, pairs = np.einsum("jrk,jr->k", Q, y), spans()
    found = span_scores(*block_sums(X, Q, y, block_edges(200)), pairs, spread, projected)
    for at in (0, 57, 700, len(pairs) - 1):
        first, last = block_edges(200)[pairs[at]]
        acts = ((np.arange(200) >= first) & (np.arange(200) < last)).astype(float)
        alone = scores(*block_sums(X * acts[None, :, None], Q, y, [0, 200]), spread, projected)
        np.testing.assert_allclose(found[at], alone[0], rtol=1e-9, atol=1e-9)
