"""Thresholds that were learnt from little are as seldom crossed as those that were learnt from much."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_diagram.estimation.drift import learned_threshold
from twin_diagram.estimation.drift.rollout_statistic import white_std
from twin_diagram.scenario import Filter


def crossed(widen: bool, witnesses: int) -> float:
    """Share of further figures that exceed what was learnt; an exponential tail, as squared innovations have."""
    rng = np.random.default_rng(1031)
    seen, later = rng.exponential(size=(20_000, witnesses)), rng.exponential(size=(20_000, 20))
    limit = learned_threshold.threshold(seen.mean(axis=1), seen.var(axis=1), 6.0, witnesses if widen else np.inf)
    return float(np.mean(later > np.asarray(limit)[:, None]))


def test_few_witnesses_raise_no_more_false_alarms_than_many() -> None:
    """Twenty witnesses alone would bring five times as many as a thousand, ten twelve times; widened, 1.0 and 2.3."""
    many = np.exp(-7.0)  # μ + 6σ = 7 where both are known
    assert crossed(False, 1000) == pytest.approx(many, rel=0.3)
    assert crossed(False, 20) > 4.0 * many and crossed(True, 20) < 1.2 * many
    assert crossed(False, 10) > 9.0 * many and crossed(True, 10) < 2.6 * many


@given(st.floats(0.0, 1e3), st.floats(0.0, 1e3), st.floats(0.0, 1e4), st.floats(0.0, 1e4))
def test_more_witnesses_never_widen_a_threshold(mean: float, variance: float, some: float, more: float) -> None:
    few, many = sorted((some, more))
    narrow, wide = (learned_threshold.threshold(mean, variance, 6.0, n) for n in (many, few))
    assert mean + 6.0 * np.sqrt(variance) - 1e-9 <= narrow <= wide
    assert wide <= mean + 18.0 * np.sqrt(variance) + 1e-9


def test_white_torque_moves_a_joint_as_far_as_it_is_said_to() -> None:
    tuning, steps, count = Filter(torque_std=0.4, rate=200.0), 20, 20_000
    rng, h = np.random.default_rng(1032), 1.0 / 200.0
    torque = 0.4 * rng.normal(size=(count, steps))  # on unit inertia
    v = np.cumsum(torque, axis=1) * h
    moved = np.sum((v - torque * h) * h + 0.5 * torque * h**2, axis=1)
    alike = np.std(moved) * 2.0 / (steps * h) ** 2
    assert white_std(tuning, steps * h) == pytest.approx(alike, rel=0.02)


@pytest.mark.parametrize(("witnesses", "wider"), [(1.0, 3.0), (0.2, 3.0), (4.0, 2.0), (16.0, 1.5), (1e12, 1.0)])
def test_a_threshold_is_wider_by_twice_the_root_of_its_witnesses(witnesses: float, wider: float) -> None:
    found = learned_threshold.threshold(np.array([1.0, -2.0]), np.array([4.0, 0.25]), 3.0, witnesses)
    np.testing.assert_allclose(found, [1.0 + 3.0 * wider * 2.0, -2.0 + 3.0 * wider * 0.5], rtol=1e-5)
