"""Table III of SyncTwin: half hidden things are grasped, lifted and held, before and after they were completed."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.systems.analysis import Simulator

from synctwin_truth.half_hidden import Draw, drawn
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.planning.grasps import PANDA_HAND, propose
from twin_diagram.planning.tasks.step_state import Phase, TaskOutcome, TaskState
from twin_diagram.scenario import Pose
from twin_diagram.scenario.file import copy_scenario
from twin_diagram.signals.layouts import TRACK_SIZE, Track
from twin_diagram.signals.pose_vectors import compose, errors, from_matrix, inverse
from twin_diagram.station import ports
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop

Array = npt.NDArray[np.float64]

LIFTED, IN_HAND, ELSEWHERE = 0.10, (0.010, float(np.radians(10.0))), 0.01
"""Height of a lift [m]; what a thing may move in the hand [m, rad]; what nothing else may move [m]."""
STEP = 0.02
"""Between two looks at the truth [s]."""


def attempt(kind: str, row: str, seed: int, profile: str) -> dict[str, Any]:
    """Run one table with grasps on what the camera saw (`before`) or on the asset (`after`); return how it ended."""
    begin = time.process_time()
    draw = drawn(kind, seed, profile)
    told = {"kind": kind, "row": row, "seed": seed, "profile": profile, "hidden": draw.share}
    if row == "before":
        grasp = grasp_on_what_is_seen(draw)
        if isinstance(grasp, str):
            return {**told, "good": False, "why": grasp, "cpu_s": time.process_time() - begin}
        scenario = copy_scenario(draw.scenario)
        scenario.twin.task.steps[0].goal = grasp
        draw = Draw(draw.name, scenario, draw.share)
    why = carried_out(draw)
    return {**told, "good": not why, "why": why, "cpu_s": time.process_time() - begin}


class Look:
    """Reads a running loop: what is true, and how the task stands."""

    def __init__(self, loop: ClosedLoop, simulator: Simulator) -> None:
        self._loop, self._context = loop, simulator.get_mutable_context()

    def objects(self) -> dict[str, Array]:
        """Return true X_WO (7) by name."""
        station = self._loop.station
        truth = np.array(station.GetOutputPort(ports.OBJECT_POSES).Eval(station.GetMyContextFromRoot(self._context)))
        return dict(zip(self._loop.scenario.world.objects, truth.reshape(-1, 7), strict=True))

    def task(self) -> TaskState:
        """Return how the task stands."""
        runner, twin = self._loop.twin.runner, self._loop.twin.diagram
        assert runner is not None
        return runner.remembered(twin.GetSubsystemContext(runner, twin.GetMyContextFromRoot(self._context)))

    def tool(self) -> Array:
        """Return X_WT (7) of the true arm, by its true angles."""
        station = self._loop.station
        arm: Any = station.GetOutputPort(ports.ARM_STATE).Eval(station.GetMyContextFromRoot(self._context))
        model = self._loop.twin.model
        return from_matrix(model.tool_pose(np.array(arm)[: len(model.joints)]).GetAsMatrix4())


def carried_out(draw: Draw) -> str:
    """Run a task; return what was wrong, nothing where it succeeded."""
    loop = make_closed_loop(draw.scenario)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    look = Look(loop, simulator)
    start = look.objects()
    in_hand: Array | None = None
    worst = np.zeros(2)
    high = 0.0
    for k in range(1, round(draw.scenario.duration / STEP) + 1):
        simulator.AdvanceTo(k * STEP)
        state, now = look.task(), look.objects()
        moved = {n: float(np.linalg.norm(now[n][4:] - start[n][4:])) for n in now if n != draw.name}
        if moved and max(moved.values()) > ELSEWHERE:
            return f"moved another thing: {max(moved, key=lambda n: moved[n])} ({state.phase.name.lower()})"
        if state.outcome is TaskOutcome.FAILED:
            return f"{state.why.name.lower()} in step {state.step}"
        if state.phase in (Phase.LIFT, Phase.MOVE, Phase.HOLD) and state.step <= 2:
            X_TO = compose(inverse(look.tool()), now[draw.name])
            in_hand = X_TO if in_hand is None else in_hand
            worst = np.maximum(worst, errors(in_hand, X_TO))
            if state.phase is Phase.HOLD:
                high = float(now[draw.name][6] - start[draw.name][6])
        if state.outcome is TaskOutcome.DONE:
            break
    else:
        return f"not done: {state.phase.name.lower()} in step {state.step}"
    if high < LIFTED:
        return "not lifted"
    if worst[0] > IN_HAND[0] or worst[1] > IN_HAND[1]:
        return f"moved in the hand by {1e3 * worst[0]:.0f} mm, {np.degrees(worst[1]):.0f}°"
    return ""


def grasp_on_what_is_seen(draw: Draw) -> Pose | str:
    """Return X_OG of the best grasp on the points that one picture shows, or why there is none.

    Where O is serves to say the same place to the task, and for nothing else.
    """
    scenario = copy_scenario(draw.scenario)
    loop = make_closed_loop(scenario)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    simulator.AdvanceTo(scenario.twin.task.start)
    twin = loop.twin.diagram
    context = twin.GetMyContextFromRoot(simulator.get_context())
    tracks = np.array(twin.GetOutputPort("tracks").Eval(context)).reshape(-1, TRACK_SIZE)
    track = Track.unpack(tracks[list(scenario.twin.library).index(draw.name)])
    source = next(system for system in twin.GetSystems() if system.HasOutputPort("segments"))
    segments: Segments = source.GetOutputPort("segments").Eval(source.GetMyContextFromRoot(simulator.get_context()))
    truth = np.array(draw.scenario.world.objects[draw.name].X_WO.translation)
    near = np.linalg.norm(segments.points_W - truth, axis=1)
    label = segments.labels[int(np.argmin(near))]
    mine = segments.labels == label
    a, b, c = segments.table
    plane = np.array([-a, -b, 1.0, c]) / np.linalg.norm([-a, -b, 1.0])
    points, normals = segments.points_W[mine], segments.normals_W[mine]
    if len(points) < 50:
        return "next to nothing of it is seen"
    beside = segments.points_W[~mine]
    around = beside[np.linalg.norm(beside - points.mean(axis=0), axis=1) < 0.3]
    order = np.random.default_rng(draw.scenario.seed).permutation(len(points))
    grasps = propose(
        points[order], normals[order], PANDA_HAND, count=10, seed=draw.scenario.seed,
        viewpoint=segments.camera.p_WC, table=plane, surroundings=around,
    )  # fmt: skip
    if not len(grasps):
        return f"no grasp: {grasps.why_empty()}"
    # From above nothing of the clutter is in the hand's way; from the side, where nothing else is had.
    best = next((k for k in range(len(grasps)) if grasps.approach[k, 2] < -0.5), 0)
    X_OG = compose(inverse(track.pose), grasps.poses[best])
    R = RotationMatrix(Quaternion(X_OG[:4] / np.linalg.norm(X_OG[:4])))
    return Pose([float(x) for x in X_OG[4:]], [float(x) for x in RollPitchYaw(R).vector()])
