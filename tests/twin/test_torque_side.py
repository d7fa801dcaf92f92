"""A twin of an arm that measures behind its gears: the filter's model has no rotors, and follows the arm as well."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tests.small_loop import BLIND, small_scenario
from twin_diagram.errors import ScenarioError
from twin_diagram.signals.arrays import Array
from twin_diagram.station import ports
from twin_diagram.twin.closed_loop import make_closed_loop


def followed(*overrides: str) -> tuple[Array, Array]:
    """Speeds as estimated and as they truly are (K, n), of an arm on its way."""
    plan = small_scenario(*BLIND, "twin.task.start=0.0", *overrides, objects=())
    loop = make_closed_loop(plan)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    rows = []
    for now in np.arange(0.3, 1.3, 0.1):
        simulator.AdvanceTo(now)
        context = simulator.get_context()
        twin, station = loop.twin.diagram, loop.station
        estimated = np.array(twin.GetOutputPort("arm_state").Eval(twin.GetMyContextFromRoot(context)))
        true = np.array(station.GetOutputPort(ports.ARM_STATE).Eval(station.GetMyContextFromRoot(context)))
        n = len(true) // 2
        rows.append((estimated[n : 2 * n], true[n:]))
    both = np.array(rows)
    return both[:, 0], both[:, 1]


@pytest.mark.long
def test_the_filter_follows_on_either_side() -> None:
    off = {}
    for side in ("motor", "link"):
        estimated, true = followed(f"twin.driver.torque_side={side}")
        assert np.abs(true).max() > 0.05, "it moves"
        off[side] = float(np.sqrt(np.mean((estimated - true) ** 2)))
    assert off["link"] < 1.3 * off["motor"] and off["link"] < 0.02


def test_another_side_is_refused_with_its_field() -> None:
    with pytest.raises(ScenarioError, match=r"twin\.driver\.torque_side.*motor, link"):
        make_closed_loop(small_scenario(*BLIND, "twin.driver.torque_side=gear", objects=()))
