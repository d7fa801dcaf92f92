"""What lies on the table beside the bin is seen by the bin's camera, and taken like what lies in it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from tests.runs.learning.test_camera_check import SOLIDS, TOLD, box, camera
from twin_diagram.runs.learning import handling
from twin_diagram.runs.learning.beside_bin import lying, stand_about, stand_about_rest, support_of, upright_points
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.camera_check import KnownFaces
from twin_diagram.runs.learning.cell import Picture, told_camera
from twin_diagram.runs.learning.motion import Mover, pointing, pose
from twin_diagram.runs.learning.tipping import plan_tipping
from twin_diagram.scenario import Learning
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array

FACES = KnownFaces.of(SOLIDS)
LEARNING = Learning(
    from_bin=[[0.276, -0.554, 0.007], [0.564, -0.166, 0.12]],
    into_bin=[[0.276, 0.166, 0.007], [0.564, 0.554, 0.12]],
    platform=[[0.42, -0.1, 0.0], [0.62, 0.1, 0.06]],
)
IN_BIN = box((0.42, -0.4, 0.032), (0.08, 0.06, 0.05))
BESIDE = box((0.16, -0.36, 0.02), (0.09, 0.06, 0.04))
ON_PLATFORM = box((0.5, -0.05, 0.08), (0.05, 0.05, 0.04))
ARM = box((0.08, -0.05, 0.2), (0.1, 0.1, 0.4))
NO_ARM: Any = SimpleNamespace(near=lambda points, q, margin, fingers: np.zeros(len(points), dtype=bool))


def taken(*things: Any, off: Array | None = None) -> Picture:
    """The bin's camera with noise, and edges of depth that smear over three pixels; `off`: by which it stands [m]."""
    told = camera(TOLD["from above"], [0.0, 0.0])
    view = told_camera(told)
    eye = view.p_WC + (np.zeros(3) if off is None else off)
    far = KnownFaces.of([*SOLIDS, *things]).hit(eye, (view.rays() @ view.R_WC.T).reshape(-1, 3))[1]
    depth = ndimage.uniform_filter(far.reshape(told.height, told.width), 3)
    depth += 8e-4 * np.random.default_rng(1).normal(size=depth.shape)
    return Picture(np.zeros((*depth.shape, 3), np.uint8), depth.astype(np.float32), view, 0.0, np.zeros(7), np.zeros(2))


@pytest.mark.parametrize("off", [[0.0, 0.0, 0.0], [0.002, -0.002, 0.001]])
def test_what_lies_beside_the_bin_comes_after_what_lies_in_it(off: list[float]) -> None:
    found = lying(taken(IN_BIN, BESIDE, ON_PLATFORM, off=np.array(off)), LEARNING, FACES, NO_ARM)
    inside, on_platform, beside = found
    assert [one.beside for one in found] == [False, True, True]
    assert [support_of(one, LEARNING) for one in found] == [0.007, 0.06, 0.0]
    assert on_platform.middle[:2] == pytest.approx([0.5, -0.05], abs=0.01)
    assert inside.middle[:2] == pytest.approx([0.42, -0.4], abs=0.01), "three pixels"
    assert beside.middle[:2] == pytest.approx([0.16, -0.36], abs=0.01)
    assert beside.top == pytest.approx(0.04, abs=0.004)


def test_what_lies_across_the_platforms_edge_is_one_thing_and_taken_above_the_platform() -> None:
    """Of a bottle that had rolled there what was over the table alone was seen, and taken for a thing on the table."""
    across = box((0.47, -0.07, 0.09), (0.06, 0.11, 0.06))
    (one,) = lying(taken(across), LEARNING, FACES, NO_ARM)
    assert one.middle[:2] == pytest.approx([0.47, -0.07], abs=0.012), "edges smear along the view"
    assert np.ptp(one.points[:, :2], axis=0) == pytest.approx([0.06, 0.11], abs=0.025)
    assert support_of(one, LEARNING) == 0.06
    # What stands at the platform's side, no higher than that, stands on the table.
    (low,) = lying(taken(box((0.38, -0.02, 0.025), (0.06, 0.06, 0.05))), LEARNING, FACES, NO_ARM)
    assert support_of(low, LEARNING) == 0.0 and low.points[:, 0].max() < 0.42


def test_what_the_border_cuts_off_beside_a_bin_does_not_go_on_within_that() -> None:
    """For what might have lain in the other bin nothing found a place there, and was let fall into it."""
    cut = box((0.36, 0.07, 0.03), (0.06, 0.14, 0.06))
    (one,) = lying(taken(cut), LEARNING, FACES, NO_ARM)
    low, high = (np.array(corner) for corner in LEARNING.into_bin)
    far = one.beyond[:, 1]
    assert one.beside and far.max() > one.points[:, 1].max() + 0.02, "up to the wall it may"
    assert not ((one.beyond > low) & (one.beyond < high)).all(axis=1).any()
    # One as high as the rim may lie over that.
    (tall,) = lying(taken(box((0.36, 0.07, 0.08), (0.06, 0.14, 0.16))), LEARNING, FACES, NO_ARM)
    inside = ((tall.beyond > low)[:, :2] & (tall.beyond < high)[:, :2]).all(axis=1)
    assert inside.any() and (tall.beyond[inside, 2] > high[2]).all()


def test_walls_platform_and_arm_are_no_things() -> None:
    assert lying(taken(), LEARNING, FACES, NO_ARM) == []
    arm: Any = SimpleNamespace(near=lambda points, q, margin, fingers: np.asarray(ARM.distance(points)[0]) < margin)
    assert lying(taken(ARM), LEARNING, FACES, arm) == [] != lying(taken(ARM), LEARNING, FACES, NO_ARM)


def test_once_something_was_taken_ways_keep_clear_of_what_had_counted_as_part_of_it() -> None:
    """Two boxes that touch are one thing; one of them is in the hand by now."""
    twin = load_scenario("bin_picking").twin
    mover = Mover(twin, {}, np.full(7, 2.0))
    over = pose(pointing(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])), np.array([0.42, -0.4, 0.075]))
    both, left = taken(IN_BIN, box((0.42, -0.34, 0.032), (0.08, 0.06, 0.05)), BESIDE), taken(IN_BIN)
    thing, beside = lying(both, LEARNING, FACES, NO_ARM)
    assert thing.middle[:2] == pytest.approx([0.42, -0.37], abs=0.01) and beside.beside
    q = mover.goals(over, np.array(twin.home))[:1]
    cell: Any = SimpleNamespace(wait=lambda seconds: None, look=lambda name: left)
    stand_about(mover, LEARNING, [beside])
    assert mover.free(q, 0.002)[0]
    stand_about_rest(mover, cell, NO_ARM, LEARNING, [beside])
    assert not mover.free(q, 0.002)[0]
    # An elbow over the bin stands in nobody's way.
    elbow = box((0.42, -0.3, 0.4), (0.1, 0.1, 0.1))
    arm: Any = SimpleNamespace(near=lambda points, q, margin, fingers: np.asarray(elbow.distance(points)[0]) < margin)
    left = taken(elbow)
    stand_about_rest(mover, cell, arm, LEARNING, [beside])
    assert mover.free(q, 0.002)[0]
    # Where the camera has stopped by then, what was seen before is still there.
    stand_about(mover, LEARNING, [beside, thing])
    dark = replace(left, depth=np.zeros_like(left.depth))
    cell.look = lambda name: dark
    stand_about_rest(mover, cell, NO_ARM, LEARNING, [beside])
    assert not mover.free(q, 0.002)[0]


def test_what_lies_on_the_table_is_taken_from_there_and_not_tipped_up(monkeypatch: pytest.MonkeyPatch) -> None:
    picture, stood, asked = taken(IN_BIN, BESIDE), dict[str, tuple[int, float]](), list[Any]()
    inside, beside = lying(picture, LEARNING, FACES, NO_ARM)

    def choice(mover: Any, cell: Any, gripper: Any, one: SeenThing, corners: Any, floor: float, *rest: Any) -> Any:
        asked.append((one, floor, len(rest[0])))
        return SimpleNamespace(best=lambda: None, why="out of reach")

    monkeypatch.setattr(handling, "Choice", choice)
    mover = SimpleNamespace(stand=lambda where, clouds, support: stood.update({where: (len(clouds), support)}))
    tools: Any = SimpleNamespace(learning=LEARNING, mover=mover, gripper=None, cell=None, faces=FACES, robot=NO_ARM)
    assert handling.pick(tools, beside, picture, 0, []).why == "out of reach"
    assert handling.pick(tools, inside, picture, 0, []).why == "out of reach"
    assert stood == {"bin": (1, 0.007), "table": (1, 0.0)}
    floors = {one.beside: floor for one, floor, _ in asked}
    assert floors[True] == pytest.approx(0.003) and floors[False] == pytest.approx(0.010)
    walls = upright_points(FACES, beside)
    assert [count for *_, count in asked] == [1 + len(walls), 1] and upright_points(FACES, inside) == []
    assert np.isclose(np.concatenate(walls)[:, 0], 0.42 - 0.15).any(), "the outer side of the bin's wall"
    assert plan_tipping(tools, beside, picture) is None


def test_what_lies_over_the_rim_is_one_thing() -> None:
    """A ring on a bin's rim was two: one in the bin, and one beside it that the fingers were to keep off."""
    over = box((0.29, -0.36, 0.16), (0.14, 0.06, 0.05))
    (one,) = lying(taken(over), LEARNING, FACES, NO_ARM)
    assert not one.beside and np.ptp(one.points[:, 0]) == pytest.approx(0.14, abs=0.01)
    # What stands on the table and leans over the rim lies beside the bin, and what of it is in there is still seen.
    inner, outer = lying(taken(box((0.225, -0.36, 0.16), (0.14, 0.06, 0.05))), LEARNING, FACES, NO_ARM)
    assert (inner.beside, outer.beside) == (False, True)
    assert inner.points[:, 0].min() > 0.2759 > outer.points[:, 0].max() - 1e-4
    # Nor is an arm over the rim part of what lies there.
    arm: Any = SimpleNamespace(near=lambda points, q, margin, fingers: points[:, 0] < 0.26)
    (free,) = lying(taken(over), LEARNING, FACES, arm)
    assert free.points[:, 0].min() > 0.255
