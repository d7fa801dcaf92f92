"""Torques that are logged in a few steps are known for it, finer ones and noisy ones are not."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.gap.whole_robot.coarse_torque import held_in_steps, in_coarse_steps
from twin_diagram.logs import Log


def log_in_steps_of(step: float, noise: float = 0.0) -> Log:
    """Two joints' torque of ± 10 N·m, rounded."""
    time = np.arange(4000) / 500.0
    torque = 10.0 * np.sin(2.0 * np.pi * np.outer(time, [0.4, 0.7]))
    torque += noise * np.random.default_rng(3).normal(size=torque.shape)
    return Log(time, ("a", "b"), np.zeros_like(torque), torque=np.round(torque / step) * step)


@pytest.mark.parametrize(
    ("step", "noise", "coarse"), [(8.0, 0.0, True), (8.0, 0.5, True), (0.1, 0.1, False), (1.0, 0.1, False)]
)
def test_steps_as_large_as_a_good_part_of_the_torque_are_coarse(step: float, noise: float, coarse: bool) -> None:
    assert in_coarse_steps([log_in_steps_of(step, noise)]) == coarse


def test_a_torque_that_never_changes_is_in_steps() -> None:
    assert all(held_in_steps(log_in_steps_of(100.0)))
