"""One reading's word on noise: its size, its direction, and its bounds."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.filter.belief import Belief
from twin_diagram.estimation.filter.noise_estimate import follow_sensor, follow_torque, gain, scaled

WIDEST = np.log(100.0)
"""A tenth to ten times, as a variance."""


def test_a_first_reading_counts_for_a_twentieth_and_later_ones_as_four_over_their_number() -> None:
    assert gain(0.005, 2.0, 0.0) == pytest.approx(0.05)
    assert gain(0.005, 2.0, 320.0) == pytest.approx(4.0 / 400.0)
    assert gain(0.005, 2.0, 1e9) == pytest.approx(0.0025)
    assert gain(1.0, 2.0, 1e9) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("square", "surprise"), [(0.0, -1.0), (1.0, 0.0), (4.0, 3.0), (8.9, 7.9), (9.1, 8.0), (99.0, 8.0)]
)
def test_a_level_moves_with_how_far_a_reading_is_off(square: float, surprise: float) -> None:
    """By the share that its variance has in what is seen; a square counts for nine times its mean at most."""
    level, noise, inverse = np.array([0.3]), np.array([0.02]), np.array([10.0])
    follow_sensor(level, noise, inverse, np.sqrt(square * inverse), 0.01)
    assert level[0] == pytest.approx(0.3 + 0.01 * 0.2 * surprise)


def test_levels_stay_within_a_tenth_and_ten_times() -> None:
    for start, end in ((WIDEST - 1e-3, WIDEST), (-WIDEST + 1e-3, -WIDEST)):
        level = np.array([start])
        follow_sensor(level, np.ones(1), np.ones(1), np.array([3.0 if start > 0.0 else 0.0]), 0.05)
        assert level[0] == pytest.approx(end)


def test_noise_is_scaled_by_deviation() -> None:
    R, level = np.array([[4.0, 1.0], [1.0, 9.0]]), np.array([0.0, np.log(4.0)])
    np.testing.assert_allclose(scaled(R, level), [[4.0, 2.0], [2.0, 36.0]])
    assert scaled(R, np.zeros(2)) is R


def torque_level(speed: float, regime: float, surprise: float, variance: float = 0.2, level: float = 0.0) -> float:
    """Two readings, one joint whose torque moves them by (3, 1); S is 2 and 4."""
    belief = Belief(1, 0)
    belief.v[:], belief.regime[:], belief.noise[2] = speed, regime, level
    by, S = np.array([[3.0], [1.0]]), np.array([2.0, 4.0])
    solved = by / S[:, None]
    expected = 9.0 / 2.0 + 1.0 / 4.0
    weighted = np.array([1.0, 0.0]) * np.sqrt((1.0 + surprise) * expected) / 3.0
    follow_torque(belief, by, np.array([variance]), solved, weighted, 0.01)
    return float(belief.noise[2, 0])


@pytest.mark.parametrize(("surprise", "counts"), [(-1.0, -1.0), (0.0, 0.0), (3.0, 3.0), (7.9, 7.9), (20.0, 8.0)])
def test_white_torque_follows_what_it_explains(surprise: float, counts: float) -> None:
    expected = 4.75
    assert torque_level(0.5, 1.0, surprise) == pytest.approx(0.01 * np.sqrt(0.2 * expected) * counts)
    assert torque_level(0.5, 1.0, surprise, variance=10.0) == pytest.approx(0.01 * counts)


def test_joints_that_rest_or_creep_say_nothing_of_it() -> None:
    for speed, regime, moves in ((0.051, 1.0, True), (-0.051, -1.0, True), (0.049, 1.0, False), (0.5, 0.0, False)):
        assert (torque_level(speed, regime, 3.0) != 0.0) == moves
    assert torque_level(0.5, 1.0, 20.0, level=WIDEST - 1e-4) == pytest.approx(WIDEST)
    assert torque_level(0.5, 1.0, -1.0, level=-WIDEST + 1e-4) == pytest.approx(-WIDEST)
