"""Which parameters changed: against likelihood ratios by least squares over all messages."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from twin_diagram.estimation.filter.fault_isolation import alarming, keep_score, suspects
from twin_diagram.signals.arrays import Array

GROUPS = [slice(0, 2), slice(2, 3), slice(3, 4)]


def ratio(rows: list[Array], whites: list[Array], at: Array) -> float:
    """2 log of the likelihood ratio, messages weighted by 0.9 each, and as much wider as forgetting made it."""
    weight = np.sqrt(0.9 ** np.arange(len(rows))[::-1])
    W = np.vstack([w * row[:, at] for w, row in zip(weight, rows, strict=True)])
    y = np.concatenate([w * row for w, row in zip(weight, whites, strict=True)])
    best = np.linalg.lstsq(W, y, rcond=None)[0]
    return float(1.9 * (y @ y - np.sum((y - W @ best) ** 2)))


def drawn(seed: int, delta: Array, count: int = 40) -> tuple[list[Array], list[Array], Array]:
    rng, score = np.random.default_rng([1311, seed]), np.zeros((4, 5))
    rows = [rng.normal(size=(3, 4)) * [1.0, 20.0, 1.0, 1e-3] for _ in range(count)]
    whites = [row @ delta + rng.normal(size=3) for row in rows]
    for row, white in zip(rows, whites, strict=True):
        keep_score(score, row, white)
    return rows, whites, score


def test_scores_are_sums_with_forgetting_of_shortened_innovations() -> None:
    score = np.zeros((1, 2))
    for length in (3.0, 400.0, 20.0):
        keep_score(score, np.array([[1.0], [2.0]]), np.array([0.6, 0.8]) * length)
    np.testing.assert_allclose(score[0], [5.0 * (0.81 + 0.9 + 1.0), 2.2 * (3.0 * 0.81 + 20.0 * 0.9 + 20.0)])


@pytest.mark.parametrize("size", [1, 2])
@pytest.mark.parametrize(("share", "says"), [(0.99, False), (1.01, True), (-1.01, True)])
def test_it_alarms_beyond_what_happens_once_in_a_billion(size: int, share: float, says: bool) -> None:
    """Information of one unit along each direction; white noise has the gradient's square over it at χ² / 1.9."""
    gradient = np.zeros(size)
    gradient[0] = np.sign(share) * np.sqrt(abs(share) * chi2.isf(1e-9, size) / 1.9)
    score = np.column_stack([np.eye(size), gradient])
    assert alarming(score, [slice(0, size)]) == says
    scale = np.diag(np.linspace(1e-3, 1e4, size)) if size > 1 else np.array([[1e5]])
    scaled = np.column_stack([scale @ scale, scale @ gradient])  # other units, the same answer
    assert alarming(scaled, [slice(0, size)]) == says
    assert not alarming(score, [slice(1, size)] if size > 1 else [])


def test_parameters_in_a_group_are_weighed_with_what_they_have_in_common() -> None:
    for seed in range(6):
        rows, whites, score = drawn(seed, np.array([0.4, 0.01, 0.0, 0.0]))
        limit = chi2.isf(1e-9, 2)
        found = ratio(rows, whites, np.arange(2))
        assert alarming(score, GROUPS[:1]) == (found > limit)
        for target in (0.99, 1.01):
            grown = score.copy()
            grown[:, -1] *= np.sqrt(target * limit / found)
            assert alarming(grown, GROUPS[:1]) == (target > 1.0)


def test_what_no_reading_told_of_alarms_nothing() -> None:
    assert not alarming(np.zeros((4, 5)), GROUPS)
    assert suspects(np.zeros((4, 5)), GROUPS).sum() == 1


def chosen(rows: list[Array], whites: list[Array]) -> Array:
    """The choice by likelihood ratios, one group after the other; two for each parameter are for nothing."""
    sizes = np.array([2, 1, 1])
    inside = [np.arange(group.start, group.stop) for group in GROUPS]
    first = np.array([ratio(rows, whites, at) for at in inside]) - 2.0 * sizes
    changed = np.zeros(4, dtype=bool)
    for at, gain in zip(inside, first, strict=True):
        if gain > 0.0 and gain >= first.max() - 9.0:
            changed[at] = True
    if not changed.any():
        changed[inside[int(np.argmax(first))]] = True
    while not changed.all():
        base = ratio(rows, whites, np.flatnonzero(changed))
        gains = []
        for at, size in zip(inside, sizes, strict=True):
            more = changed.copy()
            more[at] = True
            done = bool(changed[at].all())
            gains.append(-np.inf if done else ratio(rows, whites, np.flatnonzero(more)) - base - 2.0 * size)
        if max(gains) < 16.0:
            break
        changed[inside[int(np.argmax(gains))]] = True
    return changed


def test_suspects_are_those_of_the_likelihood_ratios() -> None:
    rng, seen = np.random.default_rng(1312), []
    for seed in range(90):
        size = 10.0 ** rng.uniform(-1.5, 0.3, 4) * rng.choice([0.0, 1.0], 4, p=[0.4, 0.6]) / [1.0, 20.0, 1.0, 1e-3]
        rows, whites, score = drawn(seed + 50, size)
        if max(float(np.linalg.norm(white)) for white in whites) > 20.0:
            continue
        found, expected = suspects(score, GROUPS), chosen(rows, whites)
        np.testing.assert_array_equal(found, expected)
        seen.append(tuple(found))
    assert len(seen) > 40 and len(set(seen)) >= 6


@pytest.mark.parametrize(
    ("gains", "found"),
    [
        ((30.0, 21.5), (True, True)),  # within nine of the best
        ((30.0, 20.5), (True, True)),  # beyond it, but worth sixteen by itself
        ((30.0, 15.5), (True, False)),
        ((30.0, 16.5), (True, True)),
        ((5.0, 0.1), (True, True)),
        ((5.0, -0.1), (True, False)),
        ((-0.5, -1.0), (True, False)),  # if any, the first
    ],
)
def test_borders_of_the_choice(gains: tuple[float, float], found: tuple[bool, bool]) -> None:
    """Two parameters that have nothing in common: their ratios, less two, as here."""
    gradient = np.sqrt((np.array(gains) + 2.0) / 1.9)
    score = np.column_stack([np.eye(2), gradient])
    assert tuple(suspects(score, [slice(0, 1), slice(1, 2)])) == found
