"""Encoders of one turn: what counts as a turn, on which joints, and what goes along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_diagram.logs import Log, unwrapped
from twin_diagram.signals.arrays import Array

TURN = 2.0 * np.pi
JOINTS = ("lift", "left", "right")
TURNING = np.array([False, True, True])


def log(*jumps: tuple[int, int, float]) -> Log:
    """Smooth angles that jump by so many turns at a sample of a joint."""
    time = np.arange(60) / 100.0
    position = np.stack([0.3 * np.sin(3 * time), 0.2 * time, -0.4 * time], axis=1)
    for sample, joint, turns in jumps:
        position[sample:, joint] += TURN * turns
    return Log(time, JOINTS, position, torque=np.zeros_like(position))


def smooth(joint: int) -> Array:
    return log().position[:, joint]


@pytest.mark.parametrize("turns", [1, -1, 2, -3])
def test_whole_turns_are_taken_back(turns: int) -> None:
    wrapped = log((20, 1, turns), (35, 1, -2 * turns))
    whole, warnings = unwrapped(wrapped, TURNING)
    np.testing.assert_allclose(whole.position[:, 1], smooth(1), atol=1e-12)
    np.testing.assert_array_equal(whole.position[:, [0, 2]], wrapped.position[:, [0, 2]])
    assert [(warning.code, warning.joint) for warning in warnings] == [("wrapped", "left")]
    assert "angle of left jumps" in warnings[0].message


@pytest.mark.parametrize(("turns", "taken"), [(0.92, True), (1.08, True), (0.88, False), (1.12, False), (0.5, False)])
def test_nearly_a_turn_is_one(turns: float, taken: bool) -> None:
    """A tenth of a turn at most may be motion; the rest of the jump stays."""
    whole, warnings = unwrapped(log((20, 1, turns)), TURNING)
    assert bool(warnings) == taken
    left = turns - 1.0 if taken else turns
    np.testing.assert_allclose(whole.position[20:, 1], smooth(1)[20:] + TURN * left, atol=1e-12)


def test_a_slide_does_not_turn() -> None:
    jumped = log((20, 0, 1))
    assert unwrapped(jumped, TURNING) == (jumped, [])
    whole, (warning,) = unwrapped(log((20, 0, 1), (30, 1, 1), (40, 2, -1)), TURNING)
    np.testing.assert_array_equal(whole.position[:, 0], jumped.position[:, 0])
    np.testing.assert_allclose(whole.position[:, 1:], log().position[:, 1:], atol=1e-12)
    assert "left, right" in warning.message and warning.joint == "left"


def test_commands_jump_on_their_own() -> None:
    """A command jumps at another sample than the encoder; the first sample is where the log says."""
    wrapped = log((20, 1, -1))
    commanded = log((23, 1, -1), (10, 2, 1)).position + TURN
    whole, _ = unwrapped(replace(wrapped, position_commanded=commanded), TURNING)
    assert whole.position_commanded is not None
    np.testing.assert_allclose(whole.position_commanded[:, 1], smooth(1) + TURN, atol=1e-12)
    np.testing.assert_array_equal(whole.position_commanded[:, 2], commanded[:, 2])  # its encoder did not jump
    np.testing.assert_allclose(whole.position[:, 1], smooth(1), atol=1e-12)
