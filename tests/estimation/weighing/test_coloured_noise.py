"""Noise with memory, found and taken out."""

from __future__ import annotations

import numpy as np
import scipy

from twin_diagram.estimation.weighing.coloured_noise import Colour


def coloured(count: int, seed: int) -> np.ndarray:
    white = np.random.default_rng(seed).normal(size=count + 100)
    return np.asarray(scipy.signal.lfilter([0.3], [1.0, -1.2, 0.5], white))[100:]


def test_the_memory_of_noise_is_found() -> None:
    found = Colour.of([coloured(3000, 0), coloured(3000, 1)])
    np.testing.assert_allclose(found.memory[:2], [1.2, -0.5], atol=0.04)
    assert abs(found.sigma - 0.3) < 0.01
    assert abs(found.size - np.std(coloured(6000, 2))) < 0.05 * found.size


def test_what_is_whitened_is_white_and_of_size_one() -> None:
    found = Colour.of([coloured(5000, 3)])
    white = found.whitened(coloured(5000, 4)[:, None])[:, 0]
    assert len(white) == 5000 - len(found.memory)
    assert abs(np.std(white) - 1.0) < 0.05
    for lag in (1, 2, 3):
        assert abs(white[lag:] @ white[:-lag]) / len(white) < 0.05


def test_white_noise_stays_as_it_is_and_none_is_no_division_by_zero() -> None:
    assert len(Colour.of([np.random.default_rng(0).normal(size=2000)]).memory) == 0
    still = Colour.of([np.zeros(100)])
    assert np.all(np.isfinite(still.whitened(np.ones((10, 2)))))
    np.testing.assert_allclose(Colour.white(0.5).whitened(np.ones((3, 1))), 2.0)


def test_a_few_far_residuals_are_no_noise() -> None:
    spoilt = coloured(4000, 5)
    spoilt[::200] += 30.0
    assert abs(Colour.of([spoilt]).sigma - 0.3) < 0.1
    assert Colour.of([coloured(4000, 5)]).sigma < Colour.of([spoilt]).sigma < 0.45


def test_noise_remembers_no_more_than_it_shows() -> None:
    """Schwarz's criterion is right about the order nearly always, and by Akaike's two in seven draws remember more."""
    assert sum(len(Colour.of([coloured(3000, seed)]).memory) == 2 for seed in range(10, 40)) >= 28
