"""Arms that lack everything at once: how far what is unusual stands out is counted in what the log's noise does."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "sims" / "benchmarks"))

from gap_truth import cases
from whole_robots.separation import BAND, whitened


def test_whitened_noise_has_a_variance_of_one_whatever_its_colour() -> None:
    rng = np.random.default_rng(3)
    chain = cases.draw_arm(rng)
    period, count, still = 0.002, 20000, np.zeros(chain.n)
    noise = cases.Noise(np.full(chain.n, 0.3), np.linspace(0.0, 2.0, chain.n), np.linspace(4.0, 40.0, chain.n), 0.0)
    robot = SimpleNamespace(
        period=period,
        noise=noise,
        control=SimpleNamespace(resolution=still),
        fit=SimpleNamespace(q=np.zeros((2, chain.n)), v=np.zeros((2, chain.n))),
        truth=SimpleNamespace(real=chain),
    )
    drawn = np.stack([noise.draw(count, period, rng).T for _ in range(8)])
    white = whitened(drawn, cast(Any, robot)).reshape(8, chain.n, -1)
    assert white.shape[2] == 2 * (int(BAND * count * period) + 1)
    np.testing.assert_allclose(np.mean(white**2, axis=(0, 2)), 1.0, rtol=0.08)
