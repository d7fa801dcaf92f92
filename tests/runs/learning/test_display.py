"""How what is held is turned before the scanning camera."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from twin_diagram.errors import StationError
from twin_diagram.runs.learning import display as module
from twin_diagram.runs.learning.display import NothingHeld, display
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array


class Sightless:
    """A cell that is where it was told to go, and takes no pictures."""

    def __init__(self, q: Array, opening: float = 0.05) -> None:
        self.commanded, self.gone, self.opening = q, [q], opening

    def wait(self, seconds: float) -> None: ...

    def follow(self, times: Array, q: Array, at: object = None) -> None:
        self.gone += list(q)
        self.commanded = q[-1]


@pytest.mark.parametrize(
    ("limits", "turned"),
    [((-3.05, 3.05), (-2.95, 2.95)), ((-2.0, 2.0), (-2.0, 2.0)), ((-0.5, 2.5), (-0.5, 2.5))],
    ids=["iiwa", "narrow", "to one side"],
)
def test_the_last_joint_is_turned_within_its_limits(limits: tuple[float, float], turned: tuple[float, float]) -> None:
    scenario = load_scenario("bin_picking")
    twin = scenario.twin
    assert twin.learning is not None
    mover, cell = Mover(twin, {}, np.full(7, 2.0)), Sightless(np.array(twin.home))
    mover.lower[-1], mover.upper[-1] = limits
    with pytest.raises(NothingHeld):
        display(mover, cast(Any, cell), twin.learning, cast(Any, None), 0, (0.2,))
    last = np.array(cell.gone)[:, -1]
    assert (last.min(), last.max()) == pytest.approx(turned)


def test_what_fell_on_its_way_is_told_at_once_and_no_empty_hand_is_turned() -> None:
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    mover, cell = Mover(twin, {}, np.full(7, 2.0)), Sightless(np.array(twin.home), 0.001)
    with pytest.raises(NothingHeld, match="fell on its way"):
        display(mover, cast(Any, cell), twin.learning, cast(Any, None), 0, (0.2,))
    assert np.ptp(np.array(cell.gone)[:, -1]) < 3.1, "a turn is 5.9 rad"


@pytest.mark.parametrize(("depth", "what"), [(0.0, StationError), (1.0, NothingHeld)])
def test_a_camera_that_measures_nothing_is_told_from_an_empty_hand(
    monkeypatch: pytest.MonkeyPatch, depth: float, what: type[Exception]
) -> None:
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    mask, picture = np.zeros((2, 2), bool), SimpleNamespace(depth=np.full((2, 2), depth))
    monkeypatch.setattr(module, "_turn", lambda *told: [SimpleNamespace(picture=picture, mask=mask)])
    mover, cell = Mover(twin, {}, np.full(7, 2.0)), Sightless(np.array(twin.home))
    with pytest.raises(what, match="no depth" if what is StationError else "no picture shows anything"):
        display(mover, cast(Any, cell), twin.learning, cast(Any, None), 0, (0.2,))
