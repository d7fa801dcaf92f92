"""What is lost from the platform is found wherever a camera sees it, and taken up from there."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from tests.runs.learning.test_camera_check import SOLIDS, TOLD, box, camera
from twin_diagram.errors import StationError
from twin_diagram.planning.collision.convex_solids import Solid
from twin_diagram.planning.grasps import gripper_of
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.camera_check import KnownFaces
from twin_diagram.runs.learning.cell import Picture, told_camera
from twin_diagram.runs.learning.handling import go_home
from twin_diagram.runs.learning.looking_about import look_about
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.picking import before_grasp
from twin_diagram.runs.learning.seeking import seek
from twin_diagram.runs.learning.start import check_cell, tools_of
from twin_diagram.runs.learning.thing_grasps import upright_poses
from twin_diagram.scenario import Learning, Pose, WorldObject
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.pose_vectors import as_matrix

FACES = KnownFaces.of(SOLIDS)
LEARNING = Learning(
    from_bin=[[0.276, -0.554, 0.007], [0.564, -0.166, 0.12]],
    into_bin=[[0.276, 0.166, 0.007], [0.564, 0.554, 0.12]],
    platform=[[0.42, -0.1, 0.0], [0.62, 0.1, 0.06]],
)
LOST = box((0.367, -0.107, 0.02), (0.07, 0.07, 0.04))
"""Where the ring of a bin was lost: beside the platform, on the arm's side."""
ON_PLATFORM = box((0.5, 0.02, 0.08), (0.05, 0.05, 0.04))
BEFORE = box((0.72, 0.05, 0.06), (0.05, 0.05, 0.12))
BEYOND = box((0.2, 0.3, 0.03), (0.06, 0.06, 0.06))
IN_BIN = box((0.42, -0.4, 0.032), (0.08, 0.06, 0.05))
ARM = box((0.5, 0.0, 0.35), (0.1, 0.1, 0.4))


def seen(name: str, things: tuple[Solid, ...], dark: bool = False) -> Picture:
    """The bin's or the scanning camera's picture, with noise, and edges of depth that smear over three pixels."""
    told = camera(TOLD["from above" if name == "bin" else "slanted"], [0.0, 0.0])
    view = told_camera(told)
    far = KnownFaces.of([*SOLIDS, *things]).hit(view.p_WC, (view.rays() @ view.R_WC.T).reshape(-1, 3))[1]
    depth = ndimage.uniform_filter(np.where(np.isfinite(far), far, 3.0).reshape(told.height, told.width), 3)
    depth += 8e-4 * np.random.default_rng(1).normal(size=depth.shape)
    depth = np.zeros_like(depth) if dark else depth
    return Picture(np.zeros((*depth.shape, 3), np.uint8), depth.astype(np.float32), view, 0.0, np.zeros(7), np.zeros(2))


def cell_of(*things: Solid, dark: tuple[str, ...] = ()) -> Any:
    pictures = {name: seen(name, things, name in dark) for name in ("bin", "scan")}
    return SimpleNamespace(wait=lambda seconds: None, look=pictures.__getitem__)


def arm_of(*parts: Solid) -> Any:
    def near(points: Array, q: Array, margin: float, fingers: Array) -> Any:
        off = [np.asarray(part.distance(points)[0]) < margin for part in parts]
        return np.logical_or.reduce(off) if off else np.zeros(len(points), dtype=bool)

    return SimpleNamespace(near=near)


def at(*things: Solid, known: tuple[Array, ...] = (), arm: tuple[Solid, ...] = (), **more: Any) -> Any:
    """Where something is found, and the height of what it lies on; None: nothing is."""
    found = look_about(cell_of(*things, *arm, **more), LEARNING, FACES, arm_of(*arm), known)
    return found and (*found.thing.middle[:2].round(2).tolist(), found.support)


def test_what_lies_beside_the_platform_on_the_arms_side_is_found() -> None:
    assert at() is None
    assert at(IN_BIN) is None, "the run comes to it by itself"
    assert at(IN_BIN, LOST) == pytest.approx((0.37, -0.11, 0.0), abs=0.011)
    # The arm over the platform is none, and what it hides from one camera the other one sees.
    assert at(LOST, arm=(ARM,)) == pytest.approx((0.37, -0.11, 0.0), abs=0.011)
    assert at(arm=(ARM,)) is None


def test_the_likeliest_place_comes_first_and_what_lay_there_before_is_left() -> None:
    assert at(LOST, ON_PLATFORM, BEFORE) == pytest.approx((0.49, 0.02, 0.06), abs=0.02), "half hidden"
    assert at(LOST, BEFORE) == pytest.approx((0.72, 0.05, 0.0), abs=0.035), "its far side is not seen"
    assert at(BEYOND) == pytest.approx((0.18, 0.31, 0.0), abs=0.03), "where the bin's camera does not see"
    assert at(LOST, BEYOND) == pytest.approx((0.37, -0.11, 0.0), abs=0.011)
    assert at(LOST, BEYOND, known=(np.array([0.367, -0.107, 0.03]),)) == pytest.approx((0.18, 0.31, 0.0), abs=0.03)


def test_one_camera_that_has_stopped_leaves_the_other() -> None:
    assert at(LOST, dark=("bin",)) == pytest.approx((0.37, -0.11, 0.0), abs=0.03)
    assert at(LOST, dark=("scan",)) == pytest.approx((0.37, -0.11, 0.0), abs=0.02)
    with pytest.raises(StationError, match="'scan' measures no depth"):
        at(dark=("scan",))  # nobody knows what lies on the platform


def test_near_the_arms_axis_a_hand_that_leans_reaches_the_table() -> None:
    twin = load_scenario("bin_picking").twin
    mover, home = Mover(twin, {}, np.full(7, 2.0)), np.array(twin.home)
    rim = np.array([[x, y, z] for x in (0.337, 0.397) for y in (-0.137, -0.077) for z in (0.004, 0.03)])
    thing = SeenThing(rim, rim, np.zeros((8, 2), np.int64), np.array([0.42, -0.36, 0.95]))
    reached = {}
    for beside in (False, True):
        poses = [as_matrix(one) for one in upright_poses(replace(thing, beside=beside), gripper_of("wsg50"), 0.003)]
        down = np.array([-X[2, 2] for X in poses])
        assert (np.abs([X[2, 1] for X in poses]) < 1e-9).all(), "fingers close along the table"
        assert set(down.round(3)) == ({1.0, round(float(np.cos(0.35)), 3)} if beside else {1.0})
        mine = [X for X, share in zip(poses, down, strict=True) if (share < 0.99) == beside][::7]
        reached[beside] = sum(len(before_grasp(mover, X, home)) > 0 for X in mine)
    assert reached[False] == 0 < reached[True], reached


@pytest.mark.long
def test_a_ring_beside_the_platform_is_put_away() -> None:
    """In the simulated cell, where a ring of a bin was lost."""
    scenario = load_scenario("bin_picking")
    lost = WorldObject(asset="objects/ring", X_WO=Pose([0.367, -0.107, 0.03], [0.0, 0.0, 0.4]))
    scenario.world.objects = {"lost": lost}
    tools = tools_of(scenario, check_cell(scenario))
    go_home(tools)
    tools.cell.wait(0.5)
    found = seek(tools, [])
    assert found.put is not None and found.lying is not None, found.told
    assert found.lying.support == 0.0 and found.lying.thing.middle[:2] == pytest.approx([0.367, -0.107], abs=0.015)
    true = tools.cell.snapshot()["positions"][-3:]
    low, high = np.array(LEARNING.into_bin)
    assert ((low < true) & (true < high)).all(), true
