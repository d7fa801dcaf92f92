"""Where the tool was at the time of an image."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.planning.tasks.tool_past import KEPT, no_past, remembering, tool_at
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

V = np.array([0.3, -0.2, 0.5, 0.1, 0.4, -0.2])
TICK = 0.01
DOWN = np.array([0.0, 1.0, 0.0, 0.0])


def pose(time: float) -> Array:
    """Turned about an axis of W, from a hand that points down."""
    return np.array([*rotations.normalized(rotations.multiply(rotations.exp(V[:3] * time), DOWN)), *(V[3:] * time)])


def test_between_ticks_it_is_where_it_moved_evenly() -> None:
    past = no_past()
    for k in range(1, 2 * KEPT):
        past = remembering(past, k * TICK, pose(k * TICK))
    for time in ((2 * KEPT - 1.0) * TICK, (2 * KEPT - 4.3) * TICK, KEPT * TICK + 1e-9):
        found = tool_at(past, time)
        assert found is not None
        np.testing.assert_allclose(found[0], pose(time), atol=1e-9)
        np.testing.assert_allclose(found[1], V, atol=1e-9)


def test_what_is_not_known_is_not_told() -> None:
    past = no_past()
    assert tool_at(past, 0.0) is None
    past = remembering(past, 1.0, pose(1.0))
    assert tool_at(past, 1.0) is None, "one place tells no velocity"
    past = remembering(past, 1.0 + TICK, pose(1.0 + TICK))
    assert tool_at(past, 0.99) is None and tool_at(past, 1.02) is None
    assert tool_at(past, 1.005) is not None


@pytest.mark.parametrize("tick", [0.002, 0.005, 0.01, 0.03])
def test_half_a_second_is_remembered_at_every_rate(tick: float) -> None:
    """A planner of 100 plans a second had forgotten after 0.12 s where the tool was: late images said nothing."""
    past = no_past()
    for k in range(1, int(1.0 / tick) + 1):
        past = remembering(past, k * tick, pose(k * tick))
    for time in (0.45, 0.7, 0.985):
        found = tool_at(past, time)
        assert found is not None
        np.testing.assert_allclose(found[0], pose(time), atol=1e-9)
        np.testing.assert_allclose(found[1], V, atol=1e-9)
