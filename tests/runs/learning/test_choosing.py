"""How a thing is taken: between walls and neighbours with fingers that are opened less than all the way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pytest

from tests.runs.learning.test_placing import flat
from twin_diagram.planning.grasps import Grasps, gripper_of
from twin_diagram.runs.learning import choosing
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.cell import Cell
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.picking import Reach
from twin_diagram.signals.pose_vectors import as_matrix

LOW, HIGH = np.array([0.27, -0.55, 0.01]), np.array([0.56, -0.16, 0.12])
NOBODY: Any = None


def all_reached(
    mover: Mover, cell: Cell, grasps: Grasps, order: Sequence[int], most: int = 8, opened: float = 1.0
) -> Reach | None:
    nowhere = np.zeros((2, 7))
    return (
        Reach(int(order[0]), as_matrix(grasps.poses[int(order[0])]), nowhere, nowhere, opened) if len(order) else None
    )


def choice_of(thing: SeenThing, rest: Sequence[np.ndarray] = ()) -> choosing.Choice:
    nobody = cast(Mover, NOBODY), cast(Cell, NOBODY)
    return choosing.Choice(*nobody, gripper_of("wsg50"), thing, (LOW, HIGH), float(LOW[2]), rest)


def choose(thing: SeenThing) -> Reach | None:
    return choice_of(thing).best()


def beside_the_wall(distance: float) -> SeenThing:
    """A box, 4.5 cm wide and too long for the fingers, that lies along a wall."""
    box = flat(0.045, 0.14, 0.08, 0.0)
    shift = np.array([0.0, LOW[1] + distance + 0.0225 - box.middle[1], 0.0])
    return SeenThing(box.points + shift, box.normals, box.pixels, box.viewpoint)


def test_fingers_are_opened_no_farther_than_a_thing_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bottle's neighbour was touched by a finger 5 cm away from the bottle, that was open all the way."""
    monkeypatch.setattr(choosing, "reach_of", all_reached)
    thing, gripper = beside_the_wall(0.10), gripper_of("wsg50")
    reach = choose(thing)
    assert reach is not None and reach.sure
    opening = gripper.opening_least + reach.opened * (gripper.opening_most - gripper.opening_least)
    aside = np.abs((thing.points - reach.X_WT[:3, 3]) @ reach.X_WT[:3, 1]).max()
    assert 2.0 * aside + 0.015 < opening < 0.08, "room beside it on both sides, and 3.5 cm less than all the way"


def between(thing: SeenThing, gap: float, height: float) -> list[np.ndarray]:
    """Two neighbours of a box that lies along a wall, one along each of its long sides, so far off and so high."""
    rng, (low, high) = np.random.default_rng(0), (thing.points.min(axis=0), thing.points.max(axis=0))
    sides = [[low[1] - gap - 0.08, low[1] - gap], [high[1] + gap, high[1] + gap + 0.08]]
    return [rng.uniform([low[0], a, height], [high[0], b, height], (4000, 3)) for a, b in sides]


@pytest.mark.long
def test_fingers_push_aside_what_leaves_them_no_room_but_not_what_the_palm_would_meet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Between a ring and a cracker box that lean on it, a bottle could be had by the pads' very tips alone."""
    monkeypatch.setattr(choosing, "reach_of", all_reached)
    thing = beside_the_wall(0.16)

    def chosen(gap: float, height: float) -> Reach | None:
        return choice_of(thing, between(thing, gap, height)).best()

    top = thing.top
    apart, close, over = chosen(0.035, top - 0.005), chosen(0.006, top - 0.005), chosen(0.006, top + 0.06)
    assert apart is not None and apart.sure and apart.roomy
    assert close is not None and not close.sure and not close.roomy and abs(close.X_WT[1, 1]) > 0.9
    assert over is None


def test_what_is_beyond_a_finger_does_not_open_it_farther() -> None:
    """A ring is held by a piece of its wall: the wall on its other side is beyond the finger in its hole."""
    angle, z = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 200), np.linspace(0.01, 0.03, 5)))
    points = np.concatenate(
        [np.column_stack([0.4 + r * np.cos(angle), -0.3 + r * np.sin(angle), z]) for r in (0.06, 0.08)]
    )
    ring = SeenThing(points, np.zeros_like(points), np.zeros((len(points), 2), dtype=np.int64), np.zeros(3))
    X_WT = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WT[:3, 3] = [0.4, -0.3 + 0.07, 0.03]
    gripper = gripper_of("wsg50")
    opening = gripper.opening_least + choosing.needed(ring, X_WT, gripper) * 0.11
    assert 0.02 + 0.015 < opening < 0.06


def test_beside_a_wall_they_are_opened_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choosing, "reach_of", all_reached)
    reach = choose(beside_the_wall(0.028))
    assert reach is not None and reach.opened < 1.0
    gripper = gripper_of("wsg50")
    most = gripper.opening_least + reach.opened * (gripper.opening_most - gripper.opening_least)
    assert reach.X_WT[1, 3] - most / 2 - gripper.finger_thickness > LOW[1], "the outer finger is within the bin"
    assert abs(reach.X_WT[:3, 1] @ [0.0, 1.0, 0.0]) > 0.97 and reach.X_WT[2, 2] < -0.9


def test_room_beside_the_fingers_is_not_bought_with_a_grasp_by_their_tips(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bottle beside a box: with 4 mm more room the pads closed on its upper half alone, and it slipped out."""

    def some(tool: float, seen: bool) -> Grasps:
        across, none = np.array([0.0, 0.035, 0.0]), np.full(3, np.nan)
        poses = np.array([[0.0, 1.0, 0.0, 0.0, 0.4, -0.3, tool]])
        middle = np.array([0.4, -0.3, 0.061])
        contacts = np.stack([middle + across, middle - across if seen else none])[None]
        return Grasps(poses, np.full(1, 0.07), np.ones(1), {}, contacts, {})

    offers = [some(0.071, True), some(0.050, False)]
    given = iter([offer for offer in offers for _ in choosing.TUNING.opened])
    monkeypatch.setattr(choosing, "reach_of", all_reached)
    monkeypatch.setattr(choosing, "grasps_of_thing", lambda *told, **lean: next(given))
    reach = choose(beside_the_wall(0.10))
    assert reach is not None and reach.X_WT[2, 3] == 0.050 and reach.opened == 1.0 and not reach.sure
    given = iter(offers[:1] * 2 * len(choosing.TUNING.opened))
    reach = choose(beside_the_wall(0.10))
    assert reach is not None and reach.X_WT[2, 3] == 0.071 and not reach.sure, "where nothing else is to be had"
