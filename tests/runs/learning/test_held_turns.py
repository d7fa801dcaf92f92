"""How far the tool leans with what turns between its pads."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.runs.learning.test_display import Sightless
from twin_diagram.runs.learning import display as module
from twin_diagram.runs.learning.display import display
from twin_diagram.runs.learning.held_turns import TUNING, Weight, about_pads, gentlest_first, gentlest_parts, parts_of
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array

BOTTLE = Weight.of(0.96, np.array([0.0, 0.0, 0.09]), 75.0, felt=True)
LYING = Weight.of(1.45, np.array([-0.069, 0.0, 0.03]), 75.0, felt=False)
"""A heavy box as it lay when its end was taken: it hangs 8 cm below the pads once it is lifted."""
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


def asked(
    weight: Weight | None,
    monkeypatch: pytest.MonkeyPatch,
    opening: float = 0.05,
    tilts: tuple[float, ...] = (0.87,),
    seen: Array | None = None,
) -> tuple[Array, Mover]:
    """Joint angles (N, 7) of a display of what has a weight, in which pictures show points (K, 3) in the tool."""
    twin = load_scenario("bin_picking").twin
    assert twin.learning is not None
    monkeypatch.setattr(module, "refuse_blind", lambda *told: None)
    mover, cell = Mover(twin, {}, np.full(7, 2.0)), Sightless(np.array(twin.home), opening)
    if seen is not None:
        turn = module._turn

        def with_picture(*told: Any) -> list[Any]:
            picture = SimpleNamespace(depth=np.ones((2, 2)))
            shown = SimpleNamespace(points_T=lambda stride: seen, picture=picture, mask=np.zeros((2, 2), bool))
            return [*turn(*told), shown]

        monkeypatch.setattr(module, "_turn", with_picture)
        monkeypatch.setattr(Sightless, "look", lambda self, name: None, raising=False)
    with pytest.raises(module.NothingHeld):
        display(mover, cast(Any, cell), twin.learning, cast(Any, None), 0, tilts, weight=weight)
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


def test_what_lay_beside_the_pads_is_first_turned_as_it_hangs_and_then_leant_by_how_it_is_seen_to_hang(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    corners = np.array([[x, y, z] for x in (-0.045, 0.035) for y in (-0.02, 0.02) for z in (0.0, 0.17)])
    q, mover = asked(LYING, monkeypatch, tilts=(0.87, 0.2, -0.45), seen=corners)
    R = mover.scene.chain.tool(mover.scene.chain.place(q))[:, :3, :3]
    straight = -R[:, 2, 2] > 0.999
    begun = int(np.flatnonzero(straight)[0])
    first_lean = begun + int(np.flatnonzero(~straight[begun:])[0])
    assert float(np.ptp(q[begun:first_lean, -1])) > 5.5, "a full turn as it hangs comes first"
    hangs = Weight.of(1.45, np.array([-0.005, 0.0, 0.085]), 75.0, felt=True)
    assert float(hangs.use(R[begun:]).max()) < 1.3
    assert float((-R[begun:, 2, 2]).min()) < 0.66, "it is leant by 0.87 all the same"


def test_a_guess_counts_on_both_sides_of_the_pads_and_what_was_felt_on_one() -> None:
    guessed = Weight.of(0.5, np.array([0.02, 0.0, 0.06]), 75.0, felt=False)
    felt = Weight.of(0.5, np.array([0.02, 0.0, 0.06]), 75.0, felt=True)
    low, high = sorted(float(felt.use(leaning(0.3, angle))[0]) for angle in (0.0, np.pi))
    assert high > 2.0 * low
    assert float(felt.asked(leaning(0.3, 0.0))[0]) == float(felt.use(leaning(0.3, 0.0))[0])
    for angle in (0.0, np.pi):
        assert float(guessed.asked(leaning(0.3, angle))[0]) == pytest.approx(high)


def test_where_no_part_is_held_the_gentlest_are_gone_along() -> None:
    at = np.linspace(-3.0, 3.0, 121)
    share = 1.5 + np.abs(np.cos(at))
    parts = gentlest_parts(share, at, np.inf)
    assert sorted(float(np.mean(part)) for part in parts) == pytest.approx([-np.pi / 2, np.pi / 2], abs=0.03)
    assert all(TUNING.least <= end - begin < TUNING.least + 0.1 for begin, end in parts)
    assert gentlest_parts(share, at, 1.6) == [] and parts_of(share <= 1.0, at) == []


def test_what_the_pads_do_not_hold_hangs_below_them() -> None:
    down = np.diag([1.0, -1.0, -1.0])
    X = about_pads(LYING.turned_by(down))
    x, y, z = X[:3, :3] @ LYING.centre_T + X[:3, 3]
    # 6.9 cm beside and 4.25 below the pads' axis, which lies 1.25 cm behind the tool's origin.
    assert (x, y, z) == pytest.approx((0.0, 0.0, np.hypot(0.069, 0.0425) - 0.0125), abs=1e-9)
    light = Weight.of(0.2, LYING.centre_T, 75.0, felt=False)
    assert light.turned_by(down) == 0.0, "its weight does not turn it"
