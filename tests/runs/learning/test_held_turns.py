"""How far the tool leans with what turns between its pads."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from tests.runs.learning.test_display import Sightless
from twin_diagram.runs.learning import display as module
from twin_diagram.runs.learning.display import display
from twin_diagram.runs.learning.held_turns import TUNING, Weight, gentlest_first, parts_of
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array

BOTTLE = Weight.of(0.96, np.array([0.0, 0.0, 0.09]), 75.0, felt=True)
BOX = Weight.of(0.3, np.array([0.0, 0.0, 0.03]), 75.0, felt=True)


def leaning(tilt: float, angle: float) -> Array:
    """R_WT (1, 3, 3) of a tool that leans from straight down by `tilt`, after a turn about its axis by `angle`."""
    c, s, a, b = np.cos(tilt), np.sin(tilt), np.cos(angle), np.sin(angle)
    down = np.diag([1.0, -1.0, -1.0])
    lean = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return (lean @ down @ np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, 1.0]]))[None]


def test_a_pendulum_asks_for_friction_across_the_pads_axis_and_for_none_along_it() -> None:
    across, along = BOTTLE.use(leaning(0.87, 0.0)), BOTTLE.use(leaning(0.87, np.pi / 2))
    # 0.96 kg · 9.81 · sin 0.87 at 0.1025 m, against a share of what two round pads' torsion carries.
    radius = np.sqrt(0.021 * 0.045 / np.pi)
    assert across[0] == pytest.approx(
        0.96 * 9.81 * np.sin(0.87) * 0.1025 / (TUNING.share * 2 / 3 * radius * 60.0), rel=0.05
    )
    assert across[0] > 1.3 > 1.0 > along[0]


def test_parts_of_a_turn_are_the_longest_that_are_held() -> None:
    at = np.linspace(-3.0, 3.0, 61)
    held = np.abs(np.sin(at)) > 0.5
    assert np.array(parts_of(held, at)) == pytest.approx(np.array([[-2.6, -0.6], [0.6, 2.6]]))
    assert parts_of(np.abs(at) < 0.1, at) == []
    assert gentlest_first((0.87, 0.2, -0.45)) == (0.2, -0.45, 0.87)


def asked(weight: Weight | None, monkeypatch: pytest.MonkeyPatch, opening: float = 0.05) -> tuple[Array, Mover]:
    """Joint angles (N, 7) of a display at 0.87 of what has a weight."""
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    monkeypatch.setattr(module, "refuse_blind", lambda *told: None)
    mover, cell = Mover(twin, {}, np.full(7, 2.0)), Sightless(np.array(twin.home), opening)
    with pytest.raises(module.NothingHeld):
        display(mover, cast(Any, cell), twin.learning, cast(Any, None), 0, (0.87,), weight=weight)
    return np.array(cell.gone), mover


@pytest.mark.parametrize("weight", [BOTTLE, BOX, None], ids=["bottle", "box", "unknown"])
def test_what_hangs_far_below_the_pads_is_leant_along_their_axis_alone(
    weight: Weight | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    q, mover = asked(weight, monkeypatch)
    R = mover.scene.chain.tool(mover.scene.chain.place(q))[:, :3, :3]
    begun = np.flatnonzero(-R[:, 2, 2] > 0.99)[0]  # the way from home, on which nobody holds anything, is over
    most = float(BOTTLE.use(R[begun:]).max())
    whole = float(np.ptp(q[begun:, -1][-R[begun:, 2, 2] < 0.7]))
    assert float((-R[:, 2, 2]).min()) < 0.66, "it is leant by 0.87"
    if weight is BOTTLE:
        assert most <= 1.02
        assert whole > np.pi - 0.5, "both sides are shown"
    else:
        assert most > 1.3
        assert whole > 5.5
