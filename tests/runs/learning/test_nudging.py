"""In the simulated cell a thing that lies across another one and the rim is pushed into the bin, and then is taken."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin_diagram import load_scenario
from twin_diagram.runs.learning.bin_view import narrowest
from twin_diagram.runs.learning.contact_count import ContactCount
from twin_diagram.runs.learning.handling import look_into_bin
from twin_diagram.runs.learning.nudging import nudge_off, plan_nudge
from twin_diagram.runs.learning.start import check_cell, tools_of
from twin_diagram.scenario import WorldObject
from twin_diagram.scenario.poses import Pose


@pytest.mark.long
def test_a_cracker_box_across_a_can_and_the_rim_is_pushed_into_the_bin() -> None:
    scenario = load_scenario("bin_picking")
    flat = Pose([0.43, -0.21, 0.145], [0.0, np.pi / 2, 0.15])
    below = Pose([0.42, -0.26, 0.06], [0.0, 0.0, 0.0])
    scenario.world.objects = {
        "flat": WorldObject(asset="objects/cracker_box", X_WO=flat),
        "below": WorldObject(asset="objects/can", X_WO=below),
    }
    tools, contacts = tools_of(scenario, check_cell(scenario)), list[dict[str, Any]]()
    tools.cell.observer = ContactCount(lambda **told: contacts.append(told))
    tools.cell.wait(0.5)
    picture, things = look_into_bin(tools, [])
    assert narrowest(things[0]) > tools.gripper.opening_most and things[0].points[:, 1].max() > -0.15
    plan = plan_nudge(tools, things[0], picture)
    assert plan is not None and plan.nudge.along[1] < -0.9, "away from the rim"
    assert nudge_off(tools, plan).startswith("pushed by 1")
    high = np.array(tools.learning.from_bin[1])
    _, after = look_into_bin(tools, [])
    pushed = min(after, key=lambda one: float(one.middle[1]))
    assert pushed.middle[1] < things[0].middle[1] - 0.08 and (pushed.points[:, :2] < high[:2] + 0.01).all()
    assert contacts == []
