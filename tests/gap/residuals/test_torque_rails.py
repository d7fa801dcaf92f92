"""A torque that is cut off at the end of a range is told, and no other."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.gap.residuals.torque_rails import told_of_rails
from twin_diagram.logs import Log


def log(torque: np.ndarray) -> Log:
    time = np.arange(len(torque)) / 100.0
    q = 0.1 * np.sin(time)[:, None] * np.ones(2)
    return Log(time, ("a", "b"), q, torque=torque, source="log.csv")


def test_a_sensor_that_saturates_is_told() -> None:
    """A push of 25 N and friction a quarter off were said of it, with no word of why."""
    time = np.arange(1000) / 100.0
    torque = 10.0 * np.sin(time)[:, None] * np.ones(2) + 0.1 * np.random.default_rng(1).normal(size=(1000, 2))
    assert not told_of_rails(log(torque))
    torque[:, 1] = np.minimum(torque[:, 1], 9.0)
    (told,) = told_of_rails(log(torque))
    assert "torque of b stays at 9 for" in told.message


@pytest.mark.parametrize("torque", [np.zeros(1000), np.round(3.0 * np.sin(np.arange(1000) / 100.0))])
def test_what_never_changes_or_is_coarse_is_not_told_of(torque: np.ndarray) -> None:
    assert not told_of_rails(log(np.stack([torque, torque], axis=1)))
