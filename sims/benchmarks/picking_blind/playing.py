"""Plays a script on the simulated arm, with nothing that looks, and scores it as a run of the closed loop is scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem, System

from picking_blind.script import Script, fingers_of
from twin_diagram.planning.tasks.step_state import TaskState
from twin_diagram.planning.tasks.task_system import Fingers
from twin_diagram.runs.task_score import TaskScore
from twin_diagram.runs.trial import sample_times
from twin_diagram.runtime.threads import one_thread
from twin_diagram.station import ports
from twin_diagram.station.make_station import make_station
from twin_diagram.twin.closed_loop import ClosedLoop

SETTLED = 1.0
"""So long after the script's end it is seen what came of it [s]: what was let go tilting lies by then."""


class Player(LeafSystem):
    """Commands what a script says.

    .. pydrake_system::

        name: Player
        output_ports:
        - arm.position_commanded
        - gripper.position_commanded
        - gripper.force_limit

    Latency: none; a pure function of time.
    """

    def __init__(self, script: Script, start: float, fingers: Fingers) -> None:
        """Play a script from `start` [s] on; `fingers` say what it is to be open by a share."""
        super().__init__()
        self.set_name("player")

        def state(context: Context) -> TaskState:
            return script.state_at(context.get_time() - start)

        def arm(context: Context, output: BasicVector) -> None:
            output.SetFromVector(script.at(context.get_time() - start))

        def grip(context: Context, output: BasicVector) -> None:
            begun = context.get_time() >= start
            output.SetFromVector(fingers.at(state(context).opened) if begun else fingers.described)

        def force(context: Context, output: BasicVector) -> None:
            output.SetFromVector([state(context).force])

        self.DeclareVectorOutputPort(ports.POSITION_COMMANDED, len(script.home), arm)
        self.DeclareVectorOutputPort(ports.GRIPPER_COMMANDED, len(fingers.closed), grip)
        self.DeclareVectorOutputPort(ports.GRIPPER_FORCE_LIMIT, 1, force)


class ScriptScore(TaskScore):
    """Watches contacts of an arm that plays a script: what a step asks for is what the script is at."""

    def __init__(self, loop: ClosedLoop, script: Script, start: float) -> None:
        """`loop` has the station that is played on."""
        super().__init__(loop)
        self._script, self._start = script, start

    def _state(self, context: Context) -> TaskState:
        return self._script.state_at(context.get_time() - self._start)


@one_thread()
def play(loop: ClosedLoop, script: Script) -> Mapping[str, Any]:
    """Return what of a ``summary.json`` tells how a script went: `task`.

    Args:
        loop: whose twin wrote the script; a new station of its world is played on, from its begin.
        script: at the speed that is wanted.
    """
    scenario, start = loop.scenario, loop.scenario.twin.task.start
    station = make_station(scenario)
    builder = DiagramBuilder()
    builder.AddNamedSystem("station", station)
    player: System = builder.AddSystem(Player(script, start, fingers_of(loop)))
    for name in ports.output_names(player):
        builder.Connect(player.GetOutputPort(name), station.GetInputPort(name))
    simulator = Simulator(builder.Build())
    score = ScriptScore(replace(loop, station=station), script, start)
    simulator.Initialize()
    for time in sample_times(start + script.took + SETTLED, scenario.world.time_step):
        simulator.AdvanceTo(time)
        score.poll(simulator.get_context())
    events = [{"time": start}, {"time": start + script.took}]
    return {"task": {"outcome": "done", "events": events} | score.told(simulator.get_context())}


def look(loop: ClosedLoop) -> Simulator:
    """Return a simulator of a loop, advanced to where its task begins: images have come, and nothing has moved."""
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    simulator.AdvanceTo(loop.scenario.twin.task.start)
    return simulator
