"""Colours and depth that are not taken at once."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.station.sim.test_camera import Clock
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.sim.exposure_shutter import ExposureShutter


@pytest.mark.parametrize("latency", [0.03, 0.08])
@pytest.mark.parametrize("delay", [0.0, 0.05, 0.02])
def test_depth_is_taken_before_its_colours_and_both_come_together(latency: float, delay: float) -> None:
    builder = DiagramBuilder()
    clock = builder.AddSystem(Clock())
    shutter = builder.AddSystem(ExposureShutter(np.array([7.0, 8.0]), 10.0, latency, delay))
    builder.Connect(clock.get_output_port(), shutter.get_input_port())
    simulator = Simulator(builder.Build())
    context = shutter.GetMyContextFromRoot(simulator.get_context())
    times = np.array([-0.001, 0.001, 0.099, 0.101, 0.199, 0.201]) + latency
    for time, taken in zip(times, (NEVER, 0.0, 0.0, 0.1, 0.1, 0.2), strict=True):
        simulator.AdvanceTo(time)
        colour, depth, when = (
            shutter.GetOutputPort(name).Eval(context) for name in ("colour_state", "depth_state", "capture_time")
        )
        assert when[0] == pytest.approx(taken), time
        first = [7.0, 8.0] if delay > 0 else [0.0, 10.0]
        np.testing.assert_allclose(colour, [7.0, 8.0] if taken < 0 else [taken, 10.0 + taken], atol=1e-9)
        early = [7.0, 8.0] if taken < 0 else first if taken == 0.0 else [taken - delay, 10.0 + taken - delay]
        np.testing.assert_allclose(depth, early, atol=1e-9)
