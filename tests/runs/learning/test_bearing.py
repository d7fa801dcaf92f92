"""What is held is borne by the driver: by its spring alone the arm hangs down by 6 mm with 1.4 kg."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram import load_scenario
from twin_diagram.model.model import Model
from twin_diagram.runs.learning.bearing import TUNING, Borne, holding
from twin_diagram.runs.learning.felt_weight import bear
from twin_diagram.runs.learning.motion import pointing, pose
from twin_diagram.runs.learning.picking import go
from twin_diagram.runs.learning.start import check_cell, tools_of
from twin_diagram.scenario.models import EffectSpec
from twin_diagram.signals.arrays import Array


def test_what_is_borne_comes_and_goes_steadily() -> None:
    borne, q = Borne(), np.array([0.5, 1.0])
    borne.tell(None, 0.0)
    assert borne.torque(q, 0.0).tolist() == [0.0, 0.0], "nothing is told of nothing"
    borne.tell(lambda q: 4.0 * q, 1.0)
    half = 1.0 + 0.5 * TUNING.fade
    assert not borne.torque(q, 1.0).any() and borne.torque(q, half) == pytest.approx(2.0 * q)
    assert borne.torque(q, 2.0) == pytest.approx(4.0 * q) and borne.torque(2.0 * q, 2.0) == pytest.approx(8.0 * q)
    borne.tell(lambda q: 6.0 * q, 3.0)
    assert borne.torque(q, 3.0) == pytest.approx(8.0 * q), "from what it was told last"
    assert borne.torque(q, 4.0) == pytest.approx(6.0 * q)
    borne.tell(None, 4.0)
    assert borne.torque(q, 4.0 + 0.5 * TUNING.fade) == pytest.approx(3.0 * q)
    assert not borne.torque(q, 5.0).any()


def test_a_weight_is_held_up_by_what_gravity_does_to_it() -> None:
    twin = load_scenario("bin_picking").twin
    model = Model.load(twin.arm, torque_side="motor")
    q, step, mass, centre = np.array(twin.home), 1e-6, 1.3, np.array([0.02, -0.03, 0.05])

    def height(q: Array) -> float:
        return float((model.tool_pose(q) @ centre)[2])

    moved = step * np.eye(len(q))
    slope = np.array([(height(q + d) - height(q - d)) / (2.0 * step) for d in moved])
    assert holding(model, mass, centre)(q) == pytest.approx(9.81 * mass * slope, abs=1e-5)


def test_an_arm_that_bears_what_it_holds_stays_where_it_is_told() -> None:
    """Hanging down, it set things down too early, and fingers that opened touched a bin's bottom or its rim."""
    scenario = load_scenario("bin_picking")
    scenario.world.objects = {}
    scenario.world.arm.effects.append(EffectSpec("payload", parameters={"mass": [1.4], "com": [0.0, 0.0, 0.2]}))
    tools = tools_of(scenario, check_cell(scenario))
    cell, (low, high) = tools.cell, np.array(tools.learning.into_bin)
    down = pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    over = pose(down, np.array([*(0.5 * (low + high))[:2], low[2] + 0.3]))
    go(cell, tools.mover.timed(np.stack([cell.commanded, tools.mover.goals(over, cell.commanded)[0]])))
    cell.grip(0.0)

    def hangs() -> float:
        cell.wait(0.5)
        return float((over - tools.mover.tool(cell.q))[2, 3])

    alone = hangs()
    corner = np.array([0.03, 0.03, 0.05])
    bear(tools.model, tools.driven, cell, np.array([-corner, corner]))
    borne = hangs()
    cell.grip(1.0)
    assert abs(borne) < 0.001 < 0.005 < alone, (alone, borne)
    assert hangs() == pytest.approx(alone, abs=1e-4), "open fingers hold nothing"
