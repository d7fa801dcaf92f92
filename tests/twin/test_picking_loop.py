"""An object is picked and placed in contact simulation; where it stands is told at the start, for images take long."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram.planning.tasks.step_state import NOTE_FIELDS, Note, Phase, TaskOutcome, TaskState, Why
from twin_diagram.runs.task_score import TaskScore
from twin_diagram.scenario import Pose, Scenario, load_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.layouts import PoseMeasurement
from twin_diagram.signals.pose_vectors import compose
from twin_diagram.station import ports
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop

AT = (0.5, -0.32, 0.051)
UPON = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0, -0.081, 0.0, 0.03])
"""Where the can stands upon a cracker box that lies flat, in the box's frame."""


class ToldOnce(LeafSystem):
    """Perception that sees the can where it stood at the start, and after a while, mostly once it is held, no more."""

    def __init__(self, seen_until: float) -> None:
        super().__init__()
        self.seen_until = seen_until
        size = len(PoseMeasurement(0.0, 0.0, np.zeros(7), np.zeros((6, 6))).pack())

        def calc(context: Context, output: BasicVector) -> None:
            now = context.get_time()
            pose = np.array([1.0, 0, 0, 0, *AT])
            image = np.floor(15.0 * now) / 15.0
            covariance = np.diag([1e-4] * 3 + [1e-6] * 3)
            output.SetFromVector(PoseMeasurement(float(now < self.seen_until), image, pose, covariance).pack())

        self.DeclareVectorOutputPort("object_poses", size, calc, {self.time_ticket()})


UNTIL_HELD = np.inf


def loop_of(*overrides: str, seen_until: float = UNTIL_HELD) -> ClosedLoop:
    plan: Scenario = load_scenario("pick_and_place", ["twin.camera.rate=15", *overrides])
    plan.world.objects = {"can": plan.world.objects["can"]}
    plan.twin.library = {"can": plan.twin.library["can"]}
    return make_closed_loop(plan, perception=ToldOnce(seen_until))


def state_of(loop: ClosedLoop, context: Context) -> TaskState:
    runner: Any = loop.twin.runner
    twin = loop.twin.diagram
    return runner.remembered(twin.GetSubsystemContext(runner, twin.GetMyContextFromRoot(context)))  # type: ignore[no-any-return]


def tool_of(loop: ClosedLoop, context: Context) -> Array:
    """Where the tool is estimated to be [m]."""
    runner: Any = loop.twin.runner
    twin = loop.twin.diagram
    state = runner.GetInputPort("arm_state").Eval(twin.GetSubsystemContext(runner, twin.GetMyContextFromRoot(context)))
    return np.array(loop.model.tool_pose(state[: len(state) // 2]).translation())


def run(loop: ClosedLoop, most: float) -> tuple[TaskState, dict[str, Any]]:
    """Run until the task is over; the score is that of the end."""
    simulator, score = Simulator(loop.diagram), TaskScore(loop)
    context = simulator.get_mutable_context()
    state = state_of(loop, context)
    told = next(system for system in loop.twin.diagram.GetSystems() if isinstance(system, ToldOnce))
    while state.outcome is TaskOutcome.RUNNING and context.get_time() < most:
        simulator.AdvanceTo(context.get_time() + 0.02)
        score.poll(context)
        state = state_of(loop, context)
        if told.seen_until == UNTIL_HELD and state.hand.held != NOTHING:
            told.seen_until = context.get_time()
    return state, score.told(context)


@pytest.mark.slow
def test_a_can_heavier_than_told_is_carried_across() -> None:
    state, score = run(loop_of("world.objects.can.mass=1.2"), most=12.0)
    assert state.outcome is TaskOutcome.DONE, (state.phase, state.why)
    assert score["placed"]["can"]["off_mm"] < 10.0 and score["placed"]["can"]["off_deg"] < 5.0
    assert score["collisions"] == {"point": 0, "surface": 0}, score["touched"]


@pytest.mark.slow
def test_what_slips_in_the_hand_is_seen_to_and_put_where_it_belongs() -> None:
    """Let go for an instant half way, the can slides down between the fingers and tilts; images tell by how much."""
    plan: Scenario = load_scenario("pick_and_place", ["world.objects.can.mass=0.8"])
    plan.world.objects = {"can": plan.world.objects["can"]}
    plan.twin.library = {"can": plan.twin.library["can"]}
    loop = make_closed_loop(plan)
    simulator, score = Simulator(loop.diagram), TaskScore(loop)
    context = simulator.get_mutable_context()
    runner: Any = loop.twin.runner
    own = loop.twin.diagram.GetMutableSubsystemContext(runner, loop.twin.diagram.GetMyMutableContextFromRoot(context))
    state, let_go = state_of(loop, context), np.inf
    while state.outcome is TaskOutcome.RUNNING and context.get_time() < 14.0:
        simulator.AdvanceTo(context.get_time() + 0.01)
        score.poll(context)
        state = state_of(loop, context)
        if state.phase is Phase.CARRY and np.isinf(let_go) and tool_of(loop, context)[1] >= -0.05:
            let_go = context.get_time()  # before the middle, where the hand is at its fastest
        weak = context.get_time() - let_go
        if 0.0 <= weak < 0.065:
            force = 1.0 if weak < 0.055 else 60.0
            own.get_mutable_discrete_state(0).set_value(replace(state, force=force).pack())
    assert state.outcome is TaskOutcome.DONE, (state.phase, state.why)
    slips = [entry for entry in runner.told(own) if entry["what"] == "slipped"]
    assert 1 <= len(slips) <= 2 and slips[0]["by_mm"] > 8.0, slips
    told = runner.standing(own)["in_hand"]
    assert told["slips"] == len(slips) and told["moved_mm"] > 8.0 and 0.0 < told["moved_mm_std"] < 2.0
    placed = score.told(context)
    assert placed["placed"]["can"]["off_mm"] < 10.0 and placed["placed"]["can"]["off_deg"] < 5.0
    assert placed["collisions"] == {"point": 0, "surface": 0}, placed["touched"]


@pytest.mark.slow
def test_a_can_is_put_upon_a_box_where_that_lies_and_taken_off_again() -> None:
    """The box lies flat, by images alone; goals are told in its frame, and nothing is touched that no step asks for."""
    goal = "{translation: [-0.081, 0, 0.03], rpy: [0, -1.570796, 0]}"
    upon = f"{{kind: place, upon: cracker_box, goal: {goal}}}"
    pick, back = "{kind: pick, object: can, force: 60}", "{kind: place, goal: {translation: [0.5, -0.1, 0.051]}}"
    plan: Scenario = load_scenario("pick_and_place", [f"twin.task.steps=[{pick}, {upon}, {pick}, {back}]"])
    lies = Pose(translation=[0.52, 0.28, 0.03], rpy=[0.0, 1.570796, 0.4])
    box = replace(plan.world.objects["sugar_box"], asset="objects/cracker_box", X_WO=lies)
    plan.world.objects = {"can": plan.world.objects["can"], "cracker_box": box}
    plan.twin.library = {"can": plan.twin.library["can"], "cracker_box": "objects/cracker_box"}
    loop = make_closed_loop(plan)
    simulator, score = Simulator(loop.diagram), TaskScore(loop)
    context = simulator.get_mutable_context()
    state, off = state_of(loop, context), np.inf
    while state.outcome is TaskOutcome.RUNNING and context.get_time() < 16.0:
        simulator.AdvanceTo(context.get_time() + 0.02)
        score.poll(context)
        before, state = state, state_of(loop, context)
        if state.step == 2 != before.step:  # what has just been put down stands there, where the box truly lies
            station: Any = loop.station
            truth = station.GetOutputPort(ports.OBJECT_POSES).Eval(station.GetMyContextFromRoot(context))
            off = float(np.linalg.norm(truth[4:7] - compose(truth[7:], UPON)[4:]))
    assert state.outcome is TaskOutcome.DONE, (state.step, state.phase, state.why)
    told = score.told(context)
    assert told["placed"]["can"]["off_mm"] < 10.0 and told["placed"]["can"]["off_deg"] < 5.0
    assert off < 0.01
    assert told["collisions"] == {"point": 0, "surface": 0}, told["touched"]


@pytest.mark.slow
def test_a_can_that_the_fingers_cannot_carry_is_missed_and_said_to_be() -> None:
    """Squeezed with a fifth of what its weight asks for it stays behind; after its tries the step has failed."""
    light = "twin.task.steps.0.force=1.0"
    state, _ = run(loop_of(light, "world.objects.can.mass=1.2", "twin.task.steps.0.tries=1", seen_until=99.0), most=9.0)
    notes = [Note(int(row[2])) for row in state.notes.reshape(-1, NOTE_FIELDS) if row[0] >= 0]
    assert state.outcome is TaskOutcome.FAILED and Note.FAILED in notes
    assert state.why in (Why.DROPPED, Why.SEEN_ELSEWHERE, Why.MISSED)
    assert not state.goal.any()
