"""Closed loops that are small enough to run in a test: few objects, small images, the tabletop otherwise."""

from __future__ import annotations

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.twin.closed_loop import ClosedLoop

ESTIMATES = ("arm_state", "parameters", "covariance", "object_poses", "tracks", "alarm_log")
SMALL_IMAGES = ("twin.camera.width=320", "twin.camera.height=240", "twin.camera.focal=300", "twin.perception.stride=1")
BLIND = ("twin.camera=null",)


def small_scenario(*overrides: str, objects: tuple[str, ...] = ("can", "sugar_box")) -> Scenario:
    """The tabletop with some of its objects and small images."""
    scenario = load_scenario("tabletop", [*SMALL_IMAGES, *overrides])
    scenario.world.objects = {name: scenario.world.objects[name] for name in objects}
    scenario.twin.library = {name: scenario.twin.library[name] for name in objects}
    return scenario


def estimates(loop: ClosedLoop, context: Context) -> dict[str, Array]:
    """All that the twin believes, copied."""
    twin = loop.twin.diagram
    own = twin.GetMyContextFromRoot(context)
    names = [name for name in ESTIMATES if twin.HasOutputPort(name)]
    return {name: np.array(twin.GetOutputPort(name).Eval(own)) for name in names}


def watch(loop: ClosedLoop, times: list[float], context: Context | None = None) -> list[dict[str, Array]]:
    """Runs a loop and looks at its estimates at some times."""
    simulator = Simulator(loop.diagram, context) if context is not None else Simulator(loop.diagram)
    simulator.Initialize()
    return [at(loop, simulator, time) for time in times]


def at(loop: ClosedLoop, simulator: Simulator, time: float) -> dict[str, Array]:
    """Advances to a time and looks at the estimates there."""
    simulator.AdvanceTo(time)
    return estimates(loop, simulator.get_context())


def same(first: list[dict[str, Array]], second: list[dict[str, Array]]) -> list[str]:
    """Which estimates differ in any bit, by name and index of the time."""
    assert len(first) == len(second)
    return [
        f"{name} at sample {k}"
        for k, (a, b) in enumerate(zip(first, second, strict=True))
        for name in a.keys() | b.keys()
        if name not in a or name not in b or a[name].tobytes() != b[name].tobytes()
    ]
