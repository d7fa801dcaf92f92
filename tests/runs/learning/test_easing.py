"""What is set down is eased onto what it stands on: fingers open once it presses back, bit by bit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.runs.learning.test_display import Sightless
from twin_diagram.runs.learning.easing import TUNING, release
from twin_diagram.runs.learning.motion import Mover, pointing, pose
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array

STIFF, FORCE = 1e4, 75.0
NOISE = 0.2 / np.sqrt(12)
"""Of the mean of a step's messages [N·m]."""


class OnSupport(Sightless):
    """A cell whose tool is pressed back from a height on, by a spring; it notes how its fingers were told to press."""

    force = FORCE

    def __init__(self, mover: Mover, q: Array, stands: float) -> None:
        super().__init__(q)
        self.mover, self.stands = mover, stands
        self.told: list[tuple[float, float, float]] = []
        self._rng = np.random.default_rng(0)

    @property
    def q(self) -> Array:
        return self.commanded

    def about(self, phase: str, places: Array) -> Any:
        return nullcontext()

    @contextmanager
    def recording(self) -> Iterator[Any]:
        messages = SimpleNamespace(torque=[])
        yield messages  # the reader looks once the block is over
        chain = self.mover.scene.chain
        J = chain.tool_jacobian(chain.place(self.q[None]))[0, 3:]
        up = STIFF * max(self.stands - float(self.mover.tool(self.q)[2, 3]), 0.0)
        own = 40.0 * np.sin(self.q)  # the arm's weight, as it would be with its joints all as heavy
        messages.torque.append(own - J.T @ [0.0, 0.0, up] + NOISE * self._rng.standard_normal(7))

    def grip(self, opened: float, seconds: float = 0.7, force: float | None = None) -> None:
        self.force = self.force if force is None else force
        self.told.append((opened, self.force, float(self.mover.tool(self.q)[2, 3])))


@pytest.mark.parametrize(
    "off", [-0.001, 0.002, 0.006, 0.02], ids=["too high", "as planned", "too low", "nothing there"]
)
def test_fingers_open_once_it_presses_back(off: float) -> None:
    twin = load_scenario("bin_picking").twin
    mover = Mover(twin, {}, np.full(7, 2.0))
    X = pose(pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])), np.array([0.5, 0.1, 0.3]))
    q = mover.goals(X, np.array(twin.home))[0]
    above = X.copy()
    above[2, 3] += 0.05
    line = mover.line(q, above)[::-1]
    cell = OnSupport(mover, line[0], 0.3 - off)
    release(mover, cast(Any, cell), line, line[::-1])
    *held, (opened, force, at) = cell.told
    assert (opened, force) == (1.0, FORCE), "the next thing is taken with all of it"
    shares = [told[1] / FORCE for told in held]
    assert shares == pytest.approx(TUNING.loosened) and all(told[0] == 0.0 for told in held)
    lowest = 0.3 - TUNING.deepest if off > TUNING.deepest else 0.3 - max(off, 0.0)
    assert lowest - 2 * TUNING.step <= at <= lowest + 2e-4
    assert mover.tool(cell.commanded)[2, 3] == pytest.approx(0.35, abs=1e-4), "and back"
    assert np.abs(np.diff(np.array(cell.gone), axis=0)).max() < 0.02, "without a jump"


def test_fingers_keep_off_what_it_stands_on() -> None:
    """What tips hold so low that they would stand there themselves is let go over it."""
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    floor, mover = twin.learning.platform[1][2], Mover(twin, {}, np.full(7, 2.0))
    middle = 0.5 * (np.array(twin.learning.platform[0]) + np.array(twin.learning.platform[1]))[:2]
    X = pose(pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])), np.array([*middle, floor + 0.05]))
    q = mover.goals(X, np.array(twin.home), 0.0)[0]
    low = X.copy()
    low[2, 3] = floor + 0.009
    line = mover.line(q, low)
    cell = OnSupport(mover, line[0], 0.0)
    release(mover, cast(Any, cell), line, line[::-1])
    assert cell.told[-1][2] > floor + 0.001
