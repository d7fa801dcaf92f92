"""What was foreseen, held against what came: an arm that follows its plan, and a plan that is off by a known turn."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram import load_scenario, make_closed_loop
from twin_diagram.planning.preview import AHEAD
from twin_diagram.runs.preview_watch import PreviewWatch
from twin_diagram.signals.arrays import Array

HOME = np.array([0.0, 0.1, 0.0, -2.0, 0.0, 2.1, 0.8])


def wave(t: float) -> Array:
    """From rest, to and fro by 0.2 rad in 4 s."""
    return HOME + 0.1 * (1.0 - np.cos(2 * np.pi * t / 4.0)) * np.eye(7)[0]


class Waving(LeafSystem):
    """Commands `wave`, and tells where it will be in a second, off by a turn (7,)."""

    def __init__(self, off: Array) -> None:
        super().__init__()
        for name, ahead, shift in (("position_commanded", 0.0, 0.0 * off), ("position_planned", AHEAD, off)):

            def says(context: Context, output: BasicVector, ahead: float = ahead, shift: Array = shift) -> None:
                output.SetFromVector(wave(context.get_time() + ahead) + shift)

            self.DeclareVectorOutputPort(name, 7, says, {self.time_ticket()})


@pytest.mark.parametrize("turn", [pytest.param(0.0, marks=pytest.mark.long), 0.02])
def test_a_plan_that_is_off_by_a_turn_is_told_to_be_off_by_as_much(turn: float) -> None:
    asked = ["twin.camera=null", "twin.library={}", f"twin.home={HOME.tolist()}", "twin.stop_monitor=null"]
    asked.append("world.arm.effects=[]")  # a load that nobody knows would sag
    loop = make_closed_loop(load_scenario("tabletop", asked), controller=Waving(turn * np.eye(7)[0]))
    watch, simulator = PreviewWatch(loop.twin), Simulator(loop.diagram)
    simulator.Initialize()
    assert watch.told() == {}
    for k in range(1, 131):
        simulator.AdvanceTo(0.02 * k)
        watch.poll(simulator.get_context())
    told = watch.told()["preview"]
    arm = np.linalg.norm(loop.model.tool_pose(HOME).translation()[:2])  # about the first joint's axis
    assert told["ahead_s"] == AHEAD
    assert told["tool_error_mm"]["median"] == pytest.approx(1e3 * turn * arm, rel=0.15, abs=3.0)
    assert told["tool_moved_mm"]["median"] == pytest.approx(1e3 * 0.1 * np.sqrt(2) * arm, rel=0.35)
    assert "held_error_mm" not in told
