"""A motion that is broken off ends on itself: it was planned clear of all else, a straight way on was not."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.runs.learning.cell import TUNING, Cell
from twin_diagram.signals.arrays import Array


class Commanded(Cell):
    """A cell without a world: it notes what the arm is told."""

    def __init__(self, q: Array) -> None:
        self._command, self._recording, self._clock = q, None, 0.0
        self._torque, self.told, self.added = np.zeros(2), list[Array](), list[Array]()
        self._ahead = np.zeros(1), q[None], np.zeros((1, 2)), 0.0

    @property
    def time(self) -> float:
        return self._clock

    def _advance(self, until: float) -> None:
        self._clock = until
        self.told.append(self._command)
        self.added.append(self._torque)


def circle(times: Array) -> Array:
    """Return two joints that go around once a second, as in a swing."""
    return 0.3 * np.stack([np.cos(2.0 * np.pi * times), np.sin(2.0 * np.pi * times)], axis=1)


def test_a_swing_that_is_broken_off_comes_to_rest_along_itself() -> None:
    """A hand that braked straight on would have come 2 cm into a bin from which its swing kept 6 cm off."""
    times = np.arange(0.0, 1.0, 0.0025)
    cell = Commanded(circle(times[:1])[0])

    def stop(now: float) -> None:
        if now > 0.4:
            raise RuntimeError

    with pytest.raises(RuntimeError):
        cell.follow(times, circle(times), stop, 10.0 * circle(times))
    broken_off = len(cell.told)
    cell.brake()
    ended = np.array(cell.told[broken_off:])
    assert np.linalg.norm(ended, axis=1) == pytest.approx(0.3, abs=1e-4), "it stays on the circle"
    steps = np.linalg.norm(np.diff(ended, axis=0), axis=1)
    assert steps[0] == pytest.approx(0.3 * 2.0 * np.pi * TUNING.tick, rel=0.1) and steps[-1] < 0.05 * steps[0]
    added = np.linalg.norm(cell.added[broken_off:], axis=1)
    assert added[0] == pytest.approx(3.0, rel=0.1) and added[-1] < 0.01, "what a slower motion takes"
    assert not cell._torque.any()
    cell.brake()
    assert cell.commanded == pytest.approx(ended[-1]), "at rest it stays"


def test_near_its_end_a_motion_ends_there() -> None:
    times = np.array([0.0, 0.1])
    q = np.array([[0.0, 0.0], [0.1, 0.2]])
    cell = Commanded(q[0])

    def stop(now: float) -> None:
        if now > 0.05:
            raise RuntimeError

    with pytest.raises(RuntimeError):
        cell.follow(times, q, stop)
    cell.brake()
    assert cell.commanded == pytest.approx(q[1])
    Commanded(q[0]).brake()
