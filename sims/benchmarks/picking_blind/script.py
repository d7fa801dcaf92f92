"""Writes down all that an arm does in a pick and place, from what its twin knows at the begin.

The steps are those of the task itself, run through as if everything came as planned: the tool gets exactly where it is
sent, the fingers close on the object, and that goes along. Grasps, ways and limits are the twin's own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.systems.analysis import Simulator

from twin_diagram.planning.collision.hand_shape import hand_shape
from twin_diagram.planning.collision.held_shape import obstacles_beside
from twin_diagram.planning.grasps.gripper import SHIPPED
from twin_diagram.planning.mpc.planner import MotionPlanner
from twin_diagram.planning.paths.guide import Question
from twin_diagram.planning.paths.situation import Aim, Route
from twin_diagram.planning.paths.time_optimal import SpeedProfile
from twin_diagram.planning.tasks.step_state import SENTENCES, Phase, Step, TaskOutcome, TaskState, Why, steps_of
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.planning.tasks.task_system import Fingers, takeable
from twin_diagram.planning.tasks.transitions import advance
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.layouts import TRACK_SIZE, PoseMeasurement, Track
from twin_diagram.signals.pose_vectors import compose, from_matrix
from twin_diagram.twin.closed_loop import ClosedLoop

TICK = 0.01
"""Of the steps [s]: as they run at twice a planner's 50 Hz."""
NO_IMAGE = PoseMeasurement(0.0, 0.0, np.zeros(7), np.zeros((6, 6)))
"""After the first image nothing is looked at."""


@dataclass(frozen=True)
class Ways:
    """Finds ways among what stood about at the begin.

    Attributes:
        planner: the twin's.
        radii: (K,) of balls about the library's objects [m].
        things: (T · THING_SIZE,) what nobody knows.
    """

    planner: MotionPlanner
    radii: Array
    things: Array

    def to(self, q: Array, state: TaskState, tracks: list[Track]) -> SpeedProfile | None:
        """Return the quickest way, rest to rest, from joint angles (n,) to a state's goal; None where none is found."""
        chain = self.planner.scene.chain
        X_WT = chain.tool(chain.place(q[None]))[0]
        packed = np.concatenate([track.pack() for track in tracks])
        around = obstacles_beside(state.hand, X_WT, self.radii, packed, None, self.things)
        guide = self.planner.guide
        if state.hand.held != NOTHING:
            guide = guide.holding(replace(state.hand, touched=NOTHING).pack().tobytes())
        line, free, _ = guide.line(q, state.goal, guide.scene.forecast(*around))
        if free:
            return guide.router.travel(q, Route(Aim.LINE, line))
        seed = (self.planner.params.seed, int(state.phase), 1)
        asked = Question(seed, q, state.goal, np.zeros((0, len(q))), True, *around, added=tuple(guide.scene.added))
        points = guide.answer(asked).points
        return guide.router.travel(q, Route(Aim.GOAL, points)) if len(points) else None


@dataclass
class Script:
    """What the arm and its fingers do, and when; times from the begin on, at full speed.

    Attributes:
        home: (n,) where the arm is at first [rad].
        ways: begins and ways, each from rest to rest, the first one's begin first.
        states: when what is true of the task; the hand as it is meant to be.
        took: how long all of it takes [s].
        why: why it is not complete; empty where it is.
    """

    home: Array
    ways: list[tuple[float, SpeedProfile]] = field(default_factory=list)
    states: list[tuple[float, TaskState]] = field(default_factory=list)
    took: float = 0.0
    why: str = ""

    def at(self, time: float) -> Array:
        """Return joint angles (n,) at a time [rad]."""
        begun = [way.at(np.array([time - begin]))[0] for begin, way in self.ways if begin <= time]
        return np.asarray(begun[-1]) if begun else self.home

    def state_at(self, time: float) -> TaskState:
        """Return how the task stands by then, if all is as it was planned."""
        return [state for begin, state in self.states if begin <= max(time, 0.0)][-1]

    def stretched(self, share: float) -> Script:
        """Return the same at a share of the speed; fingers take the time that they take."""
        result = Script(self.home, why=self.why)
        ends = [(begin, begin + way.duration) for begin, way in self.ways]
        slower = 1.0 / share - 1.0

        def later(time: float) -> float:
            return time + slower * sum(max(0.0, min(time, end) - begin) for begin, end in ends)

        result.ways = [
            (later(begin), replace(way, times=way.times / share, speeds=way.speeds * share)) for begin, way in self.ways
        ]
        result.states = [(later(begin), state) for begin, state in self.states]
        result.took = later(self.took)
        return result


def fingers_of(loop: ClosedLoop) -> Fingers:
    """Return the fingers as the twin is told of them."""
    scene = loop.twin.scene
    described = scene.default_positions[scene.gripper_position_index]
    palm = hand_shape(scene.plant, scene.scene_graph, scene.arm).palm
    return Fingers.of(scene.plant, scene.arm, described, scene.followers.widening, palm)


def write_script(loop: ClosedLoop, simulator: Simulator) -> Script:
    """Return what to do, from what the twin of a loop knows by now; nothing of its world is read.

    Args:
        loop: with a task of steps, and the planner of the twin's own.
        simulator: of it, advanced to where the task begins.
    """
    twin, told = loop.twin, loop.scenario.twin
    context = twin.diagram.GetMyContextFromRoot(simulator.get_context())
    rows = np.array(twin.diagram.GetOutputPort("tracks").Eval(context)).reshape(-1, TRACK_SIZE)
    q = np.array(twin.diagram.GetOutputPort("arm_state").Eval(context))[: len(loop.model.joints)]
    assert twin.mpc is not None
    radii = np.array([0.5 * float(np.linalg.norm(asset.size)) for asset in twin.library.values()])
    ways = Ways(twin.mpc.planner, radii, np.array(twin.diagram.GetOutputPort("things").Eval(context)))
    gripper = next(one for one in SHIPPED.values() if one.frame == told.arm.tool_frame)
    library = [takeable(asset, gripper) for asset in twin.library.values()]
    steps = steps_of(told.task, list(twin.library))
    return _run_through(Script(q.copy()), ways, [Track.unpack(row) for row in rows], steps, library, fingers_of(loop))


def _run_through(
    script: Script,
    ways: Ways,
    tracks: list[Track],
    steps: tuple[Step, ...],
    library: list[Takeable],
    fingers: Fingers,
) -> Script:
    """Return the script of a task's steps, or of what of them a way was found for."""
    chain, q, now, state = ways.planner.scene.chain, script.home, 0.0, TaskState()
    gone = np.zeros(7)
    while state.outcome is TaskOutcome.RUNNING:
        X_WT = from_matrix(chain.tool(chain.place(q[None]))[0])
        if state.hand.held != NOTHING:
            there = compose(X_WT, state.hand.X_TO)
            tracks[state.hand.held] = replace(tracks[state.hand.held], pose=there)
        # Whatever was seen at the begin is believed as if it were seen now.
        tracks = [replace(track, last_seen=now) for track in tracks]
        # Fingers that hold something are open by something: how far is for nobody to know.
        opening = fingers.widest if state.opened > 0.0 else 0.5 * fingers.widest
        seen = StepView(
            now, X_WT, 0.0, tracks, [NO_IMAGE] * len(tracks), opening, 0.0, fingers.widest, 1.0, palm=fingers.palm
        )
        state = advance(state, seen, steps, library)
        script.states.append((now, state))
        if not state.goal.any() or np.array_equal(state.goal, gone):
            now += TICK
            continue
        way = ways.to(q, state, tracks)
        if way is None:
            script.why = f"{SENTENCES[Why.NO_WAY]} ({state.phase.name.lower()})"
            break
        script.ways.append((now, way))
        now, q, gone = now + way.duration, way.at(np.array([way.duration]))[0], state.goal.copy()
    if state.outcome is TaskOutcome.FAILED:
        script.why = SENTENCES[state.why]
    assert script.why or state.phase is Phase.REST
    script.took = now
    return script
