"""Which way a thing beside which no finger goes down is dragged off walls, and where fingers press on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.runs.learning.test_nudges import HIGH, LOW, NONE, WSG, flat
from twin_diagram import load_scenario
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.contact_count import ContactCount
from twin_diagram.runs.learning.dragging import TUNING, drag_off, is_clear, plan_drag, tool_poses
from twin_diagram.runs.learning.drags import TUNING as DRAGS
from twin_diagram.runs.learning.drags import Drag, drags_of
from twin_diagram.runs.learning.handling import look_into_bin, pick
from twin_diagram.runs.learning.motion import pointing
from twin_diagram.runs.learning.start import check_cell, tools_of
from twin_diagram.scenario import WorldObject
from twin_diagram.scenario.poses import Pose
from twin_diagram.signals.arrays import Array

DEEP = WSG.opening_least + 2.0 * WSG.finger_thickness
BEHIND = float(-WSG.boxes(WSG.opening_least)[0][:-1, 1].min())


def lying_can(x: float, y: float) -> SeenThing:
    """The upper side of a can of 10 x 6.8 cm that lies along x."""
    along, angle = np.meshgrid(np.arange(-0.05, 0.05, 0.002), np.arange(0.4, np.pi - 0.4, 0.06))
    points = np.stack([x + along, y + 0.034 * np.cos(angle), LOW[2] + 0.034 * (1.0 + np.sin(angle))], axis=-1)
    points = np.random.default_rng(0).permutation(points.reshape(-1, 3))
    return SeenThing(points, np.zeros_like(points), np.zeros((len(points), 2), dtype=np.int64), np.zeros(3))


def ways(thing: SeenThing, others: Array = NONE) -> list[Drag]:
    """Return how it is dragged by fingers that shut along the way."""
    return drags_of(thing, others, (LOW, HIGH), DEEP, BEHIND)


def test_what_lies_along_a_wall_is_dragged_off_that_first() -> None:
    """A can in a corner of which every grasp was barred: it rolls off one wall, and slides off the other one."""
    can = lying_can(HIGH[0] - 0.053, LOW[1] + 0.037)
    first, second = ways(can)
    assert first.along.tolist() == [0.0, 1.0, 0.0] and second.along.tolist() == [-1.0, 0.0, 0.0]
    assert first.place[2] == pytest.approx(can.top)
    # The thickest of the fingers keeps off the wall, and their leading edge is beyond the can's middle.
    assert first.place[1] - BEHIND == pytest.approx(LOW[1] + DRAGS.off)
    assert LOW[1] + 0.037 < first.place[1] + 0.5 * DEEP < LOW[1] + 0.055


def test_what_lies_free_is_not_dragged() -> None:
    assert ways(lying_can(0.42, -0.36)) == []


def test_it_is_not_dragged_against_others() -> None:
    can, beside = lying_can(HIGH[0] - 0.053, LOW[1] + 0.037), flat((0.51, LOW[1] + 0.1), (0.05, 0.04), 0.06)
    assert [one.along.tolist() for one in ways(can, beside.points)] == [[-1.0, 0.0, 0.0]]


def test_what_is_higher_than_wide_is_dragged_where_it_does_not_rock_before_where_it_does() -> None:
    """A gelatin box of 85 x 60 x 73 mm in a corner: dragged across its width it rocked by 18°, and fell back."""
    box = flat((HIGH[0] - 0.045, LOW[1] + 0.032), (0.085, 0.06), LOW[2] + 0.073)
    assert [one.along.tolist() for one in ways(box)] == [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    low = flat((HIGH[0] - 0.045, LOW[1] + 0.032), (0.085, 0.06), LOW[2] + 0.04)
    assert [one.along.tolist() for one in ways(low)] == [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]


def test_fingers_press_on_its_top_and_go_aside_level() -> None:
    drag = ways(lying_can(HIGH[0] - 0.053, LOW[1] + 0.037))[0]
    poses = tool_poses(drag, pointing(np.array([0.0, 0.0, -1.0]), drag.along), WSG, TUNING.seen)
    tips = poses[:, :3, 3] - [0.0, 0.0, WSG.finger_front]
    assert tips[0, 2] == pytest.approx(drag.place[2] + TUNING.before)
    assert tips[-1] == pytest.approx(drag.place + drag.length * drag.along - [0.0, 0.0, TUNING.seen])
    wall = np.array([[drag.place[0], LOW[1], z] for z in np.arange(0.0, HIGH[2], 0.005)])
    assert is_clear(poses, WSG, wall) and not is_clear(poses, WSG, wall + [0.0, 0.02, 0.0])


@pytest.mark.long
def test_a_can_along_a_wall_is_rolled_off_it_and_taken() -> None:
    scenario = load_scenario("bin_picking")
    lies = Pose([0.515, -0.2, 0.045], [0.0, np.pi / 2, 0.0])
    scenario.world.objects = {"can": WorldObject(asset="objects/can", X_WO=lies, mass=0.6, friction=0.45)}
    tools, contacts = tools_of(scenario, check_cell(scenario)), list[dict[str, Any]]()
    tools.cell.observer = ContactCount(lambda **told: contacts.append(told))
    tools.cell.wait(1.5)
    picture, (can,) = look_into_bin(tools, [])
    assert pick(tools, can, picture, 0, []).taken is None, "a finger has no room beside it"
    plan = plan_drag(tools, can, picture)
    assert plan is not None and plan.drag.along[1] < -0.9
    assert drag_off(tools, plan).startswith("dragged")
    picture, (rolled,) = look_into_bin(tools, [])
    assert rolled.middle[1] < can.middle[1] - 0.02
    assert pick(tools, rolled, picture, 0, []).taken is not None
    assert contacts == []
