"""The LSTM of the tables: its gradient against differences, what it learns, and what it notices."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

SIMS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
pytest.importorskip("mujoco")
if str(SIMS) not in sys.path:
    sys.path.insert(0, str(SIMS))

from hrt_bench import learned, lstm  # noqa: E402


def swings(seed: int, count: int = 400, dt: float = 0.2) -> np.ndarray:
    """Two sines of one frequency and random phases: the next row needs the one before the last."""
    rng = np.random.default_rng(seed)
    angle = dt * np.arange(count)[:, None] + rng.uniform(0.0, 2.0 * np.pi, 2)
    return np.sqrt(2.0) * np.sin(angle) + 0.01 * rng.normal(size=(count, 2))


@pytest.mark.parametrize("skip", [0, 2])
def test_gradient_agrees_with_differences(skip: int) -> None:
    rng = np.random.default_rng(0)
    weights = lstm.Weights.draw(3, 4, rng)
    weights.read += 0.3 * rng.normal(size=weights.read.shape)
    batch = rng.normal(size=(7, 2, 3))
    _, gradient = lstm.loss_and_gradient(weights, batch, skip)
    for part, by in ((weights.gates, gradient.gates), (weights.read, gradient.read)):
        for _ in range(25):
            at = tuple(int(rng.integers(n)) for n in part.shape)
            kept, found = part[at], []
            for change in (1e-5, -1e-5):
                part[at] = kept + change
                found.append(lstm.loss_and_gradient(weights, batch, skip)[0])
            part[at] = kept
            assert by[at] == pytest.approx((found[0] - found[1]) / 2e-5, rel=1e-5, abs=1e-9)


def test_untrained_says_as_before_and_training_learns() -> None:
    run = swings(9)
    before = np.mean(lstm.errors(lstm.Weights.draw(2, 8, np.random.default_rng(0)), run)[20:] ** 2)
    assert before == pytest.approx(np.mean(np.diff(run, axis=0)[19:] ** 2), rel=1e-9)
    weights, losses = lstm.train([swings(k) for k in range(6)], 8, 300, seed=0, length=30, batch=8, rate=1e-2)
    assert losses[-1] < 0.2 * losses[0]
    assert np.mean(lstm.errors(weights, run)[20:] ** 2) < 0.2 * before  # never seen


def test_the_same_seed_trains_the_same() -> None:
    runs = [swings(k, 80) for k in range(2)]
    first, second = (lstm.train(runs, 4, 5, seed=3, length=20, batch=4)[0] for _ in range(2))
    np.testing.assert_array_equal(first.gates, second.gates)


def test_learners_are_kept_and_read(tmp_path: Path) -> None:
    made = learned.Lstm(np.ones(3), np.ones((5, 4)), np.ones((5, 3)), np.full(3, 2.0), np.array([0.1, 0.2]))
    learned.save(tmp_path / "lstm.npz", made)
    again = learned.load(tmp_path / "lstm.npz", learned.Lstm)
    np.testing.assert_array_equal(again.gates, made.gates)
    assert [file.name for file in tmp_path.iterdir()] == ["lstm.npz"]
